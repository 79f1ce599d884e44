"""Stages 5 and 6 on the host: E advance with redistribution, L advance with projection."""

from __future__ import annotations

import warp as wp

from melp_warp.film import Film
from melp_warp.geometry import Geometry
from melp_warp.kernels import advance as ka
from melp_warp.kernels import redistribute as kr
from melp_warp.launch import copy
from melp_warp.linear import ConjugateGradient, LinearOperator
from melp_warp.neighbors import NeighborLists
from melp_warp.state import State

SHIFT_TOLERANCE = 0.05
SHIFT_ITERATIONS = 20
SHIFT_LIMIT = 0.1
"""Largest shift of an E in one redistribution, in spacings; more where the E are very uneven, see `shift_e`."""

PROJECTION_REACH = 2.0
"""Reach of the fits that an L is projected with, in spacings: nearer fits are the better ones."""


class EulerianAdvance:
    """Motion of E with the surface. Made only for films whose surface moves.

    Attributes:
        x_old: [n] positions before the step, m.
    """

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry
        self.x_old = wp.clone(state.e.x)
        self._smoothed = film.zeros(film.n_e, wp.vec3)

    def advance(self, u_mid: wp.array, frame: wp.array, dt: wp.array) -> None:
        """Move E with the normal velocity, their drift and the film as a whole (19)."""
        film, e = self.film, self.state.e
        copy(self.x_old, e.x)
        film.launch_e(
            ka.smooth_drift_e,
            [
                *(e.drift, self.geometry.density, self.geometry.near, self.lists.ee.rows),
                *(film.r, film.n_e, film.numerics.xsph),
            ],
            [self._smoothed],
        )
        copy(e.drift, self._smoothed)
        film.launch_e(ka.advance_e, [e.normal, u_mid, e.drift, e.region, frame, dt], [e.x])


class Redistribution:
    """Even spacing of E by pseudo-pressure (20), Algorithm 5.

    Attributes:
        spread: [regions] (delta_max - delta_min)/delta_mean, delta_mean (1/m^2), 1 if E were shifted.
    """

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry
        operator = LinearOperator(film.n_e, lists.ee.rows, film.device, pair=geometry.weight)
        self.solver = ConjugateGradient(operator, film.total, wp.float32, SHIFT_TOLERANCE, SHIFT_ITERATIONS)
        self.spread = film.zeros(film.regions, wp.vec3)
        self._part = film.parts(wp.vec4)
        self._x, self._u, self._drift = (film.zeros(film.n_e, wp.vec3) for _ in range(3))

    def apply(self, dt: wp.array) -> None:
        """Shift E once towards even density; nothing moves where the spread is below the scene's threshold."""
        film, e, geometry, rows = self.film, self.state.e, self.geometry, self.lists.ee.rows
        geometry.update_density()
        film.launch_parts(kr.spread_chunks, [geometry.density, film.first], [self._part])
        film.launch_regions(kr.summarize_spread_r, [self._part, film.numerics.spread], [self.spread])
        film.launch_e(kr.load_pressure_e, [geometry.density, e.region, self.spread], [self.solver.b, self.solver.x])
        self.solver.solve()
        film.launch_e(
            kr.shift_e,
            [
                self.solver.x,
                e.x,
                e.region,
                self.spread,
                e.u,
                e.drift,
                e.normal,
                geometry.surface,
                rows,
                geometry.gradient,
                film.numerics.redistribution,
                film.spacing,
                SHIFT_LIMIT * film.spacing,
                dt,
            ],
            [self._x, self._u, self._drift],
        )
        copy(e.x, self._x, count=film.n_e)
        copy(e.u, self._u, count=film.n_e)
        copy(e.drift, self._drift)


class LagrangianAdvance:
    """Motion of L with the material, kept on the surface. Made only for films with L."""

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry

    def advance(self, frame: wp.array, passed: wp.array, bend: wp.array, dt: wp.array) -> None:
        """Move L by dt (v + frame - passed), put them onto the surface (Algorithm 7).

        `bend` [1] is that of their paths, 0 to 1.
        """
        film, lag = self.film, self.state.l
        film.launch_l(ka.advance_l, [lag.v, lag.affine, lag.normal, lag.region, frame, passed, bend, dt], [lag.x])
        if film.features.moving:
            self.project()

    def project(self) -> None:
        """Put L on the surface through E."""
        film, e = self.film, self.state.e
        film.launch_l(
            ka.project_l,
            [
                *(e.x, self.geometry.surface),
                *(self.lists.le.rows, PROJECTION_REACH * film.spacing, film.n_e),
            ],
            [self.state.l.x],
        )
