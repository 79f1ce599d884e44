"""The free rims of a film with holes, on the host: pulled by tension, they sweep up E and L (Taylor 1959, Culick 1960).

A rim is no stage of the step: the film takes its step, and then the rims take theirs along it. The film
behind a rim goes on for a while as if there were no hole, so that the film ahead sees its surroundings; what it holds
is the rim's. stepping/burst.py takes it away, stepping/foam_burst.py once a bubble's film is gone.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from melp_warp.device.launch import clear, copy, launch
from melp_warp.kernels import carried as kq
from melp_warp.kernels import free_rim as kr
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Fields

REACH = 2.0
"""Distance of an E from a rim within which it is looked at, spacings: that of L from their homes, and a step, less."""

SIGHT = 1.5
"""Distance within which a rim sees the film ahead, spacings."""

RIM_CFL = 0.5
"""Spacings that a rim may run in a step."""

SMOOTH = 0.05
"""Share of what its points do not resolve that a rim loses in a step."""

FOLLOW = 0.02
"""Share of its departure from the liquid that it holds that the inertia of a rim loses in a step."""

HEAVY = 100.0
"""Inertia across the film of an E behind a rim, over that of one ahead."""


class FreeRim:
    """The free rims of a film or a foam. Made only where there are holes.

    Attributes:
        rim: their points.
        chain: the rims, as kernels see them.
        edge: [n_e] where E are seen from the rims, see `kernels.free_rim.find_edge_e`.
    """

    def __init__(self, film: Film, state: State, lists: NeighborLists, fields: Fields):
        self.film, self.state, self.lists, self.fields = film, state, lists, fields
        self.rim = rim = state.f
        self._conormal = film.zeros(rim.x.shape[0], wp.vec3)
        self._smoothed = film.zeros(rim.x.shape[0], wp.vec3)
        self._seen = wp.zeros((rim.x.shape[0], 10), dtype=wp.float32, device=film.device)
        self.chain, self._halfway = self._chain(rim.x), self._chain(wp.clone(rim.x))
        self._own = wp.array(np.arange(film.n_e), dtype=wp.int32, device=film.device) if state.l is None else None
        self.edge = film.zeros(film.n_e, wp.vec4)
        self._turn()
        self.look()

    def _chain(self, x: wp.array) -> kr.Chain:
        """The rims with their points at x."""
        chain, rim = kr.Chain(), self.state.f
        chain.x, chain.after, chain.before, chain.conormal = x, rim.after, rim.before, self._conormal
        chain.region, chain.other = rim.region, rim.other
        return chain

    def _points(self, kernel, inputs: list, outputs: list) -> None:
        launch(kernel, self.state.f.x.shape[0], inputs, outputs, self.film.device)

    def _turn(self) -> None:
        """Conormals of the rims where they are now."""
        self._points(kr.find_conormals_f, [self.chain, self.state.f.normal], [self._conormal])

    def look(self, way: float | None = None) -> None:
        """Find which E are near a rim and which are behind it.

        Args:
            way: how far rim and film may have come closer since the last time, m; None for no one knows.
        """
        film, e = self.film, self.state.e
        if way is None:
            clear(self.edge)
        film.launch_e(
            kr.find_edge_e, [e.x, e.region, self.chain, REACH * film.spacing, way or 0.0], [e.behind, self.edge]
        )

    def advance(self, dt: float) -> None:
        """After the film's step of dt (s): pull, move and feed the rims."""
        film, e, rim, m = self.film, self.state.e, self.state.f, self.film.material
        gravity = film.gravity_at(self.state.time + 0.5 * dt)
        clear(self._seen)
        film.launch_e(
            kr.see_film_f,
            [
                *(self.edge, e.behind, e.x, e.normal, e.u, e.region, self.fields.gamma, self.fields.eta),
                *(self.chain, SIGHT * film.spacing),
            ],
            [self._seen],
        )
        self._points(kr.take_film_f, [self._seen, rim.other], [rim.normal, rim.flow, rim.film, rim.x])
        self._points(kr.go_halfway_f, [rim.x, rim.u, dt], [self._halfway.x])
        self._points(
            kr.pull_rim_f,
            [
                *(self._halfway, rim.normal, rim.flow, rim.film, rim.mass),
                *(film.tension, film.slope, m.density, gravity, FOLLOW, dt),
            ],
            [rim.inertia, rim.u, rim.growth],
        )
        self._points(kr.smooth_rim_f, [self.chain, rim.u, SMOOTH, dt], [self._halfway.x, self._smoothed])
        copy(rim.x, self._halfway.x)
        copy(rim.u, self._smoothed)
        self._turn()
        self.look(way=2.0 * RIM_CFL * film.spacing)
        self.sweep()

    def sweep(self) -> None:
        """Give the rims what they have passed."""
        film, rim, state = self.film, self.state.f, self.state
        e, lag = state.e, state.l
        if lag is None:
            held = [e.x, e.mass, e.surfactant, self._own, e.region]
            count, swept = film.n_e, e.swept
        else:
            held = [lag.x, lag.mass, lag.surfactant, self.lists.le.home, lag.region]
            count, swept = film.n_l, lag.behind
        for name, amount in rim.more.items():
            given = [lag.x, state.carried[name], *held[3:], self.edge, self.chain, REACH * film.spacing, swept]
            launch(kq.sweep_amount, count, given, [amount], film.device)
        launch(
            kr.sweep,
            count,
            [*held, self.edge, self.chain, REACH * film.spacing],
            [swept, rim.mass, rim.surfactant],
            film.device,
        )

    def fastest(self) -> float:
        """Speed of the fastest point of a rim in the last step, m/s (reads back)."""
        u = self.state.f.u.numpy()
        return float(np.sqrt((u**2).sum(axis=1)).max(initial=0.0))


class TornFilm(FreeRim):
    """The free rims of a single film, and the film behind them, which goes on with what is at the rims.

    Attributes:
        inertia: [n_e] what resists across the film, kg.
    """

    needs = ("lists", "geometry", "fields")
    kernels = ("free_rim",)

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, fields: Fields):
        super().__init__(film, state, lists, fields)
        self._area, self._air = geometry.area, 0.0
        if film.surroundings.air != "none":
            size = film.spacing * math.sqrt(film.n_e / (4.0 * math.pi))
            self._air = float(film.air.waves(6.0 / size**2, film.surroundings.air_density, size))
        self.inertia = wp.clone(state.e.mass)
        self._x_l = film.zeros(film.n_l, wp.vec3) if state.l is not None else None

    def hold(self) -> None:
        """Before a step: say what resists across the film, and let what is behind the rims go on as the film there."""
        film, e = self.film, self.state.e
        if film.features.moving:
            film.launch_e(
                kr.hold_behind_e,
                [
                    *(e.normal, e.mass, self._area, self.edge, e.behind, self.chain, self.state.f.flow),
                    *(self._air, HEAVY),
                ],
                [e.u, self.inertia],
            )
            clear(self.state.memory.load)  # E that have come behind a rim move otherwise than in the last step

    def still(self) -> None:
        """Within a step: let L behind rims lie on their E."""
        e, lag = self.state.e, self.state.l
        inputs = [lag.behind, self.lists.le.home, e.normal, e.u]
        launch(kr.still_behind_l, self.film.n_l, inputs, [lag.u, lag.v, lag.affine], self.film.device)

    def mark(self) -> None:
        """Within a step: note where L are before they move."""
        copy(self._x_l, self.state.l.x)

    def move(self, dt: wp.array) -> None:
        """Within a step of dt [1], s: move L behind rims with their E."""
        lag = self.state.l
        launch(kr.move_behind_l, self.film.n_l, [lag.behind, self._x_l, lag.v, dt], [lag.x], self.film.device)
