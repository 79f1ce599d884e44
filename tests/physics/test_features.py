"""Features that are off cost nothing, a coefficient of zero is the feature off, failures leave the last good frame."""

import math

import numpy as np
import pytest

from melp_warp.errors import SimulationError
from melp_warp.features import Features
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Rectangle, Sphere, displaced_sphere
from melp_warp.simulation import Simulation
from melp_warp.study import validation as v


def eddies(x):
    return 0.05 * np.stack([np.sin(60.0 * x[:, 1]), np.cos(40.0 * x[:, 0]), 0.0 * x[:, 0]], axis=1)


def flat(count=5, **material_and_air):
    """A flat film after `count` steps; `drag`, `flip` and `flow` besides what makes its material."""
    drag = material_and_air.pop("drag", 0.0)
    numerics = {name: material_and_air.pop(name) for name in ("flip", "flow") if name in material_and_air}
    scene = Scene(
        "flat",
        Rectangle(0.1, 0.1),
        200,
        4,
        material=Material(**material_and_air),
        surroundings=Surroundings(drag=drag, gravity=(0.0, -v.GRAVITY, 0.0)),
        velocity=eddies,
        numerics=Numerics(**numerics),
    )
    simulation = Simulation(scene)
    v.steps(simulation, count, 2e-3)
    return simulation


def same(one, two):
    a, b = one.state.numpy(), two.state.numpy()
    return all(np.array_equal(a[name], b[name]) for name in a)


def differ(one, two):
    """Largest difference of velocity of E, relative to the largest velocity."""
    a, b = v.e_velocities(one), v.e_velocities(two)
    return np.abs(a - b).max() / np.abs(a).max()


@pytest.mark.parametrize("name", ["drag", "viscosity"])
def test_a_coefficient_of_zero_is_the_feature_off(name):
    """Zero is the same run bit for bit; and the limit is smooth: a tiny coefficient changes next to nothing."""
    off = flat()
    assert same(off, flat(**{name: 0.0}))
    tiny, real = flat(**{name: 1e-12}), flat(**{name: {"drag": 0.02, "viscosity": 1e-3}[name]})
    assert differ(off, tiny) < 1e-4
    assert differ(off, real) > 1e-2


def test_no_flip_is_the_limit_of_little_and_makes_nothing():
    """A tiny share changes next to nothing, a real one does; none has no buffer."""
    off, tiny, real = (flat(flip=f, flow="backward_euler") for f in (0.0, 1e-12, 0.9))
    assert off.stepper.tangential.before is None
    assert tiny.stepper.tangential.before is not None
    assert differ(off, tiny) < 1e-5
    assert differ(off, real) > 1e-3


def test_no_surfactant_is_the_limit_of_little():
    """Gamma_0 -> 0 leaves gravity and inertia alone."""
    off = flat(surfactant=0.0)
    assert off.stepper.tangential.solver is None
    assert differ(off, flat(surfactant=1e-16)) < 1e-3


def test_light_air_is_no_air():
    """The added mass of air that weighs nothing: the frequency in vacuo."""
    leg = np.polynomial.legendre.Legendre.basis(2)
    shape = displaced_sphere(0.05, lambda d: 0.01 * leg(d[:, 1]))
    found = []
    for air in (Surroundings(), Surroundings(air="added_mass", air_density=1e-7)):
        simulation = Simulation(Scene("ring", shape, 300, material=v.CLEAN, surroundings=air))
        found.append(v.steps(simulation, 10, 1e-3, lambda run=simulation: v.e_velocities(run)))
    assert np.abs(found[0] - found[1]).max() < 1e-3 * np.abs(found[0]).max()


def test_what_is_off_is_not_made():
    """Flat: no normal dynamics, no gas motion, no E advance. E alone: no transfer, no flow along the film, no L."""
    film = flat(count=0)
    assert film.stepper.membrane is None
    assert film.stepper.e_advance is None
    assert film.stepper.redistribution is None
    assert film.stepper.tangential.viscous is None
    bubble = Simulation(Scene("bubble", Sphere(0.05), 300))
    assert bubble.state.l is None
    assert bubble.stepper.transfer is None
    assert bubble.stepper.tangential is None
    assert bubble.stepper.l_advance is None
    assert bubble.film.rim is None
    assert bubble.stepper.lists.le is None
    drum = Simulation(Scene("drum", Disc(0.05, flat=False), 300))
    assert drum.stepper.membrane is not None
    assert drum.film.rim is not None


def test_features_follow_from_the_scene():
    bubble = Features.of(Scene("a", Sphere(0.05), 300, 4))
    assert (bubble.closed, bubble.moving, bubble.lagrangian, bubble.rim) == (True, True, True, False)
    assert bubble.marangoni
    assert not bubble.viscous
    assert not bubble.air
    flat_film = Features.of(Scene("b", Disc(0.05), 300, 4, material=Material(surfactant=0.0, viscosity=1e-6)))
    assert (flat_film.closed, flat_film.moving, flat_film.rim) == (False, False, True)
    assert not flat_film.marangoni
    assert flat_film.viscous


POISONS = [
    pytest.param("l", "u", math.nan, "l_to_e", "E", id="velocity of an L"),
    pytest.param("l", "x", math.inf, "", "", id="position of an L"),
    pytest.param("e", "x", math.nan, "", "E", id="position of an E"),
    pytest.param("e", "u", math.nan, "", "E", id="velocity of an E"),
]


@pytest.mark.parametrize(("block", "name", "value", "stage", "kind"), POISONS)
def test_a_step_that_turns_non_finite_stops(block, name, value, stage, kind):
    """SimulationError names the stage and the particle; the state is that of the last good frame."""
    simulation = Simulation(v.small_giant(300, 4))
    for _ in range(2):
        simulation.advance_frame()
    good = simulation.state.numpy()
    array = getattr(getattr(simulation.state, block), name)
    poisoned = array.numpy()
    poisoned[17, 1] = value
    array.assign(poisoned)
    with pytest.raises(SimulationError) as error:
        simulation.advance_frame()
    message = str(error.value)
    assert "stage" in message
    assert f"{stage}" in message
    assert f"{kind} particle" in message
    assert "frame 3" in message
    kept = simulation.state.numpy()
    for key in good:
        np.testing.assert_array_equal(kept[key], good[key], err_msg=key)
    assert simulation.frame == 2


def test_a_run_can_go_on_from_the_last_good_frame():
    """After a failure the state is whole again, geometry and lists included: going on is as if it had not been."""
    hurt, whole = (Simulation(v.small_giant(300, 4)) for _ in range(2))
    for simulation in (hurt, whole):
        simulation.advance_frame()
    poisoned = hurt.state.l.u.numpy()
    poisoned[5] = math.nan
    hurt.state.l.u.assign(poisoned)
    with pytest.raises(SimulationError):
        hurt.advance_frame()
    for simulation in (hurt, whole):
        simulation.advance_frame()
    np.testing.assert_allclose(v.e_points(hurt), v.e_points(whole), rtol=0.0, atol=1e-6)
