"""Ever coarser sets of the E, for solves whose longest waves span the film (device/multilevel.py)."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.device.launch import launch
from melp_warp.device.linear import ConjugateGradient, LinearOperator
from melp_warp.device.multilevel import Level, MultilevelGradient
from melp_warp.features import Features
from melp_warp.kernels import levels as kv
from melp_warp.kernels import neighbors as kn
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.stages.film import Film
from melp_warp.stages.neighbors import GRID_CELLS, NeighborList, NeighborLists, fixed_rows

APART = 0.5
"""Least distance of the points of the next level, in radii within which a level's points are neighbours."""

COARSER = 2.0
"""That radius on the next level over that on this one."""

SWEEPS = 4
"""Times that points are chosen; what is left open after that is none of the level."""

FEWEST, SHARE, COVER = 32, 4.0, 0.45
"""Points of a level from which on no coarser one is made, counted by the number of E alone so that films made anew have
as many levels: points over those of the next level, and of the first those on an area of `APART` r each way."""

ROOM = 1.3
"""Room for the points of a level, over what there were when it was made."""

PARTS = 64


class _Maker:
    """Makes one level from the next finer one, and makes it again where points have moved.

    Args:
        rows: neighbours of the finer points within r at least; entries beyond them are none.
        room: of these rows.
    """

    def __init__(self, x: wp.array, region: wp.array, rows: Neighbors, room: int, r: float):
        self.x, self.region, self.rows, self.r, self.n = x, region, rows, r, x.shape[0]
        self.device = x.device
        self._state, self._chosen, self._place, self._wanted = (self._zeros(self.n) for _ in range(4))
        self._part, self._norm = self._zeros(PARTS), self._zeros(self.n, wp.float32)
        self._choose()
        count = int(np.count_nonzero(self._state.numpy() == int(kv.CHOSEN)))
        self.places = min(self.n, int(ROOM * count) + 8)
        self._of, self.next_region = self._zeros(self.places), self._zeros(self.places)
        self.next_x = self._zeros(self.places, wp.vec3)
        self._number()
        self._up = fixed_rows(self.n, 0, self.device)
        self._stride, self._up_weight = 0, self._zeros(0, wp.float32)
        self._link_up()
        self._stride = int(ROOM * self._wanted.numpy().max(initial=0)) + 8
        self._up = fixed_rows(self.n, self._stride, self.device)
        self._up_weight = self._zeros(self.n * self._stride, wp.float32)
        self._down = fixed_rows(self.places, room + 1, self.device)
        self._down_weight = self._zeros(self.places * (room + 1), wp.float32)
        self.level = Level(self.n, self.places, self._up, self._up_weight, self._down, self._down_weight)
        self.link()

    def _zeros(self, n: int, dtype=wp.int32) -> wp.array:
        return wp.zeros(n, dtype=dtype, device=self.device)

    def _launch(self, kernel, dim: int, inputs, outputs) -> None:
        launch(kernel, dim, inputs, outputs, self.device)

    def build(self) -> None:
        """Choose the points of the level anew and link it."""
        self._choose()
        self._number()
        self.link()

    def link(self) -> None:
        """Share the finer points among those of the level."""
        self._link_up()
        inputs = [self.x, self._of, self._norm, self.rows, self.r]
        self._launch(kv.link_down_p, self.places, inputs, [self._down, self._down_weight])

    def _choose(self) -> None:
        apart = APART * self.r
        self._launch(kv.open_points_p, self.n, [self.region], [self._state])
        for _ in range(SWEEPS):
            self._launch(kv.choose_points_p, self.n, [self.x, self._state, self.rows, apart], [self._chosen])
            self._launch(kv.cover_points_p, self.n, [self.x, self._chosen, self.rows, apart], [self._state])

    def _number(self) -> None:
        places = [self._of, self.next_x, self.next_region]
        self._launch(kv.empty_places_p, self.places, [self.x], places)
        self._launch(kv.count_chosen_chunks, PARTS, [self._state], [self._part])
        inputs = [self._state, self.x, self.region, self._part]
        self._launch(kv.number_chosen_chunks, PARTS, inputs, [self._place, *places])

    def _link_up(self) -> None:
        inputs = [self.x, self._place, self.rows, self.r, self._stride]
        self._launch(kv.link_up_p, self.n, inputs, [self._up, self._up_weight, self._norm, self._wanted])


class Levels:
    """The E of a film, about every fifth of them, of those every fourth, and so on down to `FEWEST`.

    No two points of a level are nearer to each other than half of the radius within which points of the finer one are
    neighbours, and each finer point has one of them within that. Each finer point is shared among those of the level
    near it, in parts that add up to 1: what a level holds goes over to the E as a smooth function, and back by the
    same shares. They are made anew whenever the lists of E are, for where E were then.

    Attributes:
        levels: from the finest on.
    """

    def __init__(self, film: Film, lists: NeighborLists):
        x, region, ee = lists.state.memory.x[: film.n_e], lists.state.e.region[: film.n_e], lists.ee
        self._grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=film.device)
        self._makers = [_Maker(x, region, ee.rows, ee.stride, film.r)]
        self._lists: list[NeighborList] = []
        points = COVER * film.n_e * (film.spacing / (APART * film.r)) ** 2
        while points > FEWEST:
            self._add()
            points /= SHARE
        self.levels = [maker.level for maker in self._makers]

    def _add(self) -> None:
        last = self._makers[-1]
        x, region, r = last.next_x, last.next_region, COARSER * last.r
        self._grid.build(x, r)
        near = NeighborList(self._grid, x, last.places, x, r, kn.SAME, (region, region), room=32, times=2.0)
        self._lists.append(near)
        self._makers.append(_Maker(x, region, near.rows, near.stride, r))

    def build(self) -> None:
        """Make them anew for where the E are listed."""
        self._makers[0].build()
        for near, maker in zip(self._lists, self._makers[1:], strict=True):
            self._grid.build(maker.x, near.radius)
            near.build(self._grid, maker.x, maker.x)
            maker.build()


def levels_of(film: Film, lists: NeighborLists) -> list[Level]:
    """The levels of a film, made at the first call and kept up with its lists from then on."""
    if lists.levels is None:
        lists.levels = Levels(film, lists)
    return lists.levels.levels


def solver_kernels(features: Features) -> tuple[str, ...]:
    """Files of kernels of `make_solver`."""
    return "linear", *(("levels",) if features.coarse else ())


def make_solver(
    film: Film,
    lists: NeighborLists,
    operator: LinearOperator,
    tolerance: float,
    max_iterations: int | None,
    x: wp.array | None = None,
) -> ConjugateGradient:
    """Conjugate gradients for a number an E, with coarser levels where the film is large enough for them to pay.

    See `ConjugateGradient` for the arguments; both start from the solver's x and end at the same residual.
    """
    if film.features.coarse:
        return MultilevelGradient(operator, film.total, tolerance, max_iterations, levels_of(film, lists), x)
    return ConjugateGradient(operator, film.total, wp.float32, tolerance, max_iterations, x=x)
