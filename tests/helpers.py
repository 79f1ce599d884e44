"""Builders shared by the tests: films on shapes, points moved about on them, fitted orders of convergence."""

from __future__ import annotations

import dataclasses

import numpy as np
import warp as wp

from melp_warp.kernels.neighbors import Neighbors
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Rim, Samples, Shape
from melp_warp.stepping.sampling import make_film


def make_stepper(shape: Shape, e_count: int, device, l_per_e: int = 0, numerics: dict | None = None, **scene):
    """Film and stepper of a scene on `shape`; `numerics` and `scene` override single defaults."""
    options = Numerics(**(numerics or {}))
    made = Scene(name="test", shape=shape, e_count=e_count, l_per_e=l_per_e, numerics=options, **scene)
    return make_film(made, device)


def spline(d, r=3.0):
    """The quintic spline W of support r at d, (22), in float64."""
    a, b, c = (np.maximum(v - 3.0 * d / r, 0.0) for v in (3.0, 2.0, 1.0))
    return 7.0 / (478.0 * np.pi) * 9.0 / r**2 * (a**5 - 6.0 * b**5 + 15.0 * c**5)


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

    def rim(self, spacing: float, width: float) -> Rim:
        return Rim(*(np.zeros((0, 3)) for _ in dataclasses.fields(Rim)))

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


def places_of(stepper, points: np.ndarray) -> np.ndarray:
    """[n] the E made of each of the sampled `points` [n, 3]: E are stored in spatial order."""
    e = stepper.state.e.x.numpy()[: len(points)]
    places = np.empty(len(points), dtype=int)
    places[np.lexsort(points.astype(np.float32).T)] = np.lexsort(e.T)
    assert np.array_equal(e[places], points.astype(np.float32))
    return places


def fitted_order(sizes, errors) -> float:
    """Least-squares slope of log(error) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def pairs_of(rows: Neighbors) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(i, k, j) of every pair of a list: its row, its place in arrays aligned with the list, its column."""
    start = rows.start.numpy().astype(np.int64)
    count = rows.stop.numpy() - start
    i = np.repeat(np.arange(len(start)), count)
    k = np.arange(len(i)) + np.repeat(start - (np.cumsum(count) - count), count)
    return i, k, rows.index.numpy()[k]


def make_rows(columns: list, device) -> Neighbors:
    """Neighbour rows from one sequence of indices a row."""
    ends = np.cumsum([len(c) for c in columns])
    starts = ends - [len(c) for c in columns]
    rows = Neighbors()
    for name, values in (("start", starts), ("stop", ends), ("index", np.concatenate(columns))):
        setattr(rows, name, wp.array(values.astype(np.int32), dtype=wp.int32, device=device))
    return rows


def near(x: np.ndarray, source: np.ndarray, radius: float, same: bool = False) -> list[np.ndarray]:
    """For each x [n, 3] the indices of `source` [m, 3] within `radius`, by brute force; `same` leaves out itself."""
    found = []
    for i, p in enumerate(x.astype(np.float64)):
        inside = np.sum((source - p) ** 2, axis=1) <= radius * radius
        if same:
            inside[i] = False
        found.append(np.flatnonzero(inside))
    return found


def dense_laplacian(stepper) -> np.ndarray:
    """[n_e, n_e] a^-1/2 W a^-1/2 in float64 of a closed film, W the pairs of the surface Laplacian, a the areas."""
    area = stepper.geometry.area.numpy().astype(np.float64)
    i, k, j = pairs_of(stepper.lists.ee.rows)
    weight = stepper.geometry.weight.numpy()[k].astype(np.float64)
    d = np.zeros((len(area), len(area)))
    d[i, j] -= weight
    np.add.at(d, (i, i), weight)
    root = np.sqrt(area)
    return d / np.outer(root, root)
