"""L that come and go: one is split into two, two are merged into one, and what they hold together stays as it is."""

from __future__ import annotations

import numpy as np

from melp_warp.measure.fits import close_pairs
from melp_warp.stepping.topology import Stored

PARTS = 0.35
"""Distance of the halves of an L from where it was, in the root of its area: as far apart as L of half of it are."""

PARTNERS = 1.6
"""Distance within which L are merged, in the root of their mean area."""

AROUND = 6.0
"""Distance within which L tell how what they hold changes from place to place, in that of a part from the whole."""

MOST_UNEVEN = 0.5
"""Most by which a part holds more than half of what an L has, relative."""

MEANS = ("x", "u", "v", "affine", "normal")
"""What two L that merge have as a mean by mass."""


def split_l(stored: Stored, chosen: np.ndarray, way: np.ndarray) -> None:
    """Split L into two parts each, of half of its area. Liquid, momentum and all else that adds up are kept.

    The parts lie on either side of where the L was. Each holds what the L around say of its place, by a plane through
    what the L has: with equal parts a film of which every L is split would be thick and thin in steps. They have the
    velocity that the affine part gives at their places: a flow that is linear about the L stays the same. The heavier
    one is nearer to where the L was, so that the middle stays. The first keeps the L's number, the second gets a new
    one.

    Args:
        stored: the state, changed in place; the parts of an L follow each other.
        chosen: [k] indices of the L.
        way: [k, 3] from each to its first part, were it as heavy as the other, m.
    """
    arrays = stored.arrays
    extra = _uneven(stored, chosen, way)
    count = np.ones(len(arrays["l.mass"]), dtype=int)
    count[chosen] = 2
    of = np.repeat(np.arange(len(count)), count)
    second = np.concatenate([[False], of[1:] == of[:-1]])
    halved, side = count[of] == 2, np.where(second, -1.0, 1.0)
    share, packed, shift = np.zeros(len(count)), np.zeros(len(count)), np.zeros((len(count), 3))
    share[chosen], shift[chosen] = extra["l.mass"] / arrays["l.mass"][chosen], way
    packed[chosen] = extra["l.surfactant"] / np.maximum(arrays["l.surfactant"][chosen].astype(np.float64), 1e-300)
    shift = shift[of] * (side - share[of])[:, None]
    changes = {}
    for name, more in extra.items():
        changes[name] = np.zeros(len(count))
        changes[name][chosen] = more
    stored.select("l", of)
    slope = np.einsum("nij,nj->ni", arrays["l.affine"].astype(np.float64), shift)
    for name, change in (("x", shift), ("u", slope), ("v", slope)):
        arrays[f"l.{name}"] = (arrays[f"l.{name}"] + change).astype(arrays[f"l.{name}"].dtype)
    thicker = (1.0 + side * share[of]) / (1.0 + side * packed[of])
    arrays["l.eta"] = (arrays["l.eta"] * thicker).astype(arrays["l.eta"].dtype)
    for name, change in changes.items():
        arrays[name][halved] = 0.5 * (arrays[name] + side * change[of])[halved]
    stored.ids["l"][second] = stored.issue("l", len(chosen))


def _uneven(stored: Stored, chosen: np.ndarray, way: np.ndarray) -> dict[str, np.ndarray]:
    """What the first part of each L is to hold more than the second, of what adds up: name -> [k]."""
    arrays, names, k = stored.arrays, _sums(stored), len(chosen)
    x, region, mass = arrays["l.x"].astype(np.float64), stored.region("l"), arrays["l.mass"].astype(np.float64)
    area = np.maximum(mass, 1e-300) / arrays["l.eta"]  # times density
    layer = np.stack([arrays[name] / area for name in names], axis=1)
    near = np.flatnonzero(stored.there() & (mass > 0.0) & np.isin(region, region[chosen]))
    slot = np.full(len(x), -1)
    slot[chosen] = np.arange(k)
    matrix, right = np.zeros((k, 3, 3)), np.zeros((k, 3, len(names)))
    for i, j in close_pairs(x[near], AROUND * float(np.linalg.norm(way, axis=1).mean())):
        i, j = near[i], near[j]
        own = (slot[i] >= 0) & (region[i] == region[j])
        i, j = i[own], j[own]
        to = x[j] - x[i]
        np.add.at(matrix, slot[i], to[:, :, None] * to[:, None, :])
        np.add.at(right, slot[i], to[:, :, None] * (layer[j] - layer[i])[:, None, :])
    scale = np.trace(matrix, axis1=1, axis2=2)
    matrix += (1e-6 * scale + 1e-30)[:, None, None] * np.eye(3)
    more = area[chosen, None] * np.einsum("ka,kan->kn", way, np.linalg.solve(matrix, right))
    held = np.stack([np.abs(arrays[name][chosen]) for name in names], axis=1)
    return dict(zip(names, np.clip(more, -MOST_UNEVEN * held, MOST_UNEVEN * held).T, strict=True))


def merge_l(stored: Stored, kept: np.ndarray, gone: np.ndarray) -> None:
    """Merge L in pairs. Liquid, momentum, area and all else that adds up are kept; the motion within a pair ends.

    Args:
        stored: the state, changed in place.
        kept: [k] indices of those that stay and keep their numbers.
        gone: [k] indices of those that they take up.
    """
    arrays = stored.arrays
    mass = [arrays["l.mass"][of].astype(np.float64) for of in (kept, gone)]
    total = mass[0] + mass[1]
    for name in MEANS:
        values = arrays[f"l.{name}"]
        share = [(part / total).reshape(-1, *([1] * (values.ndim - 1))) for part in mass]
        values[kept] = share[0] * values[kept] + share[1] * values[gone]
    arrays["l.normal"][kept] /= np.linalg.norm(arrays["l.normal"][kept], axis=1, keepdims=True)
    eta = arrays["l.eta"]
    eta[kept] = total / (mass[0] / eta[kept] + mass[1] / eta[gone])
    for name in _sums(stored):
        arrays[name][kept] += arrays[name][gone]
    stays = np.ones(len(eta), dtype=bool)
    stays[gone] = False
    stored.select("l", stays)


def _sums(stored: Stored) -> list[str]:
    """Arrays of what L hold that adds up."""
    return [name for held in (*stored.amounts, "circulation") if (name := f"l.{held}") in stored.arrays]


def widest_l(
    stored: Stored, own: np.ndarray, count: int, density: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Those L that stand for the largest areas, and ways to split them, in the film, across that to the nearest L.

    Args:
        stored: the state.
        own: indices of the L to choose from.
        count: how many.
        density: kg/m^3.
        rng: where none is near, the direction is random.

    Returns:
        [count] indices and [count, 3] ways, m.
    """
    area = areas(stored, own, density)
    chosen = own[np.argsort(-area, kind="stable")[:count]]
    size = np.sqrt(np.sort(area)[::-1][:count])
    normal = stored.arrays["l.normal"][chosen].astype(np.float64)
    across = np.cross(normal, _to_nearest(stored.arrays["l.x"], own, chosen, PARTNERS * float(np.sqrt(area.mean()))))
    length = np.linalg.norm(across, axis=1)
    other = np.cross(normal, rng.normal(size=(len(chosen), 3)))
    across = np.where((length > 1e-9)[:, None], across, other)
    return chosen, across * (PARTS * size / np.linalg.norm(across, axis=1))[:, None]


def _to_nearest(x: np.ndarray, own: np.ndarray, chosen: np.ndarray, reach: float) -> np.ndarray:
    """[k, 3] from each of the `chosen` to the nearest of `own`, m; 0 where none is within `reach`."""
    way, there = np.zeros((len(x), 3)), x[own].astype(np.float64)
    for i, j in close_pairs(there, reach):
        apart = there[j] - there[i]
        order = np.argsort(-(apart**2).sum(axis=1), kind="stable")
        way[own[i[order]]] = apart[order]  # the nearest last
    return way[chosen]


def pairs_to_merge(stored: Stored, own: np.ndarray, count: int, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of near L that stand for small areas, each L in one at most.

    Args:
        stored: the state.
        own: indices of the L to choose from.
        count: most pairs.
        density: kg/m^3.

    Returns:
        Indices of those to keep and of those to take up, [k] each, k at most `count`.
    """
    x, area = stored.arrays["l.x"][own].astype(np.float64), areas(stored, own, density)
    found = []
    for i, j in close_pairs(x, PARTNERS * float(np.sqrt(area.mean()))):
        once = i < j
        i, j = i[once], j[once]
        found.append((area[i] + area[j] + ((x[i] - x[j]) ** 2).sum(axis=1), i, j))
    cost, i, j = (np.concatenate(columns) for columns in zip(*found, strict=True))
    order = np.argsort(cost, kind="stable")
    i, j, free, kept, gone = i[order], j[order], np.ones(len(own), dtype=bool), [], []
    while len(i) and sum(map(len, kept)) < count:
        rank, first = np.arange(len(i)), np.full(len(own), len(i))
        for of in (i, j):
            np.minimum.at(first, of, rank)
        best = (first[i] == rank) & (first[j] == rank)
        kept.append(i[best])
        gone.append(j[best])
        free[i[best]] = free[j[best]] = False
        left = free[i] & free[j]
        i, j = i[left], j[left]
    kept, gone = (np.concatenate([np.zeros(0, dtype=int), *parts])[:count] for parts in (kept, gone))
    return own[kept], own[gone]


def areas(stored: Stored, of: np.ndarray, density: float) -> np.ndarray:
    """Areas that L of a film of this density (kg/m^3) stand for, m^2."""
    return stored.arrays["l.mass"][of].astype(np.float64) / (density * stored.arrays["l.eta"][of])


def count_l(stored: Stored, region: int, wanted: int, density: float, rng: np.random.Generator) -> None:
    """Split or merge the L of a region until there are `wanted`, or no two are near enough to be merged.

    Args:
        stored: the state, changed in place.
        region: index of the region.
        wanted: number of its L.
        density: kg/m^3.
        rng: see `widest_l`.
    """
    while True:
        held = (stored.region("l") == region) & stored.there() & (stored.arrays["l.mass"] > 0.0)
        own, missing = np.flatnonzero(held), wanted - int(held.sum())
        if missing == 0 or not len(own):
            return
        if missing > 0:
            split_l(stored, *widest_l(stored, own, min(missing, len(own)), density, rng))
            continue
        kept, gone = pairs_to_merge(stored, own, -missing, density)
        if not len(kept):
            return
        merge_l(stored, kept, gone)
