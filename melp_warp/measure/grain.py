"""Grain: how much the thickness that L show departs from what is smooth at their spacing."""

from __future__ import annotations

import numpy as np

NEAREST = 18
"""L that the smooth surface is fitted to."""

SAMPLE = 1000
"""L at which it is measured."""


def grain(points: np.ndarray, normals: np.ndarray, thickness: np.ndarray, region: np.ndarray, seed: int = 0) -> float:
    """Rms residual of eta_L against a quadratic fitted to its nearest L, itself left out, over the std of eta.

    Args:
        points: [n, 3] m.
        normals: [n, 3] unit normals.
        thickness: [n], any unit.
        region: [n] those of the same one are compared.
        seed: of the L that are looked at, where there are more than `SAMPLE`.

    Returns:
        A plain number; 0 where the thickness is even or there are too few L.
    """
    points, normals, thickness = (np.asarray(a, dtype=np.float64) for a in (points, normals, thickness))
    spread = float(np.std(thickness))
    if spread <= 1e-6 * abs(float(np.mean(thickness))) or len(points) <= NEAREST:
        return 0.0
    count = min(SAMPLE, len(points))
    chosen = np.random.default_rng(seed).choice(len(points), count, replace=False)
    residuals = []
    for which in np.unique(region[chosen]):
        inside = np.flatnonzero(region == which)
        if len(inside) > NEAREST:
            at = chosen[region[chosen] == which]
            residuals.append(_residuals(at, inside, points, normals, thickness))
    found = np.concatenate(residuals) if residuals else np.zeros(1)
    return float(np.sqrt(np.mean(found**2)) / spread)


def _residuals(at: np.ndarray, inside: np.ndarray, points, normals, thickness) -> np.ndarray:
    """[len(at)] thickness less that of the fit to the nearest of `inside`."""
    centre = points[inside].mean(axis=0)
    x, p = points[inside] - centre, points[at] - centre
    squares = np.sum(x**2, axis=1)
    found = np.empty(len(at))
    for k, i in enumerate(at):
        distance = squares - 2.0 * (x @ p[k])
        near = np.argpartition(distance, NEAREST)[: NEAREST + 1]
        near = inside[near]
        near = near[near != i][:NEAREST]
        found[k] = thickness[i] - _fit_at(points[near] - points[i], normals[i], thickness[near])
    return found


def _fit_at(offsets: np.ndarray, normal: np.ndarray, values: np.ndarray) -> float:
    """Value at the origin of the quadratic over the plane with `normal` that fits `values` at `offsets` best."""
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    e1 = np.cross(normal, axis)
    e1 /= np.linalg.norm(e1)
    a, b = offsets @ e1, offsets @ np.cross(normal, e1)
    scale = max(float(np.sqrt(np.mean(a * a + b * b))), 1e-30)
    a, b = a / scale, b / scale
    terms = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=1)
    return float(np.linalg.lstsq(terms, values, rcond=None)[0][0])
