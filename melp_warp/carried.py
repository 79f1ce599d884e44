"""What L carry besides liquid and surfactant: declared once, with a scene (docs/carried.md)."""

from __future__ import annotations

import keyword
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from melp_warp.errors import require

TAKEN = {"x", "u", "v", "affine", "normal", "mass", "surfactant", "eta", "region", "circulation", "behind", "thickness"}
TAKEN |= {"inertia", "after", "before", "flow", "film", "growth", "limit", "other", "inside", "outside"}
"""Names of what L and frames hold anyway."""


@dataclass(frozen=True)
class Carried:
    """A quantity that the liquid of a film carries along.

    L hold how much of it they have. It moves with them, is handed on as surfactant is where they mix, cross between
    films, merge, pop or go into a rim, and passes to E and back by the weights of (6): its sum stays.

    Attributes:
        name: of its arrays, of its primvar and of its entry in the log.
        unit: SI, of a unit of area or, as a mean, of the liquid's value.
        start: at points [n, 3] (m) -> [n], or the same number everywhere.
        mean: whether it is a mean over the liquid (a temperature, a fraction), not an amount on an area.
        meaning: one line.
    """

    name: str
    unit: str
    start: Callable[[np.ndarray], np.ndarray] | float = 0.0
    mean: bool = False
    meaning: str = ""

    def __post_init__(self):
        right = isinstance(self.name, str) and self.name.isidentifier() and not keyword.iskeyword(self.name)
        free = right and self.name.isascii() and not self.name.endswith("_rim") and self.name not in TAKEN
        require(free, "the name of what is carried", self.name, f"a name that is not one of {', '.join(sorted(TAKEN))}")
        require(isinstance(self.unit, str), f"unit of {self.name}", self.unit, "text")
        number = isinstance(self.start, (int, float)) and not isinstance(self.start, bool) and np.isfinite(self.start)
        require(callable(self.start) or number, f"start of {self.name}", self.start, "a number or a function of points")

    def held(self, points: np.ndarray, area: np.ndarray, mass: np.ndarray) -> np.ndarray:
        """How much particles at points [n, 3] (m) of these areas (m^2) and masses (kg) start with. [n].

        Raises:
            InputError: `start` gives other than a finite number a point.
        """
        density = self.start(points) if callable(self.start) else np.full(len(points), float(self.start))
        density = np.asarray(density, dtype=np.float64)
        right = density.shape == (len(points),) and bool(np.isfinite(density).all())
        require(right, f"start of {self.name}", density.shape, f"finite numbers, {len(points)} for as many points")
        return density * (mass if self.mean else area)

    def shown(self, held: np.ndarray, area: np.ndarray, mass: np.ndarray) -> np.ndarray:
        """What is shown of particles that hold so much, in `unit`; 0 where there is no liquid. [n]."""
        over = np.asarray(mass if self.mean else area, dtype=np.float64)
        return np.divide(held, over, out=np.zeros(len(over)), where=over > 0.0)
