"""Checks of meshes: closed, oriented, in one piece."""

from __future__ import annotations

import numpy as np

from melp_warp.frame import WholeFrame
from melp_warp.usd.check_words import expect


def check_whole(whole: WholeFrame, rims: int = 0) -> list[str]:
    """What is wrong with the mesh of a whole foam.

    An edge has two faces, three on a border, and one on a rim. Those around each region are one closed surface.

    Args:
        whole: the mesh.
        rims: how many rims the film has; only a single region can have some.
    """
    n, faces, problems = len(whole.points), whole.faces.astype(np.int64), []
    ends = np.sort(np.concatenate([faces, np.roll(faces, -1, axis=1)], axis=0).reshape(2, -1).T, axis=1)
    _, times = np.unique(ends[:, 0] * n + ends[:, 1], return_counts=True)
    odd = (times > 3) | ((times < 2) & (rims == 0))
    if odd.any():
        problems.append(
            f"{odd.sum()} edges have {', '.join(map(str, np.unique(times[odd])))} faces, must be two or three"
        )
    unused = n - len(np.unique(faces))
    if unused:
        problems.append(f"{unused} points are in no face")
    p = whole.points.astype(np.float64)[faces]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    flipped = np.einsum("ij,ij->i", face, whole.normals.reshape(-1, 3, 3).sum(axis=1, dtype=float)) < 0.0
    if flipped.any():
        problems.append(f"{flipped.sum()} faces look away from their film, first {np.argmax(flipped)}")
    for region in np.setdiff1d(np.union1d(whole.inside, whole.outside), [-1]).tolist():
        skin = whole.skin(region)
        arrays = {
            "points": skin.points,
            "faceVertexCounts": np.full(len(skin.faces), 3),
            "faceVertexIndices": skin.faces.reshape(-1),
        }
        problems += [f"region {region}: {problem}" for problem in check_surface(arrays, rims)]
    return problems


def check_surface(arrays: dict, rims: int | None) -> list[str]:
    """Triangles that make one closed oriented surface, open at as many rims as the film has; empty for no region.

    Of a film with holes (None for `rims`) it may be in pieces, and open anywhere.
    """
    corners, n = arrays["faceVertexIndices"], len(arrays["points"])
    wrong = check_corners(arrays)
    if wrong or n == 0:
        return wrong
    faces = corners.reshape(-1, 3).astype(np.int64)
    problems = []
    unused = n - len(np.unique(corners))
    if unused:
        problems.append(f"{unused} points are in no face")
    start, end = faces.T.reshape(-1), np.roll(faces, -1, axis=1).T.reshape(-1)
    sides, times = np.unique(start * n + end, return_counts=True)
    if (times > 1).any():
        at = int(sides[np.argmax(times > 1)])
        problems.append(f"{(times > 1).sum()} edges have two faces on one side, first {at // n} to {at % n}")
    bare = sides[~np.isin(sides % n * n + sides // n, sides, assume_unique=True)]
    pieces = len(np.unique(_pieces(start, end, n))) - unused
    problems += expect("number of pieces", pieces, 1) if rims is not None else []
    loops = np.unique(_pieces(bare // n, bare % n, n)[bare // n]) if len(bare) else bare
    if rims is not None and len(loops) != rims:
        problems.append(f"open along {len(bare)} edges around {len(loops)} holes, the film has {rims} rims")
    edges = (len(sides) + len(bare)) // 2
    problems += expect("Euler number", n - unused - edges + len(faces), 2 * pieces - len(loops))
    if "normals" in arrays:
        x = arrays["points"].astype(np.float64)
        face = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        flipped = np.einsum("ij,ij->i", face, arrays["normals"][faces].sum(axis=1)) < 0.0
        if flipped.any():
            problems.append(f"{flipped.sum()} faces look inwards, first {np.argmax(flipped)}")
    return problems


def check_corners(arrays: dict) -> list[str]:
    """Triangles of points that are there."""
    counts, corners, n = arrays["faceVertexCounts"], arrays["faceVertexIndices"], len(arrays["points"])
    if (counts != 3).any() or 3 * len(counts) != len(corners):
        return [f"faceVertexCounts: {len(counts)} faces for {len(corners)} corners, must be triangles"]
    if len(corners) and not (corners.min() >= 0 and corners.max() < n):
        return [f"faceVertexIndices: from {corners.min()} to {corners.max()}, must be from 0 to {n - 1}"]
    return []


def _pieces(start: np.ndarray, end: np.ndarray, n: int) -> np.ndarray:
    """[n] the lowest vertex that each is connected with by edges."""
    label = np.arange(n)
    while True:
        lower = label.copy()
        np.minimum.at(lower, start, label[end])
        np.minimum.at(lower, end, label[start])
        lower = lower[lower]
        if np.array_equal(lower, label):
            return label
        label = lower
