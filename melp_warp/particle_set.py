"""Particles that a scene brings along, besides E and L; a stage of the scene moves them (docs/stages.md)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from melp_warp.errors import require

TAKEN = ("Film", "FilmE", "FilmSurface", "FreeRims", "Droplets", "Looks", "Rim")
"""Names under /World that are others'."""


@dataclass(frozen=True, eq=False)
class ParticleSet:
    """Particles of a number that stays.

    They are part of the state, so of checkpoints, and a prim of the cache. Positions are measured as those of the film
    are, and move with its origin.

    Attributes:
        name: of the prim under /World and of their arrays.
        x: [n, 3] where they start, m.
        width: diameter, m.
        arrays: name -> [n] numbers or [n, 3] vectors that they start with; "u" is their velocity, m/s.
    """

    name: str
    x: np.ndarray
    width: float
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self):
        free = isinstance(self.name, str) and self.name.isidentifier() and self.name not in TAKEN
        require(free, "name of a particle set", self.name, f"a name that is not one of {', '.join(TAKEN)}")
        object.__setattr__(self, "x", np.asarray(self.x, dtype=np.float64))
        given = {name: np.asarray(array, dtype=np.float64) for name, array in self.arrays.items()}
        object.__setattr__(self, "arrays", given)
        number = isinstance(self.width, (int, float)) and 0.0 < self.width < 1e3
        require(number, f"width of {self.name}", self.width, "a number above 0, m")
        for name, array in {"x": self.x, **given}.items():
            fits = array.shape in ((self.count,), (self.count, 3)) if name != "x" else array.shape == (self.count, 3)
            require(fits and name.isidentifier(), f"{name} of {self.name}", array.shape, f"[{self.count}] or [.., 3]")
            require(bool(np.isfinite(array).all()), f"{name} of {self.name}", "others", "finite numbers")

    @property
    def count(self) -> int:
        """Number of particles."""
        return len(self.x)

    def describe(self) -> dict[str, object]:
        """What a checkpoint says of it."""
        told = hashlib.sha256(self.x.tobytes())
        for name, array in self.arrays.items():
            told.update(name.encode() + array.tobytes())
        return {"name": self.name, "count": self.count, "width": self.width, "start": told.hexdigest()[:16]}


def check_sets(sets: tuple[object, ...]) -> None:
    """Refuse what are no particle sets.

    Raises:
        InputError: they are none, or two have one name.
    """
    names = [getattr(one, "name", one) for one in sets]
    right = all(isinstance(one, ParticleSet) for one in sets) and len(set(names)) == len(names)
    require(right, "sets", names, "ParticleSets, each name once")
