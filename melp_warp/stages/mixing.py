"""Mixing: L exchange what they hold where the flow shears them: layers too fine for them turn even, not grainy."""

from __future__ import annotations

import math

import warp as wp

from melp_warp.device.launch import Shared, clear
from melp_warp.device.scalars import Setting
from melp_warp.kernels import mixing as kx
from melp_warp.kernels.native import vec5
from melp_warp.stages.carriage import Carriage
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.state import State

WAY = 1.0
"""Way of the fastest particle from one pass to the next, E spacings."""

SMOOTHINGS = 3
"""Times that the velocity gradient is made smooth beside a rim: what uneven L make of it there is then a fifteenth."""

TURNS = 3
"""Times that L which would give more than they have are left out of a pass. Where that is not enough none mix."""


class Mixing:
    """Exchange of liquid between near L, D = C d^2 |S|. Made only where a scene asks for it (`mixing`).

    A flow that shears draws liquid out to layers that soon are thinner than the distance d of L. L of different layers
    then lie side by side, and what they show is grain. Diffusion that makes layers fade as they come to be d thick, at
    the rate |S| at which they get there, leaves a picture that is as fine as L can tell, and nothing finer.

    Attributes:
        due: whether L mix before the step to come.
    """

    needs = ("lists", "geometry", "carriage")
    kernels = ("mixing",)

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, carriage: Carriage | None):
        self.film, self.state, self.lists, self.geometry, self.carriage = film, state, lists, geometry, carriage
        self.due, self._time = False, Setting(film.device)
        self._pack, self._held = film.zeros(80 * math.ceil(film.n_l / 8)), film.zeros(film.n_l, wp.vec4)
        self._found, self._spent = film.zeros(film.n_l, vec5), film.zeros(TURNS + 1, wp.int32)
        self._area = film.zeros(film.n_l) if film.material.surfactant > 0.0 else None
        self._shear = film.zeros(film.n_e)
        self._slopes = [film.zeros(film.n_e, wp.mat33) for _ in range(2)]
        self._spacing = film.spacing * math.sqrt(film.n_e / film.n_l)

    def prepare(self, dt: float) -> None:
        """Note that a step of dt (s) is to come, and set whether and for how long a time L mix before it."""
        course = self.state.course
        self.due = course.unmixed >= WAY * self.film.spacing
        if self.due:
            self._time.at(self.state.time - course.mixed)
            course.mixed, course.unmixed = self.state.time, 0.0
        course.unmixed += self.lists.fastest * dt

    def apply(self) -> None:
        """Let L mix for the time since they last did, whatever the step to come; follows the lists."""
        lag, more = self.state.l, self.carriage
        self._find_shear()
        for name in more.of_e if more is not None else ():
            more.spare()
            amount = self.state.carried[name]
            self._mix(amount, [more.u, more.mass, amount, more.eta])
        if self._area is None:
            self._mix(lag.surfactant, [lag.u, lag.mass, lag.surfactant, lag.eta])
            return
        film, density = self.film, self.film.material.density
        film.launch_l(kx.find_area_l, [lag.mass, lag.eta, density], [self._area])
        self._mix(self._area, [lag.u, lag.mass, self._area, lag.eta])
        film.launch_l(kx.set_thickness_l, [lag.mass, self._area, density], [lag.eta])

    def _find_shear(self) -> None:
        """Rate at which the flow shears, from its gradient at E, made smooth beside a rim."""
        film, e, rows = self.film, self.state.e, self.lists.ee.rows
        slope, other = self._slopes
        film.launch_e(kx.find_slope_e, [e.u, rows, self.geometry.inner_gradient], [slope])
        for _ in range(SMOOTHINGS if film.features.rim else 0):
            film.launch_e(kx.smooth_slope_e, [e.x, slope, rows, film.r], [other])
            slope, other = other, slope
        film.launch_e(kx.find_shear_e, [slope, e.normal], [self._shear])

    def _mix(self, amount: wp.array, held: list) -> None:
        """Let L exchange what they have, `held`, with an `amount` [n_l] of it."""
        film, lag, lists = self.film, self.state.l, self.lists
        film.launch_l(
            kx.give_held_l,
            [
                *(lag.x, lag.u, lists.le.home, Shared(self._shear), lag.mass, amount, lag.eta),
                *(film.material.density, lag.surfactant, film.material.surfactant),
                *(lists.el.place, lag.behind, film.numerics.mixing, self._time.array),
            ],
            [Shared(self._pack), self._held],
        )
        u, mass, *rest = held
        clear(self._spent)
        self._find(again=0)
        inputs = [lists.el.place, mass, amount, self._found]
        spared = [self._held, Shared(self._pack), Shared(self._spent)]
        for turn in range(TURNS):
            film.launch_l(kx.spare_l, [*inputs, turn], spared)
            self._find(again=turn + 1)
        film.launch_l(kx.spare_l, [*inputs, TURNS], spared)
        film.launch_l(kx.mix_l, [self._found, Shared(self._spent)], [u, mass, *rest])

    def _find(self, again: int) -> None:
        """Find what L exchange, the first time or `again` where some of them would give more than they have."""
        lists = self.lists
        self.film.launch_l(
            kx.find_exchange_l,
            [
                *(Shared(self.state.e.x), lists.le.home, lists.el.place, Shared(lists.ee.rows), lists.el.blocks),
                *(self.state.l.x, Shared(self._pack), self._held, self._spacing, again, Shared(self._spent)),
            ],
            [self._found],
        )
