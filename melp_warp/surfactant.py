"""Stage 3 on the host, tangential: surfactant equation (14), Marangoni force (15), viscosity and drag."""

from __future__ import annotations

import math

import warp as wp

from melp_warp.film import Film
from melp_warp.forces import Forces
from melp_warp.geometry import Geometry
from melp_warp.kernels import surfactant as ks
from melp_warp.launch import copy
from melp_warp.linear import ConjugateGradient, LinearOperator
from melp_warp.neighbors import NeighborLists
from melp_warp.rim import Rim
from melp_warp.settings import Setting
from melp_warp.state import State

JACOBI_OMEGA = 0.2

RIM_MARGIN = 1.2
"""Fluxes of (14) in films with a rim, times.

The midpoint rule holds at any step only where the Laplacian of (14) is at least the divergence of the gradient of (15).
It is at most 0.98 of it on closed films, 1.08 of it beside a round rim and 1.15 in a corner, where one-sided gradients are steeper.
"""


class Fields:
    """Thickness and relative surfactant concentration of E.

    Attributes:
        eta: [n_e] m.
        gamma: [n_e] Gamma/Gamma_0.
    """

    def __init__(self, film: Film, state: State, geometry: Geometry):
        self.film, self.state, self.geometry = film, state, geometry
        self.eta, self.gamma = film.zeros(film.n_e), film.zeros(film.n_e)

    def update(self) -> None:
        """eta_E = V_E/a_E and Gamma_E = c_E/a_E."""
        film, e, m = self.film, self.state.e, self.film.material
        film.launch_e(
            ks.film_fields_e,
            [e.mass, e.surfactant, self.geometry.area, m.density, m.surfactant],
            [self.eta, self.gamma],
        )


def fastest_rate(film: Film) -> float:
    """Fastest that the flow along a film changes: by drag and viscosity, or in a wave of four spacings. 1/s."""
    m, dx = film.material, film.spacing
    decay = film.surroundings.drag / m.areal_mass + m.viscosity * (0.5 * math.pi / dx) ** 2
    return max(decay, 0.5 * math.pi * math.sqrt(film.stiffness / m.thickness) / dx)


class Tangential:
    """Tangential dynamics. Made only for films with L.

    (14) and (15) are solved over the first theta dt of the step, with which the L move through all of it; the velocity
    that they carry on is extrapolated to its end. theta = 1 is the paper's backward Euler. theta = 1/2 is the implicit
    midpoint rule, of second order, in which a wave keeps its energy; what a step does not resolve would alternate in
    sign for ever, so theta rises with the step, to 2/3, where that halves in each step.

    Attributes:
        theta: share of the step that is solved for.
        bend: of the paths of L: 1 for second order; such that a vortex neither gains nor loses by it, 2 (1 - theta),
            unless `l_order` is 2.
        dilation: [n_e] div_s u, 1/s: before the solve, then where `find_dilation` was called.
        before: [n] velocity of E at the start of the step, m/s; None where L do not look back at it.
        traction: [n_e] tangential force of uneven tension in the last solve, Pa; None where the film does not recoil.
    """

    def __init__(
        self,
        film: Film,
        state: State,
        lists: NeighborLists,
        geometry: Geometry,
        fields: Fields,
        forces: Forces,
        rim: Rim | None,
    ):
        self.film, self.state, self.lists, self.forces = film, state, lists, forces
        self.geometry, self.fields, self.rim = geometry, fields, rim
        self.dilation = film.zeros(film.n_e)
        self.midpoint = film.numerics.flow == "midpoint"
        self._rate = fastest_rate(film)
        self.theta, self.bend, self._ahead = (Setting(film.device) for _ in range(3))
        self.before = film.zeros(film.total, wp.vec3) if film.numerics.looks_back else None
        self.traction = film.zeros(film.n_e, wp.vec3) if film.features.recoils else None
        numerics = film.numerics
        operator = LinearOperator(film.n_e, lists.ee.rows, film.device)
        self.solver = None
        if film.features.marangoni:
            jacobi = JACOBI_OMEGA if numerics.solver == "jacobi" else None
            self.solver = ConjugateGradient(
                operator, film.total, wp.float32, numerics.tolerance, numerics.max_iterations, jacobi
            )
        self.viscous = None
        if film.features.viscous:
            self.viscous = ConjugateGradient(operator, film.total, wp.vec3, numerics.tolerance, numerics.max_iterations)

    def prepare(self, dt: float) -> None:
        """Set what depends on the step dt (s) to come."""
        theta = max(1.0 / 2.0, 2.0 / 3.0 - 1.0 / max(self._rate * dt, 1.0)) if self.midpoint else 1.0
        self.theta.at(theta)
        self.bend.at(1.0 if self.film.numerics.l_order == 2 else 2.0 * (1.0 - theta))
        self._ahead.at(theta * dt)

    def begin(self) -> None:
        """Note the velocity of E at the start of the step."""
        if self.before is not None:
            copy(self.before, self.state.e.u)

    def solve(self) -> None:
        """Advance the tangential velocity of E by theta dt: viscosity, then (14) and (15).

        The normal one, which is that of the step's end, is taken back to theta dt.
        """
        u, ahead = self.state.e.u, self._ahead.array
        if self.midpoint:
            self.film.launch_e(ks.rescale_change_e, [self.before, self.theta.array, 0.0], [u])
        if self.viscous is not None:
            self._diffuse(ahead)
        self.find_dilation()
        if self.solver is not None:
            self._solve_surfactant(ahead)
        self._accelerate(ahead)

    def finish(self) -> None:
        """Take the velocity of E to the end of the step."""
        if self.midpoint:
            self.film.launch_e(ks.rescale_change_e, [self.before, self.theta.array, 1.0], [self.state.e.u])

    def find_dilation(self) -> wp.array:
        """div_s u of the velocity as it is now, no flow through a rim. [n_e], 1/s."""
        if self.rim is not None:
            self.rim.mirror_velocity()
        self.film.launch_e(ks.dilation_e, [self.state.e.u, self.lists.ee.rows, self.geometry.gradient], [self.dilation])
        return self.dilation

    def _solve_surfactant(self, dt: wp.array) -> None:
        film, fields, solver = self.film, self.fields, self.solver
        film.launch_e(
            ks.assemble_surfactant_e,
            [
                self.state.e.x,
                self.geometry.area,
                fields.eta,
                fields.gamma,
                self.dilation,
                self.geometry.weight,
                self.lists.ee.rows,
                film.n_e,
                film.stiffness,
                1.0 if self.rim is None else RIM_MARGIN,
                self.forces.body,
                dt,
            ],
            [solver.operator.diag, solver.operator.pair, solver.b, solver.x],
        )
        solver.solve()

    def _accelerate(self, dt: wp.array) -> None:
        film, fields = self.film, self.fields
        gamma = fields.gamma if self.solver is None else self.solver.x
        film.launch_e(
            ks.accelerate_tangential_e,
            [
                self.state.e.x,
                self.state.e.normal,
                fields.eta,
                gamma,
                self.lists.ee.rows,
                self.geometry.inner_gradient,
                film.n_e,
                film.stiffness,
                self.forces.body,
                film.surroundings.drag,
                film.material.density,
                dt,
            ],
            [self.state.e.u, self.traction],
        )

    def _diffuse(self, dt: wp.array) -> None:
        film, e, solver = self.film, self.state.e, self.viscous
        film.launch_e(
            ks.assemble_viscosity_e,
            [
                e.mass,
                self.geometry.area,
                e.normal,
                self.geometry.weight,
                self.lists.ee.rows,
                film.n_e,
                film.material.viscosity,
                e.u,
                dt,
            ],
            [solver.operator.diag, solver.operator.pair, solver.b, solver.x],
        )
        solver.solve()
        film.launch_e(ks.replace_tangential_e, [solver.x, e.normal], [e.u])
