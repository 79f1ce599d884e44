"""One time step: the parts that a film needs, and its stages, one after the other."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable
from functools import reduce
from itertools import chain
from operator import add
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.device.launch import Recorded, launch
from melp_warp.device.linear import WORTHLESS, Account
from melp_warp.device.scalars import Setting
from melp_warp.errors import LeapError, SimulationError, require
from melp_warp.kernels import diagnostics as kd
from melp_warp.stage import Solve, Stage
from melp_warp.stages.advance import Redistribution
from melp_warp.stages.film import Film
from melp_warp.stages.notices import Notices
from melp_warp.stages.state import State
from melp_warp.stepping.parts import CARRIERS, parts_of, stages_of

if TYPE_CHECKING:
    from melp_warp.stages.advance import EulerianAdvance, LagrangianAdvance
    from melp_warp.stages.air_range import AirRange
    from melp_warp.stages.carriage import Carriage
    from melp_warp.stages.circulation import Circulation
    from melp_warp.stages.drag import AirDrag
    from melp_warp.stages.exchange import Exchange
    from melp_warp.stages.foam import FoamMembrane
    from melp_warp.stages.forces import Forces
    from melp_warp.stages.free_rim import TornFilm
    from melp_warp.stages.geometry import Geometry
    from melp_warp.stages.membrane import Membrane
    from melp_warp.stages.mixing import Mixing
    from melp_warp.stages.neighbors import NeighborLists
    from melp_warp.stages.rim import Rim
    from melp_warp.stages.surfactant import Fields, Tangential
    from melp_warp.stages.transfer import Transfer
    from melp_warp.stepping.budget import Budget

GAS_LAW = 1e-3
"""Largest relative error of p V = n R T at the end of a frame."""


class Stepper:
    """Holds the parts that a film's features ask for and runs the stages of its carrier in order.

    Which stages those are is `melp_warp.stepping.step.TABLE`, for a single layer `SingleLayer.stages`; which parts,
    `melp_warp.stepping.parts.parts_of`. Each part is an attribute: None where the film goes without it.

    On a GPU a step is two graphs, captured in the first step and replayed from then on: all up to where E have moved,
    and all after that. They decide on the device when solvers stop, and read `dt` and what else changes from step to
    step from arrays. Before each the host has lists rebuilt where it is time, see `NeighborLists`, and nothing else to
    do. On the CPU each stage is a graph of its own, a graph a core, so that `wall` can be told.

    Attributes:
        carrier: what carries the flow along the film.
        stages: those of the step in their order, the scene's own after those that they name.
        extras: the scene's own.
        frame: [regions] velocity of the film as a whole in the step, m/s.
        passed: that after the share of the step that L are moved by.
        at_rest: what the lists move along with.
        dt: the step in progress, s.
        all, half: [1] shares of a step, 1 and 1/2.
        whole: whether a step is two graphs.
        wall: seconds spent in each stage since the last reset; not known where a step is two graphs.
        accounts: what became of the solves of each kind in the last frame, for all but the redistribution.
    """

    lists: NeighborLists
    geometry: Geometry
    fields: Fields
    edge: TornFilm | None
    forces: Forces
    rim: Rim | None
    transfer: Transfer | None
    circulation: Circulation | None
    carriage: Carriage | None
    mixing: Mixing | None
    drag: AirDrag | None
    membrane: Membrane | FoamMembrane | None
    air_range: AirRange | None
    tangential: Tangential | None
    e_advance: EulerianAdvance | None
    l_advance: LagrangianAdvance | None
    exchange: Exchange | None
    budget: Budget | None

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        f, fresh, device = film.features, state.fresh, film.device
        self.dt = Setting(device)
        self.all, self.half = (wp.full(1, share, dtype=wp.float32, device=device) for share in (1.0, 0.5))
        self._make_parts()
        still = film.zeros(1, wp.vec3)
        moving = self.membrane
        self.frame, self.passed, self.at_rest = (
            (moving.frame, moving.passed, moving.at_rest) if moving is not None else (still, still, still)
        )
        self.carrier = CARRIERS[f.carrier](self.itself)
        self.extras = [stage(self.itself) for stage in f.stages]
        self.stages = self._in_order([stage(self.itself) for stage in stages_of(f)])
        self.broken = wp.array([0, 2**31 - 1], dtype=wp.int32, device=device)
        self.wall = dict.fromkeys((stage.name for stage in self.stages), 0.0)
        self.accounts: dict[str, Account] = {}
        self.whole = device.is_cuda
        before, move, follow = ([stage for stage in self.stages if part(stage)] for part in (_before, _move, _follow))
        self._before = [(stage.name, stage.run) for stage in before]
        self._moving, self._following = ([(s.name, self._record(s)) for s in part] for part in (move, follow))
        self._e_move = any("e.x" in stage.writes for stage in self.stages)
        rows = max(film.n_e, film.n_l)
        self._graphs = [Recorded(run, device, rows) for run in (self._move, self._follow)]
        self.geometry.update() if fresh else self.geometry.again()
        if self.budget is not None:
            self.budget.look()
        self.carrier.begin()

    def _make_parts(self) -> None:
        """Make each part from the film, its state and the parts that it needs."""
        for name, kind in parts_of(self.film.features).items():
            if name == "budget" and self.state.course.holed:
                kind = None  # a foam of which a film has burst keeps none from then on
            made = None if kind is None else kind(self.film, self.state, *(getattr(self, one) for one in kind.needs))
            setattr(self, name, made)

    @property
    def itself(self) -> Stepper:
        """This, for what it owns: without a circle of references."""
        return weakref.proxy(self)

    @property
    def redistribution(self) -> Redistribution | None:
        """What keeps E evenly spaced."""
        return self.e_advance.redistribution if self.e_advance is not None else None

    def _in_order(self, own: list[Stage]) -> list[Stage]:
        """The stages of the film, `own`, and the scene's after those that they name."""
        places = [stage.name for stage in own if stage.recorded]
        for stage in self.extras:
            require(
                stage.after in places, f"after of stage {stage.name}", stage.after, f"one of {', '.join(places)} here"
            )
            lacking = [part for part in stage.needs if getattr(self, part, None) is None]
            require(not lacking, f"needs of stage {stage.name}", lacking, "parts that there are here")
        ordered = []
        for stage in own:
            ordered.append(stage)
            for extra in self.extras:
                if extra.after == stage.name:
                    extra.later = stage.later
                    ordered.append(extra)
        return ordered

    def _record(self, stage: Stage) -> Recorded:
        of_e = not stage.of_l and stage not in self.extras
        rows = self.film.n_e if of_e else max(self.film.n_e, self.film.n_l)
        return Recorded(stage.run_guarded, self.film.device, rows)

    def guard(self, stage: Stage) -> None:
        """Note on the device the first stage that leaves a number of what it writes that is not finite."""
        if not stage.writes:
            return
        number = self.stages.index(stage) + 1
        if _writes_l(stage):
            lag = self.state.l
            launch(kd.find_broken, self.film.n_l, [lag.x, lag.v, number], [self.broken], self.film.device)
        else:
            e = self.state.e
            self.film.launch_e(kd.find_broken, [e.x, e.u, number], [self.broken])

    def step(self, dt: float) -> None:
        """Advance the film by dt (s)."""
        self.prepare(dt)
        if self.edge is not None:
            self.edge.hold()
        move, follow = self._graphs if self.whole else (self._move, self._follow)
        self._run(self._before)
        move()
        if self._e_move:
            self._timed("neighbors", self.lists.update_e)
        follow()
        if self.edge is not None:
            self.edge.advance(dt)
        self.lists.look(dt)
        self.state.time += dt

    def prepare(self, dt: float) -> wp.array:
        """Set what depends on the step dt (s) to come; `dt` as the stages take it."""
        for stage in self.stages:
            stage.prepare(dt)
        self.lists.expect(dt)
        return self.dt.at(dt)

    def _move(self) -> None:
        """Run the stages up to where E have moved."""
        self._run(self._moving)

    def _follow(self) -> None:
        """Run the other stages."""
        self._run(self._following)

    def _run(self, stages: list[tuple[str, Callable[[], None]]]) -> None:
        for name, run in stages:
            self._timed(name, run)

    def _timed(self, name: str, run: Callable[[], None]) -> None:
        began = time.perf_counter()
        run()
        self.wall[name] += time.perf_counter() - began

    def _solves(self) -> dict[str, tuple[Stage, Solve]]:
        """The linear solves of the stages by kind, each with its stage."""
        return {name: (stage, solve) for stage in self.stages for name, solve in stage.solves().items()}

    def _find_accounts(self) -> dict[str, Account]:
        """What became of the solves of each kind since `remark` (reads back)."""
        accounts = {name: [solver.account() for solver in solve.solvers] for name, (_, solve) in self._solves().items()}
        return {name: reduce(add, found) for name, found in accounts.items() if found}

    def check(self) -> None:
        """Raise if a stage left a number that is not finite, a list overflowed or the gas collapsed (reads back).

        Raises:
            SimulationError: names the stage and the particle or the solve.
        """
        number, particle = (int(v) for v in self.broken.numpy())
        if number:
            stage = self.stages[number - 1]
            kind = "L" if _writes_l(stage) else "E"
            raise SimulationError(f"stage {stage.name}: {kind} particle {particle} is not finite")
        solves = self._solves()
        for name, account in self._find_accounts().items():
            if not account.worst < WORTHLESS:
                raise SimulationError(f"stage {solves[name][0].name}, solver {name}: {account.text}")
        for stage in self.stages:
            stage.check()
        self.lists.check()

    def settle(self) -> None:
        """Bring the state up to date with what stages sum up over several steps."""
        if self.rim is not None:
            self.rim.settle()

    def check_gas(self) -> None:
        """Raise if a region's pressure and volume do not obey the gas law at the end of a frame (reads back).

        `close_volume` mends the volume by an offset of the film, at most a tenth of a spacing a step.
        """
        if not self.film.features.closed:
            return
        gas = self.state.gas.numpy()
        amount = np.where(gas[:, 2] > 0.0, gas[:, 2], np.inf)  # a bubble with a hole holds none
        error = (self.film.surroundings.pressure + gas[:, 1]) * gas[:, 0] / amount - 1.0
        error[amount == np.inf] = 0.0
        k = int(np.argmax(np.abs(error)))
        if not abs(error[k]) <= GAS_LAW:
            raise LeapError(
                f"stage geometry: p V is {100.0 * error[k]:+.2g} % off n R T in region {k},"
                f" more than {100.0 * GAS_LAW:g} %: {gas[k, 0]:.3g} m^3 at {gas[k, 1]:.3g} Pa above the outside"
            )

    def remark(self, notices: Notices) -> None:
        """Have the stages note what must be known of the steps since this was last asked (reads back)."""
        self.accounts = self._find_accounts()
        for name, account in self.accounts.items():
            if account.late:
                notices.note(f"{name} not solved", account.worst, account.text)
        for solver in chain.from_iterable(solve.solvers for _, solve in self._solves().values()):
            solver.forget()
        for stage in self.stages:
            stage.remark(notices)

    def report(self) -> dict:
        """What the log says of the stages, of a scene's own under its name (reads back)."""
        found = {}
        for stage in self.stages:
            if told := stage.report():
                found |= {stage.name: told} if stage in self.extras else told
        return found

    def report_solves(self) -> dict[str, dict]:
        """What the log says of the solves of each kind (reads back)."""
        lines: dict[str, dict] = {}
        for name, (_, solve) in self._solves().items():
            if solve.report is not None:
                lines[name] = dict(zip(("iterations", "residual"), solve.report(), strict=True))
        for name, account in self.accounts.items():
            lines.setdefault(name, {})
            lines[name] |= {"solves": account.solves, "unsolved": account.late, "worst": account.worst}
        return lines


def _before(stage: Stage) -> bool:
    return not stage.recorded


def _move(stage: Stage) -> bool:
    return stage.recorded and not stage.later


def _follow(stage: Stage) -> bool:
    return stage.recorded and stage.later


def _writes_l(stage: Stage) -> bool:
    return stage.writes[0].startswith("l.")


class NoFilm:
    """Takes the place of a stepper when the last film has popped or burst: time passes and nothing else happens."""

    def __init__(self, film: Film, state: State):
        self.film, self.state, self.budget = film, state, None
        self.wall: dict[str, float] = {}

    def step(self, dt: float) -> None:
        """Let dt (s) pass."""
        self.state.time += dt

    def settle(self) -> None:
        """There is nothing to bring up to date."""

    def remark(self, notices: Notices) -> None:
        """There is nothing to note."""


def make_stepper(film: Film, state: State) -> Stepper | NoFilm:
    """The step that a film needs; none where no region is left."""
    return NoFilm(film, state) if film.regions == 0 else Stepper(film, state)
