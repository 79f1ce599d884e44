"""Stage 3 on the host, normal: tension, gas, weight and air (12), implicit or explicit."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.device.launch import copy, launch
from melp_warp.device.linear import Solver
from melp_warp.device.scalars import Setting
from melp_warp.features import Features
from melp_warp.kernels import drag as kd
from melp_warp.kernels import gas as kg
from melp_warp.kernels import membrane as km
from melp_warp.kernels import motion as ko
from melp_warp.stages.drag import AirDrag
from melp_warp.stages.film import Film
from melp_warp.stages.forces import Forces
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.responses import AirResponse, ExplicitResponse, FilmResponse
from melp_warp.stages.rim import Rim
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Fields

MIDPOINT_CFL = 8.0
"""Spacings that the shortest wave may run in a step of the midpoint rule; beyond, it goes over to backward Euler."""

OFFSET_LIMIT = 0.1
"""Largest offset that mends the volume in one step, in spacings."""


def _shortest_wave_speed(film: Film) -> float:
    """Speed of a wave of two spacings, m/s."""
    mass = film.material.areal_mass
    if film.features.air:
        mass += film.air.waves((np.pi / film.spacing) ** 2, film.surroundings.air_density, film.radius)
    return float(np.sqrt(2.0 * film.material.film_tension / mass))


class Membrane:
    """Normal dynamics. Made only for films whose surface moves.

    The force is taken at the surface predicted with the present velocity, x + theta dt u_n n, and only the change of
    velocity is solved for: rigid motion and free flight cost nothing and are not damped.

    Attributes:
        theta: 1 for backward Euler, 1/2 for the midpoint rule. The midpoint rule keeps every wave, those too that a
            large step does not resolve, and the operator in the matrix is softer for the shortest than the force: they
            grow. So theta rises to 1 where the shortest wave runs more than `MIDPOINT_CFL` spacings in a step.
        theta_whole: the same for the motion of the film as a whole, which has no stiffness.
        share: [1] theta; 0 for the explicit scheme, which takes the force where the film is.
        ahead: [1] theta dt, s: how far ahead the force is taken; 0 for the explicit scheme.
        rigid_air: air that a translation takes along, kg/m^2; `taken` [regions] the same.
        blur: of the curvature, for which the inertia makes up, m^2.
        u_mid: [n_e] normal speed that moves E in this step, m/s.
        start: [1] velocity of the film as a whole at the start of the step, m/s.
        frame: [1] the same in the step; that of its end is `State.motion`.
        passed: [1] the same after the share of the step that `find_motion_at` was asked for.
        at_rest: [1] what lists move along with: they are of one film, `frame`.
        cover: None; foams have it.
    """

    needs = ("lists", "geometry", "fields", "forces", "rim", "response", "drag")
    cover = None

    @staticmethod
    def kernels(features: Features) -> tuple[str, ...]:
        """Files of kernels."""
        return "membrane", "motion", "gas", *(("drag",) if features.dragged else ())

    def __init__(
        self,
        film: Film,
        state: State,
        lists: NeighborLists,
        geometry: Geometry,
        fields: Fields,
        forces: Forces,
        rim: Rim | None,
        response: FilmResponse | AirResponse | ExplicitResponse,
        drag: AirDrag | None,
    ):
        self.film, self.state, self.geometry, self.fields = film, state, geometry, fields
        self.forces, self.rim, self.lists, self.response, self.drag = forces, rim, lists, response, drag
        self.explicit = film.features.explicit
        self.midpoint = film.numerics.scheme == "trapezoid" and not self.explicit
        self.theta = 0.5 if self.midpoint else 1.0
        self.theta_whole = 0.5 if self.midpoint or film.features.flow == "midpoint" else 1.0
        self._wave_speed = _shortest_wave_speed(film)
        n = film.n_e
        self.predicted = film.zeros(film.total, wp.vec3)
        self.force, self.external, self.u_mid = film.zeros(n), film.zeros(n), film.zeros(n)
        self.rigid, self.swelling = film.zeros(3, wp.vec3), film.zeros(1)
        self.start, self.frame, self.passed = (film.zeros(1, wp.vec3) for _ in range(3))
        self.found, self.kick = film.zeros(1, wp.vec3), film.zeros(2, wp.vec3)
        self.lifted = film.parts(wp.vec3)
        self.turning = film.zeros(n) if film.features.budget and film.features.lagrangian else None
        self.mean = film.parts(wp.vec2)
        self.moment, self.inertia = film.parts(wp.mat33), film.parts(wp.mat33)
        self.net, self.net_external = film.parts(wp.vec3), film.parts(wp.vec3)
        self.swept = film.parts(wp.vec3d)
        self.rigid_air = film.air.rigid(film.surroundings.air_density, film.radius) if film.features.air else 0.0
        self.blur = response.blur
        self._whole = wp.full(1, self.theta_whole, dtype=wp.float32, device=film.device)
        self.taken = wp.full(film.regions, self.rigid_air, dtype=wp.float32, device=film.device)
        self.whole = film.zeros(1) if drag is not None else None
        self.ahead, self._theta, self._recoil = (Setting(film.device) for _ in range(3))
        self.share = self.ahead.array if self.explicit else self._theta.array
        self.at_rest = self.frame

    def prepare(self, dt: float) -> None:
        """Set what depends on the step dt (s) to come."""
        film = self.film
        if self.midpoint:
            self.theta = max(0.5, 1.0 - 0.5 * MIDPOINT_CFL * film.spacing / (self._wave_speed * dt))
        self._theta.at(self.theta)
        if not self.explicit:
            self.ahead.at(self.theta * dt)
            self.response.prepare(2.0 * film.material.film_tension * (self.theta * dt) ** 2)
        w = 2.0 * film.stiffness / film.material.thickness * (dt / film.radius) ** 2
        self._recoil.at(w)

    def solve(self, dt: wp.array) -> None:
        """Advance the normal velocity of E by dt and set `u_mid`."""
        if self.film.features.floats:
            self._find_motion(self.found)
            copy(self.start, self.state.motion)
            e = self.state.e
            self.film.launch_e(ko.hold_motion_e, [e.normal, e.region, self.found, self.state.motion], [e.u])
        self._load(self.ahead.array, dt)
        change, unit = self.response.solve()
        if self.film.features.closed:
            self._close_gas(change, unit, dt)
            self.film.launch_one(ko.push_motion, [self.rigid, dt], [self.state.motion])
        self.film.launch_e(
            km.apply_membrane_e,
            [self.state.e.normal, change, unit, self.state.gas, self.rigid, self._theta.array, self.theta_whole, dt],
            [self.state.e.u, self.u_mid],
        )

    @property
    def solvers(self) -> tuple[Solver, ...]:
        """What the normal motion is solved with."""
        return self.response.solvers

    def longest_step(self, speed: float) -> float:
        """Longest step that it is good for where E have a `speed` (m/s), s: any, or what its user takes."""
        return np.inf

    def check(self) -> None:
        """There is nothing to run out of."""

    def report(self) -> dict:
        """There is nothing to say that is not said of any film."""
        return {}

    def wave_speed(self, mass: float) -> float:
        """Speed of waves across the explicit film where it has the mass per area `mass` (kg/m^2), m/s."""
        return float(np.sqrt(2.0 * self.film.material.tension / (mass + self.response.lumped)))

    def start_motion(self) -> None:
        """Take the translation of the film at the start of a run from its velocity."""
        if self.film.features.floats:
            self._find_motion(self.state.motion)

    def _find_motion(self, motion: wp.array) -> None:
        film, e = self.film, self.state.e
        film.launch_parts(
            ko.momentum_chunks,
            [e.normal, e.mass, self.geometry.area, e.u, self.taken, film.first],
            [self.inertia, self.net],
        )
        film.launch_regions(ko.solve_motion_r, [self.inertia, self.net], [motion])

    def _load(self, ahead: wp.array, dt: wp.array) -> None:
        film, e, m = self.film, self.state.e, self.film.material
        self._predict(ahead)
        kappa = self.geometry.curvature(self.predicted)
        film.launch_e(
            km.film_force_e,
            [
                kappa,
                self.fields.gamma,
                e.normal,
                e.mass,
                self.geometry.area,
                self.state.gas,
                *(e.u, self.start, self.swelling, ahead),
                m.tension,
                film.slope,
                self.forces.body,
            ],
            [self.force, self.external],
        )
        if film.features.lagrangian:
            film.launch_e(
                km.add_turning_e,
                [
                    *(e.normal, e.mass, self.geometry.area, e.u, self.start),
                    *(self.lists.ee.rows, self.geometry.gradient),
                ],
                [self.external, self.turning],
            )
        inertia = self.forces.inertia
        if film.features.floats:
            sums = [self.moment, self.inertia, self.net, self.net_external, self.lifted]
            film.launch_parts(
                ko.net_force_chunks,
                [
                    *(self.force, self.external, e.normal, e.mass, inertia, self.geometry.area),
                    *(self.forces.gravity, film.surroundings.lift, self.rigid_air, film.n_e),
                ],
                sums,
            )
            film.launch_one(ko.rigid_motion, sums, [self.rigid])
        film.launch_e(
            km.free_force_e,
            [e.normal, inertia, self.geometry.area, self.rigid, self.rigid_air],
            [self.force, self.external],
        )
        film.launch_e(
            km.load_membrane_e,
            [
                *(self.force, self.external, inertia, self.geometry.area, self.geometry.weight, self.lists.ee.rows),
                *(film.n_e, self.blur, dt),
            ],
            [self.response.load.b, self.response.unit.b, self.response.diag],
        )

    def _predict(self, ahead: wp.array) -> None:
        film, e = self.film, self.state.e
        if film.features.closed:
            film.launch_parts(ko.mean_speed_chunks, [e.normal, self.geometry.area, e.u, film.n_e], [self.mean])
            film.launch_one(ko.mean_speed, [self.mean], [self.swelling])
        if self.rim is not None:
            self.rim.mirror_velocity()
        launch(
            km.predict_position_e,
            film.total,
            [e.x, e.u, e.normal, self.start, self.swelling, ahead],
            [self.predicted],
            self.film.device,
        )

    def _close_gas(self, change: wp.array, unit: wp.array, dt: wp.array) -> None:
        film, e = self.film, self.state.e
        film.launch_parts(
            kg.swept_chunks,
            [
                e.u,
                e.normal,
                self.geometry.area,
                self.geometry.kappa,
                change,
                unit,
                self.start,
                self._theta.array,
                dt,
                film.n_e,
            ],
            [self.swept],
        )
        film.launch_one(kg.close_gas, [self.swept, film.surroundings.pressure], [self.state.gas])

    def recoil(self, traction: wp.array, theta: wp.array, dt: wp.array) -> None:
        """Move a closed film as a whole against the sum of the tangential forces of its tension.

        The velocity of E is taken for that after the share theta [1] of the step.
        """
        film, e = self.film, self.state.e
        film.launch_parts(ko.traction_chunks, [traction, self.geometry.area, film.n_e], [self.net])
        film.launch_one(
            ko.recoil,
            [self.moment, self.inertia, self.net, self.rigid_air, self._recoil.array, theta, dt],
            [self.kick, self.state.motion],
        )
        film.launch_e(ko.apply_recoil_e, [e.normal, self.kick, theta, self._whole], [e.u, self.u_mid])

    def slow_down(self, theta: wp.array, dt: wp.array) -> None:
        """Let the air's drag hold back a closed film as a whole, once all else that moves it is known.

        The velocity of E is taken for that after the share theta [1] of the step.
        """
        if self.drag is None:
            return
        film, e = self.film, self.state.e
        film.launch_regions(kd.find_inertia_r, [self.inertia], [self.whole])
        self.drag.find(self.start, self.whole, None, dt)
        film.launch_e(ko.push_whole_e, [e.normal, e.region, self.drag.kick, theta], [e.u])
        film.launch_e(ko.push_whole_speed_e, [e.normal, self.drag.kick, self._whole], [self.u_mid])

    def find_frame(self) -> None:
        """Set `frame`, once all that moves the film as a whole in this step is known."""
        self.film.launch_regions(ko.blend_motion, [self.start, self.state.motion, self._whole], [self.frame])

    def find_motion_at(self, theta: wp.array) -> None:
        """Set `passed` to the velocity of the film as a whole after the share theta [1] of the step."""
        self.film.launch_regions(ko.blend_motion, [self.start, self.state.motion, theta], [self.passed])

    def recall(self) -> None:
        """After the move: E are where they have moved to."""

    def keep_speed(self) -> None:
        """After the move, once normals are found anew: air does not take part in the flow along the film."""
        if self.film.features.air_waves and self.film.features.lagrangian:
            e = self.state.e
            self.film.launch_e(ko.keep_speed_e, [self.state.memory.facing, e.normal, self.state.motion], [e.u])

    def close_volume(self) -> None:
        """After the move: offset E so that volume and pressure obey the gas law, if there is gas."""
        if self.film.features.closed:
            close_volume(self.film, self.state)


def close_volume(film: Film, state: State) -> None:
    """Offset the E of each region along their normals so that its volume and its pressure obey the gas law."""
    gas = state.gas
    film.launch_regions(kg.find_offset_r, [film.surroundings.pressure, OFFSET_LIMIT * film.spacing], [gas])
    film.launch_e(kg.offset_surface_e, [state.e.normal, state.e.region, gas], [state.e.x])
