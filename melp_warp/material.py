"""Physical constants and what a film and its surroundings are made of (SI units)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from melp_warp.errors import require
from melp_warp.keyframes import Number, check_number, stays, value_at
from melp_warp.keys import Key, at_least_zero, check_numbers, keys_of, positive, quantity, word

GAS_CONSTANT = 8.31446261815324
"""R, J/(mol K)."""

THICKNESS = Key("m", "reference thickness eta_0", 1e-9, 1e-4, spoken="nm", usual=(3e-9, 1e-5))


@dataclass(frozen=True)
class Material:
    """The liquid of the film. It has sigma = sigma_0 - R T Gamma on each side."""

    thickness: float = quantity(THICKNESS, 400e-9)
    tension: float = quantity(
        positive("N/m", "surface tension of pure water, sigma_0", 10.0, spoken="mN/m", usual=(1e-3, 0.5)), 0.0728
    )
    surfactant: float = quantity(
        at_least_zero(
            "mol/m^2", "reference surfactant on each side, Gamma_0", 1e-3, spoken="umol/m^2", usual=(0.0, 3e-5)
        ),
        1e-7,
    )
    density: float = quantity(
        positive("kg/m^3", "density of the liquid", 1e5, spoken="g/cm^3", usual=(300.0, 3000.0)), 997.0
    )
    temperature: float = quantity(positive("K", "temperature", 1e4, spoken="degC", usual=(200.0, 400.0)), 298.15)
    viscosity: float = quantity(
        at_least_zero("m^2/s", "kinematic viscosity of the flow in the film", 10.0, spoken="cSt", usual=(0.0, 0.01)),
        0.0,
    )

    def __post_init__(self):
        check_numbers(self)
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

    `gravity` is a vector, along -y in scenes of the command line; each of its components is a number, `Keyframes` or a
    function of time. `air_drag` 1 is the quasi-steady drag as measured.
    Where it is at work, `drag` is the traction of the speed against the film as a whole. `damping` is of foams, against
    their cluster as a whole; `lift` is of closed films.
    """

    gravity: tuple[Number, Number, Number] = quantity(
        at_least_zero("m/s^2", "acceleration of gravity, downwards (-y)", 1e3, usual=(0.0, 100.0), varies=True),
        (0.0, 0.0, 0.0),
    )
    pressure: float = quantity(
        at_least_zero("Pa", "pressure of the air outside", 1e8, spoken="atm", usual=(1e3, 1e7)), 101325.0
    )
    air: str = quantity(word("inertia of the air that the film moves", AIR_MODELS), "none")
    air_density: float = quantity(positive("kg/m^3", "density of the air", 1e3, usual=(1e-3, 100.0)), 1.204)
    air_drag: float = quantity(
        at_least_zero("-", "factor on the drag of a sphere on a bubble as a whole, where air is on", 100.0), 1.0
    )
    drag: float = quantity(
        at_least_zero("Pa s/m", "traction of the air per speed along the film, both sides", 1e3, usual=(0.0, 10.0)), 0.0
    )
    damping: float = quantity(
        at_least_zero("1/s", "rate at which the air takes up the normal motion within a foam", 1e5), 0.0
    )
    lift: float = quantity(
        Key("-", "share of the film's weight that a lighter gas inside carries (1 hovers)", -10.0, 10.0), 0.0
    )

    def __post_init__(self):
        check_numbers(self)
        key, vector = keys_of(Surroundings)["gravity"], self.gravity
        require(len(vector) == 3, "gravity", vector, "three numbers")
        for number in vector:
            check_number("gravity", number, -key.high, key.high)
        if self.steady:
            key.check("gravity", float(np.linalg.norm(vector)))

    @property
    def steady(self) -> bool:
        """Whether gravity stays the same."""
        return all(map(stays, self.gravity))

    @property
    def height(self) -> tuple[float, float, float]:
        """Gravity that is stored as height: all where it stays the same, else none, and what it does is work, m/s^2."""
        return self.gravity if self.steady else (0.0, 0.0, 0.0)

    def gravity_at(self, time: float) -> tuple[float, float, float]:
        """Gravity at a time (s), m/s^2.

        Raises:
            InputError: a function of time gives none.
        """
        x, y, z = (value_at(number, time) for number in self.gravity)
        high = keys_of(Surroundings)["gravity"].high
        allowed = f"of at most {high:g} m/s^2"
        require(math.hypot(x, y, z) <= high, f"gravity at {time:.4g} s", (x, y, z), allowed)
        return x, y, z
