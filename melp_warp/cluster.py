"""Clusters: many bubbles as one shape, walls they may touch, and what happens to them at set times."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from melp_warp.errors import InputError, require
from melp_warp.shapes import Samples, Shape, Sphere


def _vector(name: str, value) -> None:
    ok = len(value) == 3 and bool(np.all(np.isfinite(value)))
    require(ok, name, value, "three finite numbers")


def e_spacing(radii: Iterable[float], e_count: int) -> float:
    """Spacing of `e_count` E spread evenly over bubbles of these radii (m), m."""
    return float(np.sqrt(4.0 * np.pi * sum(r**2 for r in radii) / e_count))


@dataclass(frozen=True)
class Bubble:
    """One region at its start: a sphere.

    Attributes:
        centre: m.
        radius: m.
        velocity: m/s.
        thickness: m; None for the scene's.
        tension: factor on the scene's surface tension.
        born: time at which it appears, s; it waits until its place is free.
    """

    centre: tuple[float, float, float]
    radius: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    thickness: float | None = None
    tension: float = 1.0
    born: float = 0.0

    def __post_init__(self):
        _vector("centre", self.centre)
        _vector("velocity", self.velocity)
        require(np.isfinite(self.radius) and self.radius > 0.0, "radius", self.radius, "a number above 0, m")
        thick = self.thickness is None or (np.isfinite(self.thickness) and self.thickness > 0.0)
        require(thick, "thickness", self.thickness, "a number above 0, m")
        require(0.1 <= self.tension <= 10.0, "tension", self.tension, "a factor from 0.1 to 10")
        require(np.isfinite(self.born) and self.born >= 0.0, "born", self.born, "a time of at least 0, s")


def approaching(
    corners: np.ndarray, radius: float, gap: float, speed: float, tension: Sequence[float] | None = None
) -> tuple[Bubble, ...]:
    """Equal bubbles on their way to the origin.

    Args:
        corners: [n, 3] unit vectors to where they are.
        radius: m.
        gap: distance between the surfaces of the nearest two, m.
        speed: towards the origin, m/s.
        tension: [n] factors on the scene's tension; 1 each for None.
    """
    corners = np.asarray(corners, dtype=np.float64)
    first, second = np.triu_indices(len(corners), 1)
    away = (2.0 * radius + gap) / np.linalg.norm(corners[first] - corners[second], axis=1).min()
    factors = np.ones(len(corners)) if tension is None else tension
    return tuple(
        Bubble(tuple(away * c), radius, tuple(-speed * c), tension=f) for c, f in zip(corners, factors, strict=True)
    )


@dataclass(frozen=True)
class Wall:
    """A plane that bubbles cannot cross. It is wetted: they cling to it.

    Attributes:
        point: a point of the plane, m.
        normal: unit normal towards the bubbles.
        pops: whether a bubble that touches it pops.
    """

    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    pops: bool = False

    def __post_init__(self):
        _vector("point", self.point)
        _vector("normal", self.normal)
        size = float(np.linalg.norm(self.normal))
        require(abs(size - 1.0) < 1e-6, "normal", self.normal, "a unit vector")


@dataclass(frozen=True)
class Pop:
    """Region `region` pops at `time`: a hole opens in its free film, what it shared with neighbours stays with them.

    Attributes:
        time: s.
        region: number of the bubble.
        place: [3] m; the point of its free film nearest to it is punctured. None for the middle of that film.
        delete: whether the film is removed at once, which costs nothing, in place of a rim that runs over it.
    """

    time: float
    region: int
    place: tuple[float, float, float] | None = None
    delete: bool = False

    @property
    def regions(self) -> tuple[int, ...]:
        """The regions it names."""
        return (self.region,)


@dataclass(frozen=True)
class Merge:
    """The partition between regions `first` and `second` breaks at `time`; the gas goes to `first`.

    Attributes:
        time: s.
        first: number of the bubble that stays.
        second: number of the one that becomes a part of it.
        place: [3] m; the point of the partition nearest to it is punctured. None for its middle.
        delete: whether the partition is removed at once, see `Pop`.
    """

    time: float
    first: int
    second: int
    place: tuple[float, float, float] | None = None
    delete: bool = False

    @property
    def regions(self) -> tuple[int, ...]:
        """The regions it names."""
        return (self.first, self.second)


Event = Pop | Merge


def _overlap(one: int, two: int, radius: float, other: float, depth: float) -> str:
    """What to say of two bubbles that overlap by `depth` (m)."""
    message = f"bubbles {one} and {two} must not overlap at the start, they do by {depth:.3g} m"
    if depth < 2.0 * min(radius, other):
        return message
    inner, outer = (one, two) if radius < other else (two, one)
    return f"{message}: {inner} lies inside {outer}, but a region is all that one closed film encloses"


@dataclass(frozen=True)
class Cluster(Shape):
    """Bubbles, numbered as listed, the walls around them and the events of the run.

    Attributes:
        bubbles: at least one.
        walls: planes.
        events: in any order.
    """

    bubbles: tuple[Bubble, ...]
    walls: tuple[Wall, ...] = ()
    events: tuple[Event, ...] = field(default=())

    closed = True
    flat = False
    even = True

    def __post_init__(self):
        require(len(self.bubbles) >= 1, "bubbles", self.bubbles, "at least one bubble")
        require(any(b.born == 0.0 for b in self.bubbles), "born", [b.born for b in self.bubbles], "0 for one bubble")
        for event in self.events:
            ok = np.isfinite(event.time) and event.time >= 0.0
            require(ok, f"time of {type(event).__name__}", event.time, "a time of at least 0, s")
            if event.place is not None:
                _vector(f"place of {type(event).__name__}", event.place)
            for region in event.regions:
                allowed = f"a region from 0 to {len(self.bubbles) - 1}"
                require(0 <= region < len(self.bubbles), f"region of {type(event).__name__}", region, allowed)
            distinct = len(set(event.regions)) == len(event.regions)
            require(distinct, f"regions of {type(event).__name__}", event.regions, "two different ones")
        self._check_overlap()
        self._check_walls()

    def _check_overlap(self) -> None:
        first = [k for k, b in enumerate(self.bubbles) if b.born == 0.0]
        centre = np.array([self.bubbles[k].centre for k in first], dtype=np.float64)
        radius = np.array([self.bubbles[k].radius for k in first], dtype=np.float64)
        for i in range(len(first)):
            depth = radius[i] + radius[i + 1 :] - np.linalg.norm(centre[i + 1 :] - centre[i], axis=1)
            if len(depth) and depth.max() > 1e-6 * radius[i]:
                k = int(np.argmax(depth))
                raise InputError(_overlap(first[i], first[i + 1 + k], radius[i], radius[i + 1 + k], depth[k]))

    def _check_walls(self) -> None:
        for k, b in enumerate(self.bubbles):
            for w, wall in enumerate(self.walls):
                room = float(np.dot(np.subtract(b.centre, wall.point), wall.normal)) - b.radius
                if room < -1e-6 * b.radius:
                    raise InputError(f"bubble {k} must lie inside wall {w}, it reaches {-room:.3g} m beyond")

    def tensions(self, regions: Sequence[int]) -> list[float]:
        """Factors on the scene's tension of the bubbles of these numbers."""
        return [self.bubbles[k].tension for k in regions]

    @property
    def initial(self) -> tuple[int, ...]:
        """Numbers of the bubbles that are there from the start."""
        return tuple(k for k, b in enumerate(self.bubbles) if b.born == 0.0)

    @property
    def area(self) -> float:
        """Area of the bubbles that are there from the start, m^2."""
        return sum(4.0 * np.pi * self.bubbles[k].radius ** 2 for k in self.initial)

    @property
    def smallest(self) -> int:
        """Number of the smallest bubble, also one to be born."""
        return int(np.argmin([b.radius for b in self.bubbles]))

    def fewest_e(self, support: float) -> int:
        """Fewest E at the start with which the smallest bubble is two supports (in E spacings) across."""
        return math.ceil(self.area * (support / self.bubbles[self.smallest].radius) ** 2)

    @property
    def growth(self) -> float:
        """Area of all bubbles over that of those which are there from the start."""
        return sum(4.0 * np.pi * b.radius**2 for b in self.bubbles) / self.area

    def sample(self, count: int, offset: float = 0.0) -> Samples:
        """Spread about `count` points evenly over the bubbles that are there from the start; see `Samples.region`."""
        parts = [self.sample_bubble(k, self.area / count, offset) for k in self.initial]
        made = [np.concatenate([getattr(s, name) for s in parts]) for name in ("points", "normals", "area")]
        region = np.repeat(np.arange(len(parts)), [len(s.points) for s in parts])
        return Samples(*made, region)

    def sample_bubble(self, k: int, area: float, offset: float = 0.0) -> Samples:
        """Points on bubble k that stand for about `area` (m^2) each."""
        b = self.bubbles[k]
        samples = Sphere(b.radius).sample(max(1, round(4.0 * np.pi * b.radius**2 / area)), offset)
        return Samples(samples.points + np.array(b.centre), samples.normals, samples.area)

    def extent(self) -> np.ndarray:
        """Diameter of the smallest bubble, m."""
        return np.full(3, 2.0 * min(b.radius for b in self.bubbles))
