"""Builders shared by the tests: films on shapes, points moved about on them, fitted orders of convergence."""

from __future__ import annotations

import dataclasses

import numpy as np
import warp as wp

from melp_warp.kernels.neighbors import Neighbors
from melp_warp.neighbors import NeighborList
from melp_warp.numerics import Numerics
from melp_warp.sampling import make_film
from melp_warp.scene import Scene
from melp_warp.shapes import Samples, Shape


def make_stepper(shape: Shape, e_count: int, device, l_per_e: int = 0, numerics: dict | None = None, **scene):
    """Film and stepper of a scene on `shape`; `numerics` and `scene` override single defaults."""
    options = Numerics(**(numerics or {}))
    made = Scene(name="test", shape=shape, e_count=e_count, l_per_e=l_per_e, numerics=options, **scene)
    return make_film(made, device)


@dataclasses.dataclass(frozen=True)
class Jittered(Shape):
    """A shape whose points are moved along its surface by up to `amount` spacings, at random."""

    shape: Shape
    amount: float = 0.15
    seed: int = 1

    @property
    def closed(self) -> bool:
        return self.shape.closed

    @property
    def flat(self) -> bool:
        return self.shape.flat

    @property
    def area(self) -> float:
        return self.shape.area

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        s = self.shape.sample(count, offset)
        rng = np.random.default_rng(self.seed)
        move = rng.uniform(-1.0, 1.0, s.points.shape)
        move -= np.sum(move * s.normals, axis=1, keepdims=True) * s.normals
        move *= (self.amount * rng.uniform(0.0, 1.0, len(move)) / np.linalg.norm(move, axis=1))[:, None]
        points = self.shape.project(s.points + move * np.sqrt(s.area.mean()))
        return Samples(points, s.normals, s.area)

    def rim(self, spacing: float, width: float):
        return self.shape.rim(spacing, width)

    def extent(self) -> np.ndarray:
        return self.shape.extent()


@dataclasses.dataclass(frozen=True)
class Patch(Shape):
    """An open surface given by its points and normals; nothing continues it beyond its edge."""

    samples: Samples
    flat: bool = False

    closed = False

    @property
    def area(self) -> float:
        return float(self.samples.area.sum())

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        return self.samples

    def extent(self) -> np.ndarray:
        return np.full(3, np.ptp(self.samples.points, axis=0).max())


def place_e(stepper, points: np.ndarray, normals: np.ndarray | None = None) -> None:
    """Put the E at `points` [n_e, 3] and renew lists and geometry."""
    e, n = stepper.state.e, stepper.film.n_e
    for array, values in ((e.x, points), (e.normal, normals)):
        if values is not None:
            whole = array.numpy()
            whole[:n] = values
            array.assign(whole)
    stepper.lists.rebuild()
    stepper.geometry.update()


def fitted_order(sizes, errors) -> float:
    """Least-squares slope of log(error) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def find_pairs(x: np.ndarray, source: np.ndarray, radius: float, device, same: bool) -> Neighbors:
    """Neighbour rows of points x [n, 3] among `source` [m, 3], as the solver builds them."""
    a, b = (wp.array(p.astype(np.float32), dtype=wp.vec3, device=device) for p in (x, source))
    grid = wp.HashGrid(32, 32, 32, device=device)
    grid.build(b, radius)
    made = NeighborList(len(x), device, same)
    for action in (made.allocate, made.build):
        action(grid, a, b, radius)
    return made.rows


def rows_of(neighbors) -> list[np.ndarray]:
    """The rows of a neighbour list as index arrays."""
    start, index = neighbors.start.numpy(), neighbors.index.numpy()
    return [index[a:b] for a, b in zip(start[:-1], start[1:], strict=True)]


def row_of_pair(neighbors) -> np.ndarray:
    """For each entry of a neighbour list, the particle whose row it stands in."""
    start = neighbors.start.numpy()
    return np.repeat(np.arange(len(start) - 1), np.diff(start))
