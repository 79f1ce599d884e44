"""A simulation: a scene on a device, advanced frame by frame."""

from __future__ import annotations

import copy
import math
import os
import time

import numpy as np
import warp as wp

from melp_warp.budget import Ledger, Reading
from melp_warp.errors import CrowdedError, InputError, LeapError, SimulationError
from melp_warp.events import Events
from melp_warp.files import load_arrays, save_arrays
from melp_warp.film import Film
from melp_warp.frame import BLACK_FILM, ParticleFrame
from melp_warp.interrupt import let_through
from melp_warp.kernels import advance as ka
from melp_warp.kernels import diagnostics as kd
from melp_warp.launch import launch
from melp_warp.notices import Notices
from melp_warp.sampling import FAR, MOST_TURN, make_film, resume, unresolved
from melp_warp.scene import MOST_STEPS, Scene
from melp_warp.single_layer import make_stepper
from melp_warp.state import GAS_SLOTS, Snapshot
from melp_warp.stepper import STAGES, Stepper
from melp_warp.stored import check_stored, kinds_of
from melp_warp.surgery import Stored

LEAP = 0.3
"""Longest way of a particle in one step, relative to the film as a whole and in radii of the film.

Beyond it the change of curvature is no longer nearly linear in the motion, which the implicit step rests on.
"""

LEAST_CUT = 1.0 / 16.0
"""Least part of a step in which a leap is made that is tried next."""

LEAST_STEP = 0.3
"""Step at which a leap ends the run, in times in which the fastest wave crosses a spacing: the step is not to blame."""

MOST_STEPS_AGAIN = 2000
"""Steps to which a frame that leaps is cut: one that wants more wants a smaller dt, or another scene."""

FASTEST = 100.0
"""Speed of the liquid in a flat film that runs are made for, m/s: its waves may be slow."""

MOST_ROOM = 12.0
"""Room of neighbour lists, over what they need when they are made, at which particles are taken to have clumped."""

AREA = GAS_SLOTS.index("area")


def find_device(name: str) -> wp.Device:
    """The Warp device of that name.

    Raises:
        InputError: no such device here.
    """
    try:
        return wp.get_device(name)
    except Exception:
        known = ", ".join(str(d) for d in wp.get_devices())
        raise InputError(f"device must be one of {known} on this machine, got {name!r}") from None


class Simulation:
    """A scene in time.

    Args:
        scene: what to simulate.
        device: "cpu", "cuda:0", ...

    Raises:
        InputError: the scene or the device cannot be used.

    Attributes:
        has_l: whether there are Lagrangian particles.
        notices: what whoever uses the results must know of them.
        ledger: the energy budget so far; None where the scene wants none.
        spilled: liquid that left with films that popped, kg.
        origin: [3] float64, m: where `particles` measures from, the same for the whole run.
        watched: whether every step is checked at once, which a GPU would have to be waited for; else between frames.
        step_seconds: wall time of each step, s; the first ones load and record kernels, and on a GPU this is the time
            of launching alone.
    """

    def __init__(self, scene: Scene, device: str = "cpu"):
        self.scene = scene
        self.spilled = 0.0
        self.step_seconds: list[float] = []
        self.device = find_device(device)
        try:
            self.film, self.stepper = make_film(scene, self.device)
        except (MemoryError, RuntimeError) as error:
            if isinstance(error, SimulationError) or "alloc" not in str(error).lower():
                raise
            count = scene.e_count * (1 + scene.l_per_e)
            raise InputError(
                f"e_count and l_per_e must fit the memory of {self.device}, got {count:,} particles"
            ) from None
        self.has_l = self.stepper.state.l is not None
        self._last_dt, self._step_limit, self._substeps = 0.0, 0.0, 0
        self.watched = not self.device.is_cuda
        self._cap = math.inf
        self.origin = self.stepper.state.origin
        self._ids = {"e": np.arange(self.film.n_e), "l": np.arange(self.film.n_l)}
        self._adopt(self.film, self.stepper)
        self._wave_speed = self._fastest_wave()
        self.events = Events(scene.shape) if self.film.features.foam else None
        self.notices = Notices()
        self._look_at_shape()
        self._open_ledger()
        self._remark()

    @property
    def gone(self) -> bool:
        """Whether the last film has popped: there are no particles, and time passes until a bubble appears."""
        return self.film.n_e == 0

    def _look_at_shape(self) -> None:
        """Note a shape that the E are too few for."""
        turn = unresolved(self.scene, self.stepper)
        if turn > MOST_TURN:
            text = f"E normals are {turn:.3g} degrees off the shape's (rms), {MOST_TURN:g} at most: raise e_count"
            self.notices.note("shape unresolved", turn, text)

    def _adopt(self, film: Film, stepper: Stepper) -> None:
        """Go on with this film and stepper."""
        self.film, self.stepper, self.state = film, stepper, stepper.state
        self._snapshot = Snapshot(self.state)
        if self.gone:
            return
        self._summary = film.parts(kd.vec12d)
        self._energy = film.parts(wp.float64)
        size = float(np.sqrt(self.state.gas.numpy()[:, AREA].min() / np.pi))
        self._reach = LEAP * (0.5 * size if film.features.closed else size)

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.state.time

    @property
    def frame(self) -> int:
        """Index of the last finished frame; 0 is the initial state."""
        return self.state.frame

    def step(self, dt: float) -> None:
        """One step of dt seconds."""
        began = time.perf_counter()
        self.stepper.step(dt)
        self.step_seconds.append(time.perf_counter() - began)
        self._last_dt = dt

    def advance_frame(self) -> None:
        """Advance by 1/fps.

        A frame in which a particle leaps or a neighbour list overflows is done again, in smaller steps or with more
        room. One that went wrong while nobody looked is first done again with a look at every step, which finds out
        what came first.

        Raises:
            SimulationError: names the stage and the particle; the state is then that of the last good frame.
        """
        end = (self.state.frame + 1) / self.scene.fps
        good, watched = self._mark(), self.watched
        while True:
            try:
                self._advance_to(end, watched)
                break
            except SimulationError as error:
                again = not watched or self._give_way(error)
                watched = True
                self._go_back(good)
                if not again:
                    raise SimulationError(f"{error}, at {end:.4g} s in frame {self.state.frame + 1}") from None
        self.state.frame += 1
        self.state.time = end
        self._cap *= 2.0
        self.stepper.settle()
        self._remark()
        self._recentre()
        self._snapshot.save(self.state)
        if self.stepper.budget is not None:
            self.stepper.budget.save()

    def _open_ledger(self) -> None:
        """Start an energy budget, where the scene wants one."""
        features = self.film.features
        self.ledger = Ledger(whole=not (features.foam or features.air)) if features.budget else None
        if self.stepper.budget is not None:
            self.stepper.budget.restart()
            self.ledger.open(self._weighed())

    def _weighed(self) -> Reading:
        """The budget with the liquid where it is now (reads back)."""
        self.stepper.budget.weigh()
        return self.stepper.budget.read()

    def _remark(self) -> None:
        """Note what must be known of the frame that is done (reads back)."""
        if self.stepper.budget is not None:
            self.ledger.take(self.stepper.budget.read(), self.time - self._last_dt)
            self.ledger.remark(self.notices)
        self.stepper.remark(self.notices)
        self.notices.end(self.frame)

    def _advance_to(self, end: float, watched: bool) -> None:
        """Take steps until `end` (s), each checked at once if it is `watched`."""
        self.notices.begin()
        self._change_regions()
        self._substeps = 0
        for stage in STAGES:
            self.stepper.wall[stage] = 0.0
        if not self.gone:
            self.stepper.lists.forget_leaps()
        while end - self.time > 1e-9 / self.scene.fps:
            let_through()
            if not self.gone:
                self.stepper.lists.watched = watched
            self.step_towards(end)
            if watched:
                self._check()
            if not self.gone and not end - self.time > 1e-9 / self.scene.fps:
                self.stepper.check_gas()  # before regions change: new ones take a step to come to their volume
            self._change_regions()
        self._check()
        if self.has_l and not self.gone:
            self.stepper.transfer.check()

    def _check(self) -> None:
        """Raise if the steps of this frame went wrong (reads back)."""
        if self.gone:
            return
        self._check_way()
        self.stepper.check()

    def _check_way(self) -> None:
        """Raise if a particle moved too far in a step; the explicit scheme is left to its user."""
        travel = self.stepper.lists.travel.numpy()[4:]
        if travel.max() > self._reach and self.scene.numerics.scheme != "explicit":
            which = "E" if travel[0] >= travel[1] else "L"
            raise LeapError(
                f"stage advance_{which.lower()}: {which} move {travel.max():.3g} m in a step of {self._last_dt:.3g} s,"
                f" more than {LEAP:g} of the film's radius"
            )

    def _give_way(self, error: SimulationError) -> bool:
        """Ask for what an error calls for, smaller steps or more room; whether there is any left to give."""
        if isinstance(error, LeapError):
            travel = float(self.stepper.lists.travel.numpy()[4:].max())
            self._cap = 0.5 * self._last_dt * max(self._reach / max(self._reach, travel), LEAST_CUT)
            fastest = self._wave_speed if self.film.features.moving else max(self._wave_speed, FASTEST)
            least = LEAST_STEP * self.film.spacing / fastest
            return self._cap > max(least, 1.0 / (self.scene.fps * MOST_STEPS_AGAIN))
        if isinstance(error, CrowdedError):
            self.film.room *= 2.0
            return self.film.room < MOST_ROOM
        return False

    def _mark(self) -> tuple:
        """What to go back to if the coming frame fails, besides the arrays, which the snapshot holds."""
        events = self.events.mark() if self.events else None
        return self.film, self.stepper, self._snapshot, dict(self._ids), self.spilled, events, copy.copy(self.ledger)

    def _go_back(self, good: tuple) -> None:
        """Return to the last good frame, regions that changed since included."""
        room = self.film.room
        film, stepper, snapshot, ids, self.spilled, events, self.ledger = good
        film.room = room
        self._ids = dict(ids)
        self._adopt(film, stepper)
        self._snapshot = snapshot
        self._snapshot.restore(self.state)
        self.ledger = copy.copy(self.ledger)
        if self.stepper.budget is not None:
            self.stepper.budget.restore()
        if self.events:
            self.events.back(events)
        self._renew()

    def _renew(self) -> None:
        """Make anew what the stages keep between steps (lists, fits, first guesses) from the state, which stays."""
        self._last_dt, self._step_limit = 0.0, 0.0
        if self.gone:
            return
        film, kept, area, budget = self.film, Snapshot(self.state), self.stepper.geometry.area, self.stepper.budget
        self.stepper = make_stepper(film, self.state)
        if budget is not None:
            self.stepper.budget.take(budget)
        if film.features.foam:
            self.stepper.fields.update()
            self.stepper.membrane.start_motion()
        if not film.features.moving:  # areas were found from the L at the start
            self.stepper.geometry.set_area(area)
        kept.restore(self.state)
        if self.has_l:
            self.stepper.lists.rebuild_l()

    def _recentre(self) -> None:
        """Measure positions from a closed film itself once it has flown far."""
        film, state = self.film, self.state
        if not film.features.closed or film.features.foam:
            return
        away = state.e.x[:1].numpy()[0].astype(np.float64)
        if np.abs(away).max() > 2.0 * FAR * film.radius:
            for x in (state.e.x, *([state.l.x] if state.l else [])):
                launch(ka.shift_origin_e, x.shape[0], [wp.vec3(*away)], [x], self.device)
            state.origin = state.origin + away

    def step_towards(self, end: float) -> float:
        """Take one step of those in which a frame that ends at `end` (s) is done; its size, s."""
        left = self._until(end) - self.time
        if self.gone:
            self.step(left)
            return left
        self._step_limit = self.largest_step()
        count = math.ceil(left / self._step_limit - 1e-6)
        if count == 1 and self.stepper.budget is not None:
            self.stepper.budget.weigh()
        self.step(left / count)
        self._substeps += 1
        return self._last_dt

    def _until(self, end: float) -> float:
        """End of the frame, or the time of an event before it, s."""
        following = self.events.following(self.time) if self.events else None
        return end if following is None else min(end, following)

    def _change_regions(self) -> None:
        """Let regions pop, merge and appear whose time has come; the run is set up anew for what is left."""
        while self.events is not None and (change := self.events.due(self)) is not None:
            stored = Stored(self.state.numpy(), dict(self._ids), list(self.film.labels), self.spilled)
            change(stored)
            self.stepper.remark(self.notices)
            if self.stepper.budget is not None:
                self.ledger.cut(self.stepper.budget.read(), self.stepper.budget.pending())
            self._ids, self.spilled = stored.ids, stored.spilled
            self._adopt(*self._resumed(stored.arrays, tuple(stored.labels)))
            if self.stepper.budget is not None:
                self.ledger.open(self._weighed())

    def _resumed(self, stored: dict[str, np.ndarray], labels: tuple[int, ...]) -> tuple[Film, Stepper]:
        """Film and stepper of this foam with other regions."""
        return resume(self.scene, stored, labels, self.film.spacing, self.device, self.film.room)

    def largest_step(self) -> float:
        """The scene's dt, or the step in which the fastest particle moves `cfl` spacings, s.

        A single layer is limited by its waves besides, see `SingleLayer.longest_step`.
        Where the scene sets no dt, the first step is that of the fastest wave on the film and a step is at most twice
        the one before: at the start nothing has moved yet.
        """
        limit = min(1.0 / self.scene.fps, self._cap)
        if self.film.features.single:
            limit = min(limit, self.stepper.longest_step(self._fastest()))
        if self.scene.dt is not None:
            return min(limit, self.scene.dt)
        if self.film.features.foam:
            limit = min(limit, self.stepper.membrane.longest_step(self._fastest()))
        reach = self.scene.numerics.cfl * self.film.spacing
        if self._step_limit == 0.0:
            return min(limit, reach / self._wave_speed)
        speed = self._fastest()
        wanted = min(2.0 * self._step_limit, reach / speed if speed > 0.0 else limit)
        if wanted * MOST_STEPS * self.scene.fps < 1.0:
            raise SimulationError(
                f"stage advance_e: cfl asks for steps of {wanted:.3g} s at a speed of {speed:.3g} m/s,"
                f" more than {MOST_STEPS:,} a frame"
            )
        return min(limit, wanted)

    def _fastest(self) -> float:
        """Speed of the fastest particle in the last step, on a GPU in the one before, m/s; 0 where none was done."""
        seen = self.stepper.lists.seen.get()
        return float(seen[0][2:4].max()) / seen[1][0] if seen else 0.0

    def _fastest_wave(self) -> float:
        """Fastest wave: sqrt(2 sigma/m) where the film can move, sqrt(2 R T Gamma/m) where it is flat, m/s."""
        m = self.scene.material
        tension = m.film_tension if self.film.features.moving else m.rt * m.surfactant
        particles = self.state.l or self.state.e
        v = particles.u.numpy()[: particles.count]
        return math.sqrt(2.0 * tension / m.areal_mass) + float(np.sqrt((v**2).sum(axis=1)).max()) + 1e-9

    def particles(self, which: str) -> ParticleFrame:
        """The L ("l") or E ("e") as NumPy arrays."""
        if self.gone:
            return ParticleFrame.empty(tuple(self.origin.tolist()))
        n = self.film.n_l if which == "l" else self.film.n_e
        if which == "l":
            lag = self.state.l
            x, v, normal, eta = (a.numpy() for a in (lag.x, lag.v, lag.normal, lag.eta))
            area = lag.mass.numpy() / (self.scene.material.density * eta)
            there = area > 0.0  # the rim has collected the liquid of the others
        else:
            self.stepper.fields.update()
            e = self.state.e
            x, v, normal = e.x.numpy()[:n], self._e_velocity(), e.normal.numpy()[:n]
            eta, area = self.stepper.fields.eta.numpy(), self.stepper.geometry.area.numpy()
        source = self.state.l if which == "l" else self.state.e
        region = np.array(self.film.labels, dtype=np.int32)[source.region.numpy()[:n]]
        ids = self._ids[which]
        order = np.argsort(ids, kind="stable") if self.film.features.foam else slice(None)
        if which == "l" and self.film.features.collects:
            order = np.flatnonzero(there)
        thickness = (eta * 1e9).astype(np.float32)[order]
        return ParticleFrame(
            points=(x + (self.state.origin - self.origin)).astype(np.float32)[order],
            velocities=v.astype(np.float32)[order],
            ids=ids[order].astype(np.int64),
            widths=np.sqrt(4.0 / np.pi * area).astype(np.float32)[order],
            normals=normal.astype(np.float32)[order],
            thickness=thickness,
            region=region[order],
            black_film=(thickness <= BLACK_FILM).astype(np.int32),
            origin=tuple(self.origin.tolist()),
        )

    def _e_velocity(self) -> np.ndarray:
        """[n_e, 3] m/s at which the E themselves move, (19): with the surface, while the liquid flows past them."""
        film, e, n = self.film, self.state.e, self.film.n_e
        u = e.u.numpy()[:n]
        if film.features.single:
            return u
        if not film.features.moving:
            return np.zeros_like(u)
        normal = e.normal.numpy()[:n]
        along = self.state.motion.numpy()[e.region.numpy()[:n]]
        return along + np.sum((u - along) * normal, axis=1, keepdims=True) * normal

    def diagnostics(self) -> dict:
        """Everything worth a line of the run's log; plain numbers (reads back)."""
        film, state, stepper = self.film, self.state, self.stepper
        if self.gone:
            return self._diagnostics_of_nothing()
        stepper.settle()
        stepper.fields.update()
        sums = self._sums()
        gas = state.gas.numpy()
        closed = film.features.closed
        result = {
            "frame": state.frame,
            "time": state.time,
            "dt": self._last_dt,
            "substeps": self._substeps,
            "solvers": self._solver_reports(),
            "e_count": film.n_e,
            "l_count": film.n_l,
            "area": float(gas[:, 4].sum()),
            "volume": float(gas[:, 0].sum()) if closed else None,
            "pressure": float(gas[0, 1]) if closed else None,
            **(self._foam_diagnostics(gas) if film.features.foam else {}),
            **(self._border_diagnostics() if film.features.collects else {}),
            "mass": sums[0],
            "surfactant": sums[1],
            "momentum": sums[2:5].tolist(),
            "kinetic_energy": sums[5],
            "surface_energy": self._surface_energy(),
            "max_speed": math.sqrt(sums[6]),
            **self._thickness_diagnostics(sums),
            "e_spread": float(stepper.redistribution.spread.numpy()[:, 0].max()) if stepper.redistribution else 0.0,
            "lost": len(stepper.lists.strays),
            "notices": dict(self.notices.of_frame),
            **({"budget": self.ledger.line()} if self.ledger is not None else {}),
            "wall_ms": {name: 1e3 * seconds for name, seconds in stepper.wall.items() if seconds > 0.0},
        }
        return {k: float(v) if isinstance(v, np.floating) else v for k, v in result.items()}

    def _diagnostics_of_nothing(self) -> dict:
        """The same keys once the last film has popped: sums are 0, and what has no value is None."""
        return {
            "frame": self.frame,
            "time": self.time,
            "dt": self._last_dt,
            "substeps": self._substeps,
            "solvers": {},
            **dict.fromkeys(("e_count", "l_count"), 0),
            **dict.fromkeys(("area", "volume"), 0.0),
            "pressure": None,
            **{name: [] for name in ("regions", "volumes", "pressures", "gas")},
            "covered": None,
            "spilled": self.spilled,
            **dict.fromkeys(("mass", "surfactant"), 0.0),
            "momentum": [0.0, 0.0, 0.0],
            **dict.fromkeys(("kinetic_energy", "surface_energy", "max_speed"), 0.0),
            **dict.fromkeys(("thickness_min", "thickness_mean", "thickness_max", "thickness_std"), None),
            "e_spread": 0.0,
            "lost": 0,
            "notices": dict(self.notices.of_frame),
            "wall_ms": {},
        }

    @staticmethod
    def _thickness_diagnostics(sums: np.ndarray) -> dict:
        """Thickness in nm; None where the rim has collected all liquid."""
        names = [f"thickness_{name}" for name in ("min", "mean", "max", "std")]
        if sums[10] == 0.0:
            return dict.fromkeys(names)
        mean, square = sums[9] / sums[10], sums[11] / sums[10]
        values = (sums[7], mean, sums[8], math.sqrt(max(square - mean**2, 0.0)))
        return {name: 1e9 * value for name, value in zip(names, values, strict=True)}

    def _border_diagnostics(self) -> dict:
        """Liquid (kg) and surfactant (mol) that the rim has collected, momentum that it has taken (kg m/s)."""
        border = self.state.border.numpy().tolist()
        return {"border_mass": border[0], "border_surfactant": border[1], "rim_impulse": border[2:]}

    def _foam_diagnostics(self, gas: np.ndarray) -> dict:
        return {
            "regions": list(self.film.labels),
            "volumes": gas[:, 0].tolist(),
            "pressures": gas[:, 1].tolist(),
            "gas": gas[:, 2].tolist(),
            "covered": float(np.minimum(self.stepper.membrane.cover.numpy(), 1.0).mean()),
            "spilled": self.spilled,
        }

    def _sums(self) -> np.ndarray:
        film, state = self.film, self.state
        if self.has_l:
            lag = state.l
            arrays = [lag.mass, lag.surfactant, lag.u, lag.v, lag.eta, film.material.density, film.n_l]
        else:
            e = state.e
            arrays = [e.mass, e.surfactant, e.u, e.u, self.stepper.fields.eta, film.material.density, film.n_e]
        film.launch_parts(kd.summarize_chunks, arrays, [self._summary])
        parts = self._summary.numpy()
        total = parts.sum(axis=0)
        total[6], total[7], total[8] = parts[:, 6].max(), parts[:, 7].min(), parts[:, 8].max()
        return total

    def _surface_energy(self) -> float:
        film, s = self.film, self.stepper
        cover = s.membrane.cover if film.features.foam else None
        film.launch_parts(
            kd.energy_chunks,
            [s.geometry.area, s.fields.gamma, self.state.e.region, film.tension, film.slope, cover, film.n_e],
            [self._energy],
        )
        return float(self._energy.numpy().sum())

    def _solver_reports(self) -> dict:
        s, reports = self.stepper, {}
        if s.membrane is not None and not s.membrane.explicit:
            reports["membrane"] = s.membrane.response.report()
        if s.tangential is not None and s.tangential.solver is not None:
            reports["surfactant"] = s.tangential.solver.report()
        if s.tangential is not None and s.tangential.viscous is not None:
            reports["viscosity"] = s.tangential.viscous.report()
        if s.redistribution is not None:
            reports["redistribution"] = s.redistribution.solver.report()
        lines = {name: {"iterations": i, "residual": r} for name, (i, r) in reports.items()}
        for name, account in s.accounts.items():
            lines.setdefault(name, {})
            lines[name] |= {"solves": account.solves, "unsolved": account.late, "worst": account.worst}
        return lines

    def save_checkpoint(self, path: str | os.PathLike) -> None:
        """Write the state to `path` (.npz), whole or not at all.

        The run goes on from what was written, lists and first guesses made anew: a run that loads the file goes on the
        same, bit for bit on the CPU.
        """
        self.stepper.settle()
        save_arrays(path, {**self.state.numpy(), **self._foam_record()})
        self.renew()

    def _foam_record(self) -> dict[str, np.ndarray]:
        """What a checkpoint of a foam holds besides the state."""
        if self.events is None:
            return {}
        return {
            **{f"ids.{kind}": ids for kind, ids in self._ids.items()},
            "labels": np.array(self.film.labels, dtype=int),
            "unborn": np.array(self.events.unborn, dtype=int),
            "spilled": np.array(self.spilled),
        }

    def _load_foam(self, stored: dict[str, np.ndarray]) -> None:
        self._ids = {kind: stored[f"ids.{kind}"] for kind in "el"}
        self.spilled = float(stored["spilled"])
        self.events = Events(self.scene.shape)
        self.events.skip(float(stored["time"]), stored["unborn"].tolist())
        labels = tuple(int(k) for k in stored["labels"])
        self._adopt(*self._resumed(stored, labels))
        self._take(stored)

    def _take(self, stored: dict[str, np.ndarray]) -> None:
        """Go on from the values of a state of these sizes."""
        self.state.load(stored)
        self.renew()
        self._open_ledger()

    def renew(self) -> None:
        """Go on from the state as it is now, particles that were moved by hand included."""
        self._snapshot.save(self.state)
        self._cap = math.inf
        self._renew()

    def load_checkpoint(self, path: str | os.PathLike) -> None:
        """Go on from a checkpoint of the same scene. The file may be anybody's: it is checked before anything changes.

        Raises:
            InputError: the file cannot be read, or holds what no run of this scene can have left.
        """
        like = {**self.state.numpy(), **self._foam_record()}
        stored = load_arrays(path, kinds_of(like))
        cluster = self.scene.shape if self.film.features.foam else None
        late = Events(cluster).unborn if cluster else []
        try:
            check_stored(stored, like, self.scene.fps, len(cluster.bubbles) if cluster else None, late)
        except InputError as error:
            raise InputError(f"checkpoint {path} does not fit: {error}") from None
        if cluster:
            self._load_foam(stored)
        else:
            self._take(stored)
