"""Drag of the air on closed films as a whole. Made only where a scene has air and `air_drag`."""

from __future__ import annotations

import warp as wp

from melp_warp.kernels import drag as kd
from melp_warp.stages.film import Film
from melp_warp.stages.state import State


class AirDrag:
    """What holds back each region as a whole: the quasi-steady drag of a sphere, see `kernels.drag.sphere_drag`.

    Attributes:
        kick: [regions] change of the velocity as a whole in the last step, m/s.
        force: [regions] mean drag in the last step, N.
        all: [1] 1: the share of the kick that E get at the end of a step.
    """

    needs = ()
    kernels = ("drag",)

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        self.kick, self.force = film.zeros(film.regions, wp.vec3), film.zeros(film.regions, wp.vec3)
        self.all = wp.full(1, 1.0, dtype=wp.float32, device=film.device)

    def find(self, start: wp.array, whole: wp.array, covered: wp.array | None, dt: wp.array) -> None:
        """Set `kick` and `force`, and add the kick to `State.motion`.

        Args:
            start: [regions] velocity as a whole at the start of the step, m/s.
            whole: [regions] inertia as a whole, kg.
            covered: [regions] vec4 whose last entry is the area that other regions cover, m^2; None for a single film.
            dt: [1] s.
        """
        film, air = self.film, self.film.surroundings
        film.launch_regions(
            kd.drag_motion_r,
            [start, whole, self.state.gas, covered, air.air_density, air.air_drag, dt],
            [self.state.motion, self.kick, self.force],
        )
