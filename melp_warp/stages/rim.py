"""Boundary particles on the host: the velocity and the shape of the film continued beyond its rim."""

from __future__ import annotations

import warp as wp

from melp_warp.device.launch import clear, launch
from melp_warp.device.linear import ConjugateGradient
from melp_warp.kernels import boundary as kb
from melp_warp.stages.film import Film
from melp_warp.stages.forces import Forces
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.state import State


class Rim:
    """The pinned rim of an open film. Made only for films that have one.

    With L it takes momentum from the flow along the film, and collects liquid that nothing holds off it: summed up
    particle by particle, and added to `State.border` by `settle`.

    Attributes:
        impulse_e, impulse_l: [n_e], [n_l] momentum taken since the last `settle`, kg m/s; None without L.
        collected: [n_l] mass and surfactant taken, kg, mol.
        energy: [n_l] energy taken since then, of motion, and of height and surfactant, J; None without a budget.
    """

    needs = ("lists", "geometry", "forces")
    kernels = ("boundary",)

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, forces: Forces):
        self.film, self.state, self.lists, self.geometry, self._gravity = film, state, lists, geometry, forces.gravity
        self.impulse_e, self.impulse_l, self.collected, self.energy = None, None, None, None
        if film.features.collects:
            self.impulse_e, self.impulse_l = film.zeros(film.n_e, wp.vec3), film.zeros(film.n_l, wp.vec3)
            self.collected = film.zeros(film.n_l, wp.vec2)
            self.energy = film.zeros(film.n_l, wp.vec2) if film.features.budget else None
            self._part = film.parts(kb.vec7d)

    def mirror_velocity(self) -> None:
        """Give boundary particles the velocity of their mirror points: no motion of the rim, free slip along it."""
        self.mirror(self.state.e.u)

    def mirror(self, field: wp.array) -> None:
        """The same for any vector field [n] of the film."""
        film, e, rim = self.film, self.state.e, self.film.rim
        launch(
            kb.mirror_velocity_b,
            film.n_b,
            [self.state.b.mirror, rim.outward, e.normal, e.x, self.lists.be.rows, self.lists.mirror_reach, film.n_e],
            [field],
            film.device,
        )

    def confine(self) -> None:
        """Keep L inside the rim, which takes what drives them out."""
        film, lag, rim, m = self.film, self.state.l, self.film.rim, self.film.material
        film.launch_l(
            kb.confine_l,
            [
                *(rim.anchors, rim.outward, self.lists.le.rows, film.n_e),
                *(self._gravity, film.height, 2.0 * m.rt / film.spacing),
                *(lag.eta, m.density / m.surfactant if m.surfactant > 0.0 else 0.0, m.rt),
            ],
            [lag.x, lag.u, lag.v, lag.mass, lag.surfactant, self.collected, self.impulse_l, self.energy],
        )

    def take_pull(self, traction: wp.array, dt: wp.array) -> None:
        """Count the tension of a step of dt [1] s: `traction` [n_e] drives the liquid, Pa, and pulls at the rim."""
        inputs = [traction, self.state.e.mass, self.geometry.area, dt]
        self.film.launch_e(kb.take_pull_e, inputs, [self.impulse_e])

    def take_friction(self, friction: wp.array, theta: wp.array) -> None:
        """Count the friction [n_e] of walls over the share theta [1] of a step, kg m/s."""
        self.film.launch_e(kb.take_friction_e, [friction, theta], [self.impulse_e])

    def taken(self, part: wp.array) -> None:
        """Put what was taken since the last `settle` into the parts of `kernels.boundary.taken_chunks`."""
        self.film.launch_parts(kb.taken_chunks, [self.collected, self.impulse_l, self.impulse_e, self.energy], [part])

    def settle(self) -> None:
        """Add what was taken since the last time to the state, if there are L. Between steps."""
        film = self.film
        if self.collected is None:
            return
        self.taken(self._part)
        film.launch_one(kb.add_taken, [self._part], [self.state.border])
        for array in (self.collected, self.impulse_l, self.impulse_e, self.energy):
            if array is not None:
                clear(array)

    def extend(self) -> None:
        """Let the boundary particles follow a moving film; the fits are moved with their particles and a step old."""
        film, e, rim = self.film, self.state.e, self.film.rim
        launch(
            kb.extend_film_b,
            film.n_b,
            [
                *(rim.anchors, rim.curvature, e.x, self.geometry.surface),
                *(self.lists.be.rows, self.lists.mirror_reach, film.n_e),
            ],
            [self.state.b.mirror, e.x, e.normal],
            film.device,
        )


class RimmedViscosity(ConjugateGradient):
    """Conjugate gradients for the viscosity of a film with a rim: E are coupled with the images of E beyond it, too.

    The images move as the boundary particles do (`Rim.mirror_velocity`), but are part of the matrix: it stays symmetric
    and the solve implicit.
    """

    def __init__(self, film: Film, state: State, geometry: Geometry, operator):
        numerics = film.numerics
        super().__init__(operator, film.total, wp.vec3, numerics.tolerance, numerics.max_iterations, of_change=True)
        self.film, self.state, self.geometry = film, state, geometry
        self.walls = wp.zeros((film.n_e, 2), dtype=wp.vec4, device=film.device)
        self._dt = film.zeros(1)

    def friction(self) -> wp.array:
        """Momentum that the walls have taken in the last solve, by E. [n_e], kg m/s."""
        clear(self.q)
        self._couple(kb.rub_walls_e, self.x, [], [self.q])
        return self.q

    def prepare(self, dt: wp.array) -> None:
        """Find the walls for a solve over dt [1], s."""
        film, rim, self._dt = self.film, self.film.rim, dt
        film.launch_e(
            kb.find_walls_e,
            [self.state.e.x, rim.anchors, rim.outward, self.operator.rows, film.n_e],
            [self.walls],
        )

    def _couple(self, kernel, u: wp.array, inputs: list, outputs: list) -> None:
        film, e = self.film, self.state.e
        film.launch_e(
            kernel,
            [
                *(u, e.x, e.mass, self.geometry.area, self.walls, self.operator.rows, film.r, film.n_e),
                *(film.material.viscosity, self._dt, *inputs),
            ],
            outputs,
        )

    def _start(self):
        self._couple(kb.start_walls_e, self.x, [self.inverse], [self.r, self.z, self.p])

    def _apply(self):
        super()._apply()
        self._couple(kb.rub_walls_e, self.p, [], [self.q])
