"""The stages of MELP's step, in the order of `TABLE` (docs/stages.md); single_layer.py has those of one layer."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import numpy as np

from melp_warp.errors import SimulationError
from melp_warp.kernels import transfer as kt
from melp_warp.stage import Solve, Stage
from melp_warp.stages.notices import Notices


class FindNeighbors(Stage):
    """Lists between E and L, where pairs could be missing."""

    name = "neighbors"
    velocity = "that of the step before"
    recorded = False

    def run(self) -> None:
        """Rebuild them where it is time."""
        self.stepper.lists.update_l()


class _Trade(Stage):
    """L give each other what they hold, whenever the part that knows how says that it is due."""

    writes = ("l.u", "l.mass", "l.surfactant", "l.eta")
    recorded = False

    @property
    def part(self):
        """What knows when, and how."""
        return getattr(self.stepper, self.needs[0])

    def prepare(self, dt: float) -> None:
        """Find whether it is time."""
        self.part.prepare(dt)

    def run(self) -> None:
        """Let them, where it is time, and book it."""
        if self.part.due:
            with self._weighed():
                self.trade()

    def trade(self) -> None:
        """Let them."""

    def _weighed(self) -> AbstractContextManager:
        budget = self.stepper.budget
        return nullcontext() if budget is None else budget.weigh_held()


class CrossPartitions(_Trade):
    """Liquid crosses partitions."""

    name, equation, needs = "exchange", "(27), (28)", ("exchange",)
    writes = (*_Trade.writes, "l.circulation")

    def trade(self) -> None:
        """Let it cross."""
        self.part.apply(self.stepper.dt.array)


class MixLiquid(_Trade):
    """Near L mix where the flow shears them."""

    name, needs = "mixing", ("mixing",)

    def trade(self) -> None:
        """Let them mix."""
        self.part.apply()


class FindFlow(Stage):
    """E alone: their velocity is that across the film, nothing carries what lies in it."""

    name = "l_to_e"
    velocity = "across the film: at the start of the step"
    writes = ("e.u",)

    def prepare(self, dt: float) -> None:
        """Set gravity and the numbers of forces."""
        self.stepper.forces.prepare(dt)

    def run(self) -> None:
        """Find what E hold and what acts on them."""
        self.find_velocity()
        self.stepper.fields.update()
        self.stepper.forces.update()
        if self.stepper.budget is not None:
            self.stepper.budget.open_step()

    def find_velocity(self) -> None:
        """Find it at the start of the step."""
        self.film.launch_e(kt.keep_normal_e, [self.state.e.normal], [self.state.e.u])

    def remark(self, notices: Notices) -> None:
        """Note where no tension is left."""
        self.stepper.fields.remark(notices)


class PassToE(FindFlow):
    """L give E mass, surfactant, momentum and what the carrier adds."""

    equation = "(6), (7)"
    velocity = "along the film from the L, across it kept: at the start of the step"
    needs = ("transfer",)
    writes = ("e.u", "e.mass", "e.surfactant")
    of_l = True

    def prepare(self, dt: float) -> None:
        """Set gravity, the numbers of forces and how fast thicknesses are mended."""
        super().prepare(dt)
        self.stepper.transfer.prepare(dt)

    def find_velocity(self) -> None:
        """Sum up what L carry; E restore the rotation that they lack."""
        s = self.stepper
        s.lists.note_late(1)
        s.transfer.l_to_e()
        if s.circulation is not None:
            s.circulation.restore()
        s.tangential.begin()

    def solves(self) -> dict[str, Solve]:
        """That of the stream function, where L carry circulation."""
        circulation = self.stepper.circulation
        return {"circulation": Solve((circulation.solver,), circulation.solver.report)} if circulation else {}

    def report(self) -> dict:
        """Circulation and enstrophy."""
        circulation = self.stepper.circulation
        return circulation.diagnostics() if circulation else {}


class SolveNormal(Stage):
    """Tension, gas, weight and air across the film."""

    name, equation = "membrane", "(12)"
    velocity = "across the film at the end of the step, along it at its start"
    needs = ("membrane",)
    writes = ("e.u", "gas", "motion")

    def prepare(self, dt: float) -> None:
        """Set how far ahead forces are taken."""
        self.stepper.membrane.prepare(dt)

    def run(self) -> None:
        """Solve; without a flow along the film that is all that changes the velocity."""
        s, dt = self.stepper, self.stepper.dt.array
        s.membrane.solve(dt)
        if s.tangential is None:
            self.finish(dt)

    def finish(self, dt) -> None:
        """Let the air hold the film back, settle what forces have done and book it."""
        s = self.stepper
        s.membrane.slow_down(s.all, dt)
        s.forces.settle(s.all, dt)
        if s.budget is not None:
            s.budget.book_forces()

    def check(self) -> None:
        """Raise if the gas collapsed, or regions press on more E than there is room for."""
        if self.film.features.closed:
            volume = self.state.gas.numpy()[:, 0]
            k = int(np.argmin(volume))
            if not np.all(volume > 0.0):
                raise SimulationError(f"stage membrane: the enclosed volume is {volume[k]:.3g} m^3, region {k}")
        self.stepper.membrane.check()

    def solves(self) -> dict[str, Solve]:
        """That of the membrane, unless it is explicit."""
        membrane = self.stepper.membrane
        return {"membrane": Solve(membrane.solvers, membrane.response.report)} if membrane.solvers else {}

    def report(self) -> dict:
        """What there is to say of regions."""
        return self.stepper.membrane.report()


class SolveTangential(Stage):
    """Surfactant, viscosity, drag and outside forces along the film."""

    name, equation = "surfactant", "(14), (15)"
    velocity = "after the share theta of the step (`Tangential.theta`)"
    needs = ("tangential",)
    writes = ("e.u",)

    def prepare(self, dt: float) -> None:
        """Set the bounds of theta."""
        self.stepper.tangential.prepare(dt)

    def run(self) -> None:
        """Solve, let what that does to the film as a whole happen, and find how L will move."""
        s, dt = self.stepper, self.stepper.dt.array
        flow, membrane = s.tangential, s.membrane
        flow.solve(dt)
        if self.film.features.recoils:
            membrane.recoil(flow.traction, flow.theta, dt)
        if membrane is not None:
            membrane.slow_down(flow.theta, dt)
            membrane.find_motion_at(s.half if s.circulation else flow.theta)
        flow.find_widening(s.passed, dt)

    def solves(self) -> dict[str, Solve]:
        """Those of surfactant and viscosity, where there are any."""
        flow = self.stepper.tangential
        found = {"surfactant": flow.solver, "viscosity": flow.viscous}
        return {name: Solve((solver,), solver.report) for name, solver in found.items() if solver is not None}

    def remark(self, notices: Notices) -> None:
        """Note a drainage length that E do not resolve."""
        self.stepper.tangential.remark(notices)


class PassToL(Stage):
    """E give L velocity, affine state and thickness."""

    name, equation = "e_to_l", "(16)-(18), (8)"
    velocity = "at the end of the step"
    needs = ("transfer",)
    writes = ("l.u", "l.v", "l.affine", "l.normal", "l.eta", "l.circulation", "e.u")
    of_l = True

    def run(self) -> None:
        """Pass on what the step has changed, and book it."""
        s, flow, dt = self.stepper, self.stepper.tangential, self.stepper.dt.array
        s.forces.settle(flow.theta, dt)
        if s.circulation is not None:
            s.circulation.take(flow, dt)
        features = self.film.features
        packed = flow.gamma if features.marangoni and not features.tears else None
        s.transfer.e_to_l(flow.widening, flow.before, flow.theta, packed, flow.swelling if features.moving else None)
        flow.finish()
        if s.edge is not None:
            s.edge.still()
        if s.budget is not None:
            s.budget.book_forces()

    def remark(self, notices: Notices) -> None:
        """Note where a film is too thick to be one."""
        self.stepper.transfer.remark(notices)


class AdvanceE(Stage):
    """E move with the surface and are spaced evenly on it."""

    name, equation = "advance_e", "(19), (20)"
    velocity = "the same; E have moved"
    needs = ("e_advance",)
    writes = ("e.x", "e.u")

    def run(self) -> None:
        """Move them, and the film beyond the rim."""
        s, dt = self.stepper, self.stepper.dt.array
        s.membrane.find_frame()
        if s.air_range is not None:
            s.air_range.measure()
        if s.budget is not None:
            s.budget.book_range(after=False)
            s.budget.book_shape(after=False)
        s.e_advance.advance(s.membrane.u_mid, s.frame, dt)
        s.membrane.recall()
        if s.budget is not None:
            s.budget.book_shifts()
        if s.rim is not None:
            s.rim.extend()
        s.lists.record_e(s.e_advance.x_old, s.at_rest, dt)

    def solves(self) -> dict[str, Solve]:
        """Those of the air's energy, and of even spacing, which need not come to its tolerance."""
        s = self.stepper
        found = {"air": Solve((s.air_range.solver,))} if s.air_range is not None else {}
        return found | ({"redistribution": Solve((), s.redistribution.solver.report)} if s.redistribution else {})

    def remark(self, notices: Notices) -> None:
        """Note air beyond its range."""
        if self.stepper.air_range is not None:
            self.stepper.air_range.remark(notices)

    def report(self) -> dict:
        """How unevenly E are spaced."""
        spaced = self.stepper.redistribution
        return {"e_spread": float(spaced.spread.numpy()[:, 0].max())} if spaced else {}


class FindGeometry(Stage):
    """Normals, fits, curvatures, areas and volumes; then the gas law holds again."""

    name, equation = "geometry", "(9)-(11)"
    velocity = "the same; normals, areas and volumes are new"
    needs = ("membrane",)
    writes = ("e.normal", "e.x", "e.u", "gas")
    later = True

    def run(self) -> None:
        """Find them, and mend what the move has made of energy and volume."""
        s = self.stepper
        s.lists.note_late(0)
        s.geometry.update()
        s.membrane.keep_speed()
        if s.budget is not None:
            s.budget.book_stars()
        if s.air_range is not None:
            s.air_range.damp()
        s.membrane.close_volume()
        if s.budget is not None:
            s.budget.book_end()


class AdvanceL(Stage):
    """L move with the flow and are kept on the surface, inside its rim."""

    name, equation = "advance_l", "Algorithm 7"
    velocity = "the same; L have moved"
    needs = ("l_advance",)
    writes = ("l.x", "l.u", "l.v", "l.mass", "l.surfactant")
    of_l = True
    later = True

    def run(self) -> None:
        """Move them; the rim keeps what runs into it."""
        s, dt = self.stepper, self.stepper.dt.array
        if s.edge is not None:
            s.edge.mark()
        s.l_advance.advance(s.frame, s.passed, s.tangential.bend, dt)
        if s.edge is not None:
            s.edge.move(dt)
        if s.rim is not None:
            s.rim.confine()
            if s.carriage is not None:
                s.carriage.collect()
        s.lists.record_l(s.at_rest, dt)


TABLE = (
    FindNeighbors,
    CrossPartitions,
    MixLiquid,
    PassToE,
    SolveNormal,
    SolveTangential,
    PassToL,
    AdvanceE,
    FindGeometry,
    AdvanceL,
)
"""The stages in their order; a film goes without those whose needs it has not."""
