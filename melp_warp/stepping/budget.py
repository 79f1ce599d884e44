"""The energy budget of a run: where the energy is, what it went into and what is left unexplained (docs/energy.md).

A `Budget` sums on the device, a few kernels a step, and changes nothing that the stages see. It is opened when E hold
all that L carry, at the start of each step, so it lags by the last step of a frame. A `Ledger` (ledger.py) adds up
frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.device.launch import clear, copy, launch
from melp_warp.device.linear import Solver
from melp_warp.kernels import budget as kb
from melp_warp.kernels.boundary import vec7d
from melp_warp.stages.air_range import SLOPE
from melp_warp.stages.film import Film
from melp_warp.stages.state import State
from melp_warp.stepping.ledger import Reading, sum_terms

if TYPE_CHECKING:
    from melp_warp.stepping.stepper import Stepper

AIR_TOLERANCE = 3e-2
"""Relative residual of the air's momentum; that of its energy is about its square."""

SHAPE_TOLERANCE = 0.1
"""The same where only a change of that energy is asked for, which is off by as large a share."""


class Budget:
    """Sums of the energy terms on the device. Made only where the scene wants a budget.

    Attributes:
        part: [parts, SLOTS] of the step in progress; as the next one, the state's.
        book: [4, SLOTS] what the steps add up to, see `kernels.budget.settle_step`.
    """

    needs = ("itself",)
    kernels = ("budget",)

    def __init__(self, film: Film, state: State, stepper: Stepper):
        self.film, self.state, self._stages = film, state, stepper
        f = film.features
        memory = state.memory
        self.part, self._lying, self.book = memory.part, memory.lying, memory.book
        self.before = film.zeros(film.n_e, wp.vec3)
        self._no_air = film.zeros(film.regions)
        self._whole = wp.full(1, 1.0, dtype=wp.float32, device=film.device)
        self._bending, self._swelling, self._ended = 3 * (None,)
        if f.normal == "membrane":
            self._bending, self._push, self._speed = (film.zeros(film.n_e) for _ in range(3))
            of_all = (film.zeros(film.total) for _ in range(5))  # 0 beyond the rim
            self._pushed, self._moved, self._grown, self._ahead, self._sharp = of_all
            self._swelling = film.zeros(film.n_e) if f.lagrangian and f.marangoni else None
        self._asked, self._yes = memory.asked, wp.full(1, 1, dtype=wp.int32, device=film.device)
        self._air_solver, self._airs = self._make_air(AIR_TOLERANCE), film.parts(wp.float64)
        self._shape = self._make_air(SHAPE_TOLERANCE)
        self._falls = f.lagrangian and f.normal != "foam" and any(film.surroundings.height)
        self._mixed = film.parts(wp.float64) if f.mixes or f.exchanges else None
        self._rim = stepper.rim if f.collects else None
        if self._rim is not None:
            self._taken, self._border = film.parts(vec7d), wp.clone(state.border)

    def open_step(self) -> None:
        """Note what is stored, once E hold what L carry, and settle the step before."""
        film, e, s = self.film, self.state.e, self._stages
        cover = s.membrane.cover if s.membrane is not None else None
        film.launch_parts(
            kb.open_step_chunks,
            [
                *(e.mass, e.surfactant, s.geometry.area, s.geometry.share, self._ended, s.geometry.kappa),
                s.fields.gamma,
                s.transfer.claim if s.transfer else None,
                *(cover, self.state.motion, e.u, e.normal),
                *(film.tension, film.slope, film.material.rt, self._air(), self.state.gas, film.surroundings.pressure),
                *(*self._carried(), int(film.features.closed), film.first),
                self._asked,
            ],
            [self.part, self.before],
        )
        film.launch_one(kb.settle_step, [self.part, film.material.rt], [self.book, self._asked])

    def book_forces(self) -> None:
        """Book what the forces of a step have done, once E have the velocity of its end."""
        film, e, s = self.film, self.state.e, self._stages
        membrane, flow = s.membrane, s.tangential
        f = film.features
        held = f.moving and f.closed
        if self._bending is not None:
            self._lose_membrane()
        film.launch_parts(
            kb.book_forces_chunks,
            [
                *(e.mass, s.geometry.area, e.normal, self.before, e.u, membrane.u_mid if f.moving else None),
                *((membrane.found, membrane.start) if held else (None, None)),
                *(self._air(), membrane.taken if f.moving else None, self._bending),
                membrane.rigid if held else None,
                *(e.surfactant, film.material.rt, membrane.turning if membrane else None, *self._widening()),
                *(flow.viscous.x if flow and flow.viscous else None, s.forces.body, film.height),
                *(film.surroundings.drag, flow.wind if flow else None),
                flow.theta if flow else self._whole,
                *(
                    self.state.gas,
                    film.surroundings.pressure,
                    int(f.closed and self._bending is None),
                    int(f.lagrangian),
                    int(f.circulation),
                    int(self._falls),
                    s.dt.array,
                    film.first,
                ),
            ],
            [self.part],
        )
        if self._falls:
            lag = self.state.l
            held = [lag.mass, lag.v, lag.normal, lag.affine, film.height]
            whole = self._path() if f.moving else [s.frame, s.frame, 0.0]
            inputs = [*held, *whole, s.passed, flow.bend, s.dt.array, film.n_l]
            film.launch_parts(kb.fall_chunks, inputs, [self.part])
        if self._mixed is not None:
            film.launch_parts(kb.book_mixed_chunks, [], [self._mixed, self.part])
        self._book_normal()
        if f.dragged:
            film.launch_regions(kb.book_whole_r, [membrane.drag.force, *self._path(), s.dt.array], [self.part])

    def _book_normal(self) -> None:
        """Book what only some normal motions do."""

    @contextmanager
    def weigh_held(self) -> Iterator[None]:
        """Book what is done within to what is stored in L."""
        self._weigh_held(0)
        yield
        self._weigh_held(1)

    def _weigh_held(self, after: int) -> None:
        film, lag = self.film, self.state.l
        held = [lag.mass, lag.surfactant, lag.x]
        thickness, *scales = self._thin()
        inputs = [*held, thickness, film.surroundings.height, *scales, film.n_l, after]
        film.launch_parts(kb.weigh_held_chunks, inputs, [self._mixed])

    def _thin(self) -> list:
        """Thickness of L and rho/Gamma_0, which give what surfactant they have on an area, and R T."""
        m, lag = self.film.material, self.state.l
        if lag is None or not self.film.features.marangoni:
            return [None, 0.0, 0.0]
        return [lag.eta, m.density / m.surfactant, m.rt]

    def _widening(self) -> list:
        """Traction of uneven tension, what it does as a whole, and what becomes of the area and the thickness of L."""
        flow, transfer = self._stages.tangential, self._stages.transfer
        if not self.film.features.marangoni or flow is None:
            return 7 * [None]
        kick = self._stages.membrane.kick if self.film.features.recoils else None
        swelling = flow.swelling if self._swelling is None else self._swelling
        return [flow.traction, self._stages.passed, kick, flow.widening, swelling, transfer.growth, transfer.claim]

    def _path(self) -> list:
        """Velocities as a whole that the films move at in a step: two and the share of the way between them."""
        membrane = self._stages.membrane
        return [membrane.start, self.state.motion, membrane.theta_whole]

    def _lose_membrane(self) -> None:
        film, e, s = self.film, self.state.e, self._stages
        membrane, geometry, response = s.membrane, s.geometry, s.membrane.response
        air = self._air_solver is not None
        moved = [membrane.u_mid, response.load.x, response.unit.x, self.state.gas, *self._path(), membrane.share]
        shared = [self._moved, self._grown, self._ahead]
        film.launch_e(kb.pack_membrane_e, [e.normal, *moved], shared)
        if air:
            self._sharpen(self._moved, membrane.blur, self._speed)
        film.launch_e(
            kb.lose_membrane_e,
            [
                *(e.u, self.before, e.normal, geometry.area, geometry.cell, e.mass, s.forces.heavy, geometry.surface),
                *(self._push, membrane.external, membrane.u_mid, *shared, self._speed),
                *(response.load.b, response.unit.b, self.state.gas, membrane.start, membrane.found),
                *(geometry.weight, s.lists.ee.rows, film.n_e),
                *(2.0 * film.material.film_tension, 2.0 / film.radius**2, response.left_out, membrane.blur),
                *(membrane.rigid_air, int(air), membrane.share, e.surfactant, film.material.rt, s.dt.array),
            ],
            [self._bending, self._swelling],
        )

    def _sharpen(self, blurred: wp.array, blur: float, into: wp.array) -> None:
        """Put (1 + blur lap_s)^-1 of what is blurred, [n], into an array, up to the second power of blur lap_s."""
        film, geometry = self.film, self._stages.geometry
        inputs = [geometry.area, geometry.weight, self._stages.lists.ee.rows, blur]
        for found, sharp in ((blurred, self._sharp), (self._sharp, into)):
            film.launch_e(kb.sharpen_e, [blurred, found, *inputs], [sharp])

    def look(self) -> None:
        """Find the forces of tension and gas across a film as it is, once its geometry is found."""
        if self._bending is None:
            return
        film, e, geometry = self.film, self.state.e, self._stages.geometry
        blur = geometry.blur("mls")
        amount = None if film.features.lagrangian or film.slope == 0.0 else e.surfactant
        film.launch_e(
            kb.find_push_e,
            [
                *(geometry.surface, geometry.area, amount),
                *(film.material.tension, film.material.rt, self.state.gas, 8.0 * blur),
            ],
            [self._pushed],
        )
        self._sharpen(self._pushed, blur, self._push)

    def book_range(self, after: bool) -> None:
        """Book what becomes of the energy of air beyond its range as E move: before they do, and `after`."""
        beyond = self._stages.air_range
        if beyond is not None:
            self._book_air(beyond.solver, beyond.found, after, kb.RANGE)

    def book_shape(self, after: bool) -> None:
        """Book what becomes of that of air within its range as the film gets another shape, as before."""
        if self._air_solver is not None:
            beyond = self._stages.air_range
            self._find_air(0, None if beyond is None else beyond.found, self._shape)
            self._book_air(self._shape, None, after, kb.SHAPING)

    def _book_air(self, solver: Solver, found: wp.array | None, after: bool, slot: int) -> None:
        inputs = [solver.b, solver.x, self._stages.geometry.area, found, self.film.n_e, int(after), slot]
        self.film.launch_parts(kb.book_air_chunks, inputs, [self.part])

    def _find_air(self, kept: int, found: wp.array | None, solver: Solver) -> None:
        """Find the momentum of the air; none beyond its range where it is `found` to be."""
        e = self.state.e
        inputs = [e.u, e.normal, self.state.motion, kept, found, wp.float64(SLOPE)]
        self.film.launch_e(kb.load_air_e, inputs, [solver.b])
        solver.solve()

    def book_shifts(self) -> None:
        """Book what shifts of E have done to their velocities."""
        if self._stages.redistribution is not None:
            self._book_shifts()

    def _book_shifts(self) -> None:
        film, e, s = self.film, self.state.e, self._stages
        film.launch_parts(
            kb.book_shifts_chunks,
            [
                *(e.mass, s.geometry.area, e.normal, e.u, self._air()),
                *(self.state.motion, self.state.gas, *self._carried(), film.first),
            ],
            [self.part],
        )

    def book_stars(self) -> None:
        """Book what the energy has less once the geometry is found anew."""
        self.book_shape(after=True)

    def book_end(self) -> None:
        """Book what tension and gas do where E have arrived, and what the air keeps."""
        self.book_range(after=True)
        if self._bending is None:
            return
        self.look()
        film, e, s = self.film, self.state.e, self._stages
        shape = [s.geometry.cell, self._push, s.geometry.surface, film.material.tension]
        way = [e.normal, e.x, self._left_from(), s.frame, self.state.gas, s.dt.array, film.n_e]
        film.launch_parts(kb.book_arrival_chunks, [*shape, *way], [self.part])

    def _left_from(self) -> wp.array:
        """Where E were before they moved, once they were evened out."""
        advance = self._stages.e_advance
        return advance.redistribution.shifted if advance.redistribution else advance.x_old

    def weigh(self) -> None:
        """Have the step to come note what is stored: on the host's word, as only the last one of a frame needs it.

        Where the liquid lies, what the air has and what the rim took is summed up at once.
        """
        film, state = self.film, self.state
        copy(self._asked, self._yes)
        p, n = (state.l, film.n_l) if state.l is not None else (state.e, film.n_e)
        launch(
            kb.lie_chunks,
            self._lying.shape[0],
            [p.mass, p.surfactant, p.x, p.u, *self._thin(), n],
            [self._lying],
            film.device,
        )
        if self._air_solver is not None:
            self._weigh_air()
        if self._rim is not None:
            self._rim.taken(self._taken)
            copy(self._border, state.border)

    def _make_air(self, tolerance: float) -> Solver | None:
        """What finds the momentum of the air around a single film; None where a film has none."""
        s = self._stages
        if not self.film.features.air_waves:
            return None
        return s.membrane.response.make_momentum(s.lists, tolerance, None)

    def _weigh_air(self) -> None:
        film, e, solver, motion = self.film, self.state.e, self._air_solver, self.state.motion
        self._find_air(int(not film.features.lagrangian), None, solver)
        area, added = self._stages.geometry.area, self._stages.membrane.rigid_air
        film.launch_parts(kb.air_chunks, [solver.b, solver.x, area, e.normal, motion, added, film.n_e], [self._airs])

    def begin(self) -> None:
        """Sum up from nothing, as at the start of a run: the ledger has what was summed so far."""
        clear(self.book)
        clear(self.part)

    def _carried(self) -> tuple[float, int]:
        """Density of the air that bubbles carry as a whole, and whether E of a foam know their normal motion alone."""
        return 0.0, 0

    def _air(self) -> wp.array:
        """[regions] air that moves along with each whatever the wave, kg/m^2."""
        return self._no_air

    def read(self) -> Reading:
        """What has been summed up so far (reads back)."""
        stored, opened, flow, begun = self.book.numpy()
        liquid, surfactant, *lying, free = self._lying.numpy().sum(axis=0).tolist()
        lifted = np.zeros(3) if self._rim is not None else liquid * self.state.origin
        weighed = {"gravity": -float(np.dot(self.film.surroundings.height, lying[:3] + lifted))}
        if self._air_solver is not None:
            weighed["air"] = float(self._airs.numpy().sum())
        weighed["surfactant"] = free
        taken = np.zeros(7)
        if self._rim is not None:
            taken = self._taken.numpy().sum(axis=0) + self._border.numpy()
        return Reading(
            *(sum_terms(values) for values in (stored, opened, flow)),
            weighed=weighed,
            rim=tuple(taken[5:].tolist()),
            liquid=liquid + float(taken[0]) + self.state.course.spilled,
            surfactant=surfactant + float(taken[1]),
            momentum=np.array(lying[3:]) + taken[2:5],
            impulse=flow[kb.IMPULSE : kb.IMPULSE + 3].copy(),
            fresh=begun[0] == 0.0,
        )

    def pending(self) -> dict[str, float]:
        """What the last step has done, which is not among the flows yet, J (reads back)."""
        step = self.part.numpy().sum(axis=0)
        step[[kb.STARTED, kb.ENDED, kb.CLOSING]] = 0.0  # counted, or on the way
        return sum_terms(step)
