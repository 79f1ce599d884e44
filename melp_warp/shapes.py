"""Shapes: where the particles of a film start.

A shape samples a surface evenly with any number of points, so the same class places E, L and, for an open film,
the boundary particles that continue it beyond its rim.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from melp_warp.errors import require

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass
class Samples:
    """Points on a surface.

    Attributes:
        points: [n, 3] m.
        normals: [n, 3] outward unit normals.
        area: [n] area that each point stands for, m^2.
    """

    points: np.ndarray
    normals: np.ndarray
    area: np.ndarray


@dataclass
class Rim:
    """Boundary particles of an open film and the rim they continue it across.

    Attributes:
        points: [n_b, 3] m, outside the rim.
        normals: [n_b, 3] unit normals of the continued surface.
        anchors: [n_b, 3] the nearest point of the rim, m.
        outward: [n_b, 3] unit vectors in the film's tangent plane, across the rim and away from the film.
        mirror: [n_b, 3] the point as far inside the rim as the particle lies outside, m.
    """

    points: np.ndarray
    normals: np.ndarray
    anchors: np.ndarray
    outward: np.ndarray
    mirror: np.ndarray


class Shape(ABC):
    """A film's surface."""

    closed: bool
    """Whether the film encloses gas."""
    flat: bool
    """Whether the film is plane and stays so: normal dynamics are then left out."""

    @property
    @abstractmethod
    def area(self) -> float:
        """Area of the film inside its rim, m^2."""

    @abstractmethod
    def sample(self, count: int, offset: float = 0.0) -> Samples:
        """Spread about `count` points evenly; `offset` (0 to 1) turns the pattern."""

    def rim(self, spacing: float, width: float) -> Rim | None:
        """Boundary particles at `spacing` in a strip of `width` beyond the rim; None for a closed film."""
        return None

    def extent(self) -> np.ndarray:
        """Size of the film along its own axes, m: the smallest must have room for the kernel support."""
        points = self.sample(2000).points
        return points.max(axis=0) - points.min(axis=0)

    @property
    def even(self) -> bool:
        """Whether `sample` spreads points evenly already."""
        return True

    def project(self, points: np.ndarray) -> np.ndarray:
        """Points [n, 3] near the surface put onto it, m."""
        return points

    def spacing(self, count: int) -> float:
        """Mean distance dx = sqrt(area/count) between `count` points, m."""
        return float(np.sqrt(self.area / count))


def fibonacci_sphere(count: int, offset: float = 0.0) -> np.ndarray:
    """[count, 3] near-even unit vectors along a golden spiral; `offset` turns the pattern about y."""
    i = np.arange(count) + 0.5
    y = 1.0 - 2.0 * i / count
    s = np.sqrt(1.0 - y * y)
    phi = GOLDEN_ANGLE * i + 2.0 * np.pi * offset
    return np.stack([s * np.cos(phi), y, s * np.sin(phi)], axis=1)


@dataclass(frozen=True)
class StarShaped(Shape):
    """A closed surface r = radius * (1 + displacement(direction)) about `center`.

    Args:
        radius: m.
        displacement: function of unit vectors [n, 3] -> [n], relative; None for a sphere.
        center: m.
    """

    radius: float
    displacement: Callable[[np.ndarray], np.ndarray] | None = None
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)

    closed = True
    flat = False

    def __post_init__(self):
        require(np.isfinite(self.radius) and self.radius > 0.0, "radius", self.radius, "a number above 0")

    def radii(self, directions: np.ndarray) -> np.ndarray:
        """[n] distance from the centre along unit vectors [n, 3], m."""
        if self.displacement is None:
            return np.full(len(directions), float(self.radius))
        radii = self.radius * (1.0 + self.displacement(directions))
        require(bool(np.all(radii > 0.0)), "displacement", float(radii.min()), "such that every radius is above 0")
        return radii

    def normals(self, points: np.ndarray) -> np.ndarray:
        """[n, 3] outward unit normals of the surface where it meets the rays from the centre through points [n, 3]."""
        directions = points - np.asarray(self.center)
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        _, area = self._surface(directions)
        return area / np.linalg.norm(area, axis=1, keepdims=True)

    def _surface(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and area vectors dA n per steradian, by central differences along the surface."""
        axis = np.where(np.abs(directions[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        a = np.cross(directions, axis)
        a /= np.linalg.norm(a, axis=1, keepdims=True)
        b = np.cross(directions, a)
        step = 1e-4

        def at(d):
            d = d / np.linalg.norm(d, axis=1, keepdims=True)
            return d * self.radii(d)[:, None]

        ta = (at(directions + step * a) - at(directions - step * a)) / (2.0 * step)
        tb = (at(directions + step * b) - at(directions - step * b)) / (2.0 * step)
        return at(directions), np.cross(ta, tb)

    @property
    def area(self) -> float:
        if self.displacement is None:
            return 4.0 * np.pi * self.radius**2
        return float(self.sample(20000).area.sum())

    @property
    def even(self) -> bool:
        return self.displacement is None

    def project(self, points: np.ndarray) -> np.ndarray:
        directions = points - np.asarray(self.center)
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        return directions * self.radii(directions)[:, None] + np.asarray(self.center)

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        directions = fibonacci_sphere(count, offset)
        points, area = self._surface(directions)
        size = np.linalg.norm(area, axis=1)
        return Samples(points + np.asarray(self.center), area / size[:, None], size * (4.0 * np.pi / count))


def displaced_sphere(
    radius: float,
    displacement: Callable[[np.ndarray], np.ndarray],
    center: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> StarShaped:
    """A displaced sphere, scaled so that it encloses the volume of a sphere of `radius` (m).

    Args:
        radius: m.
        displacement: function of unit vectors [n, 3] -> [n], relative to `radius` before scaling.
        center: m.

    Raises:
        InputError: for a radius that is not above 0, or a displacement that reaches the centre.
    """
    radii = StarShaped(1.0, displacement).radii(fibonacci_sphere(50000))
    scale = 1.0 / np.cbrt(np.mean(radii**3))
    return StarShaped(radius, lambda d: scale * (1.0 + displacement(d)) - 1.0, center)


def Sphere(radius: float, center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> StarShaped:
    """A sphere."""
    return StarShaped(radius, None, center)


def Ellipsoid(a: float, b: float, c: float) -> StarShaped:
    """An ellipsoid with semi-axes a, b, c along x, y, z (m)."""
    for name, value in (("a", a), ("b", b), ("c", c)):
        require(np.isfinite(value) and value > 0.0, name, value, "a number above 0")
    axes = np.array([a, b, c])
    radius = float(np.cbrt(a * b * c))
    return StarShaped(radius, lambda d: 1.0 / (radius * np.linalg.norm(d / axes, axis=1)) - 1.0)


@dataclass(frozen=True)
class Disc(Shape):
    """A flat round film in the xz plane, normal +y, held by its rim.

    With `flat=False` it is free to bulge (a drum).
    """

    radius: float
    flat: bool = True

    closed = False

    def __post_init__(self):
        require(np.isfinite(self.radius) and self.radius > 0.0, "radius", self.radius, "a number above 0")

    @property
    def area(self) -> float:
        return np.pi * self.radius**2

    def _spiral(self, first: int, last: int, count: int, offset: float) -> np.ndarray:
        i = np.arange(first, last) + 0.5
        rho = self.radius * np.sqrt(i / count)
        phi = GOLDEN_ANGLE * i + 2.0 * np.pi * offset
        return np.stack([rho * np.cos(phi), np.zeros_like(rho), rho * np.sin(phi)], axis=1)

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        points = self._spiral(0, count, count, offset)
        normals = np.tile([0.0, 1.0, 0.0], (count, 1))
        return Samples(points, normals, np.full(count, self.area / count))

    def rim(self, spacing: float, width: float) -> Rim:
        count = max(1, round(self.area / spacing**2))
        outer = int(np.ceil(count * (1.0 + width / self.radius) ** 2))
        points = self._spiral(count, outer, count, 0.0)
        rho = np.linalg.norm(points, axis=1, keepdims=True)
        outward = points / rho
        mirror = outward * np.maximum(2.0 * self.radius - rho, 0.0)
        normals = np.tile([0.0, 1.0, 0.0], (len(points), 1))
        return Rim(points, normals, outward * self.radius, outward, mirror)

    def extent(self) -> np.ndarray:
        return np.full(2, 2.0 * self.radius)


@dataclass(frozen=True)
class Rectangle(Shape):
    """A flat film width x height, centred on the origin, held by a frame.

    `tilt` (degrees) leans it out of the vertical xy plane about the x axis: 0 is vertical with normal +z, 90 lies
    flat with normal +y (up is +y). With `flat=False` it is free to bulge.
    """

    width: float
    height: float
    tilt: float = 0.0
    flat: bool = True

    closed = False

    def __post_init__(self):
        for name in ("width", "height"):
            value = getattr(self, name)
            require(np.isfinite(value) and value > 0.0, name, value, "a number above 0")
        require(np.isfinite(self.tilt), "tilt", self.tilt, "a number of degrees")

    @property
    def area(self) -> float:
        return self.width * self.height

    @property
    def axes(self) -> np.ndarray:
        """[3, 3] rows: along the width, along the height (up), normal."""
        t = np.radians(self.tilt)
        return np.array([[1.0, 0.0, 0.0], [0.0, np.cos(t), -np.sin(t)], [0.0, np.sin(t), np.cos(t)]])

    def _cells(self, count: int) -> tuple[int, int]:
        nx = max(1, round(self.width / self.spacing(count)))
        return nx, max(1, round(count / nx))

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        nx, ny = self._cells(count)
        x = ((np.arange(nx) + 0.5) / nx - 0.5) * self.width
        y = ((np.arange(ny) + 0.5) / ny - 0.5) * self.height
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) @ self.axes[:2]
        return Samples(points, np.tile(self.axes[2], (nx * ny, 1)), np.full(nx * ny, self.area / (nx * ny)))

    def rim(self, spacing: float, width: float) -> Rim:
        nx, ny = self._cells(max(1, round(self.area / spacing**2)))
        half = 0.5 * np.array([self.width, self.height])
        cell = 2.0 * half / np.array([nx, ny])
        layers = np.ceil(width / cell).astype(int)
        x = (np.arange(-layers[0], nx + layers[0]) + 0.5) * cell[0] - half[0]
        y = (np.arange(-layers[1], ny + layers[1]) + 0.5) * cell[1] - half[1]
        p = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        p = p[np.any(np.abs(p) > half, axis=1)]
        anchors = np.clip(p, -half, half)
        out = p - anchors
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        plane = self.axes[:2]
        normals = np.tile(self.axes[2], (len(p), 1))
        return Rim(p @ plane, normals, anchors @ plane, out @ plane, (2.0 * anchors - p) @ plane)

    def extent(self) -> np.ndarray:
        return np.array([self.width, self.height])
