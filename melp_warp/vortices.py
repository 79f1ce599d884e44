"""Flows of single vortices, for scenes and for what they are checked against."""

from __future__ import annotations

import numpy as np


def gaussian_vortex(x: np.ndarray, core: float, circulation: float) -> np.ndarray:
    """[n, 3] m/s velocity of the vorticity Gamma/(pi a^2) exp(-r^2/a^2) about z.

    Args:
        x: [n, 3] m, offsets from its centre in the plane.
        core: radius a, m.
        circulation: Gamma, m^2/s.
    """
    squared = np.maximum(np.sum(x * x, axis=1), 1e-12 * core**2)
    turning = -circulation / (2.0 * np.pi) * np.expm1(-squared / core**2) / squared
    return turning[:, None] * np.cross([0.0, 0.0, 1.0], x)


def sphere_vortex(x: np.ndarray, centre: np.ndarray, core: float, circulation: float) -> np.ndarray:
    """[n, 3] m/s velocity of a vortex on a sphere about the origin: Gamma/(4 pi r) c x s/(1 - c.s), filled within a.

    Its vorticity is that of the point vortex, -Gamma/(4 pi r^2) all around, which vortices of both signs make up for.

    Args:
        x: [n, 3] m, on or near the sphere.
        centre: [3] unit vector c to its centre.
        core: radius a, m.
        circulation: Gamma, m^2/s.
    """
    r = np.linalg.norm(x, axis=1, keepdims=True)
    s = x / r
    gap = np.maximum(1.0 - s @ centre, 1e-9)[:, None]
    fill = -np.expm1(-2.0 * r**2 * gap / core**2)
    return circulation / (4.0 * np.pi * r) * np.cross(centre, s) / gap * fill
