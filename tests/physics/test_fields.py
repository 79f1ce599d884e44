"""What goes in and comes out: initial fields that no film can have, and frames whose numbers agree with each other."""

import dataclasses

import numpy as np
import pytest

from melp_warp.cluster import Bubble, Cluster
from melp_warp.errors import InputError
from melp_warp.frame import BLACK_FILM
from melp_warp.material import Material, Surroundings
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Sphere
from melp_warp.simulation import Simulation

R = 0.05
FALLING = Surroundings(gravity=(0.0, -9.81, 0.0))
MATERIAL = Material()
BARE = MATERIAL.tension / MATERIAL.rt
"""Surfactant that leaves no tension, mol/m^2."""


def scene_of(name, **values):
    script = load_scene(name)
    return script.build(script.parameters.values(values))


def flight(x):
    return np.tile([1.0, 0.0, 0.0], (len(x), 1))


MOVING = {
    "giant_bubble": lambda: scene_of("giant_bubble", e_count=500, l_per_e=4, fps=240.0, dt=1.0 / 480.0),
    "oscillating_bubble": lambda: scene_of("oscillating_bubble", e_count=500),
    "a bubble that flies and falls": lambda: Scene(
        "flying", Sphere(R), 400, 4, surroundings=FALLING, velocity=flight, fps=240.0
    ),
    "two bubbles that meet": lambda: scene_of("double_bubble", e_count=400, l_per_e=4, fps=240.0),
    "drainage": lambda: scene_of("drainage", e_count=300, l_per_e=4, fps=240.0),
    "a single layer": lambda: scene_of("drainage", e_count=300, layers=1, fps=240.0),
}


@pytest.mark.parametrize("name", MOVING)
def test_velocities_are_those_of_the_points(name):
    """(x(t + h) - x(t))/h lies between v(t) and v(t + h), for L and for E, which move past the liquid.

    As rms over the particles: off the mean of both by no more than half of their difference, and 6 % of the speed, for
    projection and the bend of paths. Without redistribution, which samples the film anew: a shift is no motion.
    """
    scene = MOVING[name]()
    still = dataclasses.replace(scene.numerics, redistribution=0.0)
    simulation = Simulation(dataclasses.replace(scene, numerics=still))
    sets = "el" if simulation.has_l else "e"
    for _ in range(4):
        simulation.advance_frame()
    for _ in range(3):
        before = [simulation.particles(which) for which in sets]
        simulation.advance_frame()
        for one, two in zip(before, (simulation.particles(which) for which in sets), strict=True):
            way = simulation.scene.fps * (two.points.astype(np.float64) - one.points)
            mean, change = 0.5 * (one.velocities + two.velocities), two.velocities - one.velocities
            off, half, speed = (np.sqrt(np.sum(a**2, axis=1).mean()) for a in (way - mean, 0.5 * change, way))
            assert off <= 1.1 * half + 0.06 * speed


def test_e_of_a_flat_film_stand_still():
    """The liquid swirls past them."""
    simulation = Simulation(scene_of("taylor_vortices", e_count=400, l_per_e=4))
    assert not np.any(simulation.particles("e").velocities)
    assert np.abs(simulation.particles("l").velocities).max() > 0.1


@pytest.mark.parametrize("l_per_e", [0, 4])
def test_black_film_is_marked(l_per_e):
    """1 up to 12 nm, 0 beyond: for a bubble of 8 nm on one half and 300 nm on the other."""
    scene = Scene("black", Sphere(R), 400, l_per_e, thickness=lambda x: np.where(x[:, 1] > 0.0, 8e-9, 300e-9))
    frame = Simulation(scene).particles("l" if l_per_e else "e")
    np.testing.assert_array_equal(frame.black_film, frame.thickness <= BLACK_FILM)
    assert 0.4 < frame.black_film.mean() < 0.6


def spot(value, otherwise):
    """A field with another value around (R, 0, 0)."""
    return lambda x: np.where(x[:, 0] > 0.8 * R, value, otherwise)


def bad_velocity(x):
    return np.stack([np.where(x[:, 0] > 0.8 * R, np.nan, 0.0), 0.0 * x[:, 0], 0.0 * x[:, 0]], axis=1)


@pytest.mark.parametrize("l_per_e", [0, 2])
@pytest.mark.parametrize(
    ("field", "function", "words"),
    [
        ("concentration", spot(1.2 * BARE, 1e-7), ["concentration must be below", f"{BARE:.3g}", f"{1.2 * BARE:.3g}"]),
        ("concentration", spot(-1e-9, 1e-7), ["concentration must be at least 0", "-1e-09"]),
        ("concentration", spot(np.inf, 1e-7), ["concentration must be finite", "inf"]),
        ("thickness", spot(-1e-9, 4e-7), ["thickness must be above 0", "-1e-09"]),
        ("thickness", spot(np.nan, 4e-7), ["thickness must be finite", "nan"]),
        ("thickness", spot(2e-3, 4e-7), ["thickness must be at most 0.001", "0.002"]),
        ("thickness", lambda x: np.full((len(x), 1), 4e-7), ["thickness must be a field of shape"]),
        ("velocity", bad_velocity, ["velocity must be finite", "nan"]),
        ("velocity", lambda x: x[:, 0], ["velocity must be a field of shape"]),
    ],
)
def test_a_field_that_no_film_can_have_is_refused(field, function, words, l_per_e):
    with pytest.raises(InputError) as error:
        Simulation(Scene("bad", Sphere(R), 300, l_per_e, **{field: function}))
    for word in words:
        assert word in str(error.value)


def test_a_bubble_of_little_tension_takes_less_surfactant():
    """A tenth of the tension leaves none where the others have nine tenths."""
    bubbles = (Bubble((-R, 0.0, 0.0), R), Bubble((R, 0.0, 0.0), R, tension=0.1))
    with pytest.raises(InputError, match="surfactant must be below"):
        Simulation(Scene("weak", Cluster(bubbles), 400, material=Material(surfactant=0.5 * BARE)))


def test_surfactant_that_gathers_beyond_its_tension_is_said():
    """A film whose liquid runs together at 20 m/s on its middle; nothing is said while there is tension left."""
    rich = Material(surfactant=0.6 * BARE)
    quiet = Simulation(Scene("quiet", Disc(R), 300, 4, material=rich))
    quiet.advance_frame()
    assert not quiet.notices
    simulation = Simulation(Scene("inwards", Disc(R), 300, 4, material=rich, velocity=lambda x: -2000.0 * x, dt=2e-4))
    least = []
    for _ in range(8):
        simulation.step(2e-4)
        simulation.stepper.fields.remark(simulation.notices)
        gamma = simulation.stepper.fields.gamma.numpy().astype(np.float64).max()
        least.append(rich.tension - rich.rt * rich.surfactant * gamma)
    assert min(least) < 0.0
    assert simulation.notices.of_frame["no tension left"] == pytest.approx(-min(least), rel=1e-5)
