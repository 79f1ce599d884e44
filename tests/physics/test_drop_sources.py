"""Which L became which drop is recorded: each L once, its liquid about where it is said to be."""

import numpy as np
import pytest

from melp_warp.bursting import Bursting, Puncture
from melp_warp.cluster import Bubble, Cluster, Pop
from melp_warp.material import Material, Surroundings
from melp_warp.scene import Scene
from melp_warp.shapes import Sphere
from melp_warp.simulation import Simulation
from melp_warp.stages.record import Swept, nothing

RADIUS = 0.05


def numbers_of(simulation):
    return set() if simulation.gone else set(simulation.particles("l").ids.tolist())


def test_each_l_of_a_bubble_ends_in_one_drop(device):
    """Told once, in the frame in which the drop is made; sums are kept, and of large drops nine tenths are right."""
    hole = Bursting((Puncture((RADIUS, 0.0, 0.0), 0.0),))
    scene = Scene("bubble", Sphere(RADIUS), 400, 16, Material(thickness=1e-6), bursting=hole, fps=1000, frames=16)
    simulation = Simulation(scene, device.alias)
    ids, mass = simulation.state.ids["l"], simulation.state.l.mass.numpy()
    held, told = dict(zip(ids.tolist(), mass.tolist(), strict=True)), {}
    while not simulation.gone:
        simulation.advance_frame()
        swept = simulation.state.swept
        assert not numbers_of(simulation) & set(swept["l"].tolist())
        assert ((swept["rim"] >= 0) != (swept["drop"] >= 0)).all()
        for drop, own in simulation.diagnostics()["new_drops"].items():
            assert int(drop) not in told
            told[int(drop)] = own
    sources = simulation.burst.sources()
    assert {drop: own.tolist() for drop, own in sources.items()} == told
    assert sorted(number for own in told.values() for number in own) == sorted(held)
    drops = dict(zip(simulation.state.ids["d"].tolist(), simulation.state.d.mass.numpy().tolist(), strict=True))
    said = {drop: sum(held[number] for number in own) for drop, own in told.items()}
    assert sum(said.values()) == pytest.approx(sum(drops.values()), rel=1e-5)
    off = sum(abs(said.get(drop, 0.0) - size) for drop, size in drops.items()) / 2.0
    assert off < 0.15 * sum(drops.values())


def test_l_of_a_foam_are_in_film_rims_or_drops(device):
    """A bubble of three bursts: what its L were is in drops, or went to the neighbours; none is in two places."""
    bubbles = [Bubble((x * RADIUS, y * RADIUS, 0.0), RADIUS) for x, y in ((-1.0005, 0.0), (1.0005, 0.0), (0.0, 1.8))]
    around = Surroundings(air="added_mass", air_drag=0.0, damping=50.0)
    shape = Cluster(tuple(bubbles), events=(Pop(0.001, 1),))
    simulation = Simulation(Scene("foam", shape, 450, 4, Material(), around, fps=500.0), device.alias)
    had = numbers_of(simulation)
    for _ in range(10):
        simulation.advance_frame()
        recorded = set(simulation.state.swept["l"].tolist())
        assert recorded <= had
        assert not recorded & numbers_of(simulation)
    assert simulation.film.labels == (0, 2)
    assert len(simulation.burst.sources()) > 10


def test_drops_that_leave_are_forgotten():
    swept = Swept(nothing())
    swept.enter(np.arange(6), np.array([0, 0, 1, 1, 2, 2]), np.zeros(6))
    swept.become(np.array([0, 1, 2]), np.array([7, 8, 8]))
    assert {drop: own.tolist() for drop, own in swept.by_drop(0).items()} == {7: [0], 8: [1, 2]}
    assert {drop: own.tolist() for drop, own in swept.by_drop(8).items()} == {8: [1, 2]}
    swept.dry(np.array([8]))
    swept.leave(np.array([2]))
    assert swept["l"].tolist() == [0, 3]


def test_it_follows_points_that_come_and_go():
    """Two points become one and are parted again: those in the middle are with the new point, in their order."""
    swept = Swept(nothing())
    along = np.array([-0.4, 0.0, 0.3, 0.45, -0.45, -0.3, 0.0, 0.4])
    swept.enter(np.arange(8), np.repeat([0, 1], 4), along)
    swept.put_in(0, 1, 2)
    assert swept["rim"].tolist() == [0, 0, 2, 2, 2, 2, 1, 1]
    np.testing.assert_allclose(swept["along"][2:6], [-0.4, -0.1, 0.1, 0.4], atol=1e-6)
    assert np.abs(swept["along"]).max() <= 0.5
    swept.join(0, 2)
    swept.join(0, 1)
    assert set(swept["rim"].tolist()) == {0}
    assert (np.diff(swept["along"]) > 0.0).all()
    swept.renumber(np.array([1, 0]), 3)
    assert set(swept["rim"].tolist()) == {1}
    swept.turn(np.array([1]))
    assert (np.diff(swept["along"]) < 0.0).all()
