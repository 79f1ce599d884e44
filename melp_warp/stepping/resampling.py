"""L that clump are merged in pairs, and as many are split where they thin out; their number stays.

Between frames, where L stand more than `Numerics.resampling` times as close as in the mean of their region, or less
than one over it. See docs/vortices.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from melp_warp.stepping.recount import merge_l, pairs_to_merge, split_l, widest_l
from melp_warp.stepping.topology import Stored

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation

AROUND = 1.3
"""Radius of the disc about an E over which the density of L is taken, E spacings."""


class Resampling:
    """The places of the L of one run."""

    def __init__(self, simulation: Simulation):
        self._sim = simulation
        self._factor = simulation.scene.numerics.resampling

    def density(self) -> np.ndarray:
        """Number of L around each E on the area there, over the mean of its region. [n_e] (reads back)."""
        sim = self._sim
        film, lists = sim.film, sim.stepper.lists
        n, e = film.n_e, sim.state.e
        count = self._homes()
        area = sim.stepper.geometry.area.numpy()[:n].astype(np.float64)
        i, j = self._near(e.x.numpy().astype(np.float64), lists.ee.rows)
        held = np.stack([count, area], axis=1)
        around = held + np.stack([np.bincount(i, held[j, c], n) for c in (0, 1)], axis=1)
        region = e.region.numpy()[:n]
        mean = np.stack([np.bincount(region, held[:, c], film.regions)[region] for c in (0, 1)], axis=1)
        return around[:, 0] * mean[:, 1] / np.maximum(around[:, 1] * mean[:, 0], 1e-300)

    def follow(self) -> bool:
        """Between frames: merge L where they clump, split as many where they are thin; whether there were any."""
        sim = self._sim
        features = sim.film.features
        if not features.lagrangian or features.holed or sim.state.course.tears:
            return False
        density, region = self.density(), sim.state.e.region.numpy()[: sim.film.n_e]
        wanted = {}
        for k in np.unique(region[(density > self._factor) | (density < 1.0 / self._factor)]).tolist():
            lack = self._lack(density, region == k)
            wanted[k] = int(np.ceil(max(lack[lack > 0.0].sum(), -lack[lack < 0.0].sum())))
        if wanted:
            with self._sim.new_account("respacing"):
                self._move(wanted, density)
        return bool(wanted)

    def _homes(self) -> np.ndarray:
        """[n_e] number of L of which each E is the nearest one."""
        home = self._sim.stepper.lists.le.home.numpy()
        return np.bincount(home, minlength=self._sim.film.n_e)[: self._sim.film.n_e].astype(np.float64)

    def _near(self, x: np.ndarray, rows) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of E that are in each other's disc."""
        n = self._sim.film.n_e
        start, stop, index = (a.numpy() for a in (rows.start, rows.stop, rows.index))
        length = stop[:n] - start[:n]
        i = np.repeat(np.arange(n), length)
        j = index[np.arange(length.sum()) + np.repeat(start[:n] - (np.cumsum(length) - length), length)]
        inside = (j < n) & (np.sum((x[i] - x[np.minimum(j, len(x) - 1)]) ** 2, axis=1) < self._reach**2)
        return i[inside], j[inside]

    @property
    def _reach(self) -> float:
        return AROUND * self._sim.film.spacing

    def _lack(self, density: np.ndarray, own: np.ndarray) -> np.ndarray:
        """[own] L that each E of a region lacks of what the factor allows; below 0 where it has too many."""
        area = self._sim.stepper.geometry.area.numpy()[: len(density)].astype(np.float64)[own]
        few = np.maximum(1.0 / self._factor - density[own], 0.0)
        many = np.maximum(density[own] - self._factor, 0.0)
        return self._homes()[own].sum() * area / area.sum() * (few - many)

    def _move(self, wanted: dict[int, int], density: np.ndarray) -> None:
        """Merge so many L of each region where they are denser than in the mean, split as many where they are thinner.

        Those beyond the factor come first, where they are enough.
        """
        sim = self._sim
        state, stepper = sim.state, sim.stepper
        stored, rng = Stored.of(state), np.random.default_rng([sim.scene.seed, state.frame, len(wanted)])
        liquid, home = sim.scene.material.density, stepper.lists.le.home.numpy()
        free = stored.there() & (stored.arrays["l.mass"] > 0.0)
        parts = []
        for k, count in wanted.items():
            own = free & (stored.region("l") == k)
            crowd = _first(density[home] > self._factor, density[home] > 1.0, own, 2 * count)
            thin = _first(density[home] < 1.0 / self._factor, density[home] < 1.0, own, count)
            kept, gone = pairs_to_merge(stored, crowd, count, liquid)
            chosen, way = widest_l(stored, thin, len(kept), liquid, rng)
            parts.append((kept[: len(chosen)], gone[: len(chosen)], chosen, way))
        kept, gone, chosen, way = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        split_l(stored, chosen, way)
        later = np.sort(chosen)
        merge_l(stored, *(of + np.searchsorted(later, of) for of in (kept, gone)))
        arrays = stored.arrays
        for name, array in state.arrays().items():
            if name.startswith("l."):
                array.assign(arrays[name])
        state.ids, state.course.issued = stored.ids, stored.issued
        stepper.lists.rebuild_l()
        if sim.film.features.moving:
            stepper.l_advance.project()
        if stepper.rim is not None:
            stepper.rim.confine()


def _first(best: np.ndarray, good: np.ndarray, own: np.ndarray, count: int) -> np.ndarray:
    """Indices of the `own` that are best, or where they are fewer than `count` of those that are good."""
    found = np.flatnonzero(own & best)
    return found if len(found) >= count else np.flatnonzero(own & good)
