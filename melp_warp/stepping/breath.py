"""Gas that comes and goes: a bubble that is blown up, let out, or leaks through an opening.

The amount of gas is set between steps; how the film follows is the membrane's doing. As a film grows or shrinks lists,
supports and the air's inertia go by the spacing that its E have. Their number stays, unless they are to come and go
with the area (respacing.py).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.keyframes import Keyframes
from melp_warp.stages.film import Film
from melp_warp.stages.state import AMOUNT, AREA, GAUGE, VOLUME

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation
    from melp_warp.stages.state import State

CONTRACTION = 0.6
"""Share of an opening that a jet through it fills (sharp edge)."""

STRETCH = 0.04
"""Change of the spacing of E, relative, at which what goes by it is made anew."""


def flow_through(area: float, gauge: float, air_density: float) -> float:
    """Volume of gas that leaves by an opening, C A sqrt(2 dp/rho_air), m^3/s; below 0 where it comes in.

    Args:
        area: m^2.
        gauge: pressure inside over that outside, Pa.
        air_density: kg/m^3.
    """
    return float(np.sign(gauge) * CONTRACTION * area * np.sqrt(2.0 * abs(gauge) / air_density))


class Breath:
    """The gas of one run."""

    def __init__(self, simulation: Simulation):
        self._sim = simulation
        self.scene = simulation.scene
        gas = self.scene.gas
        self._amount = Keyframes(gas if gas and gas[0][0] == 0.0 else ((0.0, 1.0), *gas))

    def before_step(self, dt: float) -> None:
        """Let gas in or out for a step of dt (s)."""
        state, scene = self._sim.state, self.scene
        gas = state.gas.numpy()
        if scene.gas:
            gas[0, AMOUNT] = state.course.gas * self._amount.at(state.time + dt)
        else:
            around = scene.surroundings
            lost = dt * flow_through(scene.opening, gas[0, GAUGE], around.air_density)
            gas[0, AMOUNT] -= lost * (around.pressure + gas[0, GAUGE])
        state.gas.assign(gas)

    def respace(self) -> bool:
        """Between frames: go by the spacing that E have now; whether that is another one."""
        sim = self._sim
        film = breathed(sim.film, sim.state)
        if abs(film.spacing / sim.film.spacing - 1.0) < STRETCH:
            return False
        sim.remake(film)
        return True


def breathed(film: Film, state: State) -> Film:
    """A closed film as large as its gas makes it."""
    gas = state.gas.numpy()[0]
    spacing = float(np.sqrt(gas[AREA] / film.n_e))
    return replace(film, spacing=spacing, radius=float(np.cbrt(3.0 * gas[VOLUME] / (4.0 * np.pi))))
