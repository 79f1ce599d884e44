"""Shapes: where the particles of a film start.

A shape samples a surface evenly with any number of points, so the same class places E, L and, for an open film,
the boundary particles that continue it beyond its rim.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.errors import require

if TYPE_CHECKING:
    from melp_warp.cluster import Wall

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))

EDGE_POINTS = 1440
"""Points along an edge: a circle is off by 2e-6 of its radius."""


@dataclass
class Samples:
    """Points on a surface.

    Attributes:
        points: [n, 3] m.
        normals: [n, 3] outward unit normals.
        area: [n] area that each point stands for, m^2.
        region: [n] region of each point, ascending; None for a single one.
    """

    points: np.ndarray
    normals: np.ndarray
    area: np.ndarray
    region: np.ndarray | None = None


@dataclass
class Rim:
    """Boundary particles of an open film and the rim they continue it across.

    Attributes:
        points: [n_b, 3] m, outside the rim.
        normals: [n_b, 3] unit normals of the continued surface.
        anchors: [n_b, 3] the nearest point of the rim, m.
        outward: [n_b, 3] unit vectors in the film's tangent plane, across the rim and away from the film.
        mirror: [n_b, 3] the point as far inside the rim as the particle lies outside, m.
        curvature: [n_b, 3] curvature vector of the rim curve at the anchor, 1/m.
    """

    points: np.ndarray
    normals: np.ndarray
    anchors: np.ndarray
    outward: np.ndarray
    mirror: np.ndarray
    curvature: np.ndarray


class Shape(ABC):
    """A film's surface."""

    closed: bool
    """Whether the film encloses gas."""
    flat: bool
    """Whether the film is plane and stays so: normal dynamics are then left out."""
    initial: tuple[int, ...] = (0,)
    """Numbers of the regions that are there from the start."""
    walls: tuple[Wall, ...] = ()
    """Planes that it touches."""

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

    def edges(self) -> list[np.ndarray]:
        """Dense points [k, 3] along each closed curve in which the film ends, in order, m; none for a closed film."""
        return []

    def tensions(self, regions: Sequence[int]) -> list[float]:
        """Factors on the scene's tension of the regions of these numbers."""
        return [1.0 for _ in regions]

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

    def normals(self, points: np.ndarray) -> np.ndarray | None:
        """[n, 3] outward unit normals at points [n, 3] of the surface; None where a shape does not tell them."""
        return None

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


def _around() -> np.ndarray:
    """Angles of `EDGE_POINTS` points of a circle."""
    return np.linspace(0.0, 2.0 * np.pi, EDGE_POINTS, endpoint=False)


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
        return False  # a golden spiral has its two poles

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
class Jittered(Shape):
    """A shape with its points moved along the surface at random: as E lie in the middle of a run.

    Args:
        shape: the shape.
        amount: largest move, in spacings.
        seed: of the moves.
    """

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

    def edges(self) -> list[np.ndarray]:
        return self.shape.edges()

    def extent(self) -> np.ndarray:
        return self.shape.extent()


class Revolution(Shape):
    """An open film made by turning a profile about the y axis, held by a rim at one or both ends.

    Subclasses give the profile (rho, y) at the parameter t, also a little beyond its ends.
    """

    closed = False
    flat = False
    span: tuple[float, float]
    """Range of t on the film."""
    rims: tuple[bool, bool]
    """Whether the film ends in a rim at the first and at the last t; an end without one lies on the axis."""

    @abstractmethod
    def profile(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance from the axis and height at t, m."""

    def _table(self, first: float, last: float) -> tuple[np.ndarray, ...]:
        """t, rho, y, arc length and area up to t on a fine grid."""
        t = np.linspace(first, last, 20001)
        rho, y = self.profile(t)
        arc = np.hypot(np.diff(rho), np.diff(y))
        length = np.concatenate([[0.0], np.cumsum(arc)])
        area = np.concatenate([[0.0], np.cumsum(np.pi * (rho[1:] + rho[:-1]) * arc)])
        return t, rho, y, length, area

    def _turn(self, t: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, normals (to the side of growing rho) and unit tangents towards growing t."""
        step = 1e-6 * (self.span[1] - self.span[0])
        rho, y = self.profile(t)
        ahead, behind = self.profile(t + step), self.profile(t - step)
        tangent = np.stack([ahead[0] - behind[0], ahead[1] - behind[1]], axis=1)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        c, s = np.cos(phi), np.sin(phi)

        def place(radial, height):
            return np.stack([radial * c, height, radial * s], axis=1)

        sign = (
            -1.0 if self.profile(np.array([self.span[1]]))[1][0] > self.profile(np.array([self.span[0]]))[1][0] else 1.0
        )
        return (
            place(rho, y),
            place(-sign * tangent[:, 1], sign * tangent[:, 0]),
            place(tangent[:, 0], tangent[:, 1]),
        )

    @property
    def area(self) -> float:
        return float(self._table(*self.span)[-1][-1])

    @property
    def even(self) -> bool:
        return False

    def extent(self) -> np.ndarray:
        _, rho, _, length, _ = self._table(*self.span)
        across = 2.0 * rho.max() if not all(self.rims) else 2.0 * np.pi * rho.min()
        return np.array([across, length[-1]])

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        t, _, _, _, area = self._table(*self.span)
        i = np.arange(count) + 0.5
        points, normals, _ = self._turn(
            np.interp(i / count * area[-1], area, t), GOLDEN_ANGLE * i + 2.0 * np.pi * offset
        )
        return Samples(points, normals, np.full(count, area[-1] / count))

    def rim(self, spacing: float, width: float) -> Rim:
        strips = [self._strip(end, spacing, width) for end in (0, 1) if self.rims[end]]
        return Rim(*(np.concatenate(parts) for parts in zip(*strips, strict=True)))

    def edges(self) -> list[np.ndarray]:
        ends = [self.span[end] for end in (0, 1) if self.rims[end]]
        return [self._turn(np.full(EDGE_POINTS, t), _around())[0] for t in ends]

    def _strip(self, end: int, spacing: float, width: float) -> tuple[np.ndarray, ...]:
        """Boundary particles beyond one end, as the fields of `Rim`."""
        edge = self.span[end]
        away = 1.0 if end == 1 else -1.0
        slope = np.hypot(*(np.gradient(a)[1] for a in self.profile(edge + np.array([-1e-6, 0.0, 1e-6])))) / 1e-6
        beyond = edge + away * 1.5 * width / slope
        t, _, _, length, area = self._table(edge, beyond)
        last = np.interp(width, length, area)
        count = max(1, round(last / spacing**2))
        at = np.interp((np.arange(count) + 0.5) / count * last, area, t)
        phi = GOLDEN_ANGLE * np.arange(count)
        depth = np.interp(at, t, length) if end == 1 else np.interp(-at, -t, length)
        ti, _, _, inner, _ = self._table(edge, self.span[1 - end])
        points, normals, _ = self._turn(at, phi)
        anchors, _, tangents = self._turn(np.full(count, edge), phi)
        mirror, _, _ = self._turn(np.interp(depth, inner, ti), phi)
        axis = anchors * [1.0, 0.0, 1.0]
        curvature = -axis / np.sum(axis**2, axis=1, keepdims=True)
        return points, normals, anchors, away * tangents, mirror, curvature

    def project(self, points: np.ndarray) -> np.ndarray:
        t, rho, y, _, _ = self._table(*self.span)
        phi = np.arctan2(points[:, 2], points[:, 0])
        radial = np.hypot(points[:, 0], points[:, 2])
        nearest = np.array(
            [np.argmin((rho - a) ** 2 + (y - b) ** 2) for a, b in zip(radial, points[:, 1], strict=True)]
        )
        return self._turn(t[nearest], phi)[0]


@dataclass(frozen=True)
class Cap(Revolution):
    """A spherical cap of `radius` (m) above a round rim in the plane y = 0, `angle` (degrees) from pole to rim."""

    radius: float
    angle: float = 90.0

    rims = (False, True)

    def __post_init__(self):
        require(np.isfinite(self.radius) and self.radius > 0.0, "radius", self.radius, "a number above 0")
        require(0.0 < self.angle <= 120.0, "angle", self.angle, "above 0 and at most 120 degrees")

    @property
    def span(self) -> tuple[float, float]:
        return (0.0, float(np.radians(self.angle)))

    def profile(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.radius * np.sin(t), self.radius * (np.cos(t) - np.cos(np.radians(self.angle)))


@dataclass(frozen=True)
class Catenoid(Revolution):
    """The minimal surface rho = neck cosh(y/neck) between two round rims at y = -height/2 and height/2 (m)."""

    neck: float
    height: float

    rims = (True, True)

    def __post_init__(self):
        require(np.isfinite(self.neck) and self.neck > 0.0, "neck", self.neck, "a number above 0")
        require(np.isfinite(self.height) and self.height > 0.0, "height", self.height, "a number above 0")

    @property
    def span(self) -> tuple[float, float]:
        return (-0.5 * self.height, 0.5 * self.height)

    def profile(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.neck * np.cosh(t / self.neck), t


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

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        i = np.arange(count) + 0.5
        rho = self.radius * np.sqrt(i / count)
        phi = GOLDEN_ANGLE * i + 2.0 * np.pi * offset
        points = np.stack([rho * np.cos(phi), np.zeros_like(rho), rho * np.sin(phi)], axis=1)
        normals = np.tile([0.0, 1.0, 0.0], (count, 1))
        return Samples(points, normals, np.full(count, self.area / count))

    def rim(self, spacing: float, width: float) -> Rim:
        """The E of that spacing near the rim, reflected in it: what crosses the rim is then mirrored exactly."""
        points = self.sample(max(1, round(self.area / spacing**2))).points
        rho = np.linalg.norm(points, axis=1, keepdims=True)
        near = rho[:, 0] > max(self.radius - width, 0.0)
        mirror, rho = points[near], rho[near]
        outward = mirror / rho
        normals = np.tile([0.0, 1.0, 0.0], (len(mirror), 1))
        beyond = outward * (2.0 * self.radius - rho)
        return Rim(beyond, normals, outward * self.radius, outward, mirror, -outward / self.radius)

    def edges(self) -> list[np.ndarray]:
        phi = _around()
        return [self.radius * np.stack([np.cos(phi), np.zeros_like(phi), np.sin(phi)], axis=1)]

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
        straight = np.zeros_like(normals)
        return Rim(p @ plane, normals, anchors @ plane, out @ plane, (2.0 * anchors - p) @ plane, straight)

    def edges(self) -> list[np.ndarray]:
        side = np.linspace(-0.5, 0.5, EDGE_POINTS // 4, endpoint=False)
        turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
        square = [np.stack([side, np.full_like(side, -0.5)], axis=1)]
        for _ in range(3):
            square.append(square[-1] @ turn)
        return [np.concatenate(square) * [self.width, self.height] @ self.axes[:2]]

    def extent(self) -> np.ndarray:
        return np.array([self.width, self.height])
