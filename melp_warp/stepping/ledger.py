"""What the energy budget is made of, term by term, and its account over a run (docs/energy.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from melp_warp.kernels import budget as kb
from melp_warp.stages.notices import Notices

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
    Term(
        "membrane",
        LOSS,
        "scheme of the normal motion",
        ((kb.MEMBRANE, 1), (kb.BENDING, 1), (kb.PRESSING, 1), (kb.ARRIVING, 1)),
    ),
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
    Term("air_shape", LOSS, "air that has more or less to carry as the film changes shape", ((kb.SHAPING, 1),)),
    Term("air_range", LOSS, "air beyond its range, kept from making energy", ((kb.RANGE, 1),)),
    Term("redistribution", LOSS, "shifts of E", ((kb.SHIFTS, 1),)),
    Term("events", LOSS, "films that popped or merged, and those that came"),
    Term("respacing", LOSS, "E and L that come and go with the area, or where L clump"),
)
"""All terms: whoever adds a phenomenon adds a line here and a kernel that fills its slot.

stores + dissipation + losses - work stays the same but for the rest.
"""


CAUSES = ("events", "respacing")
"""Terms of what changes a film between steps."""


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


_SIGNS = np.zeros((len(TERMS), kb.SLOTS))
for _row, _term in enumerate(TERMS):
    for _slot, _sign in _term.slots:
        _SIGNS[_row, _slot] = _sign


def sum_terms(slots: np.ndarray) -> dict[str, float]:
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
        owed: what is stored by the flows up to a change of regions or of the number of E, J; None where that is booked.
        cause: term that what the change makes of it is booked as.
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
    cause: str = "events"
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
            self.past[self.cause] += self.owed - opened
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

    def cut(self, reading: Reading, pending: Mapping[str, float], cause: str) -> None:
        """Close the account of a budget whose regions or E are about to change, its last step included."""
        if reading.fresh:
            return
        self.take(reading, self.time)
        self.past = {name: self.flows[name] + pending[name] for name in self.flows}
        self.past["rim"] -= sum(reading.rim)  # which a rim sums up over the whole run
        self.past["transfer"] += reading.rim[0]
        self.pushed = list(self.impulse)
        self.owed, self.cause = sum(self.stores.values()) - _spent(pending), cause

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
