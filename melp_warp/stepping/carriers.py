"""What carries the flow along the film: nothing, or L (MELP). A single layer's E do in single_layer.py."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.kernels import transfer as kt
from melp_warp.stages.circulation import curl_of
from melp_warp.stages.surfactant import Fields
from melp_warp.stepping.step import TABLE, AdvanceE, FindFlow, FindGeometry, FindNeighbors, SolveNormal

if TYPE_CHECKING:
    from melp_warp.scene import Scene
    from melp_warp.stages.state import EulerianState, LagrangianState
    from melp_warp.stepping.stepper import Stepper

AREA_STEPS = 4

MOST_BEND = 0.7
"""Largest velocity gradient times dt: paths of neighbours cross at 1, and liquid clumps before."""


class Carrier:
    """E alone: they have the motion of the surface, and nothing carries what lies in it. Others derive from it.

    Attributes:
        stages: of the step, in their order.
        fields: part that finds thickness and concentration at E.
        room: of neighbour lists, over that of MELP.
    """

    stages = (FindNeighbors, FindFlow, SolveNormal, AdvanceE, FindGeometry)
    fields = Fields
    room = 1.0

    def __init__(self, stepper: Stepper):
        self.stepper, self.film, self.state = stepper, stepper.film, stepper.state

    def begin(self) -> None:
        """Set what follows from the surface, once it is known."""

    def share_area(self) -> None:
        """At the start of a run: give the particles that hold the liquid areas that fit those of the E."""

    def start_flow(self, scene: Scene, u: np.ndarray) -> None:
        """At the start of a run: take the flow from the velocity u [n, 3] (m/s) of E, which is the scene's."""
        self.state.e.u.assign(normal_part(u, self.state.e.normal.numpy()))

    def look(self) -> None:
        """Look at the flow for how long a step may be, between frames (reads back)."""

    def longest_step(self, speed: float) -> float:
        """Longest step that it is good for where particles have a `speed` (m/s), s."""
        return math.inf

    def particles(self) -> EulerianState | LagrangianState:
        """Those that hold the liquid."""
        return self.state.l or self.state.e

    def velocity_of_e(self) -> np.ndarray:
        """[n_e, 3] m/s at which the E themselves move, (19): with the surface, while the liquid flows past them."""
        film, e = self.film, self.state.e
        u = e.u.numpy()[: film.n_e]
        if not film.features.moving:
            return np.zeros_like(u)
        normal = e.normal.numpy()[: film.n_e]
        along = self.state.motion.numpy()[e.region.numpy()[: film.n_e]]
        return along + normal_part(u - along, normal)


class TwoLayers(Carrier):
    """L carry the flow and E pass it on, which is MELP."""

    stages = TABLE
    steepest = 0.0
    """Largest velocity gradient at an L when last looked at, 1/s."""

    def look(self) -> None:
        """Look at how steep the flow is."""
        self.steepest = self.stepper.transfer.steepest()

    def longest_step(self, speed: float) -> float:
        """Step in which paths of neighbouring L do not cross, s."""
        return MOST_BEND / self.steepest if self.steepest > 0.0 else math.inf

    def share_area(self) -> None:
        """Make the areas of L and the control areas of E agree.

        On a film that stays where it is, the evenly placed L are the better quadrature of a_E, also at the rim. On a
        curved film the L are put on the surface and their areas scaled until those near each E add up to its own.
        """
        film, s = self.film, self.stepper
        transfer, geometry = s.transfer, s.geometry
        if not film.features.moving:
            transfer.gather()
            geometry.set_area(transfer.claim)
            return
        s.l_advance.project()
        s.lists.rebuild()
        none, at_once = film.zeros(film.n_e), wp.full(1, 1.0, dtype=float, device=film.device)
        for _ in range(AREA_STEPS):
            transfer.gather()
            settings = [none, transfer.claim, geometry.area, at_once, 0.0, math.inf]
            film.launch_e(kt.thickness_growth_e, settings, [transfer.growth])
            transfer.gather_to_l()

    def start_flow(self, scene: Scene, u: np.ndarray) -> None:
        """Give L the velocity of the E near them."""
        self.stepper.transfer.start_l()


class CirculatingLayers(TwoLayers):
    """The same, and L carry circulation besides, which E restore (`melp_warp.stages.circulation`)."""

    def start_flow(self, scene: Scene, u: np.ndarray) -> None:
        """Give L the velocity of the E near them and the circulation of the scene's."""
        super().start_flow(scene, u)
        if scene.velocity is not None:
            film, lag = self.film, self.state.l
            points, normals = lag.x.numpy() + self.state.origin, lag.normal.numpy().astype(np.float64)
            area = lag.mass.numpy() / (film.material.density * lag.eta.numpy())
            lag.circulation.assign(area * curl_of(scene.velocity, points, normals, film.spacing))


def normal_part(u: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The part of velocities [n, 3] along unit normals [n, 3]."""
    return np.sum(u * normal, axis=1, keepdims=True) * normal
