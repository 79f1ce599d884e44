"""What to simulate: a scene is a shape, its material, its surroundings, initial fields and numerics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from melp_warp.errors import require
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.shapes import Shape

PointField = Callable[[np.ndarray], np.ndarray]
"""A field given by a function of points: [n, 3] (m) -> [n] or [n, 3], SI."""


@dataclass(frozen=True)
class Scene:
    """Everything a run needs; checked when made.

    Attributes:
        name: short name, used in file names and messages.
        shape: the film's geometry, which samples the particles.
        e_count: number of Eulerian particles wanted (the shape may round it, see `Shape.sample`).
        l_per_e: Lagrangian particles per Eulerian particle; 0 for an E-only scene.
        material: the liquid.
        surroundings: gravity, air, pressure.
        thickness: eta(x) in m; None for `material.thickness` everywhere.
        concentration: Gamma(x) in mol/m^2; None for `material.surfactant` everywhere.
        velocity: initial material velocity u(x) in m/s; None for rest.
        numerics: discretisation choices.
        frames: number of frames after the first.
        fps: frames a second.
        dt: largest time step, s; None for one set by `numerics.cfl`.
        seed: seed of everything random.
    """

    name: str
    shape: Shape
    e_count: int
    l_per_e: int = 0
    material: Material = field(default_factory=Material)
    surroundings: Surroundings = field(default_factory=Surroundings)
    thickness: PointField | None = None
    concentration: PointField | None = None
    velocity: PointField | None = None
    numerics: Numerics = field(default_factory=Numerics)
    frames: int = 100
    fps: float = 60.0
    dt: float | None = None
    seed: int = 0

    def __post_init__(self):
        require(isinstance(self.e_count, int) and self.e_count >= 1, "e_count", self.e_count, "a whole number above 0")
        require(isinstance(self.l_per_e, int) and self.l_per_e >= 0, "l_per_e", self.l_per_e, "a whole number >= 0")
        require(isinstance(self.frames, int) and self.frames >= 0, "frames", self.frames, "a whole number >= 0")
        require(np.isfinite(self.fps) and self.fps > 0, "fps", self.fps, "a number above 0")
        require(self.dt is None or (np.isfinite(self.dt) and self.dt > 0), "dt", self.dt, "a number of seconds above 0")
        require(isinstance(self.seed, int) and self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        closed = self.shape.closed
        require(closed or self.surroundings.lift == 0.0, "lift", self.surroundings.lift, "0 for an open film")
