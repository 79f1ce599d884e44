"""Neighbour lists against brute force, their overflow, and the skin on moving films."""

import numpy as np
import pytest
import warp as wp

from melp_warp.errors import SimulationError
from melp_warp.material import Surroundings
from melp_warp.shapes import Disc, Jittered, Sphere
from melp_warp.stages.advance import PROJECTION_REACH
from tests.helpers import make_stepper, near, pairs_of, place_e

SHAPES = {"closed": Jittered(Sphere(0.05)), "flat": Jittered(Disc(0.05))}


def rows_as_sets(rows):
    i, _, j = pairs_of(rows)
    out = [set() for _ in range(len(rows.start))]
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        assert b not in out[a], "a pair stands twice in a row"
        out[a].add(b)
    return out


def positions(stepper):
    n = stepper.film.n_e
    x = stepper.state.e.x.numpy().astype(np.float64)
    return x[:n], x, stepper.state.l.x.numpy().astype(np.float64)


def missing(rows, x, source, radius, same=False):
    """Number of pairs within `radius` that a list lacks."""
    want = np.sum(x * x, axis=1)[:, None] + np.sum(source * source, axis=1) - 2.0 * x @ source.T <= radius * radius
    if same:
        np.fill_diagonal(want, False)
    i, _, j = pairs_of(rows)
    want[i, j] = False
    return int(want.sum())


def unseen(stepper):
    """Number of E:L pairs within r that `gather_blocks` would not look at; every L stands in one block."""
    film, lists = stepper.film, stepper.lists
    e, _, lag = positions(stepper)
    start, reach, place = (a.numpy() for a in (lists.el.blocks.start, lists.el.blocks.reach, lists.el.place))
    assert start[0] == 0 and start[-1] == film.n_l and np.all(np.diff(start) >= 0)
    assert np.array_equal(np.sort(place), np.arange(film.n_l))
    block = np.searchsorted(start, place, side="right") - 1
    looks = np.zeros((film.n_e, film.n_e + 1), dtype=bool)
    looks[np.arange(film.n_e), np.arange(film.n_e)] = True
    i, _, h = pairs_of(lists.wide.rows)
    i, h = i[h < film.n_e], h[h < film.n_e]
    close = np.linalg.norm(e[i] - e[h], axis=1) <= film.r + reach[h]
    looks[i[close], h[close]] = True
    looks[:, film.n_e] = True
    apart = np.linalg.norm(e[:, None] - lag[None], axis=2)
    return int(np.sum((apart <= film.r) & ~looks[:, block]))


@pytest.mark.parametrize("name", SHAPES)
def test_lists_equal_brute_force(name, device):
    """E:E (without itself) and L:E hold the pairs within r + skin, each once; blocks hold what is within r of an E.

    Distances within rounding of the radius may fall on either side: compared just below and just above it.
    """
    film, s = make_stepper(SHAPES[name], 500, device, l_per_e=4)
    e, all_e, lag = positions(s)
    lists = s.lists
    for rows, x, source, same in (
        (lists.ee.rows, e, all_e, True),
        (lists.le.rows, lag, all_e, False),
    ):
        have = rows_as_sets(rows)
        low = near(x, source, lists.reach * (1.0 - 1e-5), same)
        high = near(x, source, lists.reach * (1.0 + 1e-5), same)
        for got, inside, around in zip(have, low, high, strict=True):
            assert set(inside.tolist()) <= got <= set(around.tolist())
    assert unseen(s) == 0
    assert (film.n_b > 0) == (name == "flat")


@pytest.mark.parametrize("name", SHAPES)
def test_lists_from_homes_equal_those_by_the_grid(name, device):
    """L that moved a little, far, and off the film: the list picked around their homes is what the grid gives.

    A home is the nearest E; L farther from any E than the margin are in the last block. E come before boundary
    particles in a row.
    """
    film, s = make_stepper(SHAPES[name], 500, device, l_per_e=4)
    rng = np.random.default_rng(2)
    e, all_e, lag = positions(s)
    lag += 0.1 * film.spacing * rng.normal(size=lag.shape)
    lag[::5] = lag[rng.permutation(len(lag))[: len(lag[::5])]]
    lag[3] = e[7] + 0.9 * film.spacing * s.state.e.normal.numpy()[7]
    s.state.l.x.assign(lag.astype(np.float32))
    s.lists.rebuild_l()
    e, all_e, lag = positions(s)
    have, low = rows_as_sets(s.lists.le.rows), near(lag, all_e, s.lists.reach * (1.0 - 1e-5))
    high = near(lag, all_e, s.lists.reach * (1.0 + 1e-5))
    for got, inside, around in zip(have, low, high, strict=True):
        assert set(inside.tolist()) <= got <= set(around.tolist())
    apart = np.linalg.norm(lag[:, None] - e[None], axis=2)
    at = s.lists.le.home.numpy()
    assert np.all(apart[np.arange(len(lag)), at] <= apart.min(axis=1) * (1.0 + 1e-5))
    assert unseen(s) == 0
    far = apart.min(axis=1) > s.lists.le.margin
    start, place = s.lists.el.blocks.start.numpy(), s.lists.el.place.numpy()
    assert far.any() and np.array_equal(place >= start[film.n_e], far)
    rows = s.lists.le.rows
    for a, b in zip(rows.start.numpy(), rows.stop.numpy(), strict=True):
        assert np.all(np.diff((rows.index.numpy()[a:b] >= film.n_e).astype(int)) >= 0)


def test_lists_refill_after_a_move(device):
    """A rebuilt list knows nothing of the old one: all particles in other places, the same brute force."""
    _, s = make_stepper(SHAPES["closed"], 500, device, l_per_e=4)
    e, _, lag = positions(s)
    s.state.l.x.assign((lag @ np.diag([1.0, -1.0, 1.0])).astype(np.float32))
    place_e(s, e[::-1], s.state.e.normal.numpy()[::-1])
    e, all_e, lag = positions(s)
    assert missing(s.lists.ee.rows, e, all_e, s.film.r, same=True) == 0
    assert missing(s.lists.le.rows, lag, all_e, s.film.r) == 0
    assert unseen(s) == 0


def test_an_overflow_is_not_forgotten(device):
    """A list that overflowed says so although it has been built anew since, for particles that lie well again."""
    _, s = make_stepper(SHAPES["closed"], 300, device)
    e = s.state.e.x.numpy().astype(np.float64)
    place_e(s, 0.02 * e)
    place_e(s, e)
    with pytest.raises(SimulationError, match="EE"):
        s.lists.check()


def test_overflow_is_reported(device):
    """Particles that clump want more neighbours than there is room for: an error, never a read beyond the rows."""
    _, s = make_stepper(SHAPES["closed"], 500, device, l_per_e=4)
    s.lists.check()
    e, _, _ = positions(s)
    place_e(s, 0.02 * e + [0.05, 0.0, 0.0])
    i, k, j = pairs_of(s.lists.ee.rows)
    assert k.max() < len(s.lists.ee.rows.index) and j.max() < 500 and len(i) > 0
    with pytest.raises(SimulationError, match="EE"):
        s.lists.check()


def test_skin_of_opposed_motion(device):
    """E that walk 0.2 dx at a time in random directions: the list is built anew before any pair within r is missing.

    Two E may close in at twice the speed of one: a skin of 0.5 dx lasts for one such walk, not for two.
    """
    film, s = make_stepper(SHAPES["closed"], 500, device, numerics={"skin": 0.5})
    x = s.state.e.x.numpy().astype(np.float64)
    way = np.random.default_rng(0).normal(size=x.shape)
    way *= 0.2 * film.spacing / np.linalg.norm(way, axis=1, keepdims=True)
    before = s.lists.builds[0]
    built = []
    for k in range(1, 7):
        old = wp.clone(s.state.e.x)
        s.state.e.x.assign((x + k * way).astype(np.float32))
        s.lists.record_e(old, s.frame, s.dt.at(1.0))
        s.lists.update_e()
        now = s.state.e.x.numpy().astype(np.float64)
        assert missing(s.lists.ee.rows, now, now, film.r, same=True) == 0
        built.append(s.lists.builds[0] - before)
    assert built == [0, 1, 1, 2, 2, 3]


AIR = Surroundings(air="added_mass")


def swirl(points):
    """Rotation about z and a squeeze along x: L flow along the surface, a bubble's E swing."""
    x, y, z = points.T
    return np.stack([-25.0 * y + 15.0 * x, 25.0 * x - 7.5 * y, -7.5 * z], axis=1)


def whirl(points):
    """Rotation of a disc in its plane xz, at rest on its rim."""
    x, _, z = points.T
    rate = 60.0 * (1.0 - (x * x + z * z) / 0.05**2)
    return np.stack([rate * z, 0.0 * x, -rate * x], axis=1)


@pytest.mark.parametrize(("name", "velocity", "dt"), [("closed", swirl, 5e-4), ("flat", whirl, 2e-4)])
@pytest.mark.slow
def test_skin_keeps_every_pair(name, velocity, dt, device):
    """Over 40 steps of flow, no pair within r is missing when it is used, though lists live for several steps.

    E:E is used from the end of a step on, L:E and the blocks from `update_l` on; between, the projection of the
    moved L reads pairs within its own shorter reach.
    """
    skin = {"skin": 0.5}
    film, s = make_stepper(SHAPES[name], 500, device, l_per_e=4, numerics=skin, velocity=velocity, surroundings=AIR)
    start = positions(s)
    before = s.lists.builds
    largest = 0.0
    for _ in range(40):
        old = positions(s)
        s.step(dt)
        e, all_e, lag = positions(s)
        largest = max(largest, np.linalg.norm(lag - old[2], axis=1).max())
        assert missing(s.lists.ee.rows, e, all_e, film.r, same=True) == 0
        assert missing(s.lists.le.rows, lag, all_e, PROJECTION_REACH * film.spacing) == 0
        s.lists.update_l()
        assert missing(s.lists.le.rows, lag, all_e, film.r) == 0
        assert unseen(s) == 0
    moved = [np.linalg.norm(a - b, axis=1).max() / film.spacing for a, b in ((e, start[0]), (lag, start[2]))]
    builds = np.subtract(s.lists.builds, before)
    print(f"{name}: E moved {moved[0]:.2f}, L {moved[1]:.2f} dx, {largest / film.spacing:.2f} a step; builds {builds}")
    assert moved[1] > 2.0 and 1 <= builds[1] < 40
    if name == "closed":
        assert moved[0] > 0.25 and 1 <= builds[0] < 40
