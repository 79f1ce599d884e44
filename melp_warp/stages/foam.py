"""Foams on the host: what regions touch (section 5.2), contact (5.3), shared tension (5.4) and gas, implicit.

Each region's surface is a sheet of tension 2 sigma, a film of its own. Two sheets that face each other cling, as one
film saves 2 sigma against two: they become a partition, and where they part the angles are Plateau's. Every force has
its opposite. See docs/foams.md.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from melp_warp.device.launch import Shared, copy
from melp_warp.device.linear import GasConjugateGradient, LinearOperator
from melp_warp.device.scalars import Setting
from melp_warp.kernels import contact as kc
from melp_warp.kernels import exchange as kx
from melp_warp.kernels import foam as kf
from melp_warp.kernels import line_forces as kl
from melp_warp.kernels import motion as ko
from melp_warp.kernels import regions as kr
from melp_warp.kernels.native import CORNERS
from melp_warp.stages.drag import AirDrag
from melp_warp.stages.film import CONTACT_REACH, Film
from melp_warp.stages.foam_surface import FoamGeometry, FoamLists
from melp_warp.stages.forces import Forces
from melp_warp.stages.membrane import close_volume
from melp_warp.stages.neighbors import check_room, fixed_rows
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Fields

CONTACT_ROOM = 70
"""Room for the E that one E presses on, besides its star, over `Film.room`."""

PARTNER_REACH = 1.2
"""Distance within which an E facing another shares its film, in spacings."""

BENT, CAP = 0.012, 3.0
"""Least mean square turn of normals within the support that counts as a bend, and in those of the region's sphere."""

LEAST_REACH, REACH_SHARE = 2.25, 0.43
"""Distance within which normals take up force along bent sheets: this share of the smallest bubble's radius, at least
so many spacings and at most the support, which it is where there are walls."""

PATIENCE = 1.0
"""Time in which force along bent sheets is passed on, in that of a wave across a spacing."""

MOST = 4.0
"""Most force that an E takes over from its neighbours, in sigma times the spacing."""

LEASH = 0.8
"""Largest distance of an E from the mean of its neighbours, spacings."""

JOINS = 4
"""Pairs of sweeps in which clusters are found; each may double the number of bubbles in a row that they reach."""


def make_contact(film: Film) -> kc.Contact:
    """The constants of `kernels.contact.Contact` for a film's spacing and tension; `lag` is set when the run starts."""
    n, dx, walls = film.numerics, film.spacing, film.walls
    contact = kc.Contact()
    for name, values in (("point", [w.point for w in walls]), ("inward", [w.normal for w in walls])):
        array = np.array(values, dtype=np.float64).reshape(-1, 3)
        setattr(contact, name, wp.array(array, dtype=wp.vec3, device=film.device))
    contact.reach, contact.give, contact.range = CONTACT_REACH * dx, 0.25 * dx, n.border * dx
    contact.cling = 2.0 * film.material.film_tension
    return contact


class FoamMembrane:
    """Normal dynamics of touching regions, backward Euler. Takes the place of `Membrane`.

    Attributes:
        cover: [n_e] 0 on a film of its own, 1 where the sheet is one film with another region's or a wall's.
        u_mid: [n_e] normal speed that moves E in this step, m/s.
        start: [regions] velocity of each region as a whole at the start of the step, m/s.
        frame: that in the step; that of its end is `State.motion`.
        passed: that after the share of the step that `find_motion_at` was asked for.
        wanted: [n_e] length that each row of the matrix has needed at most.
        added: [regions] mass of the air that moves along, kg/m^2.
        whole: [regions] inertia of each region as a whole, kg.
        bent: [regions] turn of normals that counts as a bend.
        at_rest: [regions] what lists move along with: those between regions move along with none.
        rigid, turning: None; a single film has them.
    """

    needs = ("lists", "geometry", "fields", "forces", "drag")
    kernels = ("foam", "contact", "line_forces", "regions", "exchange", "motion", "gas", "linear")
    rigid = turning = None

    def __init__(
        self,
        film: Film,
        state: State,
        lists: FoamLists,
        geometry: FoamGeometry,
        fields: Fields,
        forces: Forces,
        drag: AirDrag | None,
    ):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry
        self.fields, self.forces = fields, forces
        n = film.n_e
        self.contact = make_contact(film)
        memory = state.memory
        self.cover, self._faced, self.free = memory.cover, film.zeros(n), film.zeros(n)
        self.predicted, self.force, self._rest, self.foot = (film.zeros(n, wp.vec3) for _ in range(4))
        self._braked = film.zeros(n, wp.vec2)
        self.u_mid, self.load, self._mass, self._outer = (film.zeros(n) for _ in range(4))
        self.start, self.frame, self.passed = (film.zeros(film.regions, wp.vec3) for _ in range(3))
        self.at_rest = film.zeros(film.regions, wp.vec3)
        self.drag = drag
        self.push, self.ahead = film.zeros(film.regions), film.zeros(film.regions)
        self.bent, self.reach = film.zeros(film.regions), film.r
        self.added, self._bare = film.zeros(film.regions), film.zeros(film.regions)
        self.taken = self.added
        self.whole = film.zeros(film.regions)
        self._fall, self.missing, self.recoil, self.found = (film.zeros(film.regions, wp.vec3) for _ in range(4))
        self._balance, self.drift, self._pull = (film.zeros(film.regions, wp.vec3) for _ in range(3))
        self._held, self.weight = film.zeros(film.regions), film.parts(wp.vec4)
        self._sought, self._owed, self._spin = memory.sought, memory.owed, memory.spin
        self._hung = film.parts() if film.forces else None
        self._place = film.zeros(film.regions, wp.vec3)
        self._alone = wp.array(np.arange(film.regions, dtype=np.int32), device=film.device)
        self._cluster, self._joined = (film.zeros(film.regions, wp.int32) for _ in range(2))
        self._stride = CORNERS + int(CONTACT_ROOM * film.room)
        rows = fixed_rows(n, self._stride, film.device)
        numerics = film.numerics
        self.response = GasConjugateGradient(
            LinearOperator(n, rows, film.device),
            numerics.tolerance,
            numerics.max_iterations,
            state.e.region,
            film.first,
            film.parts().shape[0],
        )
        self.wanted = film.zeros(n, wp.int32)
        self._inertia, self._solid = film.parts(wp.mat33), film.parts(wp.mat33)
        self._momentum, self._turned, self._touch = film.parts(wp.vec3), film.parts(wp.vec3), film.parts(wp.int32)
        self._gained, self._middle = film.parts(wp.vec4), film.parts(wp.vec4)
        self._swept = film.parts(wp.float64)
        self._near = wp.zeros((self._touch.shape[0], film.regions), dtype=wp.int32, device=film.device)
        self._crossing = 0.0
        self._share, self._paid = Setting(film.device), Setting(film.device)
        self._find_sizes()

    def start_motion(self) -> None:
        """Take the air's mass from the volumes and the translations from the velocities, at the start of a run."""
        self.state.memory.volume.assign(self.state.gas.numpy()[:, 0])
        self._find_sizes()
        self._find_motion(self.state.motion)

    def _find_sizes(self) -> None:
        """Set what follows from the volumes that the regions had when they were set up."""
        film = self.film
        volume = np.maximum(self.state.memory.volume.numpy(), 0.0)
        radius = np.maximum(np.cbrt(3.0 * volume / (4.0 * np.pi)), 1e-3 * film.spacing)
        # a point at distance d has a normal turned by d/R; K's variance along an axis is 0.054 r^2
        if not film.walls:  # the corner along a wall takes up force within the whole support
            self.reach = min(max(LEAST_REACH * film.spacing, REACH_SHARE * float(radius.min())), film.r)
        self.bent.assign(np.maximum(BENT, CAP * 0.054 * (self.reach / radius) ** 2))
        if film.features.air:
            self.added.assign(film.air.film(film.surroundings.air_density, radius))
        inertia = film.material.areal_mass + float(self.added.numpy().mean())
        self.contact.lag = film.spacing * math.sqrt(inertia / self.contact.cling)
        lightest = film.material.areal_mass + float(self.added.numpy().min())
        self._crossing = film.spacing * math.sqrt(lightest / self.contact.cling)

    @property
    def solvers(self) -> tuple[GasConjugateGradient, ...]:
        """What the normal motion is solved with."""
        return (self.response,)

    def longest_step(self, speed: float) -> float:
        """Step in which sheets that move at `speed` (m/s) are still followed, s.

        Once the time in which a wave crosses a spacing of the lightest bubble where sheets move at a tenth of that
        wave, twice at rest: in longer steps sheets that meet gain energy.
        """
        moving = min(10.0 * speed * self._crossing / self.film.spacing, 1.0)
        return (2.0 - moving) * self._crossing

    def prepare(self, dt: float) -> None:
        """Set the share of what is passed on late that is passed on in a step of dt (s); all of it in the first."""
        course = self.state.course
        self._paid.at(course.paid)
        course.paid = 1.0 if course.fresh else -math.expm1(-dt / (PATIENCE * self.contact.lag))
        self._share.at(course.paid)
        course.fresh = False

    def find_contacts(self, x: wp.array) -> None:
        """What is covered by other regions and walls with E at x."""
        film, e = self.film, self.state.e
        film.launch_e(
            kc.find_cover_e,
            [x, e.normal, self.geometry.share, self.lists.eo.rows, self.lists.ee.rows, self.contact],
            [self.cover, self._faced, self.free],
        )

    def read_cover(self) -> np.ndarray:
        """[n_e] how far each E is covered (reads back: between steps)."""
        if self.state.course.fresh:  # no step has found it yet
            self.find_contacts(self.state.e.x)
        return self.cover.numpy()

    def nearest_regions(self) -> np.ndarray:
        """Other region nearest to each E, -1 for none within reach (reads back: between steps)."""
        film = self.film
        nearest = film.zeros(film.n_e, wp.int32)
        film.launch_e(kx.find_nearest_e, [self.state.e.x, self.lists.eo.rows], [nearest])
        return self._regions_of(nearest)

    def find_partners(self, kind: str) -> np.ndarray:
        """Region that the film of each E ("e") or L ("l") is shared with, -1 for none (reads back: between steps)."""
        film, e, lists, reach = self.film, self.state.e, self.lists, PARTNER_REACH * self.film.spacing
        partner = film.zeros(film.n_e if kind == "e" else film.n_l, wp.int32)
        if kind == "e":
            film.launch_e(kx.find_partner_e, [e.x, e.normal, lists.eo.rows, reach], [partner])
        else:
            across = [*map(Shared, (e.x, e.normal, lists.eo.rows)), reach]
            film.launch_l(kx.find_partner_l, [self.state.l.x, lists.le.rows, *across], [partner])
        return self._regions_of(partner)

    def _regions_of(self, found: wp.array) -> np.ndarray:
        """Regions of the E numbered `found`, -1 where that is -1."""
        index = found.numpy()
        return np.where(index >= 0, self.state.e.region.numpy()[np.maximum(index, 0)], -1)

    def check(self) -> None:
        """Raise if an E pressed on more than there is room for (reads back)."""
        check_room(self.wanted, self._stride, "contact")

    def solve(self, dt: wp.array) -> None:
        """Advance the normal velocity of E by dt and set `u_mid`."""
        film, e = self.film, self.state.e
        copy(self.start, self.state.motion)
        self._find_motion(self.found)
        film.launch_e(ko.hold_motion_e, [e.normal, e.region, self.found, self.state.motion], [e.u])
        self._fall_freely(dt)
        self._find_clusters()
        film.launch_e(kf.predict_foam_e, [e.x, e.u, e.normal, e.region, self.state.motion, dt], [self.predicted])
        self.find_contacts(self.predicted)
        self._sweep()
        pressure = film.surroundings.pressure
        solver = self.response
        film.launch_regions(kf.predict_gas_r, [self._swept, pressure, dt], [self.state.gas, solver.stiff, self.ahead])
        self._assemble(dt)
        solver.solve()
        self._pay_debt()
        film.launch_e(kf.apply_foam_e, [e.normal, e.region, solver.x, self.recoil], [e.u])
        self._find_motion(self.state.motion)
        self._find_frame(dt)
        self._sweep()
        film.launch_regions(kf.store_gas_r, [self._swept, pressure, dt], [self.state.gas])

    def _find_frame(self, dt: wp.array) -> None:
        """Let the air hold back what moves, and say how E move in the step."""
        film, e, motion = self.film, self.state.e, self.state.motion
        kick = None
        if self.drag is not None:
            self.drag.find(self.start, self.whole, self._owed, dt)
            kick = self.drag.kick
            film.launch_e(ko.push_whole_e, [e.normal, e.region, kick, self.drag.all], [e.u])
        film.launch_regions(ko.frame_motion_r, [motion, self._pull, kick, dt], [self.frame])
        film.launch_e(kf.move_foam_e, [e.u, e.normal, e.region, motion, self.frame], [self.u_mid])

    def slow_down(self, theta: wp.array, dt: wp.array) -> None:
        """The air has held back each region in the solve."""

    def find_frame(self) -> None:
        """The solve has set `frame`."""

    def report(self) -> dict:
        """What the log says of the regions: their numbers, gas, how far they are covered and what they lost."""
        gas = self.state.gas.numpy()
        return {
            "regions": list(self.film.labels),
            "volumes": gas[:, 0].tolist(),
            "pressures": gas[:, 1].tolist(),
            "gas": gas[:, 2].tolist(),
            "covered": float(np.minimum(self.cover.numpy(), 1.0).mean()),
            "spilled": self.state.course.spilled,
        }

    def find_motion_at(self, theta: wp.array) -> None:
        """Set `passed` to the velocity of each region as a whole after the share theta [1] of the step."""
        self.film.launch_regions(ko.blend_motion, [self.start, self.state.motion, theta], [self.passed])

    def recall(self) -> None:
        """After the move: E stay in their sheets and inside the walls."""
        film, e, leash = self.film, self.state.e, LEASH * self.film.spacing
        inputs = [e.x, e.u, e.normal, self.lists.ee.rows, film.r, leash, self.contact]
        found = (self.predicted, self.force, self._rest)
        film.launch_e(kf.recall_e, inputs, [self.geometry.near, *found])
        for array, new in zip((e.x, e.u, e.normal), found, strict=True):
            copy(array, new, count=film.n_e)

    def keep_speed(self) -> None:
        """After the move: E have what is left of their velocity along normals that have turned."""

    def close_volume(self) -> None:
        """After the move: offset E so that volume and pressure obey the gas law."""
        close_volume(self.film, self.state)

    def _find_motion(self, motion: wp.array) -> None:
        film, e = self.film, self.state.e
        film.launch_parts(
            ko.momentum_chunks,
            [e.normal, e.mass, self.geometry.area, e.u, self.added, film.first],
            [self._inertia, self._momentum],
        )
        film.launch_regions(ko.solve_motion_r, [self._inertia, self._momentum], [motion])

    def _fall_freely(self, dt: wp.array) -> None:
        """What outside forces do to each region as a whole."""
        film, e = self.film, self.state.e
        inputs = [e.mass, self.forces.body, self.forces.inertia, film.first]
        film.launch_parts(ko.weight_chunks, inputs, [self.weight, self._hung])
        air = film.surroundings.air_density if film.features.air else 0.0
        film.launch_regions(
            ko.carry_motion_r,
            [self.weight, self._hung, self._inertia, self.state.gas, air],
            [self.whole, self.response.rigid, self._fall],
        )
        arrays = [e.normal, e.mass, self.geometry.area, self.forces.body, self._bare, film.first]
        film.launch_parts(ko.momentum_chunks, arrays, [self._solid, self._momentum])
        film.launch_regions(ko.solve_motion_r, [self._inertia, self._momentum], [self._balance])
        film.launch_e(ko.push_whole_e, [e.normal, e.region, self._fall, dt], [e.u])

    def _pay_debt(self) -> None:
        """Momentum and angular momentum that the foam gave itself in the solve, back to where they came from."""
        film, e, solver = self.film, self.state.e, self.response
        solver.find_moments(solver.x)
        of_e = [e.x, e.normal, self.geometry.area, self._faced, self._outer, self._mass, solver.carried, self._braked]
        arrays = [*of_e, solver.moments, solver.x, film.first]
        parts, debt = [self._gained, self._turned, self._middle], [self._owed, self._spin, self._place]
        film.launch_parts(kl.gained_chunks, arrays, parts)
        film.launch_regions(kl.owe_r, [*parts, self._paid.array], debt)
        wall = [self._touch, self.contact, self._share.array]
        film.launch_regions(kl.pay_debt_r, [*debt, self._cluster, self.whole, *wall], [self.recoil])

    def _find_clusters(self) -> None:
        """Number of each region's cluster: those near each other, those near them, and so on; its drift."""
        film = self.film
        film.launch_parts(kr.near_chunks, [self.state.e.region, self.lists.eo.rows, film.first], [self._near])
        before = self._alone
        for _ in range(JOINS):
            film.launch_regions(kr.join_clusters_r, [self._near, before], [self._joined])
            film.launch_regions(kr.join_clusters_r, [self._near, self._joined], [self._cluster])
            before = self._cluster
        film.launch_parts(kl.touch_chunks, [self.state.e.x, self.contact, film.first], [self._touch])
        of_regions = [self.state.motion, self.whole, self._fall, self._cluster, self._touch]
        film.launch_regions(kl.find_drift_r, of_regions, [self.drift, self._pull, self._held])

    def _sweep(self) -> None:
        film, e = self.film, self.state.e
        film.launch_parts(kf.swept_volume_chunks, [e.u, e.normal, self.geometry.vector, film.first], [self._swept])

    def _assemble(self, dt: wp.array) -> None:
        film, e, geometry, operator = self.film, self.state.e, self.geometry, self.response.operator
        film.launch_regions(kc.set_push_r, [self.state.gas, self.contact], [self.push])
        film.launch_e(
            kf.pull_foam_e,
            [
                *(e.x, self.predicted, self.fields.gamma, self.cover, self.contact.lag, e.region),
                *(film.tension, film.slope, geometry.star, geometry.tie, dt),
            ],
            [self.force, self._rest, operator.rows, operator.pair],
        )
        film.launch_e(
            kc.press_foam_e,
            [
                *(e.x, self.predicted, e.normal, geometry.share, geometry.vector),
                *(self.fields.eta, film.material.density, e.region, self.added, self.push, self._faced, self.free),
                *(self.lists.eo.rows, self.lists.ee.rows, self.contact, self._stride, dt),
            ],
            [self.force, self._rest, self.foot, operator.diag, operator.rows, operator.pair, self.wanted],
        )
        ee, vector = self.lists.ee.rows, geometry.vector
        most = MOST * 0.5 * self.contact.cling * film.spacing
        film.launch_e(kl.weigh_near_e, [e.x, ee, self.reach], [geometry.near])
        film.launch_e(
            kl.seek_normals_e,
            [
                *(e.normal, vector, e.region, self.ahead, self._rest, self.cover, geometry.star),
                *(geometry.near, ee, self.reach, self.bent, self._share.array),
            ],
            [self._sought],
        )
        film.launch_e(
            kl.gather_load_e,
            [
                *(e.normal, vector, e.region, self.ahead, self.force, self.foot, self._sought),
                *(geometry.near, ee, self.reach, most),
            ],
            [self.load],
        )
        film.launch_parts(
            kl.missing_chunks, [e.normal, self.force, self._rest, self.foot, self.load, film.first], [self._momentum]
        )
        arrays = [self._momentum, self._inertia, self._touch, self.contact]
        film.launch_regions(kl.find_missing_r, arrays, [self.missing])
        film.launch_e(
            kf.load_foam_e,
            [
                *(e.normal, vector, geometry.area, e.mass, self.forces.inertia, self.forces.body, e.region),
                *(self._balance, self.missing),
                *(self.drift, self._held, self.added, film.surroundings.damping, e.u, self.load, dt),
            ],
            [
                self.response.b,
                operator.diag,
                self._mass,
                self._outer,
                self.response.sweep,
                self.response.carried,
                self._braked,
            ],
        )
