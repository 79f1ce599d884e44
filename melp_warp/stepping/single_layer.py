"""One layer in place of two: particles that carry the film and move with it, by explicit SPH (docs/single-layer.md).

The rival that MELP 2022 compares itself with in section 6.2, after Wang et al. 2021. E are all particles there are.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from melp_warp.device.launch import copy, launch
from melp_warp.kernels import single_layer as ks
from melp_warp.stage import Stage
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.notices import Notices
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Fields
from melp_warp.stepping.carriers import Carrier
from melp_warp.stepping.step import FindGeometry, FindNeighbors, SolveNormal

VISCOUS_REACH = 0.2
"""nu dt/dx^2 up to which explicit viscosity is stable, at a CFL number of 1."""

SUM_STEPS = 4


class SummedFields(Fields):
    """Thickness and relative surfactant concentration as sums over the particles.

    Attributes:
        eta: [n_e] m.
        gamma: [n_e] Gamma/Gamma_0.
        own: [n_e] area of each particle, V/eta, m^2.
        beyond: [n_b] gamma of boundary particles.
        near: [pairs] W of each pair, 1/m^2.
    """

    needs = ("lists", "geometry")
    kernels = ("single_layer", "surfactant")

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists = film, state, lists
        self.eta, self.gamma = film.zeros(film.n_e), film.zeros(film.n_e)
        self.own = film.zeros(film.n_e) if film.features.moving else geometry.area
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


class Push(Stage):
    """Uneven tension, viscosity, drag and outside forces along the film, by sums and explicitly."""

    name = "surfactant"
    velocity = "along the film at the end of the step, across it at its start"
    writes = ("e.u",)
    kernels = ("single_layer",)

    def prepare(self, dt: float) -> None:
        """Set gravity and the numbers of forces."""
        self.stepper.forces.prepare(dt)

    def run(self) -> None:
        """Sum up the film and push it."""
        s = self.stepper
        s.lists.note_late(0)
        s.fields.update()
        s.forces.update()
        self._accelerate()

    def _accelerate(self) -> None:
        s, film, e = self.stepper, self.film, self.state.e
        rows, fields, m, own = s.lists.ee.rows, s.fields, self.film.material, s.carrier
        symmetric = int(film.numerics.gradient == "symmetric")
        film.launch_e(
            ks.push_e,
            [
                *(e.x, e.u, e.normal, e.surfactant, fields.eta, fields.gamma, fields.beyond, fields.own),
                *(s.forces.body, s.forces.hold, rows, film.r, film.n_e, fields.rim_area),
                *(m.density, m.surfactant, film.stiffness, symmetric, m.viscosity, film.surroundings.drag),
                *(e.region, own.wind, s.dt.array),
            ],
            [own.pushed, own.traction],
        )
        film.launch_e(
            ks.smooth_velocity_e,
            [e.normal, fields.eta, fields.own, own.pushed, fields.near, rows, film.n_e, film.numerics.xsph],
            [e.u],
        )

    def remark(self, notices: Notices) -> None:
        """Note where no tension is left."""
        self.stepper.fields.remark(notices)


class PushNormal(SolveNormal):
    """The same membrane, taken explicitly: the particles' own momentum says how the film moves as a whole."""

    velocity = "at the end of the step"

    def run(self) -> None:
        """Push, and let the film as a whole recoil and be held back."""
        s, dt = self.stepper, self.stepper.dt.array
        s.membrane.start_motion()
        s.membrane.solve(dt)
        if self.film.features.recoils:
            s.membrane.recoil(s.carrier.traction, s.all, dt)
        s.membrane.slow_down(s.all, dt)


class MoveE(Stage):
    """Particles move with their whole velocity, inside the rim."""

    name = "advance_e"
    velocity = "the same; particles have moved"
    writes = ("e.x", "e.u")
    kernels = ("single_layer",)

    def run(self) -> None:
        """Move them."""
        s, film, e, rows, dt = self.stepper, self.film, self.state.e, self.stepper.lists.ee.rows, self.stepper.dt.array
        own = s.carrier
        speed = s.membrane.u_mid if film.features.moving else own.still
        copy(own.x_old, e.x)
        film.launch_e(ks.move_e, [e.normal, speed, e.u, dt], [e.x])
        if film.features.rim:
            film.launch_e(ks.confine_e, [film.rim.anchors, film.rim.outward, rows, film.n_e], [e.x, e.u])
        if film.features.moving:
            s.membrane.find_frame()
            if film.features.rim:
                s.rim.extend()
        s.lists.record_e(own.x_old, s.at_rest, dt)


class FindCells(FindGeometry):
    """Normals, fits, curvatures, cells and volume, of particles each of which has a cell of its own."""

    def run(self) -> None:
        """Find them."""
        super().run()
        self.stepper.carrier.begin()


class SingleLayer(Carrier):
    """Sums, explicit forces, symplectic Euler; E carry the film along.

    Attributes:
        wind: [regions] velocity of the air along the film, m/s; None for air at rest.
        traction: [n_e] tangential force of uneven tension, Pa; None where the film does not recoil.
        pushed: [n_e] velocity before it is smoothed, m/s.
    """

    stages = (FindNeighbors, Push, PushNormal, MoveE, FindCells)
    fields = SummedFields
    room = 2.0  # where a film gets thicker, its particles get denser

    def __init__(self, stepper):
        super().__init__(stepper)
        film, state = self.film, self.state
        self.wind = state.motion if film.features.dragged else None
        self.traction = film.zeros(film.n_e, wp.vec3) if film.features.recoils else None
        self.still, self.pushed = film.zeros(film.n_e), film.zeros(film.n_e, wp.vec3)
        self.x_old = wp.clone(state.e.x)

    def begin(self) -> None:
        """Let each particle control its own cell: nothing is transferred that would spread it over its neighbours."""
        copy(self.stepper.geometry.area, self.stepper.geometry.cell)

    def share_area(self) -> None:
        """Give the particles such areas that an even film is summed to an even one."""
        film, e, geometry, fields = self.film, self.state.e, self.stepper.geometry, self.stepper.fields
        cells = geometry.cell.numpy().astype(np.float64)
        area = cells.copy()
        for _ in range(SUM_STEPS):
            e.mass.assign(film.material.areal_mass * area)
            fields.update()
            area *= film.material.thickness / fields.eta.numpy()
        geometry.area.assign(area * cells.sum() / area.sum())

    def start_flow(self, scene, u) -> None:
        """E have it."""

    def velocity_of_e(self) -> np.ndarray:
        """[n_e, 3] m/s: that of the liquid, which they are."""
        return self.state.e.u.numpy()[: self.film.n_e]

    @property
    def wave_speed(self) -> float:
        """Fastest wave when first asked: sqrt(2 R T c/m) along the film, sqrt(2 sigma/m) across, m/s (reads back)."""
        course = self.state.course
        if course.layer_speed is None:
            course.layer_speed = self._find_wave_speed()
        return course.layer_speed

    def _find_wave_speed(self) -> float:
        film, e, m, s = self.film, self.state.e, self.film.material, self.stepper
        speed = math.sqrt(2.0 * m.rt * float((e.surfactant.numpy() / e.mass.numpy()).max()))
        if not film.features.moving:
            return speed
        s.fields.update()
        return max(speed, s.membrane.wave_speed(m.density * float(s.fields.eta.numpy().min())))

    def longest_step(self, speed: float) -> float:
        """Step in which waves and particles of `speed` (m/s) run `cfl` spacings, s."""
        film = self.film
        wave = film.spacing / max(self.wave_speed + speed, 1e-9)
        viscous = VISCOUS_REACH * film.spacing**2 / max(film.material.viscosity, 1e-30)
        return film.numerics.cfl * min(wave, viscous)
