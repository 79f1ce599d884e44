"""The state is whole: runs that go back, that are written, that are loaded, and plain ones give the same bits."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from melp_warp import features
from melp_warp.bursting import Bursting, Puncture
from melp_warp.cluster import Bubble, Cluster, Merge, Pop, Wall
from melp_warp.errors import CrowdedError
from melp_warp.material import Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Cap, Disc, Rectangle, Sphere, StarShaped
from melp_warp.simulation import Simulation
from melp_warp.study import limits
from melp_warp.study.validation import small_giant

AIR = Surroundings(air="added_mass")
CARRIED = Numerics(carrier="circulation")
DOWN = Surroundings(gravity=(0.0, -9.81, 0.0))


def whirl(x):
    """An uneven flow, m/s."""
    return np.stack([0.5 * np.sin(40.0 * x[:, 2]), 0.0 * x[:, 0], 0.5 * np.cos(30.0 * x[:, 0])], axis=1)


def blow(x):
    """Out of the plane of a drum, none at its rim, m/s."""
    return (0.2 + 5.0 * x[:, :1]) * (1.0 - np.sum(x**2, axis=1, keepdims=True) / 0.05**2) * [0.1, 1.0, -0.2]


def ridged(radius):
    """A ball out of shape."""
    return StarShaped(radius, lambda d: 0.2 * d[:, 0] ** 2 - 0.1 * d[:, 1])


def foam(**options):
    bubbles = limits.meeting(0.3, e_count=400)
    surroundings = Surroundings(damping=20.0, air="added_mass")
    return Scene(
        "foam",
        Cluster(bubbles, **options),
        400,
        3,
        numerics=Numerics(cfl=0.5, exchange=50.0),
        surroundings=surroundings,
    )


def floor():
    """Bubbles that merge, pop, come later, and reach a wall that pops them; one stands on a floor."""
    bubbles = (
        Bubble((-0.0105, 0.04, 0.0), 0.01),
        Bubble((0.0105, 0.04, 0.0), 0.01, thickness=500e-9),
        Bubble((0.0, 0.0105, 0.05), 0.01),
        Bubble((0.0, 0.0105, -0.05), 0.01, velocity=(0.0, 0.0, -0.5)),
        Bubble((0.0, 0.0105, 0.08), 0.01, born=0.03),
    )
    walls = (Wall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), Wall((0.0, 0.0, -0.07), (0.0, 0.0, 1.0), pops=True))
    cluster = Cluster(bubbles, walls, (Pop(0.04, 2), Merge(0.045, 0, 1)))
    surroundings = Surroundings(air="added_mass", damping=20.0)
    numerics = Numerics(cfl=0.5, exchange=50.0)
    return Scene("floor", cluster, 800, 1, numerics=numerics, surroundings=surroundings, dt=1.0 / 240.0)


def gone():
    """The only bubble pops in the frame before what is done between, in the last one another comes."""
    bubbles = (Bubble((0.0, 0.0, 0.0), 0.01), Bubble((0.0, 0.0, 0.05), 0.01, born=0.055))
    return Scene("gone", Cluster(bubbles, events=(Pop(0.03, 0),)), 200, 1)


def punctured(shape, place, l_per_e):
    """A film whose rim breaks into drops."""
    bursting = Bursting((Puncture(place, 0.0005),))
    return Scene("burst", shape, 400, l_per_e, fps=1000.0, bursting=bursting)


SCENES = {
    "closed": lambda: small_giant(300, 4),
    "auto": lambda: small_giant(300, 4, dt=None, air="none"),
    "vacuum": lambda: Scene("vacuum", ridged(0.05), 300, 3, velocity=whirl, dt=1.0 / 240.0),
    "midpoint": lambda: Scene(
        "midpoint", ridged(0.05), 300, 0, numerics=Numerics(scheme="trapezoid"), surroundings=AIR, dt=1.0 / 240.0
    ),
    "explicit": lambda: Scene(
        "explicit", ridged(0.05), 200, 2, numerics=Numerics(scheme="explicit"), dt=1.0 / 4000.0, fps=300.0
    ),
    "flat": lambda: Scene("flat", Disc(0.05), 300, 4, velocity=whirl, surroundings=DOWN),
    "drum": lambda: Scene("drum", Disc(0.05, flat=False), 300, 0, velocity=blow, dt=1.0 / 480.0),
    "wet drum": lambda: Scene("drum", Disc(0.05, flat=False), 300, 3, velocity=blow, dt=1.0 / 480.0, surroundings=AIR),
    "cap": lambda: Scene("cap", Cap(0.1, 30.0), 300, 2, surroundings=AIR, fps=600.0, dt=1.0 / 2400.0),
    "levels": lambda: small_giant(300, 4),
    "foam": foam,
    "floor": floor,
    "single": lambda: Scene(
        "single", ridged(0.05), 300, velocity=whirl, numerics=Numerics(layers=1), fps=300.0, surroundings=AIR
    ),
    "gone": gone,
    "vortices": lambda: small_giant(300, 4, carrier="circulation"),
    "vortices in a disc": lambda: Scene("flat", Disc(0.05), 300, 4, velocity=whirl, numerics=CARRIED),
    "vortices in a foam": lambda: replace(foam(), numerics=Numerics(cfl=0.5, exchange=50.0, carrier="circulation")),
    "burst": lambda: punctured(Sphere(0.05), (0.0, 0.05, 0.0), 2),
    "burst sheet": lambda: punctured(Rectangle(0.1, 0.1), (0.01, 0.0, 0.0), 1),
    "flat single": lambda: Scene("single", Disc(0.05), 300, velocity=whirl, numerics=Numerics(layers=1), fps=300.0),
}


LONG, SLOW = ("floor", "vortices in a foam"), pytest.mark.slow

BEFORE, AFTER = 2, 2
"""Frames before and after what is done between."""


def all_of(simulation):
    """All that evolves, by name."""
    course = {f"course.{k}": v for k, v in dataclasses.asdict(simulation.state.course).items()}
    seen = {
        f"seen.{k}": np.array([*values, *note]) for k, (values, note) in enumerate(simulation.state.seen.contents())
    }
    shown = {}
    for which in ("e", "l") if simulation.has_l else ("e",):
        shown |= {f"shown.{which}.{k}": v for k, v in vars(simulation.particles(which)).items()}
    return {**simulation.state.numpy(), **course, **seen, **shown}


def advanced(simulation, frames, each=lambda: None):
    """What a simulation has become after some more frames, with a call after each."""
    for _ in range(frames):
        simulation.advance_frame()
        each()
    return all_of(simulation)


def assert_same(found, expected, what):
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        np.testing.assert_array_equal(found[key], value, err_msg=f"{what}: {key}")


def fail_at(simulation, count, monkeypatch):
    """Let the `count`-th step from now find a list full, once: the frame is done again with more room."""
    step, left = simulation.step, [count]

    def stumble(dt):
        left[0] -= 1
        step(dt)
        if left[0] == 0:
            raise CrowdedError("stage neighbors: a list is full")

    monkeypatch.setattr(simulation, "step", stumble)


@pytest.mark.parametrize("name", [pytest.param(name, marks=SLOW if name in LONG else ()) for name in SCENES])
def test_same_bits_whatever_is_done_between(name, tmp_path, monkeypatch):
    """Plain; done again in the middle of a frame; looked at and written after each frame; loaded and rebuilt twice."""
    monkeypatch.setattr(features, "COARSE_FROM", 0 if name == "levels" else features.COARSE_FROM)
    scene, file = SCENES[name](), tmp_path / "c.npz"
    plain = advanced(Simulation(scene), BEFORE + AFTER)

    written = Simulation(scene)

    def look_and_write():
        written.diagnostics()
        written.particles("l" if written.has_l else "e")
        written.particles("e")
        written.save_checkpoint(file if written.frame == BEFORE else tmp_path / "other.npz")

    assert_same(advanced(written, BEFORE + AFTER, look_and_write), plain, "written")

    loaded = Simulation(scene, checkpoint=file)
    before = all_of(loaded)
    for _ in range(2):
        loaded.rebuild()
        assert_same(all_of(loaded), before, "rebuilt")
    assert_same(advanced(loaded, AFTER), plain, "loaded")

    again = Simulation(scene)
    advanced(again, BEFORE)
    fail_at(again, 2, monkeypatch)
    room = again.film.room
    assert_same(advanced(again, AFTER), plain, "done again")
    assert again.film.room == 2.0 * room


def test_lists_and_fits_are_old_when_a_run_is_loaded():
    """The scenes above would show nothing if lists were built in the last step of a frame, or nothing were solved."""
    for name in ("closed", "vacuum", "foam"):
        simulation = Simulation(SCENES[name]())
        found = advanced(simulation, BEFORE)
        for one, other in (("memory.x", "e.x"), ("memory.x_l", "l.x"), ("memory.place", "e.x")):
            assert not np.array_equal(found[one], found[other]), (name, one)
