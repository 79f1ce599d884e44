"""Which film each particle of a foam lies on, and which films meet near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from melp_warp.errors import require
from melp_warp.frame import ParticleFrame
from melp_warp.measure.fits import close_pairs

OUTSIDE = -1
"""The region around the foam."""

_UNKNOWN = -2
_UNIT = 1e-2
"""Largest error of the length of a normal."""
_FACING = -0.5
"""Largest product of the normals of two particles that face each other."""
_GAP = 0.6
"""Largest distance along the normal between the two sides of a film, spacings."""
_AHEAD = 1.5
"""A particle with another region this far along its normal or nearer is not outside, spacings."""
_ASIDE = 1.0
"""Largest distance across the normal in both tests, spacings."""
_CORNER = 2.0
"""Films this near to a particle meet there, spacings."""
FARTHEST = 3.5
"""Distances to the next film are known up to this, spacings."""


@dataclass(frozen=True)
class Cloud:
    """The particles of a frame, in 64 bits.

    Attributes:
        x: [n, 3] points, m.
        normal: [n, 3] outward unit normals.
        area: [n] m^2.
        region: [n] index of the bubble.
        spacing: m.
    """

    x: np.ndarray
    normal: np.ndarray
    area: np.ndarray
    region: np.ndarray
    spacing: float


@dataclass(frozen=True)
class Patches:
    """What `sort_particles` finds.

    Attributes:
        other: [n] what lies behind the film at each particle: a region or `OUTSIDE`.
        clear: [n] distance to the nearest particle of the same region on another film, m; inf beyond `FARTHEST`.
        corners: for every three or four regions that meet, ascending, the particles within two spacings of there.
    """

    other: np.ndarray
    clear: np.ndarray
    corners: dict[tuple[int, ...], np.ndarray]


def make_cloud(frame: ParticleFrame, spacing: float | None) -> Cloud:
    """Return the particles of a frame; without a spacing it is the root of the mean area."""
    require(len(frame.points) > 0, "frame", "none", "one with particles in it")
    area = 0.25 * np.pi * frame.widths.astype(np.float64) ** 2
    require(area.min() > 0.0, "widths", float(frame.widths.min()), "above 0 m: they hold the particles' areas")
    normal = frame.normals.astype(np.float64)
    length = np.linalg.norm(normal, axis=1)
    worst = float(length[np.argmax(np.abs(length - 1.0))])
    require(abs(worst - 1.0) < _UNIT, "normals", worst, "of unit length")
    if spacing is None:
        spacing = float(np.sqrt(area.mean()))
    require(np.isfinite(spacing) and spacing > 0.0, "spacing", spacing, "above 0 m")
    regions = frame.region.astype(np.int64)
    require(regions.min() >= 0, "region", int(regions.min()), "0 or above")
    return Cloud(frame.points.astype(np.float64), normal, area, regions, float(spacing))


def sort_particles(cloud: Cloud) -> Patches:
    """Tell on which film each particle lies, how far from the next film, and which films meet."""
    other = _others(cloud)
    nearest, clear, corners = _surroundings(cloud, other)
    return Patches(np.where(other == _UNKNOWN, nearest, other), clear, corners)


def _others(cloud: Cloud) -> np.ndarray:
    """The region each particle faces [n]; `OUTSIDE` with nothing ahead; `_UNKNOWN` in the rounding along a line."""
    other = np.full(len(cloud.x), OUTSIDE)
    for i, j in close_pairs(cloud.x, np.hypot(_AHEAD, _ASIDE) * cloud.spacing):
        foreign = cloud.region[i] != cloud.region[j]
        i, j = i[foreign], j[foreign]
        offset = (cloud.x[j] - cloud.x[i]) / cloud.spacing
        ahead = np.sum(offset * cloud.normal[i], axis=1)
        distance = np.linalg.norm(offset, axis=1)
        beside = distance**2 - ahead**2 <= _ASIDE**2
        other[i[beside & (ahead > -_GAP)]] = _UNKNOWN
        facing = np.sum(cloud.normal[i] * cloud.normal[j], axis=1) < _FACING
        seen = beside & facing & (np.abs(ahead) <= _GAP)
        i, j, distance = i[seen], j[seen], distance[seen]
        far_first = np.argsort(-distance, kind="stable")  # the nearest is written last
        other[i[far_first]] = cloud.region[j[far_first]]
    return other


def _surroundings(cloud: Cloud, other: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict]:
    """For each particle the film of the nearest one on a known film, the clear distance; and the corners."""
    nearest = np.full(len(other), OUTSIDE)
    clear = np.full(len(other), np.inf)
    found = []
    for i, j in close_pairs(cloud.x, FARTHEST * cloud.spacing):
        distance = np.linalg.norm(cloud.x[i] - cloud.x[j], axis=1)
        same = cloud.region[i] == cloud.region[j]
        differs = same & (other[i] != other[j])
        np.minimum.at(clear, i[differs], distance[differs])
        known = same & (other[j] != _UNKNOWN)
        far_first = np.flatnonzero(known)[np.argsort(-distance[known], kind="stable")]
        nearest[i[far_first]] = other[j[far_first]]
        near = distance <= _CORNER * cloud.spacing
        found.append(_regions_near(cloud, other, i[near], j[near]))
    return nearest, clear, _corners(np.concatenate(found))


def _regions_near(cloud: Cloud, other: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Rows [m, 2] of a particle and a region that it or a neighbour borders on, each once."""
    i = np.concatenate([i, i, np.unique(i)])
    regions = np.concatenate([cloud.region[j], other[j], cloud.region[i[len(j) * 2 :]]])
    known = regions != _UNKNOWN
    return np.unique(np.stack([i[known], regions[known]], axis=1), axis=0)


def _corners(rows: np.ndarray) -> dict[tuple[int, ...], np.ndarray]:
    """Particles by the three or four regions around them, from rows [m, 2] of a particle and one of its regions."""
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    particles, start, count = np.unique(rows[:, 0], return_index=True, return_counts=True)
    corners = {}
    for size in (3, 4):
        chosen = count == size
        members = rows[start[chosen][:, None] + np.arange(size), 1]
        for regions in np.unique(members, axis=0):
            corners[tuple(regions.tolist())] = particles[chosen][(members == regions).all(axis=1)]
    return corners
