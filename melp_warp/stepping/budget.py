"""The energy budget of a run: where the energy is, what it went into and what is left unexplained (docs/energy.md).

A `Budget` sums on the device, a few kernels a step, and changes nothing that the stages see. It is opened when E hold
all that L carry, at the start of each step, so it lags by the last step of a frame. A `Ledger` adds up frames.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.device.launch import copy, launch
from melp_warp.device.linear import RationalLaplacian
from melp_warp.kernels import budget as kb
from melp_warp.kernels.boundary import vec7d
from melp_warp.stages.film import Film
from melp_warp.stages.notices import Notices
from melp_warp.stages.state import State

if TYPE_CHECKING:
    from melp_warp.stepping.stepper import Stepper

STORE, WORK, DISSIPATION, LOSS = "stores", "work", "dissipation", "losses"
KINDS = (STORE, WORK, DISSIPATION, LOSS)

UNEXPLAINED = 0.01
"""Rest over what moves from which on a run says so."""

RAISED = 0.001
"""Energy that the numerics of a stage may make over what moves."""

FAINTEST = 1e-7
"""Least energy that moves over what is stored in the surfaces: what float32 tells apart."""


AIR_TOLERANCE = 3e-2
"""Relative residual of the air's momentum; that of its energy is about its square."""


@dataclass(frozen=True)
class Term:
    """A line of the budget.

    Attributes:
        name: as in run.jsonl.
        kind: `STORE`, `WORK` of outside forces, `DISSIPATION` by physics or numerical `LOSS`.
        meaning: one line.
        slots: what it is the sum of: slots of `kernels.budget` and their signs; empty where the host finds it.
    """

    name: str
    kind: str
    meaning: str
    slots: tuple[tuple[int, int], ...] = ()


TERMS = (
    Term("kinetic", STORE, "motion of the liquid", ((kb.KINETIC, 1),)),
    Term("air", STORE, "motion of the air that films take along", ((kb.AIR, 1),)),
    Term("surface", STORE, "free energy of the surfaces, without surfactant", ((kb.SURFACE, 1),)),
    Term("surfactant", STORE, "free energy of the surfactant on them", ((kb.SURFACTANT, 1),)),
    Term("gas", STORE, "the gas inside against the pressure outside, since the start", ((kb.GAS, 1),)),
    Term("gravity", STORE, "height of the liquid, since the start"),
    Term("lift", WORK, "the lighter gas that carries the film", ((kb.LIFT, 1),)),
    Term("push", WORK, "other forces from outside", ((kb.PUSH, 1),)),
    Term("air_drag", DISSIPATION, "drag of the air on films as a whole", ((kb.WHOLE, 1),)),
    Term("drag", DISSIPATION, "drag of the air along the film", ((kb.DRAG, 1),)),
    Term("viscosity", DISSIPATION, "viscosity of the flow in the film", ((kb.VISCOSITY, 1),)),
    Term("damping", DISSIPATION, "normal motion that the air takes up", ((kb.DAMPING, 1),)),
    Term("membrane", LOSS, "scheme of the normal motion", ((kb.MEMBRANE, 1), (kb.BENDING, 1), (kb.PRESSING, 1))),
    Term("stretch", LOSS, "tension of foams, that of a little later", ((kb.STRETCH, 1),)),
    Term("stars", LOSS, "neighbours in foams that are found anew", ((kb.STARS, 1),)),
    Term("contact", LOSS, "sheets that are stopped where they meet", ((kb.CONTACT, 1),)),
    Term("closing", LOSS, "offsets of foams that close their volumes", ((kb.CLOSING, 1),)),
    Term("lines", LOSS, "force passed on along lines", ((kb.LINES, 1),)),
    Term("debt", LOSS, "momentum of foams given back", ((kb.DEBT, 1),)),
    Term("flow", LOSS, "scheme of the flow along the film", ((kb.FLOW, 1), (kb.SPREADING, 1))),
    Term("mending", LOSS, "thickness of L kept in step with that of E", ((kb.MENDING, 1),)),
    Term("mixing", LOSS, "liquid that L exchange as they mix, and across partitions", ((kb.MIXED, 1),)),
    Term("splitting", LOSS, "viscosity solved apart from the flow", ((kb.SPLITTING, 1),)),
    Term("hold", LOSS, "momentum of the film as a whole held", ((kb.HOLD, 1),)),
    Term("rim", LOSS, "what the rim takes: motion, and liquid with its height"),
    Term(
        "transfer",
        LOSS,
        "from E to L, along with L, back to E; normals that turn",
        ((kb.ENDED, 1), (kb.STARTED, -1), (kb.FALLING, 1)),
    ),
    Term("air_range", LOSS, "air beyond its range, kept from making energy", ((kb.RANGE, 1),)),
    Term("redistribution", LOSS, "shifts of E", ((kb.SHIFTS, 1),)),
    Term("events", LOSS, "films that popped or merged, and those that came"),
)
"""All terms: whoever adds a phenomenon adds a line here and a kernel that fills its slot.

stores + dissipation + losses - work stays the same but for the rest.
"""


@dataclass(frozen=True)
class Reading:
    """What a `Budget` has summed up.

    Attributes:
        stored: terms stored at the start of the last step, J.
        opened: at the start of the first.
        flows: what all steps but the last have done, J.
        weighed: terms that are summed up on the host's word alone, by `Budget.weigh`, J.
        rim: energy that the rim has taken, of motion and of all else, J.
        liquid: that of the border and what was spilled included, kg.
        surfactant: on one interface, mol.
        momentum: [3] of the liquid and of what the rim has taken, kg m/s.
        impulse: [3] of outside forces in all steps but the last, kg m/s.
        fresh: whether there was no step yet.
    """

    stored: dict[str, float]
    opened: dict[str, float]
    flows: dict[str, float]
    weighed: dict[str, float]
    rim: tuple[float, float]
    liquid: float
    surfactant: float
    momentum: np.ndarray
    impulse: np.ndarray
    fresh: bool


class Budget:
    """Sums of the energy terms on the device. Made only where the scene wants a budget.

    Attributes:
        part: [parts, SLOTS] of the step in progress; as the next one, the state's.
        book: [4, SLOTS] what the steps add up to, see `kernels.budget.settle_step`.
    """

    def __init__(self, film: Film, state: State, stepper: Stepper):
        self.film, self.state = film, state
        self._stages = weakref.proxy(stepper)  # which owns this
        f = film.features
        memory = state.memory
        self.part, self._lying, self.book = memory.part, memory.lying, memory.book
        self.before = film.zeros(film.n_e, wp.vec3)
        self._no_air = film.zeros(film.regions)
        self._whole = wp.full(1, 1.0, dtype=wp.float32, device=film.device)
        self._bending, self._packed, self._swelling = None, None, None
        if f.moving and not f.foam:
            self._bending, self._packed = film.zeros(film.n_e), film.zeros(film.n_e, wp.vec3)
            self._swelling = film.zeros(film.n_e) if f.lagrangian and f.marangoni else None
        self._asked, self._yes = memory.asked, wp.full(1, 1, dtype=wp.int32, device=film.device)
        self._air_solver, self._airs = self._make_air(), film.parts(wp.float64)
        self._falls = f.lagrangian and not f.moving and any(film.surroundings.height)
        self._stretched, self._touched, self._swept, self._left, self._ended, self._cover = (
            (film.zeros(film.n_e) for _ in range(6)) if f.foam else 6 * (None,)
        )
        self._pull, self._hold = (film.zeros(film.n_e, wp.vec3) for _ in range(2)) if f.foam else 2 * (None,)
        self._mixed = film.parts(wp.float64) if f.mixes or f.exchanges else None
        self._rim = stepper.rim if f.collects else None
        if self._rim is not None:
            self._taken, self._border = film.parts(vec7d), wp.clone(state.border)

    def open_step(self) -> None:
        """Note what is stored, once E hold what L carry, and settle the step before."""
        film, e, s = self.film, self.state.e, self._stages
        cover = None
        if film.features.foam:
            cover = s.membrane.cover
            copy(self._cover, cover)
            film.launch_e(kb.measure_stars_e, [e.x, s.geometry.star], [self._ended])
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
                membrane.rigid if held and not f.foam else None,
                *(e.surfactant, film.material.rt, *self._widening()),
                *(flow.viscous.x if flow and flow.viscous else None, s.forces.body, film.height),
                *(film.surroundings.drag, flow.wind if flow else None, film.surroundings.damping),
                membrane.drift if f.foam else None,
                flow.theta if flow else self._whole,
                *(
                    self.state.gas,
                    film.surroundings.pressure,
                    int(f.closed),
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
            inputs = [lag.mass, lag.v, lag.normal, lag.affine, film.height, flow.bend, s.dt.array, film.n_l]
            film.launch_parts(kb.fall_chunks, inputs, [self.part])
        if self._mixed is not None:
            film.launch_parts(kb.book_mixed_chunks, [], [self._mixed, self.part])
        if f.foam:
            self._book_foam()
        if f.dragged:
            film.launch_regions(kb.book_whole_r, [membrane.drag.force, *self._path(), s.dt.array], [self.part])

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
        """Traction of uneven tension, and what becomes of the area and the thickness of L; None without surfactant."""
        flow, transfer = self._stages.tangential, self._stages.transfer
        if not self.film.features.marangoni or flow is None:
            return 6 * [None]
        swelling = flow.swelling if self._swelling is None else self._swelling
        return [flow.traction, self._stages.passed, flow.widening, swelling, transfer.growth, transfer.claim]

    def _path(self) -> list:
        """Velocities as a whole that the films move at in a step: two and the share of the way between them."""
        membrane = self._stages.membrane
        if self.film.features.foam:
            return [membrane.frame, membrane.frame, 0.0]
        return [membrane.start, self.state.motion, membrane.theta_whole]

    def _book_foam(self) -> None:
        film, e, s, g = self.film, self.state.e, self._stages, self._stages.geometry
        m, dt = s.membrane, s.dt.array
        change, matrix = m.response.x, m.response.operator
        film.launch_e(
            kb.lose_tension_e,
            [e.x, m.predicted, *self._tensed(), g.tie, m.u_mid, change, m.contact.lag, dt],
            [self._pull, self._stretched],
        )
        film.launch_e(
            kb.lose_contact_e,
            [
                *(g.area, self._ended, e.mass, s.fields.gamma, m.cover, self._cover, e.region, m.added),
                *(film.surroundings.damping, film.tension, film.slope, m.force, self._pull, m.foot),
                *(m.u_mid, change, g.star, matrix.diag, matrix.rows, matrix.pair, dt),
            ],
            [self._hold, self._touched],
        )
        film.launch_parts(
            kb.book_foam_chunks,
            [
                *(e.mass, g.area, e.normal, g.vector, m.response.moments, m.u_mid, m.load, m.missing, m.added),
                *(m.recoil, self._stretched, self._touched, film.first, dt),
            ],
            [self.part],
        )
        film.launch_regions(
            kb.book_carried_r,
            [m.start, self.state.motion, m.frame, m.recoil, m.weight, self.state.gas, m.added, *self._carried()],
            [self.part],
        )

    def _tensed(self) -> list:
        """What tension in a foam depends on besides places."""
        film, e, s, m = self.film, self.state.e, self._stages, self._stages.membrane
        return [s.fields.gamma, m.cover, e.region, film.tension, film.slope, s.geometry.star]

    def _lose_membrane(self) -> None:
        film, e, s = self.film, self.state.e, self._stages
        membrane, geometry = s.membrane, s.geometry
        response, bent = membrane.response, 2.0 / film.radius**2
        moved = [membrane.u_mid, response.load.x, response.unit.x, self.state.gas, membrane.start, membrane.share]
        film.launch_e(kb.pack_membrane_e, [e.normal, *moved], [self._packed])
        film.launch_e(
            kb.lose_membrane_e,
            [
                *(e.u, self.before, e.normal, geometry.area, e.mass, s.fields.gamma, geometry.surface),
                *(membrane.u_mid, self._packed, response.load.b, response.unit.b, self.state.gas),
                *(membrane.start, membrane.found, self.state.motion, membrane.theta_whole),
                *(geometry.weight, s.lists.ee.rows, film.n_e),
                *(film.material.tension, film.slope, bent, response.left_out, membrane.blur, membrane.rigid_air),
                *(int(self._air_solver is not None), membrane.share, s.dt.array),
            ],
            [self._bending, self._swelling],
        )

    def book_range(self, after: bool) -> None:
        """Book what becomes of the energy of air beyond its range as E move: before they do, and `after`."""
        beyond = getattr(self._stages.membrane, "air_range", None)
        if beyond is not None:
            solver, n = beyond.solver, self.film.n_e
            inputs = [solver.b, solver.x, self._stages.geometry.area, beyond.found, n, int(after)]
            self.film.launch_parts(kb.book_range_chunks, inputs, [self.part])

    def book_shifts(self) -> None:
        """Book what shifts of E have done to their velocities."""
        film, e, s = self.film, self.state.e, self._stages
        film.launch_parts(
            kb.book_shifts_chunks,
            [e.mass, s.geometry.area, e.normal, e.u, self._air(), film.first],
            [self.part],
        )
        if film.features.foam:
            self._book_moves()

    def book_stars(self) -> None:
        """Book what the energy of a foam has less once its stars are found anew."""
        film, s = self.film, self._stages
        surface = [self._left, s.geometry.share, s.membrane.cover, film.tension, self.state.gas]
        film.launch_parts(kb.book_stars_chunks, [*surface, film.first], [self.part])

    def _book_moves(self) -> None:
        """Book what the forces of a foam would do on the way of its E."""
        film, e, advance = self.film, self.state.e, self._stages.e_advance
        shifted = advance.redistribution.shifted if advance.redistribution else advance.x_old
        film.launch_e(
            kb.lose_move_e,
            [advance.x_old, shifted, e.x, *self._tensed()],
            [self._stretched, self._touched, self._swept, self._left],
        )
        film.launch_parts(
            kb.book_moves_chunks,
            [
                *(shifted, e.x, self.state.gas, self._pull, self._hold),
                *(self._stretched, self._touched, self._swept, film.first),
            ],
            [self.part],
        )

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

    def _make_air(self) -> RationalLaplacian | None:
        """What finds the momentum of the air around a single film; None where a film has none."""
        film, s = self.film, self._stages
        if not film.features.air_waves:
            return None
        arrays = [s.geometry.weight, s.geometry.area, s.lists.ee.rows]
        solver = RationalLaplacian(film.n_e, film.total, *arrays, AIR_TOLERANCE, None, film.device)
        response = s.membrane.response
        solver.set_function(*(p.astype(complex) for p in response.poles), response.low)
        return solver

    def _weigh_air(self) -> None:
        film, e, solver, motion = self.film, self.state.e, self._air_solver, self.state.motion
        kept = int(not film.features.lagrangian)
        film.launch_e(kb.load_air_e, [e.u, e.normal, motion, kept], [solver.b])
        solver.solve()
        area, added = self._stages.geometry.area, self._stages.membrane.rigid_air
        film.launch_parts(kb.air_chunks, [solver.b, solver.x, area, e.normal, motion, added, film.n_e], [self._airs])

    def _carried(self) -> tuple[float, int]:
        """Density of the air that bubbles carry as a whole, and whether E of a foam know their normal motion alone."""
        film, f = self.film, self.film.features
        return film.surroundings.air_density if f.foam and f.air else 0.0, int(f.foam and not f.lagrangian)

    def _air(self) -> wp.array:
        return self._stages.membrane.added if self.film.features.foam else self._no_air

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
            *(_sums(values) for values in (stored, opened, flow)),
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
        return _sums(step)


_SIGNS = np.zeros((len(TERMS), kb.SLOTS))
for _row, _term in enumerate(TERMS):
    for _slot, _sign in _term.slots:
        _SIGNS[_row, _slot] = _sign


def _sums(slots: np.ndarray) -> dict[str, float]:
    """Terms from the sums of the slots, J."""
    return dict(zip((t.name for t in TERMS), (_SIGNS @ slots).tolist(), strict=True))


def _of(kind: str) -> list[str]:
    """Names of the terms of a kind."""
    return [t.name for t in TERMS if t.kind == kind]


def _no_flows() -> dict[str, float]:
    """All flows by name, none yet, J."""
    return dict.fromkeys((t.name for t in TERMS if t.kind != STORE), 0.0)


def _spent(flows: Mapping[str, float]) -> float:
    """What left the stores, J."""
    out = sum(flows[name] for kind in (DISSIPATION, LOSS) for name in _of(kind))
    return out - sum(flows[name] for name in _of(WORK))


@dataclass
class Ledger:
    """The budget of a run, frame by frame, over changes of regions too: plain numbers, a part of the state.

    Attributes:
        time: that of the last reading, s.
        stores: name -> J.
        flows: name -> J since the start.
        rest: what the stores hold more than the flows explain, J.
        worst: the largest that it has been, J.
        moved: largest of kinetic energy and what has been dissipated and lost so far, J: the rest is measured by it.
        start: stores at the start, name -> J; empty before the first step.
        weighed: what `Budget.weigh` found at the start of the run, or where its regions changed last, J.
        past: flows of the budgets before, up to the last change of regions, J.
        pushed: [3] impulse of outside forces up to then, kg m/s.
        impulse: [3] the same up to now, kg m/s.
        owed: what is stored by the flows up to a change of regions, J; None where that is booked.
        liquid: at the start, kg.
        surfactant: at the start, mol.
        momentum: [3] at the start, kg m/s; empty before.
        balance: what has changed since the start.
    """

    time: float = 0.0
    stores: dict[str, float] = field(default_factory=dict)
    flows: dict[str, float] = field(default_factory=_no_flows)
    rest: float = 0.0
    worst: float = 0.0
    moved: float = 0.0
    start: dict[str, float] = field(default_factory=dict)
    weighed: dict[str, float] = field(default_factory=dict)
    past: dict[str, float] = field(default_factory=_no_flows)
    pushed: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    impulse: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    owed: float | None = None
    liquid: float = 0.0
    surfactant: float = 0.0
    momentum: list[float] = field(default_factory=list)
    balance: dict[str, float | list[float]] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """Largest rest so far over what moves, 0 where nothing does that float32 could tell."""
        least = FAINTEST * abs(self.stores.get("surface", 0.0))
        return self.worst / self.moved if self.moved > least else 0.0

    def open(self, reading: Reading) -> None:
        """Take the place of the liquid at the start of a run, or of one that goes on with other regions."""
        if not self.momentum:
            self.liquid, self.surfactant = reading.liquid, reading.surfactant
            self.momentum = reading.momentum.tolist()
        self.weighed = reading.weighed

    def take(self, reading: Reading, time: float) -> None:
        """Go on to a reading at `time` (s)."""
        if reading.fresh:
            return
        if not self.start:
            self.start = self._stores(reading.opened, self.weighed)
        if self.owed is not None:
            opened = sum(self._stores(reading.opened, self.weighed).values())
            self.past["events"] += self.owed - opened
            self.owed = None
        self.time, self.stores = time, self._stores(reading.stored, reading.weighed)
        self.flows = {name: past + reading.flows[name] for name, past in self.past.items()}
        self.flows["rim"] += sum(reading.rim)
        self.flows["transfer"] -= reading.rim[0]  # which E with L of which the rim took it lack
        self.impulse = (np.array(self.pushed) + reading.impulse).tolist()
        self.rest = sum(self.stores.values()) - sum(self.start.values()) + _spent(self.flows)
        self.worst = max(self.worst, abs(self.rest))
        spent = sum(self.flows[name] for kind in (DISSIPATION, LOSS) for name in _of(kind))
        spent -= self.flows["events"]  # films that pop take along far more than ever moves
        motion = self.stores["kinetic"] + self.stores["air"]
        self.moved = max(self.moved, motion + max(spent, 0.0))
        self.balance = {
            "liquid": reading.liquid / self.liquid - 1.0,
            "surfactant": reading.surfactant / self.surfactant - 1.0 if self.surfactant > 0.0 else 0.0,
            "momentum": (reading.momentum - np.array(self.momentum) - np.array(self.impulse)).tolist(),
        }

    def cut(self, reading: Reading, pending: Mapping[str, float]) -> None:
        """Close the account of a budget whose regions are about to change, its last step included."""
        if reading.fresh:
            return
        self.take(reading, self.time)
        self.past = {name: self.flows[name] + pending[name] for name in self.flows}
        self.pushed = list(self.impulse)
        self.owed = sum(self.stores.values()) - _spent(pending)

    def remark(self, notices: Notices, frame: int) -> None:
        """Note, once a run is done with `frame`, a rest that was too large."""
        if self.share > UNEXPLAINED:
            notices.add(
                frame,
                "energy budget",
                self.share,
                f"{100.0 * self.share:.3g} % of the energy that moves is unexplained,"
                f" {100.0 * UNEXPLAINED:g} % is what a sound run keeps to: see melp-warp report",
            )

    def line(self) -> dict:
        """What run.jsonl holds of a frame."""
        if not self.stores:
            return {}
        flows = {kind: {name: self.flows[name] for name in _of(kind)} for kind in KINDS if kind != STORE}
        return {
            "time": self.time,
            "start": dict(self.start),
            STORE: dict(self.stores),
            **flows,
            "rest": self.rest,
            "moved": self.moved,
            "share": self.share,
            "balance": dict(self.balance),
        }

    def _stores(self, sums: Mapping[str, float], weighed: Mapping[str, float]) -> dict[str, float]:
        return {name: sums[name] + weighed.get(name, 0.0) for name in _of(STORE)}
