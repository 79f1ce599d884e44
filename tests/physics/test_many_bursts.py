"""A hundred bursts in a row: bubbles come and burst one after the other, and nothing of them stays."""

import gc
import resource

import numpy as np
import pytest
import warp as wp

from melp_warp.bursting import Bursting
from melp_warp.cluster import Bubble, Cluster, Pop, Wall
from melp_warp.material import Material, Surroundings
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation

R, EACH, BOX = 0.01, 0.006, 0.03
FPS = 4.0 / EACH
"""Four frames a bubble: it comes, is punctured, is torn, and its drops leave by the walls."""


def one_after_the_other(bursts):
    bubbles = tuple(Bubble((0.0, 0.0, 0.0), R, born=(k + 0.01 * (k > 0)) * EACH) for k in range(bursts))
    events = tuple(Pop((k + 0.25) * EACH, k) for k in range(bursts))
    sides = [np.sign(side) * np.eye(3)[axis] for axis in range(3) for side in (-1, 1)]
    walls = tuple(Wall(tuple(BOX * side), tuple(-side)) for side in sides)
    shape = Cluster(bubbles, walls=walls, events=events)
    return Scene(
        "bursts", shape, 150, 2, Material(), Surroundings(air="added_mass"), bursting=Bursting(breakup=20.0), fps=FPS
    )


def arrays_on_the_device():
    gc.collect()
    return sum(isinstance(one, wp.array) for one in gc.get_objects())


def liquid(line):
    return sum(line[name] for name in ("mass", "rim_mass", "drop_mass", "frame_mass", "spilled"))


@pytest.mark.slow
def test_a_hundred_bursts_leave_nothing_behind(device):
    """Each bubble has as many E and L as the first, and numbers that none had; no liquid is lost, no memory."""
    bursts, kinds = 100, ("e", "l", "d")
    simulation = Simulation(one_after_the_other(bursts), device.alias)
    had, arrays, resident = {kind: set() for kind in kinds}, [], []
    ids = {kind: set() for kind in kinds}
    for k in range(bursts):
        for frame in range(4):
            simulation.advance_frame()
            last, ids = ids, {kind: set(simulation.state.ids[kind].tolist()) for kind in kinds}
            for kind in kinds:
                assert not (ids[kind] - last[kind]) & had[kind], f"a number of {kind} was given twice"
                had[kind] |= ids[kind]
            if frame == 0:
                assert simulation.state.course.labels == [k]
                assert (len(ids["e"]), len(ids["l"])) == (150, 300)
                before = liquid(simulation.diagnostics())
        assert simulation.gone
        assert liquid(simulation.diagnostics()) == pytest.approx(before, rel=1e-6)
        assert set(simulation.burst.sources()) <= ids["d"]
        arrays.append(arrays_on_the_device())
        resident.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    assert len(had["e"]) == bursts * 150 and len(had["l"]) == bursts * 300
    assert len(set(arrays)) == 1
    assert resident[-1] - resident[bursts // 5] < 20_000, "kB of memory"
    assert simulation.state.sizes["d"] < 0.1 * len(had["d"]), "most drops have come to a wall"
