"""Spheres through particles, the points where they meet, and the pairs of particles within a distance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

_PART = 1_000_000
"""Pairs that are looked at at once, which bounds the memory to 100 to 200 MB."""

_ROUNDS = 30
"""Most Newton steps; they end within ten wherever there is something to find."""

_PLANE = 1e-6
"""A curvature below this over the size of what was fitted is that of a plane: 32-bit points tell no less."""


@dataclass(frozen=True)
class Sphere:
    """A sphere or, where the curvature is 0, a plane.

    Attributes:
        point: [3], a point on it, m.
        normal: [3], the unit normal there.
        curvature: 1/R, 1/m; positive where the centre lies behind the normal.
        residual: rms distance of the particles from it, m.
        count: particles it was fitted to.
        gap: between the two sides of a film, which it lies in the middle of, m; 0 where there is one side.
    """

    point: np.ndarray
    normal: np.ndarray
    curvature: float
    residual: float = 0.0
    count: int = 0
    gap: float = 0.0

    @property
    def radius(self) -> float | None:
        """Radius, m; None for a plane."""
        return 1.0 / abs(self.curvature) if self.curvature else None

    @property
    def center(self) -> np.ndarray | None:
        """Centre [3], m; None for a plane."""
        return self.point - self.normal / self.curvature if self.curvature else None

    def reversed(self) -> Sphere:
        """The same surface with the opposite normal."""
        return Sphere(self.point, -self.normal, -self.curvature, self.residual, self.count, self.gap)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Gradient [n, 3] at x [n, 3]: along the normal, of unit length on the surface."""
        return self.curvature * (x - self.point) + self.normal

    def normals(self, x: np.ndarray) -> np.ndarray:
        """Unit normals [n, 3] of the concentric surfaces through x [n, 3]."""
        gradient = self.gradient(x)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance [n], m, of x [n, 3]; positive on the side of the normal."""
        y = x - self.point
        value = 0.5 * self.curvature * np.sum(y * y, axis=-1) + y @ self.normal
        return 2.0 * value / (1.0 + np.linalg.norm(self.gradient(x), axis=-1))


def fit_sphere(x: np.ndarray, normals: np.ndarray, weights: np.ndarray, side: np.ndarray) -> Sphere:
    """Fit a sphere, or a plane, with the least sum of squared distances, in the middle between two sides of a film.

    The start is the field k y + b closest to the normals, which is the gradient of a sphere's equation; Gauss-Newton
    steps in offset, tilt, curvature and gap follow. No step divides by the curvature.

    Args:
        x: [n, 3] points, m.
        normals: [n, 3] unit normals; they decide the side of the sphere's normal.
        weights: [n], above 0.
        side: [n], 1 and -1 for points of the sides before and behind the sphere, or all 0.
    """
    weights = weights / weights.sum()
    size = float(np.sqrt(weights @ np.sum((x - weights @ x) ** 2, axis=1)))
    sphere, half_gap = _start(x, normals, weights), 0.0
    root = np.sqrt(weights)[:, None]
    for _ in range(_ROUNDS):
        columns, tangents = _derivatives(sphere, x, side, size)
        step = np.linalg.lstsq(root * columns, -root[:, 0] * (sphere.distance(x) - half_gap * side), rcond=None)[0]
        normal = sphere.normal + step[1:3] @ tangents / size
        sphere = Sphere(
            sphere.point + step[0] * sphere.normal,
            normal / np.linalg.norm(normal),
            sphere.curvature + float(step[3]) / size**2,
        )
        half_gap += float(step[4])
        if np.abs(step).max() < 1e-12 * size:
            break
    curvature = 0.0 if abs(sphere.curvature) * size < _PLANE else sphere.curvature
    residual = float(np.sqrt(weights @ (sphere.distance(x) - half_gap * side) ** 2))
    return Sphere(sphere.point, sphere.normal, curvature, residual, len(x), 2.0 * half_gap)


def _start(x: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> Sphere:
    """The sphere whose gradient k y + b is closest to the normals, through the point nearest to the mean."""
    mean = weights @ x
    y = x - mean
    b = weights @ normals
    k = float(weights @ np.sum(y * (normals - b), axis=1) / (weights @ np.sum(y * y, axis=1)))
    base = int(np.argmin(np.sum(y * y, axis=1)))
    normal = k * y[base] + b
    return Sphere(x[base], normal / np.linalg.norm(normal), k)


def _derivatives(sphere: Sphere, x: np.ndarray, side: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives [n, 5] of the distance by offset, two tilts, curvature and half gap; the tangents [2, 3].

    Tilts and curvature are scaled by the size, so that all are lengths.
    """
    tangents = np.linalg.svd(sphere.normal[None])[2][1:]
    y = x - sphere.point
    gradient = sphere.gradient(x)
    length = np.linalg.norm(gradient, axis=1)
    bend = 0.5 * (np.sum(y * y, axis=1) - sphere.distance(x) ** 2) / size**2
    columns = [-gradient @ sphere.normal, y @ tangents[0] / size, y @ tangents[1] / size, bend, -side * length]
    return np.stack(columns, axis=1) / length[:, None], tangents


def meet(spheres: Sequence[Sphere], x: np.ndarray, rank: int, reach: float) -> np.ndarray:
    """Move points to where surfaces meet, in the sense of least squares where they do not meet exactly.

    Args:
        spheres: at least `rank` surfaces.
        x: [n, 3] points to start from, m.
        rank: 2 where the surfaces share a line, 3 where they share a point.
        reach: points that move further than this are left out, m.

    Returns:
        [m, 3], m <= n.
    """
    found = x.copy()
    for _ in range(_ROUNDS):
        normals = np.stack([sphere.normals(found) for sphere in spheres], axis=1)
        distance = np.stack([sphere.distance(found) for sphere in spheres], axis=1)
        u, s, v = np.linalg.svd(normals, full_matrices=False)
        along = np.einsum("nfr,nf->nr", u[:, :, :rank], distance) / np.maximum(s[:, :rank], 1e-3)
        step = np.einsum("nr,nrk->nk", along, v[:, :rank])
        length = np.linalg.norm(step, axis=1, keepdims=True)
        found -= step * np.minimum(1.0, reach / np.maximum(length, 1e-30))
        if len(step) == 0 or length.max() < 1e-10 * reach:
            break
    return found[np.linalg.norm(found - x, axis=1) <= reach]


def turned(index: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What lies along a closed curve, and a mask of it, from the first outside on: no span then runs over the end."""
    turn = int(np.argmin(inside))
    return np.roll(index, -turn, axis=0), np.roll(inside, -turn)


def spans(inside: np.ndarray) -> list[tuple[int, int]]:
    """First and last + 1 of those in a mask that follow each other, span by span."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def connected(n: int, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """[n] least index of those that each is connected with by pairs i, j, given both ways."""
    piece = np.arange(n)
    while True:
        least = piece.copy()
        np.minimum.at(least, i, piece[j])
        least = least[least]
        if np.array_equal(least, piece):
            return piece
        piece = least


def squares(x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Squared distances of x [n, 3] from points [m, 3]. [n, m]."""
    return ((x[:, None] - points[None]) ** 2).sum(axis=2)


def nearest_distance(x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of each of x [n, 3] from the nearest of some points. [n]."""
    if not len(points):
        return np.full(len(x), np.inf)
    parts = np.array_split(x.astype(np.float64), 1 + len(x) * len(points) // 2_000_000)
    return np.concatenate([np.sqrt(squares(part, points).min(axis=1)) for part in parts])


def close_pairs(x: np.ndarray, radius: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the pairs (i, j), i != j, of points x [n, 3] within `radius`, in parts; all of an i are in one part."""
    cell = np.floor((x - x.min(axis=0)) / radius).astype(np.int64) + 1
    _, ny, nz = cell.max(axis=0) + 2
    key = (cell[:, 0] * ny + cell[:, 1]) * nz + cell[:, 2]
    order = np.argsort(key, kind="stable")
    key = key[order]
    columns = [(a * ny + b) * nz for a in (-1, 0, 1) for b in (-1, 0, 1)]
    start = np.stack([np.searchsorted(key, key + c - 1) for c in columns])
    stop = np.stack([np.searchsorted(key, key + c + 1, side="right") for c in columns])
    part = np.cumsum((stop - start).sum(axis=0)) // _PART
    for at in np.split(np.arange(len(x)), np.flatnonzero(np.diff(part)) + 1):
        parts = [_ranges(order[at], a[at], b[at]) for a, b in zip(start, stop, strict=True)]
        i, j = np.concatenate([p[0] for p in parts]), order[np.concatenate([p[1] for p in parts])]
        inside = (np.sum((x[i] - x[j]) ** 2, axis=1) <= radius * radius) & (i != j)
        yield i[inside], j[inside]


def _ranges(i: np.ndarray, start: np.ndarray, stop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each i [n] with every whole number from its start to before its stop."""
    count = stop - start
    first = np.cumsum(count) - count
    return np.repeat(i, count), np.arange(count.sum()) + np.repeat(start - first, count)
