"""Gradient noise for initial shapes and thicknesses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from melp_warp.errors import require

_TABLE = 256
_CORNERS = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
_PEAK = np.sqrt(3.0) / 2.0
"""Largest value with unit gradients: in a cell's middle, all eight pointing at it or away from it."""


def _gradients(rng: np.random.Generator) -> np.ndarray:
    """[256, 3] random unit vectors."""
    vectors = rng.normal(size=(_TABLE, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _fade(t: np.ndarray) -> np.ndarray:
    """6 t^5 - 15 t^4 + 10 t^3: first and second derivatives vanish at 0 and 1."""
    return t * t * t * (t * (6.0 * t - 15.0) + 10.0)


@dataclass(frozen=True)
class _Octave:
    permutation: np.ndarray
    gradients: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """[n] values in [-1, 1] at [n, 3] points in cells."""
        cell = np.floor(x).astype(np.int64)
        from_low = np.ascontiguousarray((x - cell).T)
        fade = _fade(from_low)
        weight, inside = (1.0 - fade, fade), (from_low, from_low - 1.0)
        p, (cx, cy, cz) = self.permutation, cell.T
        gx, gy, gz = np.ascontiguousarray(self.gradients.T)
        total = np.zeros(len(x))
        for i, j, k in _CORNERS:
            index = p[(p[(p[(cx + i) % _TABLE] + cy + j) % _TABLE] + cz + k) % _TABLE]
            slope = gx[index] * inside[i][0] + gz[index] * inside[k][2] + gy[index] * inside[j][1]
            total += weight[i][0] * weight[j][1] * weight[k][2] * slope
        return total / _PEAK


class Perlin:
    """Seeded 3D Perlin noise: twice continuously differentiable, zero at the lattice points (k + 1/2)/frequency.

    The origin is the middle of a cell, so that a flat film through it does not lie in a plane of lattice points, where
    the noise is faint. Each octave has twice the frequency and half the weight of the one before; weights add up to 1.

    Args:
        seed: same seed, same noise.
        frequency: cells per unit length of the first octave, 1/m where points are in m.
        octaves: number of octaves.

    Raises:
        InputError: for a frequency that is not above 0 or fewer than one octave.
    """

    def __init__(self, seed: int, frequency: float = 1.0, octaves: int = 1):
        require(np.isfinite(frequency) and frequency > 0.0, "frequency", frequency, "a number above 0")
        require(octaves >= 1, "octaves", octaves, "a whole number above 0")
        self.frequency = frequency
        rng = np.random.default_rng(seed)
        self._octaves = [_Octave(rng.permutation(_TABLE), _gradients(rng)) for _ in range(octaves)]
        weights = 0.5 ** np.arange(octaves)
        self._weights = weights / weights.sum()

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """[n] values in [-1, 1] at points [n, 3]."""
        x = np.asarray(points, dtype=np.float64) * self.frequency
        return sum(
            w * octave(x * 2.0**i + 0.5) for i, (w, octave) in enumerate(zip(self._weights, self._octaves, strict=True))
        )

    def even(self, points: np.ndarray) -> np.ndarray:
        """[n] values in (-1, 1), spread so that nearly all of the range is used: plain noise keeps to its middle."""
        return np.tanh(3.0 * self(points))

    def gradient(self, points: np.ndarray) -> np.ndarray:
        """[n, 3] gradient of the noise, by central differences, per unit length."""
        step = 1e-4 / self.frequency
        axes = step * np.eye(3)
        points = np.asarray(points, dtype=np.float64)
        return np.stack([self(points + a) - self(points - a) for a in axes], axis=1) / (2.0 * step)
