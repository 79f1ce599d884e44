"""Neighbour lists from wp.HashGrid, with a skin so that they live for several steps."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.errors import SimulationError
from melp_warp.film import Film
from melp_warp.kernels import diagnostics as kd
from melp_warp.kernels import neighbors as kn
from melp_warp.launch import launch
from melp_warp.state import State

GRID_CELLS = 64
ROOM = 1.5


class NeighborList:
    """One list: for each of `n` points the source points within a radius; capacity is fixed when made."""

    def __init__(self, n: int, device, same: bool):
        self.n, self.device, self.same = n, device, int(same)
        self.count = wp.zeros(n + 1, dtype=wp.int32, device=device)
        self.overflow = wp.zeros(1, dtype=wp.int32, device=device)
        self.rows = kn.Neighbors()
        self.rows.start = wp.zeros(n + 1, dtype=wp.int32, device=device)
        self.rows.index = wp.zeros(0, dtype=wp.int32, device=device)

    def _count(self, grid, x, source, radius):
        launch(kn.count_neighbors, self.n, [grid.id, x, source, radius, self.same], [self.count], self.device)
        wp.utils.array_scan(self.count, self.rows.start, inclusive=False)

    def allocate(self, grid, x, source, radius) -> None:
        """Size the index array for the present particles with room to spare (reads back: at set-up only)."""
        self._count(grid, x, source, radius)
        self.reserve(int(ROOM * self.rows.start.numpy()[-1]) + 64)

    def reserve(self, entries: int) -> None:
        """Make room for so many entries."""
        self.rows.index = wp.zeros(entries, dtype=wp.int32, device=self.device)

    def build(self, grid, x, source, radius) -> None:
        """Fill the list; what does not fit is left out and shows in `check`."""
        self._count(grid, x, source, radius)
        launch(
            kn.fill_neighbors,
            self.n,
            [grid.id, x, source, radius, self.same],
            [self.rows, self.overflow],
            self.device,
        )
        launch(kn.clamp_rows, self.n + 1, [self.rows.index.shape[0]], [self.rows.start], self.device)

    def transpose(self, other: NeighborList) -> None:
        """Become the transpose of another list, without its boundary entries."""
        self.count.zero_()
        launch(kn.count_columns, other.n, [other.rows, self.n], [self.count], self.device)
        wp.utils.array_scan(self.count, self.rows.start, inclusive=False)
        launch(kn.clamp_rows, self.n + 1, [self.rows.index.shape[0]], [self.rows.start], self.device)
        wp.copy(self.count, self.rows.start)
        launch(kn.transpose_rows, other.n, [other.rows, self.n], [self.count, self.rows, self.overflow], self.device)

    @property
    def pairs(self) -> int:
        """Number of entries (reads back)."""
        return int(self.rows.start.numpy()[-1])

    def check(self, name: str) -> None:
        """Raise if a build ever wanted more entries than there is room for (reads back)."""
        wanted, room = int(self.overflow.numpy()[0]), self.rows.index.shape[0]
        if wanted > room:
            raise SimulationError(f"neighbour list {name} needs {wanted} entries, has room for {room}: particles clump")


class NeighborLists:
    """The lists of a film: E:E (boundary included), L:E, E:L, and mirror points:E.

    Lists reach `skin` beyond the support and are rebuilt when particles have moved so far that a pair could be
    missing. Row entries of `ee` are what the geometry's pair arrays are aligned with.

    Attributes:
        travel: [4] largest distances moved, m: E since `ee` was built; E and L together since the other lists were;
            E in the last step; L in the last step.
        builds: times that the E and the L lists were built.
    """

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        self.skin = film.numerics.skin * film.spacing
        self.reach = film.r + self.skin
        self.ee = NeighborList(film.n_e, film.device, same=True)
        self.le = NeighborList(film.n_l, film.device, same=False) if film.features.lagrangian else None
        self.el = NeighborList(film.n_e, film.device, same=False) if film.features.lagrangian else None
        mirrored = film.features.rim and film.features.lagrangian
        self.be = NeighborList(film.n_b, film.device, same=False) if mirrored else None
        self.mirror_reach = 2.0 * film.spacing
        self._grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=film.device)
        self.travel = film.zeros(4)
        self._part = film.parts()
        self.builds = [0, 0]
        self._allocate()
        self.rebuild()

    def _allocate(self) -> None:
        x = self.state.e.x
        self._grid.build(x, self.reach)
        self.ee.allocate(self._grid, x, x, self.reach)
        if self.be is not None:
            self.be.allocate(self._grid, self.film.rim.mirror, x, self.mirror_reach + self.skin)
        if self.le is not None:
            self.le.allocate(self._grid, self.state.l.x, x, self.reach)
            self.el.reserve(self.le.rows.index.shape[0])

    def _build_e(self) -> None:
        x = self.state.e.x
        self._grid.build(x, self.reach)
        self.ee.build(self._grid, x, x, self.reach)
        if self.be is not None:
            self.be.build(self._grid, self.film.rim.mirror, x, self.mirror_reach + self.skin)
        self.film.launch_one(kn.reset_travel, [0], [self.travel])
        self.builds[0] += 1

    def _build_l(self) -> None:
        x_e, x_l = self.state.e.x, self.state.l.x
        self._grid.build(x_e, self.reach)
        self.le.build(self._grid, x_l, x_e, self.reach)
        self.el.transpose(self.le)
        self.film.launch_one(kn.reset_travel, [1], [self.travel])
        self.builds[1] += 1

    def rebuild(self) -> None:
        """Fill all lists for the present positions; whatever is aligned with them must be made anew."""
        self._build_e()
        if self.le is not None:
            self._build_l()

    def update_e(self) -> None:
        """Rebuild the E:E list if pairs could be missing; to be followed by `Geometry.update`."""
        if 2.0 * self._read_travel()[0] > self.skin:
            self._build_e()

    def update_l(self) -> None:
        """Rebuild the lists between E and L if pairs could be missing before the coming step ends."""
        if self.le is not None:
            travel = self._read_travel()
            if travel[1] + 1.5 * (travel[2] + travel[3]) > self.skin:
                self._build_l()

    def _read_travel(self) -> np.ndarray:
        return self.travel.numpy()

    def record_e(self, x_old: wp.array, frame: wp.array, dt: float) -> None:
        """Add how far E moved in this step, relative to the film as a whole."""
        film = self.film
        film.launch_parts(kd.moved_chunks, [self.state.e.x, x_old, frame, dt, film.n_e], [self._part])
        film.launch_one(kn.add_travel, [self._part, 2], [self.travel])

    def record_l(self, frame: wp.array, dt: float) -> None:
        """Add how far L moved in this step, relative to the film as a whole."""
        film = self.film
        film.launch_parts(kd.travel_chunks, [self.state.l.v, frame, dt, film.n_l], [self._part])
        film.launch_one(kn.add_travel, [self._part, 3], [self.travel])

    def check(self) -> None:
        """Raise if any list overflowed (reads back: between frames)."""
        for name in ("ee", "le", "el", "be"):
            one = getattr(self, name)
            if one is not None:
                one.check(name.upper())
