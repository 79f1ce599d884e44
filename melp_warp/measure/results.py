"""Measures the bubbles of a foam from its particles: volumes, films as spheres, the angles at which films meet."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from melp_warp.errors import require
from melp_warp.frame import ParticleFrame
from melp_warp.measure.fits import Sphere
from melp_warp.measure.fitted_films import (
    Films,
    common_circle,
    fit_films,
    line_angles,
    share_corners,
    touching_regions,
    vertex_angles,
)
from melp_warp.measure.patches import OUTSIDE, Cloud, make_cloud, sort_particles
from melp_warp.tables import columns

_OPEN = 0.05
"""Relative error of a closed surface's integrals from which a surface is open."""

_EQUAL = 0.05
"""Volumes this close, relative, are compared with the least area of two equal bubbles."""


@dataclass(frozen=True)
class RegionMeasure:
    """One bubble.

    Attributes:
        region: its index.
        count: particles.
        area: of its whole surface, m^2.
        volume: enclosed, m^3; None where the surface is open.
        centroid: [3], of the volume, or of the surface where that is open, m.
        cap: sphere through its film to the outside; None where too few particles are on it.
        cap_area: area of that film, m^2.
        pressure: excess over the outside by the cap, 4/R, in units of the surface tension of one side, 1/m.
    """

    region: int
    count: int
    area: float
    volume: float | None
    centroid: np.ndarray
    cap: Sphere | None
    cap_area: float
    pressure: float | None


@dataclass(frozen=True)
class PairMeasure:
    """Two bubbles that touch.

    Attributes:
        regions: their indices, ascending.
        partition: sphere through the film between them, normal to the second; None with too few particles.
        area: of the partition, mean of both sides, m^2.
        expected: curvature of the partition by the pressures of the two caps, 1/R_first - 1/R_second, 1/m.
        contact_radius: of the circle where the two caps meet, m; None where they do not meet.
        angles: dihedral angles within the first, within the second and outside, degrees; None where they do not meet
            outside, and for an angle with a film that is not fitted.
        samples: points of that line over which the angles are averaged.
    """

    regions: tuple[int, int]
    partition: Sphere | None
    area: float
    expected: float | None
    contact_radius: float | None
    angles: tuple[float | None, ...] | None
    samples: int


@dataclass(frozen=True)
class TripleMeasure:
    """The inner line of three bubbles that touch one another.

    Attributes:
        regions: their indices, ascending.
        angles: dihedral angle within each of them, degrees; None for one with a film that is not fitted.
        samples: points of the line over which the angles are averaged.
    """

    regions: tuple[int, int, int]
    angles: tuple[float | None, ...]
    samples: int


@dataclass(frozen=True)
class VertexMeasure:
    """A point where four lines meet.

    Attributes:
        regions: indices of the four regions that meet, ascending; -1 is the outside.
        point: [3], m.
        angles: between the lines, each with each, degrees: six, fewer where films are not fitted.
    """

    regions: tuple[int, int, int, int]
    point: np.ndarray
    angles: tuple[float, ...]


@dataclass(frozen=True)
class CarriedMeasure:
    """What the scene declares, on the film of one bubble.

    Attributes:
        name: of the quantity.
        unit: its own; "" where it is not known.
        region: index of the bubble.
        least, mean, most: of its values, the mean by area.
        total: integral over the film, unit m^2.
    """

    name: str
    unit: str
    region: int
    least: float
    mean: float
    most: float
    total: float


@dataclass(frozen=True)
class Measurement:
    """What `measure` finds.

    Attributes:
        spacing: of the particles, m.
        regions: every bubble.
        pairs: every two that touch.
        triples: every inner line.
        vertices: every point where four lines meet.
        film_area: of all films, each counted once, m^2.
        fitted_area: the same for a double bubble by the fitted spheres alone; None for any other foam.
        least_area: the least for two equal bubbles of these volumes; None where they differ by more than 5 %.
        carried: what the scene declares, quantity by quantity and region by region.
    """

    spacing: float
    regions: tuple[RegionMeasure, ...]
    pairs: tuple[PairMeasure, ...]
    triples: tuple[TripleMeasure, ...]
    vertices: tuple[VertexMeasure, ...]
    film_area: float
    fitted_area: float | None
    least_area: float | None
    carried: tuple[CarriedMeasure, ...] = ()

    def to_json(self) -> dict:
        """Return everything as dictionaries, lists, numbers and None."""
        return _plain(self)

    def table(self) -> str:
        """Return everything as text."""
        return "\n\n".join(
            columns(rows)
            for rows in (
                *(*self._regions(), self._pairs(), self._triples(), self._vertices()),
                *(self._carried(), self._totals()),
            )
            if len(rows) > 1
        )

    def _regions(self) -> tuple[list, list]:
        head = ("region", "particles", "area m2", "volume m3", "centroid m")
        cap_head = ("cap", "area m2", "radius m", "center m", "rms / spacing", "fitted", "4/R 1/m")
        body = [(r.region, r.count, r.area, r.volume, r.centroid) for r in self.regions]
        caps = [
            (r.region, r.cap_area, r.cap.radius, r.cap.center, r.cap.residual / self.spacing, r.cap.count, r.pressure)
            for r in self.regions
            if r.cap
        ]
        return _rows(head, body), _rows(cap_head, caps)

    def _pairs(self) -> list:
        head = ("pair", "area m2", "1/R 1/m", "by caps 1/m", "contact m", "gap / spacing", "rms / spacing", "fitted")
        head += ("angle first", "second", "outside", "over")
        body = []
        for p in self.pairs:
            f, angles = p.partition, p.angles or (None,) * 3
            fit = (f.gap / self.spacing, f.residual / self.spacing, f.count) if f else (None, None, 0)
            curvature = f.curvature if f else None
            body.append((_names(p.regions), p.area, curvature, p.expected, p.contact_radius, *fit, *angles, p.samples))
        return _rows(head, body)

    def _triples(self) -> list:
        head = ("line", "angle first", "second", "third", "over")
        return _rows(head, [(_names(t.regions), *t.angles, t.samples) for t in self.triples])

    def _vertices(self) -> list:
        body = [(_names(v.regions), v.point, " ".join(f"{a:.2f}" for a in v.angles)) for v in self.vertices]
        return _rows(("vertex", "point m", "angles between the lines"), body)

    def _carried(self) -> list:
        head = ("carried", "region", "unit", "least", "mean", "most", "over the film, unit m2")
        return _rows(head, [(c.name, c.region, c.unit, c.least, c.mean, c.most, c.total) for c in self.carried])

    def _totals(self) -> list:
        body = [
            ("film area m2", self.film_area),
            ("film area by fitted spheres m2", self.fitted_area),
            ("least area of two equal bubbles m2", self.least_area),
            ("spacing m", self.spacing),
        ]
        return _rows(("total", ""), [row for row in body if row[1] is not None])


def measure(frame: ParticleFrame, spacing: float | None = None, units: Mapping[str, str] | None = None) -> Measurement:
    """Measure the bubbles of one frame.

    Args:
        frame: closed surfaces by region; `widths` hold the areas of the particles. Open surfaces have no volume.
        spacing: distance of neighbouring particles, m; by default the root of the mean area of a particle.
        units: of what the frame has in `carried`, by name.

    Raises:
        InputError: the frame has no particles, or particles without an area or a unit normal.
    """
    cloud = make_cloud(frame, spacing)
    patches = sort_particles(cloud)
    touching = touching_regions(cloud, patches)
    films = fit_films(cloud, patches, touching)
    other = share_corners(cloud, patches, films)
    corners = {key: near for key, near in patches.corners.items() if set(combinations(key, 2)) <= touching}
    regions = tuple(_region(cloud, other, films, int(k)) for k in np.unique(cloud.region))
    pairs = tuple(_pair(cloud, other, films, corners, pair) for pair in sorted(touching) if OUTSIDE not in pair)
    double = len(regions) == 2 and len(pairs) == 1
    return Measurement(
        spacing=cloud.spacing,
        regions=regions,
        pairs=pairs,
        triples=tuple(_triples(cloud, films, corners)),
        vertices=tuple(_vertices(cloud, films, corners)),
        film_area=float(cloud.area @ np.where(other == OUTSIDE, 1.0, 0.5)),
        fitted_area=_double_area(films, pairs[0]) if double else None,
        least_area=_least_area(regions[0].volume, regions[1].volume) if double else None,
        carried=tuple(_carried(frame, cloud, units or {})),
    )


def measure_cache(
    folder: str | os.PathLike, frame: int | None = None, which: str | None = None, spacing: float | None = None
) -> Measurement:
    """Measure a frame of a cache.

    Args:
        folder: folder of the cache.
        frame: its number; None for the last.
        which: "e" or "film"; None for E where the cache has them.
        spacing: see `measure`; by default that of the E where the cache has them, whichever are measured.

    Raises:
        InputError: there is no such cache, frame or set, or see `measure`.
    """
    from melp_warp.usd.apart import read_frame, read_root
    from melp_warp.usd.schema import list_frames

    frames = list_frames(folder)
    require(bool(frames), "DIR", str(folder), "a folder that a run wrote, with frames in it")
    frame = frames[-1] if frame is None else frame
    require(frame in frames, "--frame", frame, f"from {frames[0]} to {frames[-1]}")
    root = read_root(folder)
    has_e = "FilmE" in root["prims"]
    require(which != "e" or has_e, "--set", which, "film, as the cache has no /World/FilmE")
    prim = "FilmE" if has_e and which != "film" else "Film"
    if spacing is None and has_e:
        spacing = make_cloud(read_frame(folder, frame, "FilmE"), None).spacing
    return measure(read_frame(folder, frame, prim), spacing, root["carried"])


# --- bubbles, films and lines ----------------------------------------------------------------------------------------


def _region(cloud: Cloud, other: np.ndarray, films: Films, k: int) -> RegionMeasure:
    mine = cloud.region == k
    volume, centroid = _enclosed(cloud.x[mine], cloud.normal[mine], cloud.area[mine])
    cap = films.get((k, OUTSIDE))
    return RegionMeasure(
        region=k,
        count=int(mine.sum()),
        area=float(cloud.area[mine].sum()),
        volume=volume,
        centroid=centroid,
        cap=cap,
        cap_area=float(cloud.area[mine & (other == OUTSIDE)].sum()),
        pressure=4.0 * cap.curvature if cap else None,
    )


def _carried(frame: ParticleFrame, cloud: Cloud, units: Mapping[str, str]) -> Iterable[CarriedMeasure]:
    for name, values in frame.carried.items():
        for k in np.unique(cloud.region):
            held, area = values[cloud.region == k].astype(np.float64), cloud.area[cloud.region == k]
            total = float(held @ area)
            bounds = float(held.min()), total / float(area.sum()), float(held.max())
            yield CarriedMeasure(name, units.get(name, ""), int(k), *bounds, total)


def _enclosed(x: np.ndarray, normal: np.ndarray, area: np.ndarray) -> tuple[float | None, np.ndarray]:
    """Volume and its centroid [3]; None and the centroid of the surface where the surface is open.

    Of a closed surface the integral of the normal is 0 and that of x_a n_b the volume where a = b, otherwise 0.
    """
    mean = area @ x / area.sum()
    y, n = x - mean, normal * area[:, None]
    moments = y.T @ n
    volume = float(np.trace(moments) / 3.0)
    gap = np.abs(n.sum(axis=0)).max() / area.sum()
    if volume == 0.0 or gap > _OPEN or np.abs(moments - volume * np.eye(3)).max() > _OPEN * abs(volume):
        return None, mean
    return volume, mean + 0.5 * np.sum(y * y * n, axis=0) / volume


def _pair(cloud: Cloud, other: np.ndarray, films: Films, corners: dict, pair: tuple[int, int]) -> PairMeasure:
    a, b = pair
    between = (cloud.region == a) & (other == b) | (cloud.region == b) & (other == a)
    caps = [films.get((k, OUTSIDE)) for k in pair]
    near = corners.get((OUTSIDE, a, b))
    angles, samples = (None, 0) if near is None else line_angles(cloud, films, (a, b, OUTSIDE), near)
    circle = common_circle(*caps) if all(caps) and angles else None
    return PairMeasure(
        regions=pair,
        partition=films.get(pair),
        area=0.5 * float(cloud.area[between].sum()),
        expected=caps[0].curvature - caps[1].curvature if all(caps) else None,
        contact_radius=circle[0] if circle else None,
        angles=angles,
        samples=samples,
    )


def _triples(cloud: Cloud, films: Films, corners: dict) -> Iterable[TripleMeasure]:
    for key, near in corners.items():
        if len(key) == 3 and OUTSIDE not in key:
            angles, samples = line_angles(cloud, films, key, near)
            if angles:
                yield TripleMeasure(key, angles, samples)


def _vertices(cloud: Cloud, films: Films, corners: dict) -> Iterable[VertexMeasure]:
    for key, near in corners.items():
        if len(key) == 4:
            for point, angles in vertex_angles(cloud, films, key, near):
                yield VertexMeasure(key, point, angles)


# --- double bubble ---------------------------------------------------------------------------------------------------


def _double_area(films: Films, pair: PairMeasure) -> float | None:
    """Area of two caps and the partition in their circle, m^2."""
    caps = [films.get((k, OUTSIDE)) for k in pair.regions]
    if pair.contact_radius is None or pair.partition is None:
        return None
    radius, *heights = common_circle(*caps)
    outer = sum(2.0 * np.pi * cap.radius * (cap.radius + height) for cap, height in zip(caps, heights, strict=True))
    bulge = max(1.0 - (pair.partition.curvature * radius) ** 2, 0.0)
    return float(outer + 2.0 * np.pi * radius**2 / (1.0 + np.sqrt(bulge)))


def _least_area(first: float | None, second: float | None) -> float | None:
    """Least area around two equal volumes (m^3), m^2; None where these differ by more than 5 %."""
    if first is None or second is None:
        return None
    mean = 0.5 * (first + second)
    if abs(first - second) > _EQUAL * mean:
        return None
    return float(27.0 * np.pi * (mean / (9.0 * np.pi)) ** (2.0 / 3.0))


# --- output ----------------------------------------------------------------------------------------------------------


def _plain(value: object) -> object:
    if isinstance(value, Sphere):
        names = ("center", "radius", *(field.name for field in dataclasses.fields(value)))
        return {name: _plain(getattr(value, name)) for name in names}
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _rows(head: tuple, body: Iterable[tuple]) -> list[tuple[str, ...]]:
    return [head, *(tuple(map(_text, row)) for row in body)]


def _text(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, np.ndarray):
        return " ".join(map(_text, value.tolist()))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _names(regions: tuple[int, ...]) -> str:
    return " ".join("out" if region == OUTSIDE else str(region) for region in regions)
