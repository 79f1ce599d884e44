"""Neighbour lists from a grid of cells, with a skin so that they live for several steps."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from melp_warp.errors import CrowdedError, LeapError
from melp_warp.film import Film
from melp_warp.kernels import diagnostics as kd
from melp_warp.kernels import neighbors as kn
from melp_warp.launch import launch, when
from melp_warp.state import State

STRAYS = 0.01
"""Share of the L that may lose the film at once; one always may."""

CROWD_ROOM = 64
"""Further room for the E near an E of a foam: they crowd for a while where films meet."""

FACING_ROOM = 256
"""Least room for the E of other regions near an E: at the start there may be none."""


def fixed_rows(n: int, stride: int, device) -> kn.Neighbors:
    """Empty rows with room for `stride` entries each."""
    rows = _rows(n, n * stride, device)
    start = stride * np.arange(n, dtype=np.int32)
    rows.start.assign(start)
    rows.stop.assign(start)
    return rows


def _rows(n: int, entries: int, device) -> kn.Neighbors:
    rows = kn.Neighbors()
    rows.start = wp.zeros(n, dtype=wp.int32, device=device)
    rows.stop = wp.zeros(n, dtype=wp.int32, device=device)
    rows.index = wp.zeros(entries, dtype=wp.int32, device=device)
    return rows


def check_room(wanted: wp.array, stride: int, name: str) -> None:
    """Raise if a row of list `name` ever wanted more entries than there is room for (reads back)."""
    most = int(wanted.numpy().max(initial=0))
    if most > stride:
        raise CrowdedError(
            f"stage neighbors: a row of list {name} has {most} entries, room for {stride}: particles clump"
        )


class TransposedList:
    """The transpose of a list, entries from `n` on left out: for each of `n` columns the rows it occurs in."""

    def __init__(self, n: int, other: kn.Neighbors):
        self.n, self.other, self.device = n, other, other.index.device
        self.count, self.taken = (wp.zeros(m, dtype=wp.int32, device=self.device) for m in (n, 1))
        self.rows = _rows(n, other.index.shape[0], self.device)

    def build(self) -> None:
        """Transpose the other list as it is now."""
        self.count.zero_()
        self.taken.zero_()
        self._launch(kn.count_columns, [self.other, self.n, self.count])
        launch(kn.open_columns, self.n, [self.count, self.taken, self.rows], device=self.device)
        self._launch(kn.transpose_rows, [self.other, self.n, self.rows])

    def _launch(self, kernel, arguments) -> None:
        launch(kernel, self.other.start.shape[0], arguments, device=self.device)


class CellGrid:
    """Points by the cell that they lie in: rows of the points in each cell, in a grid that wraps around.

    Kernels alone make it, so that a conditional part of a graph can: `wp.HashGrid` copies its descriptor from host
    memory, which CUDA forbids there, and from one place for all grids, so that building one would spoil the graphs
    of others.

    Args:
        n: number of points. There are cells enough for a film of them that is laid out flat, as far as they are few to
            go through.
        width: of a cell, m.
        device: where the points are.

    Attributes:
        cells: what kernels take.
    """

    def __init__(self, n: int, width: float, device):
        side = min(max(2 ** math.ceil(math.log2(max(math.sqrt(n) / 5.0, 1.0))), 16), 64)
        points = fixed_rows(n, 1, device)
        points.stop.assign(np.arange(1, n + 1, dtype=np.int32))
        self._cell = points.index
        self._list = TransposedList(side**3, points)
        self.cells = kn.Cells()
        self.cells.points, self.cells.width, self.cells.side = self._list.rows, width, side

    def build(self, x: wp.array) -> None:
        """Sort the points x [n] (m) into their cells."""
        launch(kn.find_cell, x.shape[0], [x, self.cells], [self._cell], x.device)
        self._list.build()
        launch(kn.sort_rows, self._list.n, [self._list.rows], device=x.device)


class NeighborList:
    """For each of `n` points the source points within a radius, in rows of a fixed room.

    The room is set from the particles present when it is made (reads back: at set-up only).

    Attributes:
        rows: the list; `rows.index.shape[0]` is the size of arrays aligned with its pairs.
        wanted: [n] entries that each row asked for when the list was last built.
    """

    def __init__(
        self,
        grid: CellGrid,
        x: wp.array,
        n: int,
        source: wp.array,
        radius: float,
        pick: int,
        regions: tuple[wp.array, wp.array] | None = None,
        room: int = 8,
        times: float = 1.4,
    ):
        self.n, self.device, self.radius, self.pick = n, x.device, radius, pick
        self.regions = (None, None) if regions is None else regions
        self.wanted = wp.zeros(n, dtype=wp.int32, device=self.device)
        self._most = wp.zeros(1, dtype=wp.int32, device=self.device)
        self.stride = 0
        self.rows = _rows(n, 0, self.device)
        self.build(grid, x, source)
        self.stride = int(times * self.wanted.numpy().max(initial=0)) + room
        self.rows = fixed_rows(n, self.stride, self.device)
        self._most.zero_()
        self.build(grid, x, source)

    def build(self, grid: CellGrid, x: wp.array, source: wp.array) -> None:
        """Fill the list; what does not fit is left out and shows in `check`."""
        of_x, of_source = self.regions
        launch(
            kn.fill_neighbors,
            self.n,
            [grid.cells, x, source, self.radius, of_x, of_source, self.pick, self.stride],
            [self.rows, self.wanted, self._most],
            self.device,
        )

    @property
    def pairs(self) -> int:
        """Number of entries (reads back)."""
        return int((self.rows.stop.numpy() - self.rows.start.numpy()).sum())

    def check(self, name: str) -> None:
        """Raise if a row ever wanted more entries than there is room for (reads back)."""
        check_room(self._most, self.stride, name)


class NeighborLists:
    """The lists of a film: E:E (boundary included), L:E, E:L, mirror points:E, and in foams E to E of other regions.

    Lists reach `skin` beyond the support and are rebuilt when particles have moved so far that a pair could be
    missing. Row entries of `ee` are what the geometry's pair arrays are aligned with.

    Attributes:
        travel: [6] largest distances moved, m: E since `ee` was built; E and L together since the other lists were;
            E in the last step; L in the last step; E and L in any step since `forget_leaps`.
    """

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        self.skin = film.numerics.skin * film.spacing
        self.reach = film.r + self.skin
        self.mirror_reach = 2.0 * film.spacing
        x = state.e.x
        self._grid = CellGrid(film.total, self.reach, film.device)
        self._grid.build(x)
        of_e = state.e.region
        several = film.features.foam
        of_both, room = ((of_e, of_e), CROWD_ROOM) if several else (None, 8)
        times = film.room
        self.ee = NeighborList(self._grid, x, film.n_e, x, self.reach, kn.SAME, of_both, room, times)
        self.le = self.el = self.be = self.eo = None
        if several:
            reach = film.contact_reach + self.skin
            self.eo = NeighborList(self._grid, x, film.n_e, x, reach, kn.OTHER, of_both, FACING_ROOM, times)
        if state.l is not None:
            regions = (state.l.region, of_e) if several else None
            self.le = NeighborList(self._grid, state.l.x, film.n_l, x, self.reach, kn.ALL, regions, times=times)
            self._return_strays()
            self.el = TransposedList(film.n_e, self.le.rows)
            self.el.build()
        if film.features.rim:
            reach = self.mirror_reach + self.skin
            self.be = NeighborList(self._grid, film.rim.mirror, film.n_b, x, reach, kn.ALL, times=times)
        self.travel = film.zeros(6)
        self._stale_e, self._stale_l = (film.zeros(1, wp.int32) for _ in range(2))
        self._builds = wp.full(2, 1, dtype=wp.int32, device=film.device)
        self._part = film.parts()

    @property
    def builds(self) -> list[int]:
        """Times that the E and the L lists were built (reads back)."""
        return self._builds.numpy().tolist()

    def rebuild_e(self) -> None:
        """Fill the lists of E for the present positions; to be followed by `Geometry.update`."""
        x = self.state.e.x
        self._grid.build(x)
        self.ee.build(self._grid, x, x)
        if self.eo is not None:
            self.eo.build(self._grid, x, x)
        if self.be is not None:
            self.be.build(self._grid, self.film.rim.mirror, x)
        self.film.launch_one(kn.count_build, [0], [self.travel, self._builds])

    def rebuild_l(self) -> None:
        """Fill the lists between E and L for the present positions."""
        x = self.state.e.x
        self._grid.build(x)
        self.le.build(self._grid, self.state.l.x, x)
        self._return_strays()
        self.el.build()
        self.film.launch_one(kn.count_build, [1], [self.travel, self._builds])

    def _return_strays(self) -> None:
        """Put L that have lost the film back onto it, with the neighbours of the E where they land."""
        e, lag, film = self.state.e, self.state.l, self.film
        film.launch_l(
            kn.return_strays_l,
            [
                *(e.x, e.region, self.ee.rows),
                *(lag.region, film.n_e, film.r, self.le.stride),
            ],
            [lag.x, self.le.rows, self.le.wanted],
        )

    @property
    def strays(self) -> np.ndarray:
        """Indices of the L that had lost the film when the lists were last built (reads back)."""
        return np.flatnonzero(self.le.wanted.numpy() < 0) if self.le is not None else np.zeros(0, dtype=int)

    def rebuild(self) -> None:
        """Fill all lists for the present positions; whatever is aligned with them must be made anew."""
        self.rebuild_e()
        if self.le is not None:
            self.rebuild_l()

    def update_e(self) -> None:
        """Rebuild the E:E list if pairs could be missing; to be followed by `Geometry.update`."""
        self.film.launch_one(kn.find_stale_e, [self.skin, self.travel], [self._stale_e])
        when(self._stale_e, self.rebuild_e)

    def update_l(self) -> None:
        """Rebuild the lists between E and L if pairs could be missing before the coming step ends."""
        if self.le is not None:
            self.film.launch_one(kn.find_stale_l, [self.skin, self.travel], [self._stale_l])
            when(self._stale_l, self.rebuild_l)

    def expire_l(self) -> None:
        """Let the next `update_l` rebuild the lists between E and L whatever moved."""
        self.film.launch_one(kn.expire_travel, [], [self.travel])

    def forget_leaps(self) -> None:
        """Forget how far E and L moved in the steps so far."""
        self.film.launch_one(kn.forget_leaps, [], [self.travel])

    def record_e(self, x_old: wp.array, frame: wp.array, dt: wp.array) -> None:
        """Add how far E moved in this step, relative to the film as a whole."""
        film = self.film
        e = self.state.e
        film.launch_parts(kd.moved_chunks, [e.x, x_old, e.region, frame, dt, film.n_e], [self._part])
        film.launch_one(kn.add_travel, [self._part, 2], [self.travel])

    def record_l(self, frame: wp.array, dt: wp.array) -> None:
        """Add how far L moved in this step, relative to the film as a whole."""
        film = self.film
        lag = self.state.l
        film.launch_parts(kd.travel_chunks, [lag.v, lag.region, frame, dt, film.n_l], [self._part])
        film.launch_one(kn.add_travel, [self._part, 3], [self.travel])

    def check(self) -> None:
        """Raise if any list overflowed or many L have lost the film (reads back: between frames).

        Raises:
            CrowdedError: a list overflowed.
            LeapError: more L than `STRAYS` had no E within the support.
        """
        for name in ("ee", "eo", "le", "be"):
            one = getattr(self, name)
            if one is not None:
                one.check(name.upper())
        strays = self.strays
        if len(strays) > max(1.0, STRAYS * self.film.n_l):
            raise LeapError(
                f"stage neighbors: {len(strays)} of {self.film.n_l} L have no E within {self.film.r:.3g} m,"
                f" particle {strays[0]} first: they leave the film"
            )
