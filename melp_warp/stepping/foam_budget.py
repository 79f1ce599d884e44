"""The energy budget of a foam: tension, contact and the stars of its geometry besides (docs/energy.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import warp as wp

from melp_warp.device.launch import copy
from melp_warp.kernels import budget as kb
from melp_warp.stages.film import Film
from melp_warp.stages.state import State
from melp_warp.stepping.budget import Budget

if TYPE_CHECKING:
    from melp_warp.stepping.stepper import Stepper


class FoamBudget(Budget):
    """Sums of the energy terms of touching regions."""

    def __init__(self, film: Film, state: State, stepper: Stepper):
        super().__init__(film, state, stepper)
        self._stretched, self._touched, self._swept, self._left, self._ended, self._cover = (
            film.zeros(film.n_e) for _ in range(6)
        )
        self._pull, self._hold = (film.zeros(film.n_e, wp.vec3) for _ in range(2))

    def open_step(self) -> None:
        """Note how far E are covered and what stars have, besides."""
        s = self._stages
        copy(self._cover, s.membrane.cover)
        self.film.launch_e(kb.measure_stars_e, [self.state.e.x, s.geometry.star], [self._ended])
        super().open_step()

    def book_shifts(self) -> None:
        """Book what the forces do on the way of E besides."""
        self._book_shifts()
        self._book_moves()

    def book_stars(self) -> None:
        """Book what the energy has less once stars are found anew."""
        film, s = self.film, self._stages
        surface = [self._left, s.geometry.share, s.membrane.cover, film.tension, self.state.gas]
        film.launch_parts(kb.book_stars_chunks, [*surface, film.first], [self.part])

    def _book_moves(self) -> None:
        """Book what the forces of a foam would do on the way of its E."""
        film, e, advance, shifted = self.film, self.state.e, self._stages.e_advance, self._left_from()
        film.launch_e(
            kb.lose_move_e,
            [advance.x_old, shifted, e.x, *self._tensed()],
            [self._stretched, self._touched, self._swept, self._left],
        )
        film.launch_parts(
            kb.book_moves_chunks,
            [
                *(shifted, e.x, self.state.gas, self._pull, self._hold),
                *(self._stretched, self._touched, self._swept, film.first),
            ],
            [self.part],
        )

    def _book_normal(self) -> None:
        film, e, s, g = self.film, self.state.e, self._stages, self._stages.geometry
        m, flow, dt = s.membrane, s.tangential, s.dt.array
        change, matrix = m.response.x, m.response.operator
        film.launch_e(
            kb.lose_tension_e,
            [e.x, m.predicted, *self._tensed(), g.tie, m.u_mid, change, m.contact.lag, dt],
            [self._pull, self._stretched],
        )
        film.launch_e(
            kb.lose_contact_e,
            [
                *(g.area, self._ended, e.mass, s.fields.gamma, m.cover, self._cover, e.region, m.added),
                *(film.surroundings.damping, film.tension, film.slope, m.force, self._pull, m.foot),
                *(m.u_mid, change, g.star, matrix.diag, matrix.rows, matrix.pair, dt),
            ],
            [self._hold, self._touched],
        )
        film.launch_parts(
            kb.book_foam_chunks,
            [
                *(e.mass, g.area, e.normal, g.vector, m.response.moments, m.u_mid, m.load, m.missing, m.added),
                *(m.recoil, self.state.gas, *self._carried(), m.drag.kick if m.drag else None, m.drift),
                *(film.surroundings.damping, self._stretched, self._touched, e.u),
                *(m.start, self.state.motion, m.frame, m.passed),
                *(s.forces.body, flow.traction if flow else None, film.first, dt),
            ],
            [self.part],
        )

    def _tensed(self) -> list:
        """What tension in a foam depends on besides places."""
        film, e, s, m = self.film, self.state.e, self._stages, self._stages.membrane
        return [s.fields.gamma, m.cover, e.region, film.tension, film.slope, s.geometry.star]

    def _path(self) -> list:
        frame = self._stages.membrane.frame
        return [frame, frame, 0.0]

    def _carried(self) -> tuple[float, int]:
        film, f = self.film, self.film.features
        return film.surroundings.air_density if f.air else 0.0, int(not f.lagrangian)

    def _air(self) -> wp.array:
        return self._stages.membrane.added
