"""Stage 3 on the host, body forces: the one place that a new force is added to."""

from __future__ import annotations

import warp as wp

from melp_warp.kernels import forces as kf
from melp_warp.stages.film import Film
from melp_warp.stages.state import State


class Forces:
    """Acceleration that forces from outside give each E.

    The normal and the tangential dynamics both take it from here.

    Attributes:
        body: [n_e] m/s^2.
    """

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        self.body = film.zeros(film.n_e, wp.vec3)

    def update(self) -> None:
        """Find the accelerations at the present positions and time."""
        self.film.launch_e(kf.set_gravity_e, [self.film.gravity], [self.body])
