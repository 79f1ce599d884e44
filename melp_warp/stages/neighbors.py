"""Neighbour lists from wp.HashGrid, with a skin so that they live for several steps."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.device.launch import copy, launch, sort_pairs
from melp_warp.errors import CrowdedError, LeapError
from melp_warp.kernels import diagnostics as kd
from melp_warp.kernels import l_lists as kh
from melp_warp.kernels import neighbors as kn
from melp_warp.kernels.native import Blocks
from melp_warp.stages.film import Film
from melp_warp.stages.state import State

GRID_CELLS = 64

HOME_MARGIN = 0.8
"""Distance from its home within which an L is found without a grid, spacings; 0.71 is the farthest in a square grid."""

GROWTH = 1.5
"""Most that the distance moved in a step, or the speed, is expected to grow from one step to the next."""

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


class NeighborList:
    """For each of `n` points the source points within a radius, in rows of a fixed room.

    The room is set from the particles present when it is made (reads back: at set-up only).

    Attributes:
        rows: the list; `rows.index.shape[0]` is the size of arrays aligned with its pairs.
    """

    def __init__(
        self,
        grid: wp.HashGrid,
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

    def build(self, grid: wp.HashGrid, x: wp.array, source: wp.array) -> None:
        """Fill the list; what does not fit is left out and shows in `check`."""
        of_x, of_source = self.regions
        launch(
            kn.fill_neighbors,
            self.n,
            [grid.id, x, source, self.radius, of_x, of_source, self.pick, self.stride],
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


class HomeList(NeighborList):
    """L:E, picked from a wide E:E row around the home of each L, the E nearest to it; E first in each row.

    Attributes:
        home: [n_l] nearest E when the list was last built.
        margin: distance from its home within which an L's neighbours are in the wide row, m.
    """

    def __init__(
        self,
        grid: wp.HashGrid,
        film: Film,
        state: State,
        wide: NeighborList,
        reach: float,
        margin: float,
        regions: tuple[wp.array, wp.array] | None,
    ):
        self.home, self.margin, self._wide, self._n_e = film.zeros(film.n_l, wp.int32), margin, wide, film.n_e
        super().__init__(grid, state.memory.x_l, film.n_l, state.memory.x_e, reach, kn.ALL, regions, times=film.room)

    def build(self, grid: wp.HashGrid, x: wp.array, source: wp.array) -> None:
        """Fill the list and find the homes anew."""
        of_x, of_source = self.regions
        launch(
            kh.fill_neighbors_l,
            self.n,
            [
                *(grid.id, x, source, self.radius, of_x, of_source),
                *(self._wide.rows, self._n_e, self.margin, self.stride),
            ],
            [self.home, self.rows, self.wanted, self._most],
            self.device,
        )


class BlockList:
    """E:L as the L sorted by their homes: those near an E are in the blocks of the E in its wide row.

    L that are farther than a margin from any E are in a last block, at which every E looks.

    Attributes:
        blocks: where the block of each E starts.
        place: [n_l] place of each L.
    """

    def __init__(self, film: Film, state: State, le: HomeList):
        self.film, self.state, self._le = film, state, le
        self._key, self._order = (film.zeros(2 * film.n_l, wp.int32) for _ in range(2))  # as the sort wants it
        self.place = film.zeros(film.n_l, wp.int32)
        self.blocks = Blocks()
        self.blocks.start, self.blocks.reach = film.zeros(film.n_e + 2, wp.int32), film.zeros(film.n_e)
        self.blocks.region = film.zeros(film.n_l + 7, wp.int32)  # read by eights

    def build(self, x_e: wp.array, x_l: wp.array) -> None:
        """Sort the L by their present homes, E and L at these places."""
        film, le = self.film, self._le
        lag = self.state.l
        launch(kh.key_l, film.n_l, [x_l, x_e, le.home, le.margin, film.n_e], [self._key, self._order], film.device)
        sort_pairs(self._key, self._order, film.n_l)
        outputs = [self.blocks.start, self.place, self.blocks.region]
        launch(kh.start_blocks_l, film.n_l, [self._key, self._order, lag.region, film.n_l], outputs, film.device)
        skin = film.numerics.skin * film.spacing
        found = [x_e, x_l, self._order, self.blocks.start, skin]
        film.launch_e(kh.measure_blocks_e, found, [self.blocks.reach])


class NeighborLists:
    """The lists of a film: E:E (boundary included), L:E, E:L, mirror points:E, and E to E of other regions, if several.

    `wide` is an E:E list from which those between E and L are made.

    Lists reach `skin` beyond the support and are rebuilt when particles have moved so far that a pair could be
    missing. Row entries of `ee` are what the geometry's pair arrays are aligned with.

    `wp.HashGrid` allocates and copies from the host, which no graph can hold: lists are built between graphs, and it is
    the host that decides. On a GPU it does so by what it knows without waiting, how far particles had moved a step
    before the last one, with room for as fast a rise of the speed as lists between E and L always had; whether that was
    enough is noted on the device, and a frame in which it was not is done again under watch.

    Attributes:
        levels: coarser sets of the E, kept up with the lists once `stages.levels` has made them; None before.
        travel: [6] largest distances moved, m: E since `ee` was built; E and L together since the other lists were;
            E in the last step; L in the last step; E and L in any step since `forget_leaps`.
        watched: whether the host looks at the device before it decides, which a GPU must be waited for.
        seen: `travel` after a step, with (its dt in s, seconds since the start, builds of E, builds of L).
        several: whether regions are told apart.
    """

    needs = ()
    kernels = ("neighbors",)
    several = False

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        self.skin = film.numerics.skin * film.spacing
        self.reach = film.r + self.skin
        self.mirror_reach = 2.0 * film.spacing
        self._grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=film.device)
        self.wide = self.le = self.el = self.be = self.eo = self.levels = None
        fresh = state.fresh
        if fresh:
            self._remember_e()
        self._make_e()
        if state.l is not None:
            self._make_l(fresh)
        if fresh:
            state.course.builds = [1, 1]
        self.travel, self.seen = state.memory.travel, state.seen
        self._part = film.parts()
        self._late = film.zeros(1, wp.int32)
        self.watched = not film.device.is_cuda

    def _make_e(self) -> None:
        """Make the lists of E, for where E were when they were last built."""
        film, memory, of_e = self.film, self.state.memory, self.state.e.region
        x, n, times = memory.x, film.n_e, film.room
        of_both, room = ((of_e, of_e), CROWD_ROOM) if self.several else (None, 8)
        self._grid.build(x, self.reach)
        self.ee = NeighborList(self._grid, x, n, x, self.reach, kn.SAME, of_both, room, times)
        if self.several:
            reach = film.contact_reach + self.skin
            self.eo = NeighborList(self._grid, x, n, x, reach, kn.OTHER, of_both, FACING_ROOM, times)
        if film.features.lagrangian:
            wide = self.reach + self.skin + HOME_MARGIN * film.spacing  # two E may have come closer by a skin since
            self.wide = NeighborList(self._grid, x, n, x, wide, kn.SAME, of_both, room, times)
            self._part_wide()
        if film.features.rim:
            reach = self.mirror_reach + self.skin
            self.be = NeighborList(self._grid, memory.mirror, film.n_b, x, reach, kn.ALL, times=times)

    def _make_l(self, fresh: bool) -> None:
        """Make the lists between E and L, for where both were when they were last built."""
        film, state, memory = self.film, self.state, self.state.memory
        if fresh:
            self._remember_l()
        else:
            self._build_e(memory.wide)
        self._grid.build(memory.x_e, self.reach)
        regions = (state.l.region, state.e.region) if self.several else None
        self.le = HomeList(self._grid, film, state, self.wide, self.reach, HOME_MARGIN * film.spacing, regions)
        self.el = BlockList(film, state, self.le)
        if fresh:
            copy(memory.home, self.le.home)
            self._build_l(state.l.x)
        else:
            self._build_l(wp.clone(memory.x_l))
            self._build_e(memory.x)

    @property
    def builds(self) -> list[int]:
        """Times that the E and the L lists were built."""
        return list(self.state.course.builds)

    def rebuild_e(self) -> None:
        """Fill the lists of E for the present positions; to be followed by `Geometry.update`."""
        self._remember_e()
        self._build_e(self.state.memory.x)
        self.film.launch_one(kn.reset_travel, [0], [self.travel])
        self.state.course.builds[0] += 1

    def rebuild_l(self) -> None:
        """Fill the lists between E and L for the present positions."""
        self._remember_l()
        self._build_l(self.state.l.x)
        self.film.launch_one(kn.reset_travel, [1], [self.travel])
        self.state.course.builds[1] += 1

    def _remember_e(self) -> None:
        """Note where E are, for their lists to be built there."""
        memory, state = self.state.memory, self.state
        copy(memory.x, state.e.x)
        if memory.mirror is not None:
            copy(memory.mirror, state.b.mirror)

    def _remember_l(self) -> None:
        """Note where E and L are and what homes L had, for the lists between them to be built there."""
        memory, state = self.state.memory, self.state
        copy(memory.wide, memory.x)
        copy(memory.x_e, state.e.x)
        copy(memory.x_l, state.l.x)
        if self.le is not None:
            copy(memory.home, self.le.home)

    def _build_e(self, x: wp.array) -> None:
        self._grid.build(x, self.reach)
        self.ee.build(self._grid, x, x)
        if self.eo is not None:
            self.eo.build(self._grid, x, x)
        if self.be is not None:
            self.be.build(self._grid, self.state.memory.mirror, x)
        if self.wide is not None:
            self.wide.build(self._grid, x, x)
            self._part_wide()
        if self.levels is not None:
            self.levels.build()

    def _build_l(self, x_l: wp.array) -> None:
        """List L as remembered; strays among `x_l`, which are where those were, are put back."""
        memory = self.state.memory
        self._grid.build(memory.x_e, self.reach)
        copy(self.le.home, memory.home)
        self.le.build(self._grid, x_l, memory.x_e)
        self._return_strays(x_l)
        self.el.build(memory.x_e, x_l)

    def _part_wide(self) -> None:
        """Put boundary particles last in the wide rows."""
        if self.film.features.rim:
            self.film.launch_e(kh.part_rows_e, [self.film.n_e], [self.wide.rows])

    def _return_strays(self, x_l: wp.array) -> None:
        """Put L that have lost the film back onto it, with the neighbours of the E where they land."""
        e, lag, film = self.state.e, self.state.l, self.film
        film.launch_l(
            kh.return_strays_l,
            [
                *(self.state.memory.x_e, e.region, self.ee.rows),
                *(lag.region, film.n_e, film.r, self.le.stride),
            ],
            [self.le.home, x_l, self.le.rows, self.le.wanted],
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
        if 2.0 * self._way(0) > self.skin:
            self.rebuild_e()

    def update_l(self) -> None:
        """Rebuild the lists between E and L if pairs could be missing before the coming step ends."""
        if self.le is not None and self._way(1) > self.skin:
            self.rebuild_l()

    def _way(self, which: int) -> float:
        """How far particles are from where list `which` was built at its next use, as far as the host can say, m."""
        if self.watched:
            travel = self.travel.numpy()
            return float(travel[which] + GROWTH * which * (travel[2] + travel[3]))
        seen = self.seen.get()
        if seen is None:
            return np.inf
        travel, (dt, clock, *builds) = seen
        speed = (travel[2] + which * travel[3]) / dt
        since = GROWTH**2 * speed * (self.state.course.clock - clock)
        return float(since + travel[which] * (builds[which] == self.state.course.builds[which]))

    @property
    def fastest(self) -> float:
        """Speed of the fastest particle in the last step, on a GPU in the one before, m/s; 0 where none was done."""
        seen = self.seen.get()
        return float(seen[0][2:4].max()) / seen[1][0] if seen else 0.0

    def expect(self, dt: float) -> None:
        """Note that a step of dt (s) is to come."""
        self.state.course.clock += dt

    def look(self, dt: float) -> None:
        """Let the host see how far particles moved, after a step of dt (s)."""
        self.seen.take((dt, self.state.course.clock, *self.state.course.builds))

    def forget_leaps(self) -> None:
        """Forget how far E and L moved in the steps so far, and what lists were late."""
        self.film.launch_one(kn.forget_leaps, [], [self.travel])
        self._late.zero_()

    def note_late(self, which: int) -> None:
        """Note on the device if list `which` is used although pairs could be missing."""
        self.film.launch_one(kn.find_late, [self.skin, which, self.travel], [self._late])

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
            LeapError: nobody watched, and a list was used when pairs could be missing; or more L than `STRAYS` had no E
                within the support.
        """
        for name in ("ee", "eo", "wide", "le", "be"):
            one = getattr(self, name)
            if one is not None:
                one.check(name.upper())
        if not self.watched and self._late.numpy()[0]:
            raise LeapError("stage neighbors: particles moved further than neighbour lists reach")
        strays = self.strays
        if len(strays) > max(1.0, STRAYS * self.film.n_l):
            raise LeapError(
                f"stage neighbors: {len(strays)} of {self.film.n_l} L have no E within {self.film.r:.3g} m,"
                f" particle {strays[0]} first: they leave the film"
            )
