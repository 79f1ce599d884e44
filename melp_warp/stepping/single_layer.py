"""One layer in place of two: particles that carry the film and move with it, by explicit SPH (docs/single-layer.md).

The rival that MELP 2022 compares itself with in section 6.2, after Wang et al. 2021.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import warp as wp

from melp_warp.device.launch import copy, launch
from melp_warp.kernels import single_layer as ks
from melp_warp.stages.film import Film
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Fields
from melp_warp.stepping.stepper import NoFilm, Stepper

VISCOUS_REACH = 0.2
"""nu dt/dx^2 up to which explicit viscosity is stable, at a CFL number of 1."""


class SummedFields(Fields):
    """Thickness and relative surfactant concentration as sums over the particles.

    Attributes:
        eta: [n_e] m.
        gamma: [n_e] Gamma/Gamma_0.
        own: [n_e] area of each particle, V/eta, m^2.
        beyond: [n_b] gamma of boundary particles.
        near: [pairs] W of each pair, 1/m^2.
    """

    def __init__(self, film: Film, state: State, lists: NeighborLists, area: wp.array):
        self.film, self.state, self.lists = film, state, lists
        self.eta, self.gamma = film.zeros(film.n_e), film.zeros(film.n_e)
        self.own = film.zeros(film.n_e) if film.features.moving else area
        self.beyond = film.zeros(film.n_b)
        self.rim_area = film.spacing**2
        self.near = film.zeros(lists.ee.rows.index.shape[0])

    def update(self) -> None:
        """Find them at the present positions."""
        film, e, m = self.film, self.state.e, self.film.material
        film.launch_e(
            ks.sum_film_e,
            [
                *(e.x, e.mass, e.surfactant, self.lists.ee.rows, film.r, film.n_e),
                *(self.rim_area, m.density, m.surfactant),
            ],
            [self.near, self.eta, self.gamma, self.own],
        )
        if film.features.rim:
            launch(
                ks.mirror_concentration_b,
                film.n_b,
                [self.state.b.mirror, e.x, self.gamma, self.lists.be.rows, self.lists.mirror_reach, film.n_e],
                [self.beyond],
                film.device,
            )


class SingleLayer(Stepper):
    """The step of a single layer: sums, explicit forces, symplectic Euler. E are all particles there are."""

    def __init__(self, film: Film, state: State):
        super().__init__(film, state)
        self.redistribution = None
        self.wind = state.motion if film.features.dragged else None
        self.traction = film.zeros(film.n_e, wp.vec3) if film.features.recoils else None
        self._still, self._at_rest = film.zeros(film.n_e), film.zeros(1, wp.vec3)
        self._pushed = film.zeros(film.n_e, wp.vec3)
        self._x_old = wp.clone(state.e.x)
        self._own_cells()

    def _make_fields(self) -> SummedFields:
        return SummedFields(self.film, self.state, self.lists, self.geometry.area)

    def _table(self) -> dict[str, Callable[[], None]]:
        """The stages of a step in their order."""
        table = {"surfactant": self._push, "membrane": None, "advance_e": self._advance_e}
        if self.film.features.moving:
            table |= {"membrane": self._solve_normal, "geometry": self._find_geometry}
        return {name: run for name, run in table.items() if run is not None}

    def _push(self) -> None:
        self.lists.note_late(0)
        self.fields.update()
        self.forces.update()
        self._accelerate()
        self._guard_e("surfactant")

    def _accelerate(self) -> None:
        film, e, rows, fields, m = self.film, self.state.e, self.lists.ee.rows, self.fields, self.film.material
        symmetric = int(film.numerics.gradient == "symmetric")
        film.launch_e(
            ks.push_e,
            [
                *(e.x, e.u, e.normal, e.surfactant, fields.eta, fields.gamma, fields.beyond, fields.own),
                *(self.forces.body, self.forces.hold, rows, film.r, film.n_e, fields.rim_area),
                *(m.density, m.surfactant, film.stiffness, symmetric, m.viscosity, film.surroundings.drag),
                *(e.region, self.wind, self.dt.array),
            ],
            [self._pushed, self.traction],
        )
        film.launch_e(
            ks.smooth_velocity_e,
            [e.normal, fields.eta, fields.own, self._pushed, fields.near, rows, film.n_e, film.numerics.xsph],
            [e.u],
        )

    def _own_cells(self) -> None:
        """Let each particle control its own cell: nothing is transferred that would spread it over its neighbours."""
        copy(self.geometry.area, self.geometry.cell)

    def _find_geometry(self) -> None:
        super()._find_geometry()
        self._own_cells()

    def _solve_normal(self) -> None:
        self.membrane.start_motion()  # the particles' own momentum says how the film moves as a whole
        self.membrane.solve(self.dt.array)
        if self.film.features.recoils:
            self.membrane.recoil(self.traction, self._all, self.dt.array)
        self._slow_down(self._all)
        self._guard_e("membrane")

    def _advance_e(self) -> None:
        film, e, rows, dt = self.film, self.state.e, self.lists.ee.rows, self.dt.array
        speed = self.membrane.u_mid if film.features.moving else self._still
        copy(self._x_old, e.x)
        film.launch_e(ks.move_e, [e.normal, speed, e.u, dt], [e.x])
        if film.features.rim:
            film.launch_e(ks.confine_e, [film.rim.anchors, film.rim.outward, rows, film.n_e], [e.x, e.u])
        if film.features.moving:
            self.membrane.find_frame()
            if film.features.rim:
                self.rim.extend()
        self.lists.record_e(self._x_old, self.at_rest, dt)
        self._guard_e("advance_e")

    @property
    def wave_speed(self) -> float:
        """Fastest wave when first asked: sqrt(2 R T c/m) along the film, sqrt(2 sigma/m) across, m/s (reads back)."""
        course = self.state.course
        if course.layer_speed is None:
            course.layer_speed = self._find_wave_speed()
        return course.layer_speed

    def _find_wave_speed(self) -> float:
        film, e, m = self.film, self.state.e, self.film.material
        speed = math.sqrt(2.0 * m.rt * float((e.surfactant.numpy() / e.mass.numpy()).max()))
        if not film.features.moving:
            return speed
        self.fields.update()
        return max(speed, self.membrane.wave_speed(m.density * float(self.fields.eta.numpy().min())))

    def longest_step(self, speed: float) -> float:
        """Step in which waves and particles of `speed` (m/s) run `cfl` spacings, s."""
        film = self.film
        wave = film.spacing / max(self.wave_speed + speed, 1e-9)
        viscous = VISCOUS_REACH * film.spacing**2 / max(film.material.viscosity, 1e-30)
        return film.numerics.cfl * min(wave, viscous)


def make_stepper(film: Film, state: State) -> Stepper | NoFilm:
    """The step that the scene's numerics ask for; none where no region is left."""
    if film.regions == 0:
        return NoFilm(film, state)
    return SingleLayer(film, state) if film.features.single else Stepper(film, state)
