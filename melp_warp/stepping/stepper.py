"""One time step, as a table of contents."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from functools import reduce
from itertools import chain
from operator import add

import numpy as np
import warp as wp

from melp_warp.device.launch import Recorded, launch
from melp_warp.device.linear import WORTHLESS, Account, ConjugateGradient, RationalLaplacian
from melp_warp.device.scalars import Setting
from melp_warp.errors import LeapError, SimulationError, require
from melp_warp.kernels import diagnostics as kd
from melp_warp.kernels import transfer as kt
from melp_warp.stage import TABLE
from melp_warp.stages.advance import EulerianAdvance, LagrangianAdvance
from melp_warp.stages.carriage import Carriage
from melp_warp.stages.circulation import Circulation
from melp_warp.stages.film import Film
from melp_warp.stages.foam import Exchange, FoamMembrane
from melp_warp.stages.forces import Forces
from melp_warp.stages.free_rim import TornFilm
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.membrane import Membrane
from melp_warp.stages.mixing import Mixing
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.notices import Notices
from melp_warp.stages.rim import Rim
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Fields, Tangential
from melp_warp.stages.transfer import Transfer
from melp_warp.stepping.budget import Budget

STAGES = tuple(row.name for row in TABLE)

GAS_LAW = 1e-3
"""Largest relative error of p V = n R T at the end of a frame."""

SOLVED_IN = {
    **{"membrane": "membrane", "air": "advance_e", "surfactant": "surfactant", "viscosity": "surfactant"},
    "circulation": "l_to_e",
}
"""Stage of each kind of solve."""


class Stepper:
    """Holds the stages that a film's features ask for and runs them in order.

    On a GPU a step is two graphs, captured in the first step and replayed from then on: all up to where E have moved,
    and all after that. They decide on the device when solvers stop, and read `dt` and what else changes from step to
    step from arrays. Before each the host has lists rebuilt where it is time, see `NeighborLists`, and nothing else to
    do. On the CPU each stage is a graph of its own, a graph a core, so that `wall` can be told.

    Attributes:
        dt: the step in progress, s.
        whole: whether a step is two graphs.
        wall: seconds spent in each stage since the last reset; not known where a step is two graphs.
        accounts: what became of the solves of each kind in the last frame, for all but the redistribution.
    """

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        f, fresh = film.features, state.fresh
        self.lists = NeighborLists(film, state)
        self.geometry = Geometry(film, state, self.lists)
        self.fields = self._make_fields()
        self.edge = TornFilm(film, state, self.lists, self.geometry, self.fields) if f.holed else None
        hung = self.edge.inertia if self.edge is not None else None
        self.forces = Forces(film, state, self.fields, self.geometry.gain, hung)
        self.rim = Rim(film, state, self.lists, self.geometry, self.forces.gravity) if f.rim else None
        self.transfer = Transfer(film, state, self.lists, self.geometry) if f.lagrangian else None
        self.circulation = (
            Circulation(film, state, self.lists, self.geometry, self.transfer, self.rim) if f.circulation else None
        )
        self.carriage = Carriage(film, state, self.transfer) if f.carried else None
        self.mixing = Mixing(film, state, self.lists, self.carriage) if f.mixes else None
        self.membrane = self._make_membrane() if f.moving else None
        self.tangential = (
            Tangential(film, state, self.lists, self.geometry, self.fields, self.forces, self.rim)
            if f.lagrangian
            else None
        )
        self.e_advance = EulerianAdvance(film, state, self.lists, self.geometry) if f.moving else None
        self.redistribution = self.e_advance.redistribution if f.moving else None
        self.l_advance = LagrangianAdvance(film, state, self.lists, self.geometry) if f.lagrangian else None
        self.exchange = (
            Exchange(film, state, self.geometry, self.fields, self.transfer, self.circulation, self.carriage)
            if f.exchanges
            else None
        )
        self.budget = Budget(film, state, self) if f.budget and not state.course.holed else None
        self.broken = wp.array([0, 2**31 - 1], dtype=wp.int32, device=film.device)
        still = film.zeros(1, wp.vec3)
        self.frame, self.passed = (self.membrane.frame, self.membrane.passed) if f.moving else (still, still)
        # lists within a film move along with it; those between regions do not
        self.at_rest = film.zeros(film.regions, wp.vec3) if f.foam else self.frame
        self.dt = Setting(film.device)
        self._all, self._half = (wp.full(1, share, dtype=wp.float32, device=film.device) for share in (1.0, 0.5))
        self.extras = [stage(weakref.proxy(self)) for stage in f.stages]
        self.wall = dict.fromkeys([*STAGES, *(stage.name for stage in self.extras)], 0.0)
        self.accounts: dict[str, Account] = {}
        self.whole = film.device.is_cuda
        rows = max(film.n_e, film.n_l)
        self._later = {row.name for row in TABLE if row.later}
        self._stages = {name: Recorded(run, film.device, self._rows(name)) for name, run in self._all_stages()}
        self._graphs = [Recorded(run, film.device, rows) for run in (self._move, self._follow)]
        self.geometry.update() if fresh else self.geometry.again()

    def _make_fields(self) -> Fields:
        return Fields(self.film, self.state, self.geometry)

    def _make_membrane(self) -> Membrane | FoamMembrane:
        common = [self.film, self.state, self.lists, self.geometry, self.fields, self.forces]
        return FoamMembrane(*common) if self.film.features.foam else Membrane(*common, self.rim)

    def _table(self) -> dict[str, Callable[[], None]]:
        """The stages of a step in their order."""
        moving, lagrangian = self.film.features.moving, self.film.features.lagrangian
        table = {
            "l_to_e": self._gather if lagrangian else self._keep,
            "membrane": self._solve_normal if moving else None,
            "surfactant": self._solve_tangential if lagrangian else None,
            "e_to_l": self._scatter if lagrangian else None,
            "advance_e": self._advance_e if moving else None,
            "geometry": self._find_geometry if moving else None,
            "advance_l": self._advance_l if lagrangian else None,
        }
        return {name: run for name, run in table.items() if run is not None}

    def _all_stages(self) -> Iterator[tuple[str, Callable[[], None]]]:
        """The stages in their order, the scene's own after those that they name."""
        table = self._table()
        for stage in self.extras:
            require(
                stage.after in table, f"after of stage {stage.name}", stage.after, f"one of {', '.join(table)} here"
            )
        for name, run in table.items():
            yield name, run
            for stage in self.extras:
                if stage.after == name:
                    if name in self._later:
                        self._later.add(stage.name)
                    yield stage.name, stage.run

    def _rows(self, name: str) -> int:
        """Threads of a stage's largest kernels."""
        of_e = any(row.name == name and not row.of_l for row in TABLE)
        return self.film.n_e if of_e else max(self.film.n_e, self.film.n_l)

    def step(self, dt: float) -> None:
        """Advance the film by dt (s)."""
        self.prepare(dt)
        if self.edge is not None:
            self.edge.hold()
        move, follow = self._graphs if self.whole else (self._move, self._follow)
        self._timed("neighbors", self._find_neighbors)
        move()
        if self.film.features.moving or self.film.features.single:
            self._timed("geometry", self.lists.update_e)
        follow()
        if self.edge is not None:
            self.edge.advance(dt)
        self.lists.look(dt)
        self.state.time += dt

    def prepare(self, dt: float) -> wp.array:
        """Set what depends on the step dt (s) to come; `dt` as the stages take it."""
        for stage in (self.forces, self.exchange, self.mixing, self.transfer, self.membrane, self.tangential):
            if stage is not None:
                stage.prepare(dt)
        for stage in self.extras:
            stage.prepare(dt)
        self.lists.expect(dt)
        return self.dt.at(dt)

    def _move(self) -> None:
        """Run the stages up to where E have moved."""
        self._run(lambda name: name not in self._later)

    def _follow(self) -> None:
        """Run the other stages."""
        self._run(lambda name: name in self._later)

    def _run(self, wanted: Callable[[str], bool]) -> None:
        for name, stage in self._stages.items():
            if wanted(name):
                self._timed(name, stage)

    def _timed(self, name: str, stage: Callable[[], None]) -> None:
        began = time.perf_counter()
        stage()
        self.wall[name] += time.perf_counter() - began

    def _find_neighbors(self) -> None:
        self.lists.update_l()
        if self.exchange is not None and self.exchange.due:
            with self._weighed():
                self.exchange.apply(self.dt.array)  # (27), (28)
        if self.mixing is not None and self.mixing.due:
            with self._weighed():
                self.mixing.apply()

    def _weighed(self) -> AbstractContextManager:
        """Where L exchange what they hold."""
        return nullcontext() if self.budget is None else self.budget.weigh_held()

    def _gather(self) -> None:
        self.lists.note_late(1)
        self.transfer.l_to_e()  # (6), (7)
        if self.circulation is not None:
            self.circulation.restore()
        self.tangential.begin()
        self._find_fields()

    def _keep(self) -> None:
        self.film.launch_e(kt.keep_normal_e, [self.state.e.normal], [self.state.e.u])
        self._find_fields()

    def _find_fields(self) -> None:
        self.fields.update()
        self.forces.update()
        if self.budget is not None:
            self.budget.open_step()
        self._guard_e("l_to_e")

    def _solve_normal(self) -> None:
        self.membrane.solve(self.dt.array)  # (12), gas
        if self.tangential is None:
            self._slow_down(self._all)
            self.forces.settle(self._all, self.dt.array)
            if self.budget is not None:
                self.budget.book_forces()
        self._guard_e("membrane")

    def _solve_tangential(self) -> None:
        self.tangential.solve(self.dt.array)  # (14), (15)
        if self.film.features.recoils:
            self.membrane.recoil(self.tangential.traction, self.tangential.theta, self.dt.array)
        self._slow_down(self.tangential.theta)
        if self.film.features.moving:
            self.membrane.find_motion_at(self._half if self.film.features.circulation else self.tangential.theta)
        self.tangential.find_widening(self.passed, self.dt.array)
        self._guard_e("surfactant")

    def _slow_down(self, theta: wp.array) -> None:
        """Let the air hold back a film as a whole; foams see to that in their solve."""
        if self.film.features.dragged and not self.film.features.foam:
            self.membrane.slow_down(theta, self.dt.array)

    def _scatter(self) -> None:
        flow = self.tangential
        self.forces.settle(flow.theta, self.dt.array)
        if self.circulation is not None:
            self.circulation.take(flow, self.dt.array)
        self.transfer.e_to_l(flow.widening, flow.before, flow.theta)  # (16)-(18), (8)
        flow.finish()
        if self.edge is not None:
            self.edge.still()
        if self.budget is not None:
            self.budget.book_forces()
        self._guard_l("e_to_l")

    def _advance_e(self) -> None:
        foam, dt = self.film.features.foam, self.dt.array
        if not foam:
            self.membrane.find_frame()
            self.membrane.before_move()
            if self.budget is not None:
                self.budget.book_range(after=False)
        self.e_advance.advance(self.membrane.u_mid, self.frame, dt)  # (19), (20)
        if foam:
            self.membrane.recall()
        if self.budget is not None and (foam or self.redistribution is not None):
            self.budget.book_shifts()
        if self.rim is not None:
            self.rim.extend()
        self.lists.record_e(self.e_advance.x_old, self.at_rest, dt)
        self._guard_e("advance_e")

    def _find_geometry(self) -> None:
        self.lists.note_late(0)
        self.geometry.update()  # (9), (10), (11)
        if self.film.features.foam:
            if self.budget is not None:
                self.budget.book_stars()
            self.membrane.close_volume()
        elif self.film.features.closed:
            self.membrane.after_move()
            if self.budget is not None:
                self.budget.book_range(after=True)
        self._guard_e("geometry")

    def _advance_l(self) -> None:
        if self.edge is not None:
            self.edge.mark()
        self.l_advance.advance(self.frame, self.passed, self.tangential.bend, self.dt.array)  # Algorithm 7
        if self.edge is not None:
            self.edge.move(self.dt.array)
        if self.rim is not None:
            self.rim.confine()
            if self.carriage is not None:
                self.carriage.collect()
        self.lists.record_l(self.at_rest, self.dt.array)
        self._guard_l("advance_l")

    def _guard_e(self, name: str) -> None:
        """Note on the device the first stage that leaves a number of E that is not finite."""
        e = self.state.e
        self.film.launch_e(kd.find_broken, [e.x, e.u, STAGES.index(name) + 1], [self.broken])

    def _guard_l(self, name: str) -> None:
        """The same for L."""
        lag = self.state.l
        launch(kd.find_broken, self.film.n_l, [lag.x, lag.v, STAGES.index(name) + 1], [self.broken], self.film.device)

    def _solvers(self) -> dict[str, tuple[ConjugateGradient | RationalLaplacian, ...]]:
        """The solvers of each kind of solve that must end within its tolerance."""
        flow, air = self.tangential, getattr(self.membrane, "air_range", None)
        solvers = {
            "membrane": self.membrane.solvers if self.membrane else (),
            "air": (air.solver,) if air else (),
            "surfactant": (flow.solver,) if flow and flow.solver else (),
            "viscosity": (flow.viscous,) if flow and flow.viscous else (),
            "circulation": (self.circulation.solver,) if self.circulation else (),
        }
        return {name: found for name, found in solvers.items() if found}

    def _find_accounts(self) -> dict[str, Account]:
        """What became of the solves of each kind since `remark` (reads back)."""
        accounts = {name: [solver.account() for solver in found] for name, found in self._solvers().items()}
        return {name: reduce(add, found) for name, found in accounts.items()}

    def check(self) -> None:
        """Raise if a stage left a number that is not finite, a list overflowed or the gas collapsed (reads back).

        Raises:
            SimulationError: names the stage and the particle or the solve.
        """
        stage, particle = (int(v) for v in self.broken.numpy())
        if stage:
            name = STAGES[stage - 1]
            kind = "L" if name in ("e_to_l", "advance_l") else "E"
            raise SimulationError(f"stage {name}: {kind} particle {particle} is not finite")
        for name, account in self._find_accounts().items():
            if not account.worst < WORTHLESS:
                raise SimulationError(f"stage {SOLVED_IN[name]}, solver {name}: {account.text}")
        if self.film.features.closed:
            volume = self.state.gas.numpy()[:, 0]
            k = int(np.argmin(volume))
            if not np.all(volume > 0.0):
                raise SimulationError(f"stage membrane: the enclosed volume is {volume[k]:.3g} m^3, region {k}")
        self.lists.check()
        if self.film.features.foam:
            self.membrane.check()
        for stage in self.extras:
            stage.check()

    def settle(self) -> None:
        """Bring the state up to date with what stages sum up over several steps."""
        if self.film.features.collects:
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
        for solver in chain.from_iterable(self._solvers().values()):
            solver.forget()
        stages = (self.rim, self.transfer, self.membrane, self.tangential, self.redistribution, self.l_advance)
        for stage in (self.fields, *stages):
            if hasattr(stage, "remark"):
                stage.remark(notices)


class NoFilm:
    """Takes the place of a stepper when the last film has popped or burst: time passes and nothing else happens."""

    def __init__(self, film: Film, state: State):
        self.film, self.state, self.budget = film, state, None
        self.wall = dict.fromkeys(STAGES, 0.0)

    def step(self, dt: float) -> None:
        """Let dt (s) pass."""
        self.state.time += dt

    def settle(self) -> None:
        """There is nothing to bring up to date."""

    def remark(self, notices: Notices) -> None:
        """There is nothing to note."""
