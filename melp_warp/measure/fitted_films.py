"""The films of a foam as spheres, and the angles at which they meet along lines and at points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from melp_warp.measure.fits import Sphere, fit_sphere, meet
from melp_warp.measure.patches import FARTHEST, OUTSIDE, Cloud, Patches

CUTS = (FARTHEST, 3.0, 2.5, 2.0, 1.5, 1.0)
"""Particles nearer than this to one on another film are left out of a fit, spacings: the first that leaves `ENOUGH`.

Those next to a line count as on another film, so that the fit keeps about one spacing more from the line itself.
"""

ENOUGH = 30
"""Particles from which a fit keeps its distance from the lines."""

FEWEST = 12
"""Particles that a fit needs in any case."""

_REACH = 4.0
"""Particles near a line or vertex are this close to it at most, spacings."""

Films = dict[tuple[int, int], Sphere]
"""The fitted films by the regions on their two sides, in both orders; the normal points to the second."""


def touching_regions(cloud: Cloud, patches: Patches) -> set[tuple[int, int]]:
    """Return the pairs of regions with a film between them, ascending: seen from both sides, or from one outside."""
    rows = np.stack([cloud.region, patches.other], axis=1)
    pairs, counts = np.unique(rows, axis=0, return_counts=True)
    seen = {tuple(pair) for pair, count in zip(pairs.tolist(), counts, strict=True) if count >= FEWEST}
    seen |= {tuple(pair) for pair in pairs.tolist() if OUTSIDE not in pair}
    return {(min(pair), max(pair)) for pair in seen if OUTSIDE in pair or pair[::-1] in seen}


def fit_films(cloud: Cloud, patches: Patches, touching: Iterable[tuple[int, int]]) -> Films:
    """Fit every film that has particles enough."""
    films = {}
    for a, b in touching:
        film = _fit_film(cloud, patches, a, b)
        if film:
            films[a, b], films[b, a] = film, film.reversed()
    return films


def _fit_film(cloud: Cloud, patches: Patches, a: int, b: int) -> Sphere | None:
    """The sphere through the film between two regions, both sides of equal weight, normal to the second."""
    first = (cloud.region == a) & (patches.other == b)
    second = (cloud.region == b) & (patches.other == a)
    for cut in CUTS:
        inner = patches.clear > cut * cloud.spacing
        sides = [np.flatnonzero(side & inner) for side in (first, second)]
        chosen = np.concatenate(sides)
        if len(chosen) >= (FEWEST if cut == CUTS[-1] else ENOUGH):
            weights = np.concatenate([np.full(len(side), 1.0 / max(len(side), 1)) for side in sides])
            sign = np.where(cloud.region[chosen] == a, 1.0, -1.0)
            if not np.ptp(cloud.x[chosen], axis=0).any():
                return None  # all in one point, as no particles of a film are
            side = -sign if all(map(len, sides)) else np.zeros(len(chosen))
            return fit_sphere(cloud.x[chosen], sign[:, None] * cloud.normal[chosen], weights, side)
    return None


def share_corners(cloud: Cloud, patches: Patches, films: Films) -> np.ndarray:
    """Return what lies behind the film at each particle [n], by the nearest fitted film where films meet."""
    other = patches.other.copy()
    for regions, near in patches.corners.items():
        for k in regions:
            mine = near[cloud.region[near] == k]
            behind = [r for r in regions if (k, r) in films]
            if len(mine) and len(behind) > 1:
                distance = [np.abs(films[k, r].distance(cloud.x[mine])) for r in behind]
                other[mine] = np.array(behind)[np.argmin(distance, axis=0)]
    return other


def line_angles(
    cloud: Cloud, films: Films, regions: Sequence[int], near: np.ndarray
) -> tuple[tuple[float | None, ...] | None, int]:
    """Return the dihedral angles inside three regions averaged along their line, and the number of points on it.

    Args:
        cloud: the particles.
        films: the fitted films.
        regions: three regions.
        near: particles near the line. Each is moved to where the films meet, and the angles are taken there.

    Returns:
        Three angles, degrees, None for one with a film that is not fitted; None without a line.
    """
    points = _common_points(cloud, films, regions, near, 2)
    if not len(points):
        return None, 0
    angles = []
    for k in regions:
        sides = [films.get((k, other)) for other in regions if other != k]
        angles.append(float(_dihedral(*sides, points).mean()) if all(sides) else None)
    return tuple(angles), len(points)


def _common_points(cloud: Cloud, films: Films, regions: Sequence[int], near: np.ndarray, rank: int) -> np.ndarray:
    """Points [m, 3] where the films between regions meet, one for each particle near; none with too few films."""
    known = [films[pair] for pair in combinations(regions, 2) if pair in films]
    if len(known) < rank:
        return np.zeros((0, 3))
    return meet(known, cloud.x[near], rank, _REACH * cloud.spacing)


def _dihedral(one: Sphere, two: Sphere, x: np.ndarray) -> np.ndarray:
    """The angle [n], degrees, at x [n, 3] inside a region between two films whose normals point out of it."""
    return np.degrees(np.arccos(np.clip(-np.sum(one.normals(x) * two.normals(x), axis=1), -1.0, 1.0)))


def vertex_angles(
    cloud: Cloud, films: Films, regions: Sequence[int], near: np.ndarray
) -> Iterable[tuple[np.ndarray, tuple[float, ...]]]:
    """Yield the points [3] where four regions meet, each with the angles between its lines, degrees.

    There are two for three bubbles around a line, which has two ends outside. Each line has an angle with each: six
    angles, fewer where films are not fitted.
    """
    points = _common_points(cloud, films, regions, near, 3)
    while len(points):
        here = np.linalg.norm(points - points[0], axis=1) < cloud.spacing
        point = points[here].mean(axis=0)
        points = points[~here]
        lines = [t for t in (_tangent(films, regions, k, point) for k in regions) if t is not None]
        angles = tuple(float(np.degrees(np.arccos(np.clip(s @ t, -1.0, 1.0)))) for s, t in combinations(lines, 2))
        if angles:
            yield point, angles


def _tangent(films: Films, regions: Sequence[int], k: int, point: np.ndarray) -> np.ndarray | None:
    """The direction [3] from a vertex along the line of the three regions that are not `k`, which is away from `k`.

    It is at right angles, in the sense of least squares, to the normals of the films that meet there.
    """
    rest = [region for region in regions if region != k]
    normals = [films[pair].normals(point) for pair in combinations(rest, 2) if pair in films]
    outward = [films[k, other].normals(point) for other in rest if (k, other) in films]
    if len(normals) < 2 or not outward:
        return None
    tangent = np.linalg.svd(np.array(normals))[2][2]
    return tangent if np.sum(outward @ tangent) > 0.0 else -tangent


def common_circle(one: Sphere, two: Sphere) -> tuple[float, float, float] | None:
    """Return the radius of the circle where two spheres meet and how far from each centre, towards the other, m."""
    if not (one.curvature and two.curvature):
        return None
    apart = float(np.linalg.norm(two.center - one.center))
    first = (apart**2 + one.radius**2 - two.radius**2) / (2.0 * max(apart, 1e-30))
    square = one.radius**2 - first**2
    return (float(np.sqrt(square)), first, apart - first) if square > 0.0 else None
