"""Physical constants and what a film and its surroundings are made of (SI units)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from melp_warp.errors import require

GAS_CONSTANT = 8.31446261815324
"""R, J/(mol K)."""


def _finite(value: float) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and bool(np.isfinite(value))


@dataclass(frozen=True)
class Material:
    """The liquid of the film.

    Attributes:
        thickness: reference thickness eta_0, m.
        tension: sigma_0 of the pure liquid, N/m; the film has sigma = sigma_0 - R T Gamma on each side.
        surfactant: reference concentration Gamma_0 per interface, mol/m^2.
        density: rho, kg/m^3.
        temperature: T, K.
        viscosity: kinematic viscosity nu of the in-plane flow, m^2/s.
    """

    thickness: float = 400e-9
    tension: float = 0.0728
    surfactant: float = 1e-7
    density: float = 997.0
    temperature: float = 298.15
    viscosity: float = 0.0

    def __post_init__(self):
        for field in ("thickness", "tension", "density", "temperature"):
            value = getattr(self, field)
            require(_finite(value) and value > 0.0, field, value, "a number above 0")
        for field in ("surfactant", "viscosity"):
            value = getattr(self, field)
            require(_finite(value) and value >= 0.0, field, value, "a number of at least 0")
        require(
            self.film_tension > 0.0,
            "surfactant",
            self.surfactant,
            f"below tension/(R T) = {self.tension / (GAS_CONSTANT * self.temperature):.3g} mol/m^2",
        )

    @property
    def rt(self) -> float:
        """R T, J/mol."""
        return GAS_CONSTANT * self.temperature

    @property
    def film_tension(self) -> float:
        """sigma = sigma_0 - R T Gamma_0 of one interface at the reference concentration, N/m."""
        return self.tension - self.rt * self.surfactant

    @property
    def areal_mass(self) -> float:
        """m = rho eta_0, kg/m^2."""
        return self.density * self.thickness


AIR_MODELS = ("none", "added_mass")


@dataclass(frozen=True)
class Surroundings:
    """What acts on the film from outside.

    Attributes:
        gravity: acceleration vector, m/s^2.
        pressure: atmospheric pressure p_atm, Pa.
        air: "none", or "added_mass" for the inertia of the air that the film moves (normal motion).
        air_density: kg/m^3.
        air_drag: factor on the quasi-steady drag of a sphere on each closed film as a whole, where `air` is on; 1 as
            measured, 0 for none.
        drag: traction of the air per tangential film speed, both sides together, Pa s/m; where `air_drag` is at work,
            of the speed against the film as a whole.
        damping: rate at which the air takes up the normal motion of a foam's films against their cluster as a whole,
            1/s.
        lift: fraction of the film's weight that a lighter gas inside carries; 1 hovers, 0 falls. Closed films only.
    """

    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pressure: float = 101325.0
    air: str = "none"
    air_density: float = 1.204
    air_drag: float = 1.0
    drag: float = 0.0
    damping: float = 0.0
    lift: float = 0.0

    def __post_init__(self):
        require(len(self.gravity) == 3 and all(map(_finite, self.gravity)), "gravity", self.gravity, "three numbers")
        require(_finite(self.pressure) and self.pressure >= 0.0, "pressure", self.pressure, "a number of at least 0")
        require(self.air in AIR_MODELS, "air", self.air, f"one of {', '.join(AIR_MODELS)}")
        require(_finite(self.air_density) and self.air_density > 0.0, "air_density", self.air_density, "above 0")
        require(_finite(self.air_drag) and self.air_drag >= 0.0, "air_drag", self.air_drag, "a number of at least 0")
        require(_finite(self.drag) and self.drag >= 0.0, "drag", self.drag, "a number of at least 0")
        require(_finite(self.damping) and self.damping >= 0.0, "damping", self.damping, "a number of at least 0")
        require(_finite(self.lift), "lift", self.lift, "a number")
