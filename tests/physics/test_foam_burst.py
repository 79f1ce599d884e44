"""Bubbles of foams that burst: rims run up to the borders, neighbours keep what is theirs and feel the recoil."""

import math

import numpy as np
import pytest

from melp_warp.bursting import Bursting, Puncture
from melp_warp.cluster import Bubble, Cluster, Merge, Pop, Wall
from melp_warp.material import Material, Surroundings
from melp_warp.measure.results import measure
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation
from melp_warp.stages.state import AMOUNT, VOLUME
from melp_warp.stepping.parts import kernel_files

R = 0.02
PAIR = (Bubble((-1.0005 * R, 0.0, 0.0), R), Bubble((1.0005 * R, 0.0, 0.0), R))
TRIPLE = (*PAIR, Bubble((0.0, 1.8 * R, 0.0), R))


def foam(bubbles, e_count, l_per_e=2, events=(), punctures=(), damping=50.0, fps=1000.0, **more):
    around = Surroundings(damping=damping, air="added_mass", air_drag=0.0)
    bursting = Bursting(punctures, breakup=0.0)
    shape = Cluster(tuple(bubbles), events=tuple(events))
    return Scene("foam", shape, e_count, l_per_e, Material(), around, bursting=bursting, fps=fps, **more)


def liquid(simulation):
    """All of it, wherever it is, kg."""
    line = simulation.diagnostics()
    return sum(line[name] for name in ("mass", "rim_mass", "drop_mass", "frame_mass", "spilled"))


def culick(scene):
    m = scene.material
    return math.sqrt(2.0 * m.film_tension / m.areal_mass)


@pytest.mark.parametrize("l_per_e", [0, 4])
def test_a_rim_runs_over_a_bubble_of_a_foam_as_over_any_film(l_per_e):
    """A bubble that touches none, held up by air of a thousand times the density: arc v t within 3 %."""
    scene = foam((Bubble((0.0, 0.0, 0.0), R), Bubble((3.0 * R, 0.0, 0.0), R)), 1000, l_per_e, fps=10000.0)
    object.__setattr__(scene, "surroundings", Surroundings(air="added_mass", air_density=1000.0))
    object.__setattr__(scene, "bursting", Bursting((Puncture((0.0, R, 0.0), 0.0, 0.1 * R),), breakup=0.0))
    simulation, seen = Simulation(scene), []
    for _ in range(22):
        simulation.advance_frame()
        x = simulation.state.f.x.numpy()
        seen.append((simulation.time, R * np.arccos(x[:, 1] / np.linalg.norm(x, axis=1)).mean()))
    (began, first), (ended, last) = seen[1], seen[-1]
    assert last > 2.0 * R
    assert (last - first) / (ended - began) == pytest.approx(culick(scene), rel=0.03)
    assert set(simulation.film.labels) == {0, 1}


@pytest.mark.parametrize("l_per_e", [0, 2])
def test_a_bubble_of_three_bursts_and_two_holes_at_once(l_per_e):
    """All liquid stays, 1e-6, in every frame; the gas of those that are whole is theirs; a kill costs no bit."""
    holes = (Puncture((0.0, 2.8 * R, 0.0), 0.0015),)
    scene = foam(TRIPLE, 450, l_per_e, [Pop(0.001, 1)], holes, fps=2000.0)
    simulation = Simulation(scene)
    start, gas = liquid(simulation), simulation.state.gas.numpy()[0, AMOUNT]
    torn = 0
    for _ in range(14):
        simulation.advance_frame()
        assert liquid(simulation) == pytest.approx(start, rel=1e-6)
        torn = max(torn, len(simulation.state.course.tears))
    assert torn == 2
    assert simulation.film.labels == (0,)
    assert simulation.state.gas.numpy()[0, AMOUNT] == pytest.approx(gas, rel=1e-9)
    line = simulation.diagnostics()
    assert line["rims"] == 0 and line["drops"] > 0 and line["spilled"] == 0.0


def test_a_partition_breaks_and_two_bubbles_are_one(tmp_path):
    """Both amounts of gas, all liquid and no drop but few; a run that loads a checkpoint goes on to the same bits."""
    scene = foam(PAIR, 500, 2, [Merge(0.0305, 0, 1)], damping=100.0)
    simulation = Simulation(scene)
    start, gas = liquid(simulation), simulation.state.gas.numpy()[:, AMOUNT].sum()
    while not simulation.state.course.tears:
        simulation.advance_frame()
    simulation.save_checkpoint(tmp_path / "torn.npz")
    for _ in range(6):
        simulation.advance_frame()
        assert liquid(simulation) == pytest.approx(start, rel=1e-6)
    assert simulation.film.labels == (0,)
    assert simulation.state.gas.numpy()[0, AMOUNT] == pytest.approx(gas, rel=1e-9)
    assert simulation.diagnostics()["drop_mass"] < 0.1 * start
    again = Simulation(scene, checkpoint=tmp_path / "torn.npz")
    for _ in range(6):
        again.advance_frame()
    held, same = simulation.state.numpy(), again.state.numpy()
    assert all(np.array_equal(held[name], same[name]) for name in held)


@pytest.mark.parametrize("l_per_e", [0, 2])
def test_a_torn_bubble_is_deleted(l_per_e):
    """What its rim holds is drops, the rest is spilled: nothing counts twice."""
    simulation = Simulation(foam(TRIPLE, 450, l_per_e, [Pop(0.0, 1), Pop(0.001, 1, delete=True)], fps=1000.0))
    start = liquid(simulation)
    simulation.advance_frame()
    assert simulation.film.labels == (0, 2) and simulation.spilled > 0.1 * start
    assert liquid(simulation) == pytest.approx(start, rel=1e-6)


@pytest.mark.parametrize("l_per_e", [0, 2])
def test_two_torn_bubbles_become_one_and_a_torn_partition_goes(l_per_e):
    """No liquid goes to film that a rim has taken, no rim is left where its film is not, and each tear counts once."""
    events = [Merge(0.0302, 0, 1), Pop(0.0304, 0), Pop(0.0304, 1), Merge(0.0308, 0, 1, delete=True)]
    simulation = Simulation(foam(PAIR, 400, l_per_e, events))
    start = liquid(simulation)
    while simulation.time < 0.0305:
        simulation.advance_frame()
    assert simulation.film.labels == (0,)
    assert simulation.state.course.tears == [[0, -1]]
    assert set(simulation.state.f.other.numpy()) == {-1}
    assert liquid(simulation) == pytest.approx(start, rel=1e-6)


@pytest.mark.parametrize(("l_per_e", "popped"), [(0, 0), (2, 0), (0, 1)])
def test_a_bubble_goes_whose_partition_is_torn(l_per_e, popped):
    """The hole in it is one in the other bubble now: its rim runs on, the gas leaves and all ends as drops."""
    events = [Merge(0.0302, 0, 1), Pop(0.0306, popped, delete=True)]
    simulation, left = Simulation(foam(PAIR, 400, l_per_e, events)), 1 - popped
    start = liquid(simulation)
    while simulation.time < 0.0305:
        simulation.advance_frame()
    assert simulation.film.labels == (left,) and simulation.state.course.tears == [[left, -1]]
    assert simulation.state.gas.numpy()[0, AMOUNT] == 0.0
    began = simulation.diagnostics()["rim_length"]
    for _ in range(10):
        assert liquid(simulation) == pytest.approx(start, rel=1e-6)
        simulation.advance_frame()
        if simulation.time < 0.0325:
            assert simulation.diagnostics()["rim_length"] > began  # it runs away from the hole
    assert simulation.gone


def test_a_second_hole_in_a_torn_film_takes_what_was_there():
    """Its rim has the liquid of the hole from the start, and is not found by a later change."""
    holes = (Puncture((0.0, R, 0.0), 0.0, 0.3 * R), Puncture((0.0, -R, 0.0), 0.0, 0.3 * R))
    simulation = Simulation(foam((Bubble((0.0, 0.0, 0.0), R),), 400, 0, punctures=holes, fps=1e6))
    simulation.advance_frame()
    y = simulation.state.f.x.numpy()[:, 1]
    for held in (simulation.state.f.mass.numpy(), simulation.state.f.inertia.numpy()):
        assert held[y < 0.0].sum() == pytest.approx(held[y > 0.0].sum(), rel=0.3)


def test_two_bubbles_end_at_once(monkeypatch):
    """What is left of one that ends right after another gets its momentum, a number. They end once a little fell in."""
    monkeypatch.setattr("melp_warp.stepping.foam_burst.CAVED_IN", 0.999)
    scene = foam(TRIPLE, 450, 0, [Pop(0.0005, 1), Pop(0.0005, 2)])
    object.__setattr__(scene, "bursting", Bursting(breakup=20.0))
    simulation = Simulation(scene)
    for _ in range(5):
        simulation.advance_frame()
    assert simulation.film.labels == (0,)
    assert np.isfinite(simulation.state.e.u.numpy()).all()


@pytest.mark.parametrize("scripted", [Merge(0.0305, 0, 1), Pop(0.0305, 0)])
def test_what_comes_after_another_change_at_once_sees_partitions(scripted):
    """A partition is one although the film was set up anew a moment ago and has done no step since."""
    far = Bubble((0.0, 5.0 * R, 0.0), R)
    simulation = Simulation(foam((*PAIR, far), 600, 0, [Pop(0.0305, 2, delete=True), scripted]))
    while simulation.time < 0.0305:
        simulation.advance_frame()
    other = 1 if isinstance(scripted, Merge) else -1
    assert simulation.state.course.tears == [[0, other]]
    x = simulation.state.f.x.numpy()[:, 0] + simulation.state.origin[0]
    assert (x.mean() < -R) if other < 0 else (abs(x.mean()) < 0.1 * R)


def test_gas_leaves_by_the_hole():
    """The root of the pressure falls as C A sqrt(rho_air/2) p_atm/V asks, with the hole as its rim has it: 1 %."""
    scene = foam(PAIR, 800, 0, punctures=(Puncture((2.0 * R, 0.0, 0.0), 0.0, 2e-4),), fps=5e4)
    simulation = Simulation(scene)
    gas = simulation.state.gas.numpy()
    around, volume, before = scene.surroundings, gas[1, VOLUME], gas[1, 1]
    fallen = 0.0
    for _ in range(5):
        simulation.advance_frame()
        x = simulation.state.f.x.numpy().astype(np.float64)
        radius = np.linalg.norm(x - x.mean(axis=0), axis=1).mean()
        rate = 0.6 * np.pi * radius**2 * around.pressure / volume / math.sqrt(2.0 * around.air_density)
        fallen += rate * 2e-5
        now = simulation.state.gas.numpy()[1, 1]
        assert now < before
        assert math.sqrt(now) == pytest.approx(math.sqrt(before) - fallen, rel=0.01)


def test_drops_leave_at_the_floor():
    """A bubble over a floor bursts: its drops fall there, and what left is counted."""
    scene = foam(
        (Bubble((0.0, 1.05 * R, 0.0), R),), 200, 2, punctures=(Puncture((0.0, 2.05 * R, 0.0), 0.0),), fps=200.0
    )
    object.__setattr__(scene, "shape", Cluster(scene.shape.bubbles, (Wall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),)))
    simulation = Simulation(scene)
    start = liquid(simulation)
    for _ in range(6):
        simulation.advance_frame()
    line = simulation.diagnostics()
    assert simulation.gone
    assert liquid(simulation) == pytest.approx(start, rel=1e-6)
    assert 0.2 * start < line["frame_mass"] < start
    assert simulation.state.d.x.numpy()[:, 1].min() > -1e-3


def test_without_air_a_bubble_keeps_its_shape_while_it_bursts():
    """Its gas holds it, to 1e-4 of its volume, until its film is gone; nothing else would."""
    scene = foam(PAIR, 500, 0, punctures=(Puncture((2.0 * R, 0.0, 0.0), 0.0),), fps=4000.0)
    object.__setattr__(scene, "surroundings", Surroundings(damping=50.0))
    simulation = Simulation(scene)
    volume = simulation.state.gas.numpy()[1, VOLUME]
    while simulation.film.labels == (0, 1):
        assert simulation.state.gas.numpy()[1, VOLUME] == pytest.approx(volume, rel=1e-4)
        assert simulation.frame < 40
        simulation.advance_frame()
    assert simulation.frame > 10


def test_a_puncture_off_the_film_or_in_a_hole_is_said():
    scene = foam(PAIR, 450, 0, punctures=(Puncture((1.0, 0.0, 0.0), 0.0),))
    simulation = Simulation(scene)
    simulation.advance_frame()
    assert simulation.film.labels == (0, 1)
    assert "off the film" in " ".join(simulation.notices.fresh())


def test_what_does_not_burst_has_nothing_of_it():
    """A foam without punctures has no buffers and no kernels of rims."""
    simulation = Simulation(foam(PAIR, 450, 2))
    assert simulation.burst is None and simulation.state.f is None and simulation.state.l.behind is None
    assert "free_rim" not in kernel_files(simulation.film.features)


@pytest.mark.slow
def test_the_neighbour_takes_the_recoil_and_is_a_sphere_again():
    """Two equal bubbles at rest, one punctured from afar: the film pulls at the border until the rim arrives.

    The other keeps its gas, comes to be a sphere within 1 % and moves at J/(M + 2 pi rho_air R^3), 5 %, with
    J = 1.5 pi (2 sigma) R times the rim's time for 120 degrees, R that of the caps.
    """
    time, size = 0.3, 0.05
    pair = (Bubble((-1.0005 * size, 0.0, 0.0), size), Bubble((1.0005 * size, 0.0, 0.0), size))
    scene = foam(pair, 1200, 0, [Pop(time, 1, place=(10.0 * size, 0.0, 0.0))], damping=30.0, fps=240.0, budget=False)
    simulation = Simulation(scene)
    while simulation.time < time - 1.5 / 240.0:
        simulation.advance_frame()
    gas, before = simulation.state.gas.numpy()[0, AMOUNT], simulation.state.motion.numpy()[0, 0]
    simulation.change(damping=0.0)
    for _ in range(4):
        simulation.advance_frame()
    volume = simulation.state.gas.numpy()[0, VOLUME]
    assert simulation.film.labels == (0,)
    assert simulation.state.gas.numpy()[0, AMOUNT] == pytest.approx(gas, rel=1e-9)
    gamma, cap = 2.0 * scene.material.film_tension, np.cbrt(8.0 * volume / (9.0 * np.pi))
    pull = 1.5 * np.pi * gamma * cap * (2.0 * np.pi / 3.0 * cap / culick(scene))
    whole = simulation.state.e.mass.numpy().sum() + 1.5 * scene.surroundings.air_density * volume
    speed = simulation.state.motion.numpy()[0, 0] - before
    assert speed * whole == pytest.approx(pull, rel=0.05)
    simulation.change(damping=30.0)
    for _ in range(60):
        simulation.advance_frame()
    x = simulation.particles("e").points
    away = np.linalg.norm(x - x.mean(axis=0), axis=1)
    assert np.std(away) < 0.01 * away.mean()


@pytest.mark.slow
def test_what_is_left_of_three_meets_at_120_degrees():
    """One of three is punctured: the other two are a double bubble again, 1.5 degrees."""
    simulation = Simulation(foam(TRIPLE, 1500, 0, [Pop(0.06, 2)], damping=60.0, fps=240.0, budget=False))
    for _ in range(72):
        simulation.advance_frame()
    assert simulation.film.labels == (0, 1)
    found = measure(simulation.particles("e"))
    angles = np.array(found.pairs[0].angles)
    assert np.abs(angles - 120.0).max() < 1.5
