"""Stages 5 and 6 on the host: E advance with redistribution, L advance with projection."""

from __future__ import annotations

import math

import warp as wp

from melp_warp.device.launch import clear, copy, repeat
from melp_warp.device.linear import LinearOperator
from melp_warp.features import Features
from melp_warp.kernels import advance as ka
from melp_warp.kernels import redistribute as kr
from melp_warp.kernels import regions as kg
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.levels import make_solver, solver_kernels
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.state import State

SHIFT_TOLERANCE = 0.05

SHIFT_ITERATIONS = 2.0
"""Most iterations of the pseudo-pressure solve over the square root of the number of E: it takes 0.75 of that."""

SHIFT_SHARE = 0.02
"""Largest shift of an E in one redistribution, in radii of a sphere of the film's size: what a film is stretched by
over a length is more spacings the finer it is."""

FILLED_REACH = 0.25
"""Largest shift, in spacings, after which areas are found anew in the midst of a step. Lists are those of before: the
neighbours that they may lack have less than 1e-3 of the weight of a near one."""

START_SPREAD = 0.02
"""Spread of E density from which on they are evened out at the start, where it costs the film nothing."""

PROJECTION_REACH = 2.0
"""Reach of the fits that an L is projected with, in spacings: nearer fits are the better ones."""


class EulerianAdvance:
    """Motion of E with the surface. Made only for films whose surface moves.

    Attributes:
        redistribution: keeps E evenly spaced; None where the scene asks for none.
        x_old: [n] positions before the step, m.
    """

    needs = ("lists", "geometry")

    @staticmethod
    def kernels(features: Features) -> tuple[str, ...]:
        """Files of kernels."""
        return "advance", "redistribute", *(("regions",) if features.coarse else ()), *solver_kernels(features)

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry
        shifted = film.numerics.redistribution > 0.0 and not film.features.holed
        self.redistribution = Redistribution(film, state, lists, geometry) if shifted else None
        self.x_old = wp.clone(state.e.x)

    def advance(self, u_mid: wp.array, frame: wp.array, dt: wp.array) -> None:
        """Space E evenly on the film as it is (20), then move them along their normals and with it as a whole (19)."""
        film, e, geometry = self.film, self.state.e, self.geometry
        copy(self.x_old, e.x)
        if self.redistribution is not None:
            self.redistribution.apply(u_mid)
        film.launch_e(
            ka.advance_e,
            [e.normal, u_mid, e.region, frame, geometry.surface, self.lists.ee.rows, geometry.gradient, dt],
            [e.x],
        )


class Redistribution:
    """Even spacing of E by pseudo-pressure (20), Algorithm 5 without its line 13.

    What line 13 adds, drift += shift/dt, carries E on past where they are even: it winds up and drives the film.

    Attributes:
        spread: [regions] (delta_max - delta_min)/delta_mean, delta_mean (1/m^2), above 0 if E were shifted.
    """

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry
        operator = LinearOperator(film.n_e, lists.ee.rows, film.device, pair=geometry.weight)
        most = math.ceil(SHIFT_ITERATIONS * math.sqrt(film.n_e))
        self.solver = make_solver(film, lists, operator, SHIFT_TOLERANCE, most)
        size = math.sqrt(film.n_e / film.regions / (4.0 * math.pi))
        self._limit = film.spacing * (SHIFT_SHARE * size)
        self.spread = film.zeros(film.regions, wp.vec3)
        self._part = film.parts(wp.vec4)
        # of many E the mean is rounded by as much as they depart from it
        self._loads = film.parts(wp.vec2) if film.features.coarse and not film.features.rim else None
        self.shifted, self._u, self._asked = (film.zeros(film.n_e, wp.vec3) for _ in range(3))
        self._shift_by = film.zeros(film.n_e, wp.vec3) if film.features.coarse else self._asked
        self._u_mid = film.zeros(film.n_e)
        n, single = film.n_e, film.features.floats
        alone = not film.features.lagrangian  # the liquid of a film with L is theirs
        self._sharp = [film.zeros(n, wp.vec3), film.zeros(n), film.zeros(n)] if single else None
        self._swept = [film.zeros(n, wp.vec2) for _ in range(2)] if alone and not single else None
        self._layer, self._sharp_layer, self._layer_new = (
            film.zeros(n, wp.vec3) if alone and single else None for _ in range(3)
        )
        if self._layer is not None:
            self._limit = min(self._limit, FILLED_REACH * film.spacing)
            self._filled, self._go = film.parts(wp.vec4d), film.zeros(1, wp.int32)

    def apply(self, u_mid: wp.array) -> None:
        """Shift E once towards even density; nothing moves where the spread is below the scene's threshold.

        The geometry is that of the present positions. `u_mid` [n_e], m/s, is carried along as the velocities are.
        """
        numerics = self.film.numerics
        self._shift(u_mid, numerics.redistribution, numerics.spread)

    def even_out(self) -> None:
        """Shift E at full strength: for a film at the start, whose shape is known."""
        self._shift(self._u_mid, 1.0, START_SPREAD)

    def _shift(self, u_mid: wp.array, strength: float, threshold: float) -> None:
        film, e, geometry, rows = self.film, self.state.e, self.geometry, self.lists.ee.rows
        film.launch_parts(kr.spread_chunks, [geometry.density, film.first], [self._part])
        film.launch_regions(kr.summarize_spread_r, [self._part, threshold], [self.spread])
        film.launch_e(kr.load_pressure_e, [geometry.density, e.region, self.spread], [self.solver.b, self.solver.x])
        if self._loads is not None:
            film.launch_parts(kg.load_chunks, [self.solver.b, geometry.area, film.first], [self._loads])
            inputs = [geometry.area, e.region, self._loads, film.regions]
            film.launch_e(kr.balance_pressure_e, inputs, [self.solver.b])
        self.solver.solve()
        pressure = [self.solver.x, e.x, e.region, self.spread, e.normal, rows, geometry.gradient]
        film.launch_e(kr.ask_shift_e, [*pressure, strength, film.spacing, self._limit], [self._asked])
        if self._shift_by is not self._asked:
            inputs = [self._asked, e.normal, geometry.near, rows, film.spacing]
            film.launch_e(kr.smooth_far_e, inputs, [self._shift_by])
        if self._layer is not None:
            film.launch_e(kr.spread_layer_e, [e.mass, e.surfactant, geometry.area], [self._layer])
        if self._sharp is not None:
            fields = [e.x, e.u, u_mid, self._layer, geometry.surface, e.normal, e.region, self.spread, rows, film.r]
            film.launch_e(kr.sharpen_fields_e, fields, [*self._sharp, self._sharp_layer])
        film.launch_e(
            kr.shift_e,
            [
                *(self._shift_by, e.x, e.u, u_mid, *(self._sharp or (e.u, u_mid, None))),
                *(self._layer, self._sharp_layer, e.normal, rows, film.r, film.spacing),
            ],
            [self.shifted, self._u, self._u_mid, self._layer_new],
        )
        if self._swept is not None:
            self._keep_liquid()
        for array, new in ((e.x, self.shifted), (e.u, self._u), (u_mid, self._u_mid)):
            copy(array, new, count=film.n_e)
        if self._layer is not None:
            film.launch_one(kr.ask_layers, [self.spread], [self._go])
            repeat(self._go, self._fill_layers, 1)

    def _fill_layers(self) -> None:
        """Give E the liquid that lies where they are now: a layer on the area that each has there."""
        film, e, geometry = self.film, self.state.e, self.geometry
        geometry.update()
        film.launch_parts(
            kr.sum_layers_chunks,
            [e.mass, e.surfactant, self._layer_new, geometry.area, film.first],
            [self._filled],
        )
        film.launch_e(
            kr.fill_layers_e, [self._layer_new, geometry.area, self._filled, self._go], [e.mass, e.surfactant]
        )
        clear(self._go)

    def _keep_liquid(self) -> None:
        """Leave the liquid where it is."""
        film, e, geometry = self.film, self.state.e, self.geometry
        rows, (swept, blurred) = self.lists.ee.rows, self._swept
        inputs = [e.x, self.shifted, geometry.area, geometry.weight, rows, film.n_e, e.mass, e.surfactant, e.swept]
        film.launch_e(kr.sweep_liquid_e, inputs, [swept])
        for new, mean in ((swept, blurred), (blurred, swept)):
            film.launch_e(kr.blur_swept_e, [new, geometry.area, geometry.near, rows, film.n_e, e.swept], [mean])
        film.launch_e(kr.take_swept_e, [swept], [e.mass, e.surfactant])


class LagrangianAdvance:
    """Motion of L with the material, kept on the surface. Made only for films with L."""

    needs = ("lists", "geometry")
    kernels = ("advance",)

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
