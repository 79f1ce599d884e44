"""Liquid that crosses between films that touch (MELP 2022, section 5.5)."""

from __future__ import annotations

import warp as wp

from melp_warp.device.scalars import Setting
from melp_warp.kernels import exchange as kx
from melp_warp.stages.carriage import Carriage
from melp_warp.stages.circulation import Circulation
from melp_warp.stages.film import Film
from melp_warp.stages.foam import make_contact
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Fields
from melp_warp.stages.transfer import Transfer

EXCHANGE_INTERVAL = 1.0 / 240.0
"""Least time between two exchanges of liquid, s."""


class Exchange:
    """Liquid that crosses between films that touch. Made only where a scene asks for it.

    The paper lets L change sides by chance; here each gives a share of what it has, as large as that chance: what is
    smooth stays smooth. Liquid crosses before the first step that ends `EXCHANGE_INTERVAL` or more after the last
    exchange.

    Attributes:
        due: whether it does before the step to come.
    """

    needs = ("geometry", "fields", "transfer", "circulation", "carriage")
    kernels = ("exchange", "contact")

    def __init__(
        self,
        film: Film,
        state: State,
        geometry: Geometry,
        fields: Fields,
        transfer: Transfer,
        circulation: Circulation | None,
        carriage: Carriage | None,
    ):
        self.film, self.state, self.geometry, self.fields, self.carriage = film, state, geometry, fields, carriage
        self.transfer, self.circulation = transfer, circulation
        self.contact = make_contact(film)
        self.due, self._time = False, Setting(film.device)
        self._over, self._left = film.zeros(film.n_e), film.zeros(film.n_e)
        self._gained, self._pushed = film.zeros(film.n_e, wp.vec3), film.zeros(film.n_e, wp.vec3)

    def prepare(self, dt: float) -> None:
        """Set whether and how much crosses before a step of dt (s)."""
        course, end = self.state.course, self.state.time + dt
        self.due = end - course.crossed > EXCHANGE_INTERVAL and not course.tears  # torn films hold none
        if self.due:
            self._time.at(self.film.numerics.exchange * (end - course.crossed))
            course.crossed = end

    def apply(self, dt: wp.array) -> None:
        """Let liquid cross; follows the lists between E and L. E are to gather it anew."""
        film, e, lag, transfer, lists = self.film, self.state.e, self.state.l, self.transfer, self.transfer.lists
        transfer.l_to_e()
        carried = None
        if self.circulation is not None:
            self.circulation.gather()
            carried = self.circulation.carried
        self.fields.update()
        area, claim, across = self.geometry.area, transfer.claim, [lists.eo.rows, self.contact]
        film.launch_e(kx.weigh_across_e, [e.x, e.normal, area, claim, *across], [self._over])
        more = self.carriage
        for name in more.of_e if more is not None else ():
            more.spare()
            self._cross(more.gather(name), None, [more.u, more.mass, self.state.carried[name], more.eta, None], dt)
        self._cross(e.surfactant, carried, [lag.u, lag.mass, lag.surfactant, lag.eta, lag.circulation], dt)

    def _cross(self, amount: wp.array, turning: wp.array | None, held: list, dt: wp.array) -> None:
        """Let L exchange what they have, `held`, with an `amount` [n_e] that E know of it."""
        film, e, transfer, lists = self.film, self.state.e, self.transfer, self.transfer.lists
        claim = transfer.claim
        film.launch_e(
            kx.cross_e,
            [
                *(e.x, e.normal, e.u, e.mass, amount, self.geometry.area, claim, self.fields.gamma, turning),
                *(self._over, lists.eo.rows, self.contact, self._time.array, dt),
            ],
            [self._left, self._gained, self._pushed],
        )
        film.launch_l(
            kx.cross_l,
            [
                *(e.normal, e.u, claim, self._left, self._gained, self._pushed),
                *(transfer.weight, lists.le.rows, film.material.density),
            ],
            held,
        )
