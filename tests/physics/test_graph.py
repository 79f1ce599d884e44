"""A step captured whole as a graph, as it runs on a GPU, against the same step launch by launch."""

import gc
import weakref
from collections import deque

import numpy as np
import pytest
import warp as wp

from melp_warp import features
from melp_warp.cluster import Bubble, Cluster, Pop
from melp_warp.device import launch
from melp_warp.device.scalars import Reading, Setting
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Sphere, StarShaped
from melp_warp.simulation import Simulation
from melp_warp.stages import state as state_module
from melp_warp.stepping.stepper import Stepper
from melp_warp.study import limits

R = 0.05
MODES = ("launches", "stages", "whole")


def swirl(points):
    """Rotation about z and a squeeze along x: L flow along the surface, a bubble's E swing."""
    x, y, z = points.T
    return np.stack([-25.0 * y + 15.0 * x, 25.0 * x - 7.5 * y, -7.5 * z], axis=1)


def whirl(points):
    """Rotation of a disc in its plane xz, at rest on its rim."""
    rate = 60.0 * (1.0 - np.sum(points**2, axis=1) / R**2)
    return np.stack([rate * points[:, 2], 0.0 * rate, -rate * points[:, 0]], axis=1)


def oval(directions):
    return 0.2 * (1.5 * directions[:, 1] ** 2 - 0.5)


def row(count):
    """Bubbles side by side that close in on each other."""
    middle = 0.5 * (count - 1)
    return Cluster(
        tuple(Bubble((2.02 * R * (k - middle), 0.0, 0.0), R, velocity=(middle - k, 0.0, 0.0)) for k in range(count))
    )


FOAM = {"support": 3.0, "exchange": 500.0}
AIR = Surroundings(air="added_mass")
SCENES = {
    "closed": (Sphere(R), 300, 4, {"velocity": swirl, "surroundings": AIR}, {}, 5e-4),
    "midpoint": (Sphere(R), 300, 4, {"velocity": swirl}, {"scheme": "trapezoid", "l_order": 2, "flip": 0.5}, 5e-4),
    "open": (Disc(R), 300, 4, {"velocity": whirl, "material": Material(viscosity=1e-5)}, {"solver": "jacobi"}, 3e-4),
    "levels": (Sphere(R), 300, 4, {"velocity": swirl, "surroundings": AIR}, {}, 5e-4),
    "circulation": (Sphere(R), 300, 4, {"velocity": swirl}, {"carrier": "circulation"}, 5e-4),
    "without L": (StarShaped(R, oval), 400, 0, {"material": Material(surfactant=0.0)}, {}, 5e-4),
    "one layer, open": (
        Disc(R),
        400,
        0,
        {"velocity": whirl, "material": Material(viscosity=1e-5)},
        {"layers": 1},
        3e-4,
    ),
    "one layer, closed": (Sphere(R), 400, 0, {"velocity": swirl, "surroundings": AIR}, {"layers": 1}, 3e-4),
    "two bubbles": (row(2), 400, 4, {}, FOAM, 5e-4),
    "three bubbles": (row(3), 600, 0, {"surroundings": AIR}, {"support": 3.0}, 5e-4),
}


def simulation_of(name, mode, monkeypatch):
    """A simulation of the scene whose steps run `mode`'s way, and its usual step, s."""
    shape, e_count, l_per_e, scene, numerics, dt = SCENES[name]
    monkeypatch.setattr(features, "COARSE_FROM", 0 if name == "levels" else features.COARSE_FROM)
    monkeypatch.setattr(launch, "GRAPHS", mode != "launches")
    made = Simulation(Scene("graph", shape, e_count, l_per_e, numerics=Numerics(**numerics), **scene))
    made.stepper.whole = mode == "whole"
    return made, dt


def liquid_of(simulation):
    """Liquid of the L of each region, kg."""
    lag = simulation.state.l
    return np.zeros(0) if lag is None else np.bincount(lag.region.numpy(), lag.mass.numpy().astype(np.float64))


def run(name, mode, count, monkeypatch):
    """The state after `count` steps of two sizes by turns, how often lists were built, and the share that crossed."""
    simulation, dt = simulation_of(name, mode, monkeypatch)
    before = simulation.stepper.lists.builds
    start = liquid_of(simulation)
    for k in range(count):
        simulation.step(dt if k % 3 else 0.75 * dt)
    simulation.stepper.check()
    crossed = float(np.abs(liquid_of(simulation) / start - 1.0).max(initial=0.0))
    return simulation.state.numpy(), np.subtract(simulation.stepper.lists.builds, before), crossed


@pytest.mark.parametrize("name", SCENES)
def test_a_replayed_step_is_the_step(name, monkeypatch):
    """Bit for bit, over 40 steps of changing size in which lists are rebuilt, and liquid crosses between bubbles."""
    states, builds, crossed = zip(*(run(name, mode, 40, monkeypatch) for mode in MODES), strict=True)
    print(f"{name}: lists built {builds[0]}, {crossed[0]:.2g} of the liquid crossed")
    for state, built in zip(states[1:], builds[1:], strict=True):
        assert all(np.array_equal(state[key], states[0][key]) for key in states[0])
        assert np.array_equal(built, builds[0])
    assert np.all(np.isfinite(states[0]["e.x"]))
    assert builds[0].max() >= 2 and builds[0].max() < 40
    assert (crossed[0] > 1e-5) == (name == "two bubbles")


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", SCENES)
def test_a_step_neither_allocates_nor_reads_back(name, mode, device, monkeypatch):
    """Once the graphs are there, steps with rebuilds among them take no memory, and show the host nothing but what
    arrived by itself: how far particles had moved a step before the last one.
    """
    simulation, dt = simulation_of(name, mode, monkeypatch)
    lists = simulation.stepper.lists
    lists.watched, lists.seen._taken = False, deque(maxlen=2)
    for _ in range(3):
        simulation.step(dt)
    before, calls = lists.builds, []
    arrived = [id(host) for host, _, _ in lists.seen._taken]
    allocator = device.get_allocator()
    numpy, allocate = wp.array.numpy, allocator.allocate
    with monkeypatch.context() as patch:
        patch.setattr(wp.array, "numpy", lambda a: (id(a) in arrived or calls.append("numpy"), numpy(a))[1])
        patch.setattr(allocator, "allocate", lambda size: calls.append("allocate") or allocate(size))
        wp.zeros(3, device=device).numpy()
        assert calls == ["allocate", "numpy"], "the patches see nothing"
        calls.clear()
        for k in range(30):
            simulation.stepper.step(0.9**k * dt if name == "open" else dt)
        assert calls == []
    assert np.max(np.subtract(lists.builds, before)) >= 1


def test_two_graphs_are_launched_a_step(monkeypatch):
    """From the second step on the host does no more than that, but for lists and for numbers that changed."""
    monkeypatch.setattr(launch, "THREADS", 1)  # on the CPU each core has its own two
    simulation, dt = simulation_of("closed", "whole", monkeypatch)
    simulation.step(dt)
    simulation.stepper.lists.skin = np.inf  # no lists in this test
    calls = []
    replay = wp.capture_launch
    with monkeypatch.context() as patch:
        patch.setattr(wp, "capture_launch", lambda graph: calls.append("graph") or replay(graph))
        patch.setattr(wp, "launch", lambda *_, **__: calls.append("kernel"))
        for _ in range(5):
            simulation.step(dt)
    assert calls == ["graph"] * 10


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.slow
def test_counted_iterations_change_nothing(name, monkeypatch):
    """Where graphs have no conditional parts, solvers run on after they are done, to no effect.

    Jacobi sweeps do go on.
    """
    expected, _, crossed = run(name, "whole", 8, monkeypatch)
    monkeypatch.setattr(launch, "_decides", lambda _: False)
    state, _, crossed_too = run(name, "whole", 8, monkeypatch)
    assert crossed_too == crossed
    for key in expected:
        if name == "open":
            assert np.abs(state[key] - expected[key]).max() <= 2e-3 * np.abs(expected[key]).max(), key
        else:
            assert np.array_equal(state[key], expected[key]), key


def test_a_stepper_goes_as_soon_as_it_is_replaced(monkeypatch):
    """Graphs do not keep the arrays of a run that was set up anew until the garbage is collected."""
    simulation, dt = simulation_of("closed", "whole", monkeypatch)
    simulation.step(dt)
    old = weakref.ref(simulation.stepper)
    gc.disable()
    try:
        simulation.rebuild()
        assert old() is None
    finally:
        gc.enable()


def test_a_setting_is_what_was_set(device):
    """Whole numbers and fractions, and again after others."""
    for dtype, values in ((wp.float32, (0.5, 0.0, 0.25, 0.5)), (wp.int32, (3, 0, -2))):
        setting = Setting(device, dtype)
        for value in values:
            assert setting.at(value) is setting.array
            assert setting.array.numpy()[0] == value


def test_a_reading_may_lag(device):
    """With room for two the one before the last is seen, the first one until there are two."""
    number = Setting(device)
    reading = Reading(number.array)
    assert reading.get() is None
    reading._taken = deque(maxlen=2)
    seen = []
    for value in range(1, 6):
        number.at(value)
        reading.take(10.0 * value)
        values, note = reading.get()
        seen.append((float(values[0]), note))
    assert seen == [(1.0, 10.0), (1.0, 10.0), (2.0, 20.0), (3.0, 30.0), (4.0, 40.0)]


class Late(Reading):
    """A reading that is a step late, as on a GPU."""

    def __init__(self, array):
        super().__init__(array)
        self._taken = deque(maxlen=2)


def unwatched(scene, monkeypatch):
    """A simulation that runs as on a GPU: two graphs a step, checks between frames alone, its size a step late."""
    monkeypatch.setattr(Stepper, "whole", property(lambda _: True, lambda *_: None), raising=False)
    monkeypatch.setattr(state_module, "Reading", Late)
    simulation = Simulation(scene)
    simulation.watched = False
    return simulation


def test_frames_without_a_look(monkeypatch):
    """A frame of many steps reads back as often as one of few, and takes steps like those that are watched."""
    numerics = Numerics(support=4.0, cfl=0.4)
    scene = Scene("graph", StarShaped(R, oval), 400, 0, material=Material(surfactant=0.0), numerics=numerics)
    watched = Simulation(scene)
    for _ in range(3):
        watched.advance_frame()
    simulation = unwatched(scene, monkeypatch)
    reads, numpy = [], wp.array.numpy
    for _ in range(3):
        with monkeypatch.context() as patch:
            seen = []
            patch.setattr(wp.array, "numpy", lambda array, seen=seen: seen.append(array.shape) or numpy(array))
            simulation.advance_frame()
        reads.append(sum(shape != (6,) for shape in seen))  # `travel` arrives by itself
    print(f"{len(simulation.step_seconds)} steps, watched {len(watched.step_seconds)}; reads a frame {reads}")
    assert len(set(reads)) == 1
    assert max(reads) <= 12  # checks, the gas law, two for the budget, one for each solver whose end is watched
    assert len(simulation.step_seconds) == pytest.approx(len(watched.step_seconds), abs=3)
    gas = [s.state.gas.numpy()[0] for s in (watched, simulation)]
    assert gas[1][4] == pytest.approx(gas[0][4], rel=1e-2)


def test_a_step_is_captured_anew_where_regions_change(monkeypatch):
    """A bubble pops in mid-frame: two graphs before and two after, and the bits of a run that has none.

    With so thin a skin both build lists in every step; else one that sees distances late builds them at other times.
    """
    shape = Cluster(row(3).bubbles, events=(Pop(0.012, 2, delete=True),))
    scene = Scene("graph", shape, 450, 2, numerics=Numerics(support=3.0, skin=0.1), dt=1.0 / 960.0)
    plain = Simulation(scene)
    plain.advance_frame()
    graphs, capture = [], wp.ScopedCapture
    monkeypatch.setattr(wp, "ScopedCapture", lambda **options: graphs.append(capture(**options)) or graphs[-1])
    monkeypatch.setattr(launch, "THREADS", 1)  # on the CPU each core has its own two
    simulation = unwatched(scene, monkeypatch)
    graphs.clear()
    simulation.advance_frame()
    assert len(graphs) == 4
    assert simulation.film.regions == 2
    states = [s.state.numpy() for s in (plain, simulation)]
    assert all(np.array_equal(states[1][key], states[0][key]) for key in states[0])


@pytest.mark.slow
def test_an_unwatched_frame_that_goes_wrong_is_done_again(monkeypatch):
    """Lists of a dumbbell overflow and E leap: frames end as they do where each step is checked at once, to the bit."""
    numerics = Numerics(support=3.0)
    scene = Scene("leap", limits.dumbbell(), 1000, 2, numerics=numerics, dt=1.0 / 120.0)
    watched = Simulation(scene)
    for _ in range(2):
        watched.advance_frame()
    simulation = unwatched(scene, monkeypatch)
    for _ in range(2):
        simulation.advance_frame()
    assert watched.diagnostics()["substeps"] > 2
    assert len(simulation.step_seconds) > len(watched.step_seconds)
    states = [s.state.numpy() for s in (watched, simulation)]
    assert all(np.array_equal(states[1][key], states[0][key]) for key in states[0])
