"""Stages 1 and 4 on the host: L to E and E to L."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from melp_warp.device.launch import Shared, clear, launch
from melp_warp.device.scalars import Setting
from melp_warp.errors import SimulationError
from melp_warp.kernels import circulation as kc
from melp_warp.kernels import diagnostics as kd
from melp_warp.kernels import surfactant as ks
from melp_warp.kernels import transfer as kt
from melp_warp.kernels.native import vec16
from melp_warp.stages.film import THICKEST, Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.notices import Notices
from melp_warp.stages.state import State

THICKNESS_SLACK = 0.02
"""Relative difference between eta_L and eta_E that is left alone."""

THICKNESS_LIMIT = 0.7
"""Log of the ratio between eta_L and eta_E beyond which the difference is mended at once: a factor of two."""


class Transfer:
    """APIC transfer, or a blend with PIC and FLIP. Made only for films with L.

    Attributes:
        claim: [n_e] area that the L take up at their thickness, m^2.
        weight: [pairs] W(E, L), 1/m^2.
        given: what the L give by the place where they are sorted to, see `normalize_l`.
        lost: [n_l] 1 where no E is near.
        share: [n_l] what an L gives of one of a quantity per weight W, m^2; None where L carry nothing besides liquid
            and surfactant.
    """

    needs = ("lists", "geometry")
    kernels = ("transfer", "l_lists", "surfactant")

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry
        self.weight = film.zeros(lists.le.rows.index.shape[0])
        self.given = film.zeros(144 * math.ceil(film.n_l / 8))
        self._pack = film.zeros(film.total, vec16)
        self.lost = film.zeros(film.n_l, wp.int32)
        self.share = None
        if film.features.circulation or film.features.carried:
            self.share, self._given_amount = film.zeros(film.n_l), film.zeros(8 * -(-film.n_l // 8))
            self._dense = film.zeros(film.total)
        self._largest = film.parts()
        self.claim, self.growth = film.zeros(film.n_e), film.zeros(film.n_e)
        self.momentum = film.zeros(film.n_e, wp.vec3)
        self._rate, self._whole = Setting(film.device), wp.full(1, 1.0, dtype=wp.float32, device=film.device)

    def thickest(self) -> tuple[int, float]:
        """The L whose film is thickest and how thick, m (reads back)."""
        lag = self.state.l
        self.film.launch_parts(ks.largest_chunks, [lag.eta], [self._largest])
        most = float(self._largest.numpy().max())
        if most <= THICKEST:
            return 0, most
        eta = np.where(lag.mass.numpy() > 0.0, lag.eta.numpy(), 0.0)  # the rim has collected the liquid of the others
        return int(np.argmax(eta)), float(eta.max())

    def steepest(self) -> float:
        """Largest velocity gradient at an L, 1/s (reads back)."""
        lag = self.state.l
        self.film.launch_parts(kd.steepest_chunks, [lag.affine, lag.mass], [self._largest])
        return float(self._largest.numpy().max())

    def check(self) -> None:
        """Raise where a film is thicker than its E are apart: then it is none (reads back).

        Raises:
            SimulationError: names the L.
        """
        i, most = self.thickest()
        if most > self.film.spacing:
            raise SimulationError(
                f"stage e_to_l: the film at L particle {i} is {most:.3g} m thick, more than the E spacing of"
                f" {self.film.spacing:.3g} m: the liquid runs together faster than any film can"
            )

    def remark(self, notices: Notices) -> None:
        """Note where a film is too thick to be one."""
        i, most = self.thickest()
        if most > THICKEST:
            text = (
                f"the film at L {i} is {1e3 * most:.3g} mm thick: beyond {1e3 * THICKEST:g} mm nothing is thin about it"
            )
            notices.note("thicker than a film", most, text)

    def prepare(self, dt: float) -> None:
        """Set what depends on the step dt (s) to come."""
        self._rate.at(-math.expm1(-dt / self.film.numerics.thickness_time))

    def l_to_e(self) -> None:
        """Mass, surfactant, claimed area and tangential velocity of E from L, (6) and (7)."""
        e = self.state.e
        self.gather()
        self.film.launch_e(kt.split_velocity_e, [e.mass, self.momentum, e.normal], [e.u])

    def gather(self) -> None:
        """The sums of (6) and (7) alone."""
        film, e = self.film, self.state.e
        self.normalize()
        film.launch_e(
            kt.gather_l_to_e,
            [
                *(e.x, e.region, self.lists.wide.rows, self.lists.el.blocks),
                *(film.r, self.given),
            ],
            [e.mass, e.surfactant, self.claim, self.momentum],
        )

    def normalize(self) -> None:
        """Weights of all pairs at the present positions, and what each L gives per weight."""
        film, lag = self.film, self.state.l
        film.launch_l(
            kt.normalize_l,
            [
                *(lag.x, lag.u, lag.affine, lag.mass, lag.surfactant, lag.eta),
                *(self.state.e.x, self.lists.le.rows, film.r, film.n_e, film.material.density),
                *(film.numerics.affinity, self.lists.el.place),
            ],
            [self.weight, self.given, self.lost, self.share],
        )

    def gather_amount(self, held: wp.array, found: wp.array) -> None:
        """Gather what L carry besides, `held` [n_l], by the same weights: `found` [n_e]. Follows `normalize`."""
        film, e, lists = self.film, self.state.e, self.lists
        film.launch_l(kc.give_amount_l, [held, self.share, lists.el.place], [Shared(self._given_amount)])
        film.launch_e(
            kc.gather_amount_e,
            [e.x, e.region, lists.wide.rows, lists.el.blocks, film.r, self.given, self._given_amount],
            [found],
        )

    def give_made(self, made: wp.array, held: wp.array) -> None:
        """Give L what was made at the E, `made` [n_e], each by the area that it claims."""
        film, lag = self.film, self.state.l
        film.launch_e(kc.spread_made_e, [made, self.claim], [self._dense])
        film.launch_l(
            kc.take_made_l,
            [self._dense, lag.mass, lag.eta, self.share, film.material.density, self.weight, self.lists.le.rows],
            [held],
        )

    def e_to_l(
        self,
        widening: wp.array,
        before: wp.array | None,
        theta: wp.array,
        gamma: wp.array | None = None,
        swelling: wp.array | None = None,
    ) -> None:
        """Velocity, affine state and thickness of L from E, (16)-(18) and (8).

        Args:
            widening: [n_e] logarithm of an area after the step over that before.
            before: [n] velocity of E at the start of the step, m/s, that L look back at; None where they do not.
            theta: [1] share of the step after which the velocity of E, and gamma, are.
            gamma: [n] relative concentration of surfactant, which thickness goes along with; None where it goes by the
                widening: in a film without, and one that is torn.
            swelling: [n_e] what normal motion makes of the widening; None for a film that stays where it is.
        """
        film, limits = self.film, [self._rate.array, THICKNESS_SLACK, THICKNESS_LIMIT]
        if gamma is None:
            inputs = [widening, self.claim, self.geometry.area, *limits]
            film.launch_e(kt.thickness_growth_e, inputs, [self.growth])
        else:
            e, rows = self.state.e, self.lists.ee.rows
            held = [e.x, self.claim, e.surfactant, gamma, film.material.surfactant]
            film.launch_e(kt.follow_surfactant_e, [*held, rows, film.r, widening, swelling, theta], [self.growth])
        self._gather_to_l(before, theta, self.film.numerics.kept)

    def start_l(self) -> None:
        """Velocity and affine state of L from E at the start of a run; the thickness stays."""
        clear(self.growth)
        self.normalize()
        self.gather_to_l()

    def gather_to_l(self) -> None:
        """The sums of (16)-(18), and the thickness of L grown by `growth`."""
        self._gather_to_l(None, self._whole, 0.0)

    def _gather_to_l(self, before: wp.array | None, theta: wp.array, flip: float) -> None:
        film, e, lag = self.film, self.state.e, self.state.l
        midway = float(film.features.circulation and before is not None)
        inputs = [e.x, e.u, before, e.normal, self.growth, e.mass, self.geometry.area, film.material.density]
        launch(kt.pack_e, film.total, inputs, [self._pack], film.device)
        film.launch_l(
            kt.gather_e_to_l,
            [lag.x, self._pack, self.weight, self.lists.le.rows, flip, midway, theta],
            [lag.u, lag.affine, lag.v, lag.normal, lag.eta],
        )
