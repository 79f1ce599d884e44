"""The energy budget of a run: where the energy is, what it went into and what is left unexplained (docs/energy.md).

A `Budget` sums on the device, a few kernels a step, and changes nothing that the stages see. It is opened when E hold
all that L carry, at the start of each step, so it lags by the last step of a frame. A `Ledger` adds up frames.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.film import Film
from melp_warp.kernels import budget as kb
from melp_warp.launch import launch
from melp_warp.notices import Notices
from melp_warp.state import State

if TYPE_CHECKING:
    from melp_warp.stepper import Stepper

STORE, WORK, DISSIPATION, LOSS = "stores", "work", "dissipation", "losses"
KINDS = (STORE, WORK, DISSIPATION, LOSS)

UNEXPLAINED = 0.01
"""Rest over what moves from which on a run says so."""

RAISED = 0.001
"""Energy that the numerics of a stage may make over what moves."""

FAINTEST = 1e-7
"""Least energy that moves over what is stored in the surfaces: what float32 tells apart."""


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
    Term("surface", STORE, "free energy of the surfaces, surfactant included", ((kb.SURFACE, 1),)),
    Term("gas", STORE, "the gas inside against the pressure outside, since the start", ((kb.GAS, 1),)),
    Term("gravity", STORE, "height of the liquid, since the start"),
    Term("lift", WORK, "the lighter gas that carries the film", ((kb.LIFT, 1),)),
    Term("push", WORK, "other forces from outside", ((kb.PUSH, 1),)),
    Term("drag", DISSIPATION, "drag of the air along the film", ((kb.DRAG, 1),)),
    Term("viscosity", DISSIPATION, "viscosity of the flow in the film", ((kb.VISCOSITY, 1),)),
    Term("damping", DISSIPATION, "normal motion that the air takes up", ((kb.DAMPING, 1),)),
    Term("membrane", LOSS, "scheme of the normal motion", ((kb.MEMBRANE, 1), (kb.BENDING, 1), (kb.PRESSING, 1))),
    Term("flow", LOSS, "scheme of the flow along the film", ((kb.FLOW, 1), (kb.SPREADING, 1))),
    Term("splitting", LOSS, "viscosity solved apart from the flow", ((kb.SPLITTING, 1),)),
    Term("hold", LOSS, "momentum of the film as a whole held", ((kb.HOLD, 1),)),
    Term(
        "transfer", LOSS, "from E to L, along with L, back to E; normals that turn", ((kb.ENDED, 1), (kb.STARTED, -1))
    ),
    Term("redistribution", LOSS, "shifts of E", ((kb.SHIFTS, 1),)),
    Term("offset", LOSS, "surface moved to hold the volume", ((kb.OFFSETS, 1),)),
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
        height: energy of the liquid's height, J.
        liquid: kg.
        surfactant: on one interface, mol.
        momentum: [3] of the liquid, kg m/s.
        impulse: [3] of outside forces in all steps but the last, kg m/s.
        fresh: whether there was no step yet.
    """

    stored: dict[str, float]
    opened: dict[str, float]
    flows: dict[str, float]
    height: float
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
        self._bending = film.zeros(film.n_e) if f.moving and not f.foam else None

    def open_step(self) -> None:
        """Note what is stored, once E hold what L carry, and settle the step before."""
        film, e, m, s = self.film, self.state.e, self.film.material, self._stages
        cover = s.membrane.cover if film.features.foam else None
        film.launch_parts(
            kb.open_step_chunks,
            [
                *(e.mass, e.surfactant, s.geometry.area, s.geometry.kappa, s.fields.gamma, cover, e.u, e.normal),
                *(film.tension, film.slope, m.rt, self._air(), self.state.gas, film.surroundings.pressure),
                *(int(film.features.closed), int(film.features.moving), film.first),
            ],
            [self.part, self.before],
        )
        film.launch_one(kb.settle_step, [self.part], [self.book])

    def book_forces(self) -> None:
        """Book what the forces of a step have done, once E have the velocity of its end."""
        film, e, s = self.film, self.state.e, self._stages
        membrane, flow = s.membrane, s.tangential
        f = film.features
        held = f.moving and f.closed
        if self._bending is not None:
            film.launch_e(
                kb.bend_film_e,
                [
                    *(e.x, e.normal, s.geometry.area, s.fields.gamma, membrane.u_mid, membrane.start),
                    *(s.geometry.weight, s.lists.ee.rows, film.n_e, film.material.tension, film.slope),
                    *(2.0 / film.radius**2, membrane.share, s.dt.array),
                ],
                [self._bending],
            )
        film.launch_parts(
            kb.book_forces_chunks,
            [
                *(e.mass, s.geometry.area, e.normal, self.before, e.u, membrane.u_mid if f.moving else None),
                *((membrane.found, membrane.start) if held else (None, None)),
                *(self._air(), self._bending, membrane.response.left_out if self._bending is not None else None),
                membrane.rigid if held and not f.foam else None,
                *(s.fields.gamma, flow.solver.x if flow and flow.solver else None, film.slope),
                *(flow.viscous.x if flow and flow.viscous else None, s.forces.body, film.gravity),
                *(film.surroundings.drag, film.surroundings.damping, flow.theta if flow else self._whole),
                *(self.state.gas, film.surroundings.pressure, int(f.closed), s.dt.array, film.first),
            ],
            [self.part],
        )

    def book_shifts(self) -> None:
        """Book what shifts of E have done to their velocities."""
        film, e, s = self.film, self.state.e, self._stages
        film.launch_parts(
            kb.book_shifts_chunks,
            [e.mass, s.geometry.area, e.normal, e.u, self._air(), film.first],
            [self.part],
        )

    def weigh(self) -> None:
        """Note where the liquid lies; on the host's word alone, as only the last step of a frame needs it."""
        film, state = self.film, self.state
        p, n = (state.l, film.n_l) if state.l is not None else (state.e, film.n_e)
        launch(
            kb.lie_chunks,
            self._lying.shape[0],
            [p.mass, p.surfactant, p.x, p.u, n],
            [self._lying],
            film.device,
        )

    def _air(self) -> wp.array:
        return self._stages.membrane.added if self.film.features.foam else self._no_air

    def read(self) -> Reading:
        """What has been summed up so far (reads back)."""
        stored, opened, flow, begun = self.book.numpy()
        liquid, surfactant, *lying = self._lying.numpy().sum(axis=0).tolist()
        place = np.array(lying[:3]) + liquid * self.state.origin
        return Reading(
            *(_sums(values) for values in (stored, opened, flow)),
            height=-float(np.dot(self.film.surroundings.gravity, place)),
            liquid=liquid,
            surfactant=surfactant,
            momentum=np.array(lying[3:]),
            impulse=flow[kb.IMPULSE : kb.IMPULSE + 3].copy(),
            fresh=begun[0] == 0.0,
        )

    def pending(self) -> dict[str, float]:
        """What the last step has done, which is not among the flows yet, J (reads back)."""
        step = self.part.numpy().sum(axis=0)
        step[[kb.OFFSETS, kb.STARTED, kb.ENDED]] = 0.0  # counted, or on the way
        return _sums(step)


def _sums(slots: np.ndarray) -> dict[str, float]:
    """Terms from the sums of the slots, J."""
    return {t.name: float(sum(sign * slots[slot] for slot, sign in t.slots)) for t in TERMS}


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
        whole: whether all terms are known. The energy of the air around a single film and that of contact in a foam
            are not yet: the rest says nothing there.
        time: that of the last reading, s.
        stores: name -> J.
        flows: name -> J since the start.
        rest: what the stores hold more than the flows explain, J.
        moved: largest of kinetic energy and what has been dissipated and lost so far, J: the rest is measured by it.
        start: stores at the start, name -> J; empty before the first step.
        height: energy of the liquid's height at the start of the run, or where its regions changed last, J.
        past: flows of the budgets before, up to the last change of regions, J.
        pushed: [3] impulse of outside forces up to then, kg m/s.
        impulse: [3] the same up to now, kg m/s.
        owed: what is stored by the flows up to a change of regions, J; None where that is booked.
        liquid: at the start, kg.
        surfactant: at the start, mol.
        momentum: [3] at the start, kg m/s; empty before.
        balance: what has changed since the start.
    """

    whole: bool = True
    time: float = 0.0
    stores: dict[str, float] = field(default_factory=dict)
    flows: dict[str, float] = field(default_factory=_no_flows)
    rest: float = 0.0
    moved: float = 0.0
    start: dict[str, float] = field(default_factory=dict)
    height: float = 0.0
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
        """Rest over what moves, 0 where nothing does that float32 could tell."""
        least = FAINTEST * abs(self.stores.get("surface", 0.0))
        return abs(self.rest) / self.moved if self.moved > least else 0.0

    def open(self, reading: Reading) -> None:
        """Take the place of the liquid at the start of a run, or of one that goes on with other regions."""
        if not self.momentum:
            self.liquid, self.surfactant = reading.liquid, reading.surfactant
            self.momentum = reading.momentum.tolist()
        self.height = reading.height

    def take(self, reading: Reading, time: float) -> None:
        """Go on to a reading at `time` (s)."""
        if reading.fresh:
            return
        if not self.start:
            self.start = self._stores(reading.opened, self.height)
        if self.owed is not None:
            opened = sum(self._stores(reading.opened, self.height).values())
            self.past["events"] += self.owed - opened
            self.owed = None
        self.time, self.stores = time, self._stores(reading.stored, reading.height)
        self.flows = {name: past + reading.flows[name] for name, past in self.past.items()}
        self.impulse = (np.array(self.pushed) + reading.impulse).tolist()
        self.rest = sum(self.stores.values()) - sum(self.start.values()) + _spent(self.flows)
        spent = sum(self.flows[name] for kind in (DISSIPATION, LOSS) for name in _of(kind))
        self.moved = max(self.moved, self.stores["kinetic"] + self.stores["air"] + spent)
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

    def remark(self, notices: Notices) -> None:
        """Note a rest that is too large."""
        if self.whole and self.share > UNEXPLAINED:
            notices.note(
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
            "whole": self.whole,
            "balance": dict(self.balance),
        }

    def _stores(self, sums: Mapping[str, float], height: float) -> dict[str, float]:
        return {name: sums[name] for name in _of(STORE)} | {"gravity": height}
