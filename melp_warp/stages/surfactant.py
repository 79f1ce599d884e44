"""Stage 3 on the host, tangential: surfactant equation (14), Marangoni force (15), viscosity and drag."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from melp_warp.device.launch import copy
from melp_warp.device.linear import ConjugateGradient, LinearOperator
from melp_warp.device.scalars import Setting
from melp_warp.features import Features
from melp_warp.kernels import circulation as kc
from melp_warp.kernels import surfactant as ks
from melp_warp.stages.film import Film
from melp_warp.stages.forces import Forces
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.levels import make_solver, solver_kernels
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.notices import Notices
from melp_warp.stages.rim import Rim, RimmedViscosity
from melp_warp.stages.state import State

JACOBI_OMEGA = 0.2

RISE = 1.0
"""Rise of theta with the shear in a step: what grows in it does so by about half of it a step."""


class Fields:
    """Thickness and relative surfactant concentration of E.

    Attributes:
        eta: [n_e] m.
        gamma: [n_e] Gamma/Gamma_0.
    """

    needs = ("geometry",)
    kernels = ("surfactant",)

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

    def remark(self, notices: Notices) -> None:
        """Note where so much surfactant has gathered that no tension is left (reads back)."""
        film, m = self.film, self.film.material
        if m.surfactant == 0.0:
            return
        self.update()
        gamma = self.gamma.numpy().astype(np.float64)
        tension = film.tension.numpy()[self.state.e.region.numpy()[: film.n_e]].astype(np.float64)
        sigma = tension - film.slope * gamma
        i = int(np.argmin(sigma))
        if sigma[i] < 0.0:
            text = (
                f"E {i} has {m.surfactant * gamma[i]:.3g} mol/m^2 of surfactant, more than sigma_0/(R T) ="
                f" {tension[i] / m.rt:.3g} mol/m^2: its tension, {sigma[i]:.3g} N/m, is below 0"
            )
            notices.note("no tension left", -float(sigma[i]), text)


def fastest_rate(film: Film) -> float:
    """Fastest that the flow along a film changes: by drag and viscosity, or in a wave of four spacings. 1/s."""
    m, dx = film.material, film.spacing
    decay = film.surroundings.drag / m.areal_mass + m.viscosity * (0.5 * math.pi / dx) ** 2
    return max(decay, 0.5 * math.pi * math.sqrt(film.stiffness / m.thickness) / dx)


def drainage_length(film: Film, state: State) -> float:
    """Height over which a film at rest gets e times as thick, 2 R T Gamma/(rho g eta) of all its liquid, m.

    g is the weight along the film where it is steepest; a bubble that falls freely, without air, feels what `lift`
    holds back alone. Infinite without weight, 0 without surfactant. Reads back.
    """
    g = np.array(film.surroundings.gravity_at(state.time))
    if film.features.floats and not film.features.air:
        g = g * film.surroundings.lift
    normal = state.e.normal.numpy()[: film.n_e].astype(np.float64)
    steepest = float(np.linalg.norm(g - (normal @ g)[:, None] * normal, axis=1).max(initial=0.0))
    mass, amount = (array.numpy().sum(dtype=np.float64) for array in (state.l.mass, state.l.surfactant))
    if steepest <= 1e-6 * np.linalg.norm(g) or mass == 0.0:
        return math.inf
    return 2.0 * film.material.rt * float(amount) / (steepest * float(mass))


class Tangential:
    """Tangential dynamics. Made only for films with L.

    (14) and (15) are solved over the first theta dt of the step, with which the L move through all of it; the velocity
    that they carry on is extrapolated to its end. theta = 1 is the paper's backward Euler. theta = 1/2 is the implicit
    midpoint rule, of second order, in which a wave keeps its energy; what a step does not resolve would alternate in
    sign for ever and, in a flow that shears, grow. theta therefore rises with the step and with the shear, to 2/3 at
    most, where that halves in each step.

    Attributes:
        theta: [1] share of the step that is solved for.
        bend: [1] of the paths of L: 1 for second order; such that a vortex neither gains nor loses by it,
            2 (1 - theta), unless `l_order` is 2.
        drainage_length: m, see `drainage_length`; None before it was first asked for.
        dilation: [n_e] div_s u, 1/s: before the solve, then where `find_dilation` was called.
        before: [n] velocity of E at the start of the step, m/s; None where L do not look back at it.
        wind: [regions] velocity of the air along the film, m/s: that of the film as a whole where drag on the whole is
            told apart; None for air at rest.
        push: [n] change of velocity by viscosity, drag and forces as the film is not at rest over theta dt, m/s; None
            where L carry no circulation.
        traction: [n_e] tangential force of uneven tension in the last solve, Pa; None where neither the film recoils
            nor a rim is pulled at.
    """

    needs = ("lists", "geometry", "fields", "forces", "rim")

    @staticmethod
    def kernels(features: Features) -> tuple[str, ...]:
        """Files of kernels."""
        return "surfactant", *(solver_kernels(features) if features.marangoni or features.viscous else ())

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
        self.dilation, self.widening = film.zeros(film.n_e), film.zeros(film.n_e)
        swells = film.features.budget or (film.features.marangoni and film.features.moving)
        self.swelling = film.zeros(film.n_e) if swells else None
        self.path = film.zeros(film.total, wp.vec3)
        self.midpoint = film.numerics.flow == "midpoint"
        self._rate = fastest_rate(film)
        rubbed = film.features.viscous or film.surroundings.drag > 0.0 or bool(film.forces)
        self.push = film.zeros(film.total, wp.vec3) if film.features.circulation and rubbed else None
        self.theta, self.bend, self._ahead = (film.zeros(1) for _ in range(3))
        self._least, self._most = Setting(film.device), Setting(film.device)
        self._shear, self._shears = film.zeros(film.n_e), film.parts()
        self.before = film.zeros(film.total, wp.vec3) if film.numerics.looks_back else None
        self.wind = state.motion if film.features.dragged else None
        pulls = film.features.recoils or (film.features.marangoni and (film.features.collects or film.features.budget))
        self.traction = film.zeros(film.n_e, wp.vec3) if pulls else None
        self.drainage_length: float | None = None
        operator = LinearOperator(film.n_e, lists.ee.rows, film.device)
        self.solver = self._make_solver(operator) if film.features.marangoni else None
        self.viscous = None
        if film.features.viscous:
            self.viscous = self._make_viscous(operator)

    def _make_solver(self, operator: LinearOperator) -> ConjugateGradient:
        film, numerics = self.film, self.film.numerics
        limits = [numerics.tolerance, numerics.max_iterations]
        if numerics.solver == "jacobi":
            return ConjugateGradient(operator, film.total, wp.float32, *limits, JACOBI_OMEGA)
        return make_solver(film, self.lists, operator, *limits)

    def _make_viscous(self, operator: LinearOperator) -> ConjugateGradient:
        film, numerics = self.film, self.film.numerics
        if film.features.rim:
            return RimmedViscosity(film, self.state, self.geometry, operator)
        return ConjugateGradient(
            operator, film.total, wp.vec3, numerics.tolerance, numerics.max_iterations, of_change=True
        )

    def prepare(self, dt: float) -> None:
        """Set what depends on the step dt (s) to come."""
        stiff = max(self._rate * dt, 1.0)
        self._least.at(max(1.0 / 2.0, 2.0 / 3.0 - 1.0 / stiff) if self.midpoint else 1.0)
        self._most.at(max(1.0 / 2.0, 2.0 / 3.0 - 1.0 / 3.0 / stiff) if self.midpoint else 1.0)

    def remark(self, notices: Notices) -> None:
        """Note where weight packs the liquid more tightly than the E can see."""
        film = self.film
        if self.drainage_length is None:
            self.drainage_length = drainage_length(film, self.state)
        length = self.drainage_length
        if length >= film.spacing:
            return
        need = f"at least {math.ceil(film.n_e * (film.spacing / length) ** 2):,} E see it" if length else "no E see it"
        fate = "what reaches the rim goes into its border" if film.features.collects else "it gathers on single E"
        text = (
            f"the drainage length 2 R T Gamma/(rho g eta) of {length:.3g} m is below the E spacing of"
            f" {film.spacing:.3g} m: surfactant does not hold the liquid up, and {fate}; {need}"
        )
        notices.note("drainage length unresolved", 1.0 - length / film.spacing, text)

    def begin(self) -> None:
        """Note the velocity of E at the start of the step."""
        if self.before is not None:
            copy(self.before, self.state.e.u)

    def solve(self, dt: wp.array) -> None:
        """Advance the tangential velocity of E by theta dt: viscosity, then (14) and (15).

        The normal one, which is that of the step's end, is taken back to theta dt.
        """
        u, ahead = self.state.e.u, self._ahead
        self.choose_share(dt)
        if self.midpoint:
            self.film.launch_e(ks.rescale_change_e, [self.before, self.theta, 0.0], [u])
        self._note_push(0.0)
        if self.viscous is not None:
            self._diffuse(ahead)
        self._note_push(1.0)
        self.forces.take_flow()
        self.find_dilation()
        if self.solver is not None:
            self._solve_surfactant(ahead)
        self._accelerate(ahead)
        self._note_drag(ahead)
        if self.rim is not None and self.traction is not None:
            self.rim.take_pull(self.traction, dt)

    def finish(self) -> None:
        """Take the velocity of E to the end of the step."""
        if self.midpoint:
            self.film.launch_e(ks.rescale_change_e, [self.before, self.theta, 1.0], [self.state.e.u])

    def choose_share(self, dt: wp.array) -> None:
        """Set theta, the bend of the paths and theta dt for a step of dt [1] from the flow as it is now."""
        film, e = self.film, self.state.e
        if self.midpoint:
            if self.rim is not None:
                self.rim.mirror_velocity()
            film.launch_e(ks.shear_e, [e.u, e.normal, self.lists.ee.rows, self.geometry.gradient], [self._shear])
            film.launch_parts(ks.largest_chunks, [self._shear], [self._shears])
        bounds = [self._least.array, self._most.array, RISE]
        bend = 1.0 if film.numerics.l_order == 2 else -1.0
        if film.features.circulation:
            bend = 0.0  # the velocity half a step on has the acceleration in it
        film.launch_one(ks.choose_share, [self._shears, *bounds, bend, dt], [self.theta, self.bend, self._ahead])

    def find_widening(self, passed: wp.array, dt: wp.array) -> None:
        """Find how L will move and by how much the film widens with them; `passed` [regions] as a whole, m/s."""
        film, e, rows, geometry = self.film, self.state.e, self.lists.ee.rows, self.geometry
        midway = float(film.features.circulation)
        film.launch_e(ks.find_path_e, [e.u, self.before, e.region, passed, midway, self.theta], [self.path])
        if self.rim is not None:
            self.rim.mirror(self.path)
        film.launch_e(
            ks.widen_path_e,
            [self.path, e.normal, geometry.surface, rows, geometry.gradient, self.bend, dt],
            [self.widening, self.swelling],
        )

    def find_dilation(self) -> wp.array:
        """div_s u of the velocity as it is now, no flow through a rim. [n_e], 1/s."""
        if self.rim is not None:
            self.rim.mirror_velocity()
        self.film.launch_e(ks.dilation_e, [self.state.e.u, self.lists.ee.rows, self.geometry.gradient], [self.dilation])
        return self.dilation

    def _note_push(self, onward: float) -> None:
        """Note the velocity before viscosity acts (0), and what it has changed (1)."""
        if self.push is not None:
            self.film.launch_e(kc.note_change_e, [self.state.e.u, onward], [self.push])

    def _note_drag(self, dt: wp.array) -> None:
        film, e = self.film, self.state.e
        drag = film.surroundings.drag
        if self.push is not None and drag > 0.0:
            film.launch_e(
                kc.note_drag_e,
                [e.u, e.normal, self.fields.eta, e.region, self.wind, drag, film.material.density, dt],
                [self.push],
            )

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
                self.forces.ease,
                self.forces.body,
                dt,
            ],
            [solver.operator.diag, solver.operator.pair, solver.b, solver.x],
        )
        solver.solve()

    @property
    def gamma(self) -> wp.array:
        """[n] Gamma/Gamma_0 that drives the step: after its share theta, where there is surfactant."""
        return self.fields.gamma if self.solver is None else self.solver.x

    def _accelerate(self, dt: wp.array) -> None:
        film, fields = self.film, self.fields
        film.launch_e(
            ks.accelerate_tangential_e,
            [
                self.state.e.x,
                self.state.e.normal,
                fields.eta,
                self.gamma,
                self.lists.ee.rows,
                self.geometry.inner_gradient,
                film.n_e,
                film.stiffness,
                self.forces.still,
                self.forces.rate,
                self.forces.hold,
                film.surroundings.drag,
                self.state.e.region,
                self.wind,
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
        if self.film.features.rim:
            solver.prepare(dt)
        solver.solve()
        if self.film.features.collects:
            self.rim.take_friction(solver.friction(), self.theta)
        film.launch_e(ks.replace_tangential_e, [solver.x, e.normal], [e.u])
