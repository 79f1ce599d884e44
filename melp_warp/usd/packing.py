"""What a cache stores of L in fewer bytes than float32 takes: widths in steps, directions and colours from tables.

USD packs whole numbers and arrays of few different floats, not vectors. So a vector that need not be exact is stored as
a table of few vectors and the number of one for each particle, an indexed primvar, which any reader of USD takes.
"""

from __future__ import annotations

import numpy as np

from melp_warp.errors import require
from melp_warp.frame import ParticleFrame
from melp_warp.measure.fits import close_pairs
from melp_warp.optics import DISPLAY_MAX_THICKNESS, display_color

WIDTH_STEPS = 32
"""Widths from one power of two to the next: they are off by 1/32 at most."""

COLOR_STEP = 2.0
"""nm; the colour is that of a film up to half of this thicker or thinner."""

DIRECTIONS = 32
"""Directions along a side of the square that an octahedron is laid out to: 3 degrees off in the mean square."""

SUPPORT = 3.0
"""Radius within which the film is fitted, spacings of the particles."""

MOST_NEAR = 1000
"""Particles in a cube as wide as that radius; where there are more it is no film, and nothing is fitted."""

_UNIT = 1e-2
"""Largest error of the length of a stored normal."""

_SAME_SIDE = 0.5
"""Least product of the stored normals of particles that lie on one sheet."""


def round_widths(widths: np.ndarray) -> np.ndarray:
    """Widths [n], float32, of few values: those within a step of each other share one, and keep their area together."""
    mantissa, exponent = np.frexp(widths)
    level = np.rint(2 * WIDTH_STEPS * mantissa).astype(np.int32)
    step = (2 * WIDTH_STEPS + 1) * (exponent - exponent.min(initial=0)) + level
    known, row = _numbered(step)
    square = np.bincount(row, widths.astype(np.float64) ** 2, len(known))
    return np.sqrt(square / np.maximum(np.bincount(row, minlength=len(known)), 1)).astype(np.float32)[row]


def _numbered(codes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The codes that there are, ascending, and the number of each particle's among them, int32; codes are small."""
    known = np.flatnonzero(np.bincount(codes))
    number = np.zeros(known.max(initial=0) + 1, np.int32)
    number[known] = np.arange(len(known))
    return known, number[codes]


def shown_thickness(thickness: np.ndarray) -> np.ndarray:
    """The thickness [n] whose colour a packed set has, nm."""
    return COLOR_STEP * np.rint(np.minimum(thickness, DISPLAY_MAX_THICKNESS) / COLOR_STEP)


def pack_colors(thickness: np.ndarray, gain: float, index: float) -> tuple[np.ndarray, np.ndarray]:
    """Table [k, 3] of `optics.display_color`, float32, and the row of each particle [n], int32."""
    known, row = _numbered(np.rint(shown_thickness(thickness) / COLOR_STEP).astype(np.int32))
    return display_color(COLOR_STEP * known, gain, index), row


def pack_normals(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Table [k, 3] of unit vectors, float32, and the row of each particle [n], int32: a direction near to its normal.

    The sphere is laid out flat as an octahedron (Meyer et al., "On floating-point normal vectors", 2010).
    """
    n = np.asarray(normals, dtype=np.float32)
    flat = n[:, :2] / np.maximum(np.abs(n).sum(axis=1, keepdims=True), 1e-30)
    flat = np.where(n[:, 2:] < 0.0, (1.0 - np.abs(flat[:, ::-1])) * np.where(flat < 0.0, -1.0, 1.0), flat)
    most = DIRECTIONS - 1
    cell = np.clip(np.rint(0.5 * (flat + 1.0) * most), 0, most).astype(np.int32)
    known, row = _numbered(cell[:, 0] * DIRECTIONS + cell[:, 1])
    at = np.stack([known // DIRECTIONS, known % DIRECTIONS], axis=1) * (2.0 / most) - 1.0
    up = 1.0 - np.abs(at).sum(axis=1, keepdims=True)
    at = np.where(up < 0.0, (1.0 - np.abs(at[:, ::-1])) * np.where(at < 0.0, -1.0, 1.0), at)
    table = np.concatenate([at, up], axis=1)
    table /= np.linalg.norm(table, axis=1, keepdims=True)
    return table.astype(np.float32), row


def _most_in_a_cube(x: np.ndarray, width: float) -> int:
    """Most points [n, 3] in a cube of a lattice."""
    cell = np.floor((x - x.min(axis=0)) / width)
    _, count = np.unique(cell @ [1.0, 1e6 + 3.0, 1e12 + 39.0], return_counts=True)
    return int(count.max())


def refine_normals(frame: ParticleFrame) -> ParticleFrame:
    """The frame with normals of the film that its points lie on, where those it has tell no more than the side.

    The film is fitted at each particle by a quadric over those of the same region that look the same way.

    Raises:
        InputError: a normal is not of unit length.
    """
    n = len(frame.points)
    if n == 0:
        return frame
    x, normal = frame.points.astype(np.float64), frame.normals.astype(np.float64)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    require(bool((np.abs(size - 1.0) < _UNIT).all()), "normals", float(size.min()), "of unit length")
    radius = SUPPORT * max(float(np.sqrt(0.25 * np.pi * np.mean(frame.widths.astype(np.float64) ** 2))), 1e-9)
    if _most_in_a_cube(x, radius) > MOST_NEAR:
        return frame
    aside = np.where(np.abs(normal[:, 2:]) > 0.7, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    e1 = np.cross(aside, normal)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = np.cross(normal, e1)
    matrix, right = np.zeros((n, 6, 6)), np.zeros((n, 6))
    for i, j in close_pairs(x, radius):
        kept = (frame.region[i] == frame.region[j]) & (np.einsum("ij,ij->i", normal[i], normal[j]) > _SAME_SIDE)
        i, j = i[kept], j[kept]
        d = (x[j] - x[i]) / radius
        u, v, w = (np.einsum("ij,ij->i", d, axis[i]) for axis in (e1, e2, normal))
        weight = (1.0 - np.minimum(np.einsum("ij,ij->i", d, d), 1.0)) ** 2
        terms = [np.ones_like(u), u, v, u * u, u * v, v * v]
        for a, term in enumerate(terms):
            right[:, a] += np.bincount(i, weight * term * w, n)
            for b in range(a, 6):
                matrix[:, a, b] += np.bincount(i, weight * term * terms[b], n)
    matrix += np.triu(matrix, 1).transpose(0, 2, 1) + 1e-6 * np.eye(6)
    slope = np.linalg.solve(matrix, right[..., None])[:, 1:3]
    fitted = normal - slope[:, 0] * e1 - slope[:, 1] * e2
    fitted /= np.linalg.norm(fitted, axis=1, keepdims=True)
    return ParticleFrame(**{**vars(frame), "normals": fitted.astype(np.float32)})
