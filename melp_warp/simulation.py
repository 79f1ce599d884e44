"""A simulation: a scene on a device, advanced frame by frame."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace

import numpy as np
import warp as wp

from melp_warp.cluster import Cluster
from melp_warp.device.environment import start_warp
from melp_warp.device.interrupt import let_through
from melp_warp.device.launch import compile_kernels, launch
from melp_warp.errors import CrowdedError, InputError, LeapError, SimulationError
from melp_warp.features import Features, without_budget
from melp_warp.frame import CurveFrame, ParticleFrame
from melp_warp.kernels import advance as ka
from melp_warp.kernels import diagnostics as kd
from melp_warp.scene import MOST_STEPS, MOST_STEPS_AGAIN, Scene
from melp_warp.stages.film import THINNEST, Film
from melp_warp.stages.notices import Notices
from melp_warp.stages.state import AMOUNT, AREA, Snapshot, State
from melp_warp.stepping import checkpoint
from melp_warp.stepping.breath import Breath
from melp_warp.stepping.burst import Burst
from melp_warp.stepping.events import Events
from melp_warp.stepping.foam_burst import FoamBurst
from melp_warp.stepping.ledger import Ledger, Reading
from melp_warp.stepping.log_line import line_of
from melp_warp.stepping.parts import kernel_files
from melp_warp.stepping.resampling import Resampling
from melp_warp.stepping.respacing import Respacing
from melp_warp.stepping.sampling import FAR, MOST_TURN, film_of, make_film, set_up_again, unresolved
from melp_warp.stepping.stepper import make_stepper
from melp_warp.stepping.topology import Stored
from melp_warp.stepping.view import particles_of

LEAP = 0.3
"""Longest way of a particle in one step, relative to the film as a whole and in radii of the film.

Beyond it the change of curvature is no longer nearly linear in the motion, which the implicit step rests on.
"""

LEAST_CUT = 1.0 / 16.0
"""Least part of a step in which a leap is made that is tried next."""

LEAST_STEP = 0.3
"""Step at which a leap ends the run, in times in which the fastest wave crosses a spacing: the step is not to blame."""

FASTEST = 100.0
"""Speed of the liquid in a flat film that runs are made for, m/s: its waves may be slow."""

MOST_ROOM = 12.0
"""Room of neighbour lists, over what they need when they are made, at which particles are taken to have clumped."""


def find_device(name: str) -> wp.Device:
    """The Warp device of that name.

    Raises:
        InputError: no such device here.
    """
    start_warp()
    try:
        return wp.get_device(name)
    except Exception:
        known = ", ".join(str(d) for d in wp.get_devices())
        raise InputError(f"device must be one of those here, {known}, got {name!r}") from None


STRETCHED = 1.5
"""Spacing of the E of a region over that at the start beyond which a run says that its film has stretched."""


class Simulation:
    """A scene in time.

    Args:
        scene: what to simulate.
        device: "cpu", "cuda:0", ...
        checkpoint: file to go on from; None to start.
        changed: whether the scene may differ from that of the file, see `load_checkpoint`.

    Raises:
        InputError: the scene, the device or the checkpoint cannot be used.

    Attributes:
        stepper: the stages, with the film and its state.
        last_dt: size of the last step, s; substeps: how many there were in the frame.
        notices: what whoever uses the results must know of them.
        watched: whether every step is checked at once, which a GPU would have to be waited for; else between frames.
        step_seconds: wall time of each step, s; the first ones load and record kernels, and on a GPU this is the time
            of launching alone.
    """

    def __init__(
        self,
        scene: Scene,
        device: str = "cpu",
        checkpoint: str | os.PathLike | None = None,
        changed: bool = False,
    ):
        self._scene = scene
        self.step_seconds: list[float] = []
        self.device = find_device(device)
        self.watched = not self.device.is_cuda
        self.notices = Notices()
        self.last_dt, self.substeps = 0.0, 0
        self.events = Events(self) if isinstance(scene.shape, Cluster) else None
        kind = FoamBurst if isinstance(scene.shape, Cluster) else Burst
        self.burst = kind(self) if scene.bursts else None
        self.breath = Breath(self) if scene.breathes else None
        self._make_counts()
        try:
            if checkpoint is not None:
                self.load_checkpoint(checkpoint, changed)
            else:
                self._begin()
        except (MemoryError, RuntimeError) as error:
            if isinstance(error, SimulationError) or "alloc" not in str(error).lower():
                raise
            count = scene.e_count * (1 + scene.l_per_e)
            raise InputError(
                f"e_count and l_per_e must fit the memory of {self.device}, got {count:,} particles"
            ) from None

    def _begin(self) -> None:
        """Start from the scene."""
        _, self.stepper = make_film(self.scene, self.device)
        course, features = self.state.course, self.film.features
        if self.events is not None:
            self.events.begin(course)
        course.reach, course.speed = self._longest_way(), self._fastest_wave()
        course.gas = float(self.state.gas.numpy()[0, AMOUNT]) if self.breath is not None else 0.0
        course.issued = {kind: len(ids) for kind, ids in {"d": (), **self.state.ids}.items()}
        course.spacing = self.film.spacing
        self._look_at_shape()
        if features.budget:
            course.ledger = Ledger()
            course.ledger.open(self._weighed())
        self._good = None
        self._keep()
        self._remark(self._look())

    @property
    def scene(self) -> Scene:
        """What is simulated, with the numbers as they are now."""
        return self._scene

    @scene.setter
    def scene(self, _: Scene) -> None:
        raise InputError("a scene cannot be replaced during a run: change its numbers with change(gravity=1.62, ...)")

    @property
    def film(self) -> Film:
        """The film as it is now; another one after its regions changed."""
        return self.stepper.film

    @property
    def state(self) -> State:
        """All that evolves; another one after the film's regions changed."""
        return self.stepper.state

    @property
    def gone(self) -> bool:
        """Whether the last film has popped: there are no particles, and time passes until a bubble appears."""
        return self.film.n_e == 0

    @property
    def has_l(self) -> bool:
        """Whether there are Lagrangian particles."""
        return self.state.l is not None

    @property
    def ledger(self) -> Ledger | None:
        """The energy budget so far; None where the scene wants none."""
        return self.state.course.ledger

    @property
    def unaccounted(self) -> str:
        """A sentence on what the energy budget does not cover though it is wanted; empty where it covers the run."""
        if self.scene.budget and (why := without_budget(self.scene)):
            return f"No energy budget was kept: {why}"
        if self.ledger is not None and self.state.course.holed:
            return f"The energy budget ended when a film burst: it goes up to {self.ledger.time:.4g} s"
        return ""

    @property
    def spilled(self) -> float:
        """Liquid that left with films that popped, kg."""
        return self.state.course.spilled

    @property
    def origin(self) -> np.ndarray:
        """[3] float64, m: where `particles` measures from, the same for the whole run."""
        return np.array(self.state.course.shown)

    def _look_at_shape(self) -> None:
        """Note a shape that the E are too few for."""
        turn = unresolved(self.scene, self.stepper)
        if turn > MOST_TURN:
            text = f"E normals are {turn:.3g} degrees off the shape's (rms), {MOST_TURN:g} at most: raise e_count"
            self.notices.note("shape unresolved", turn, text)

    def _longest_way(self) -> float:
        """How far a particle may move in a step, m."""
        size = float(np.sqrt(self.state.gas.numpy()[:, AREA].min() / np.pi))
        return LEAP * (0.5 * size if self.film.features.closed else size)

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
        if self.breath is not None and self.film.features.closed:
            self.breath.before_step(dt)
        self.stepper.step(dt)
        if self.burst is not None:
            self.burst.after_step(dt)
        self.step_seconds.append(time.perf_counter() - began)
        self.last_dt = dt

    def advance_frame(self) -> None:
        """Advance by 1/fps.

        A frame in which a particle leaps or a neighbour list overflows is done again, in smaller steps or with more
        room. One that went wrong while nobody looked is first done again with a look at every step, which finds out
        what came first.

        Raises:
            SimulationError: names the stage and the particle; the state is then that of the last good frame.
        """
        end = self.scene.film_time(self.state.frame + 1)
        watched = self.watched
        while True:
            try:
                self._advance_to(end, watched)
                break
            except SimulationError as error:
                given = self._give_way(error) if watched else (self.state.course.cap, self.film.room)
                self._go_back(given)
                if given is None:
                    raise SimulationError(f"{error}, at {end:.4g} s in frame {self.state.frame + 1}") from None
                watched = True
        self.state.frame += 1
        self.state.time = end
        self.state.course.cap *= 2.0
        self.stepper.settle()
        seen = self._look()
        self._remark(seen)
        self._recentre(seen)
        follows = self.respacing is not None and not self.gone and self.respacing.follow()
        if not follows and self.breath is not None and self.film.features.closed:
            self.breath.respace()
        if self.resampling is not None and not self.gone:
            self.resampling.follow()
        self._keep()

    @contextmanager
    def new_account(self, cause: str) -> Iterator[None]:
        """Close the energy budget before particles are others, then open one of what there is; `cause` is its term."""
        budget = self.stepper.budget
        if budget is not None:
            self.ledger.cut(budget.read(), budget.pending(), cause)
            budget.begin()
        yield
        if self.stepper.budget is not None:
            self.ledger.open(self._weighed())

    def _weighed(self) -> Reading:
        """The budget with the liquid where it is now (reads back)."""
        budget = self.stepper.budget
        budget.look()
        budget.weigh()
        return budget.read()

    def _keep(self) -> None:
        """Take the state as it is for the one to go back to."""
        if self._good is not None and self._good.state is self.state:
            self._good.save()
        else:
            self._good = Snapshot(self.state)
        self._good_film = self.film

    def _go_back(self, given: tuple[float, float] | None) -> None:
        """Return to the last good frame, regions that changed since included, with the step and the room `given`."""
        self._good.restore()
        film = self._good_film
        if given is not None:
            self._good.state.course.cap, film = given[0], replace(film, room=given[1])
        self.stepper = make_stepper(film, self._good.state)

    def rebuild(self, moved: bool = False) -> None:
        """Make what follows from the state anew: lists, fits, graphs. It changes nothing: twice is as good as once.

        Args:
            moved: whether particles were moved by hand, so that lists are to be those of where they are now.
        """
        state = self.state
        if not moved:
            self.stepper = make_stepper(self.film, state)
            return
        self.remake(self.film)
        if not self.film.features.moving and self.has_l:
            self.stepper.geometry.set_area(state.memory.area)  # found from the L at the start
        self._keep()

    def remake(self, film: Film) -> None:
        """Go on with the present state as another film has it: with lists and fits of where particles are now."""
        state = self.state
        kept = [(array, wp.clone(array)) for array in (state.e.normal, state.gas)]
        state.forget()
        wall = self.stepper.wall
        self.stepper = make_stepper(film, state)
        self.stepper.wall |= wall
        for array, values in kept:
            wp.copy(array, values)
        state.course.reach = self._longest_way()

    def conclude(self) -> None:
        """Note what only the end of a run tells: a rest of its energy budget that is too large."""
        if self.ledger is not None:
            self.ledger.remark(self.notices, self.frame)

    def _look(self) -> np.ndarray | None:
        """What `kernels.diagnostics.look_chunks` sees of the film, [parts, 6] (reads back); None where it is gone."""
        if self.gone:
            return None
        film, e = self.film, self.state.e
        self.stepper.fields.update()
        seen = film.parts(kd.vec6d)
        inputs = [e.x, e.mass, self.stepper.fields.eta, e.behind, self.state.gas, film.first]
        film.launch_parts(kd.look_chunks, inputs, [seen])
        return seen.numpy()

    def _remark(self, seen: np.ndarray | None) -> None:
        """Note what must be known of the frame that is done, `seen` of its film included (reads back)."""
        if self.stepper.budget is not None:
            self.ledger.take(self.stepper.budget.read(), self.time - self.last_dt)
        self.stepper.remark(self.notices)
        if seen is not None:
            self._remark_film(seen)
        self.notices.end(self.frame)

    def _make_counts(self) -> None:
        """What puts E and L in and takes them out between frames, where the scene asks for it."""
        numerics = self.scene.numerics
        self.respacing = Respacing(self) if numerics.respacing is not None else None
        resampled = numerics.resampling is not None and self.scene.l_per_e > 0
        self.resampling = Resampling(self) if resampled else None

    def _remark_film(self, seen: np.ndarray) -> None:
        """Note a film that has stretched or thinned beyond what its particles resolve."""
        growth = float(np.sqrt(seen[:, 5].max())) / self.state.course.spacing
        if growth > STRETCHED and self.respacing is None:
            text = (
                f"the film has stretched: its E are {growth:.3g} times as far apart as at the start and see what is"
                " smaller no more; respacing=1.2 puts E and L in where a film's surface moves"
            )
            self.notices.note("stretched", growth, text)
        eta, i = seen[np.argmin(seen[:, 3]), 3:5].tolist()
        if eta < THINNEST:
            text = (
                f"the film at E {i:.0f} is {1e9 * eta:.3g} nm thick: none is thinner than {1e9 * THINNEST:g} nm;"
                " rupture_thickness lets it burst"
            )
            self.notices.note("thinner than a film", 1.0 / max(eta, 1e-30), text)

    def _advance_to(self, end: float, watched: bool) -> None:
        """Take steps until `end` (s), each checked at once if it is `watched`."""
        self.notices.begin()
        self.state.course.sprayed = self.state.course.issued["d"]
        self._change_regions()
        self.substeps = 0
        self.stepper.wall = dict.fromkeys(self.stepper.wall, 0.0)
        if not self.gone:
            self.stepper.lists.forget_leaps()
            self.stepper.carrier.look()
        least = 1e-9 * (end - self.scene.film_time(self.state.frame))
        while end - self.time > least:
            let_through()
            if not self.gone:
                self.stepper.lists.watched = watched
            self.step_towards(end)
            if watched:
                self._check()
            if not self.gone and not end - self.time > least:
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
        if travel.max() > self.state.course.reach and self.scene.numerics.scheme != "explicit":
            which = "E" if travel[0] >= travel[1] else "L"
            raise LeapError(
                f"stage advance_{which.lower()}: {which} move {travel.max():.3g} m in a step of {self.last_dt:.3g} s,"
                f" more than {LEAP:g} of the film's radius"
            )

    def _give_way(self, error: SimulationError) -> tuple[float, float] | None:
        """What an error calls for, smaller steps or more room for lists; None where there is none left to give."""
        course, room = self.state.course, self.film.room
        if isinstance(error, LeapError):
            travel = float(self.stepper.lists.travel.numpy()[4:].max())
            cap = 0.5 * self.last_dt * max(course.reach / max(course.reach, travel), LEAST_CUT)
            fastest = course.speed if self.film.features.moving else max(course.speed, FASTEST)
            least = LEAST_STEP * self.film.spacing / fastest
            return (cap, room) if cap > max(least, 1.0 / (self.scene.fps * MOST_STEPS_AGAIN)) else None
        if isinstance(error, CrowdedError):
            return (course.cap, 2.0 * room) if 2.0 * room < MOST_ROOM else None
        return None

    def _recentre(self, seen: np.ndarray | None) -> None:
        """Measure positions from a film itself once it has flown far."""
        film, state = self.film, self.state
        if seen is None or not film.features.floats:
            return
        away = seen[0, :3]
        if np.abs(away).max() > 2.0 * FAR * film.radius:
            for x in (state.e.x, *([state.l.x] if state.l else []), *(held["x"] for held in state.sets.values())):
                launch(ka.shift_origin_e, x.shape[0], [wp.vec3(*away)], [x], self.device)
            state.origin = state.origin + away

    def step_towards(self, end: float) -> float:
        """Take one step of those in which a frame that ends at `end` (s) is done; its size, s."""
        left = self._until(end) - self.time
        if self.gone:
            self.step(left)
            return left
        limit = self.state.course.limit = self.largest_step()
        if limit * MOST_STEPS * self.scene.fps < 1.0 - 1e-9:
            speed = self.stepper.lists.fastest
            raise SimulationError(
                f"stage advance_e: cfl asks for steps of {limit:.3g} s at a speed of {speed:.3g} m/s,"
                f" more than {MOST_STEPS:,} a frame"
            )
        count = max(1, math.ceil(left / limit - 1e-6))
        sudden = self.film.walls or self.state.course.unborn  # regions may change after any step
        if self.stepper.budget is not None and (count == 1 or sudden):
            self.stepper.budget.weigh()
        self.step(left / count)
        self.substeps += 1
        return self.last_dt

    def _until(self, end: float) -> float:
        """End of the frame, or the time of an event before it, s."""
        sources = [source for source in (self.events, self.burst) if source is not None]
        times = [source.following() for source in sources]
        return min([end, *(time for time in times if time is not None)])

    def _change_regions(self) -> None:
        """Let films burst and regions appear whose time has come; the run is set up anew for what is left."""
        while (change := self._due()) is not None:
            self.stepper.settle()
            stored = Stored.of(self.state)
            change(stored)
            self.state.course.issued = stored.issued
            if self.burst is None or not self.burst.put_back(stored):
                self._set_up(stored)
            if self.burst is not None:
                self.burst.begin()

    def _due(self) -> Callable[[Stored], None] | None:
        """What is to change now: holes first; None for nothing."""
        for source in (self.burst, self.events):
            if source is not None and (change := source.due()) is not None:
                return change
        return None

    def _set_up(self, stored: Stored) -> None:
        """Go on with a state of other regions or with other holes."""
        wall = self.stepper.wall
        self.stepper.remark(self.notices)
        with self.new_account("events"):
            _, self.stepper = set_up_again(self.scene, stored, self.state, self.film)
            self.stepper.wall |= wall
            if self.gone:
                return
            self.stepper.carrier.look()
            if self.state.course.reach == 0.0:
                self.state.course.reach = self._longest_way()

    def largest_step(self) -> float:
        """The scene's dt, or the step in which the fastest particle moves `cfl` spacings, s.

        What carries the flow may know a limit besides, see `Carrier.longest_step`, and so may the normal motion.
        Where the scene sets no dt, the first step is that of the fastest wave on the film and a step is at most twice
        the one before: at the start nothing has moved yet.
        """
        limit = min(1.0 / self.scene.fps, self.state.course.cap)
        if self.burst is not None:
            limit = min(limit, self.burst.longest_step())
        stepper, fastest = self.stepper, self.stepper.lists.fastest
        limit = min(limit, stepper.carrier.longest_step(fastest))
        if self.scene.dt is not None:
            return min(limit, self.scene.dt)
        if stepper.membrane is not None:
            limit = min(limit, stepper.membrane.longest_step(fastest))
        reach = self.scene.numerics.cfl * self.film.spacing
        if self.state.course.limit == 0.0:
            return min(limit, reach / self.state.course.speed)
        wanted = min(2.0 * self.state.course.limit, reach / fastest if fastest > 0.0 else limit)
        return min(limit, wanted)

    def _fastest_wave(self) -> float:
        """Fastest wave: sqrt(2 sigma/m) where the film can move, sqrt(2 R T Gamma/m) where it is flat, m/s."""
        m = self.scene.material
        tension = m.film_tension if self.film.features.moving else m.rt * m.surfactant
        particles = self.state.l or self.state.e
        v = particles.u.numpy()[: particles.count]
        return math.sqrt(2.0 * tension / m.areal_mass) + float(np.sqrt((v**2).sum(axis=1)).max()) + 1e-9

    def particles(self, which: str) -> ParticleFrame | CurveFrame:
        """The L ("l"), E ("e"), free rims ("rims"), drops ("drops") or the scene's own by name, as NumPy arrays.

        "rim_curves" are the free rims as curves.
        """
        return particles_of(self, which)

    def diagnostics(self) -> dict:
        """Everything worth a line of the run's log; plain numbers (reads back)."""
        return line_of(self)

    def back(self) -> None:
        """Return to the last good frame, from within a frame that was interrupted."""
        self._go_back(None)

    def change(self, **numbers: object) -> None:
        """Go on with other numbers of the scene, between frames: `change(drag=0.01, gravity=(0, -1.62, 0), dt=None)`.

        Args:
            **numbers: fields of `Material`, `Surroundings` and `Numerics`, and `dt`.

        Raises:
            InputError: a number that there is none of, that is out of range or that cannot change during a run. Nothing
                is changed then.
        """
        scene = checkpoint.changed(self.scene, numbers)
        now, then = self.film.features, Features.of(scene, self.state.course.holed)
        if then != now:
            parts = [f.name for f in fields(Features) if getattr(now, f.name) != getattr(then, f.name)]
            names = ", ".join(numbers)
            raise InputError(f"{names} cannot change so during a run, which was begun with other parts: {parts}")
        self.stepper.settle()
        film = {"spacing": self.film.spacing, "radius": self.film.radius, "room": self.film.room}
        self._scene = scene
        self._make_counts()
        self.stepper = make_stepper(film_of(scene, self.state, **film), self.state)
        self.state.course.speed = self._fastest_wave()
        self._keep()

    def save_checkpoint(self, path: str | os.PathLike, run: Mapping | None = None) -> None:
        """Write the state to `path` (.npz), whole or not at all, see `stepping.checkpoint`; the run goes on as if not.

        Args:
            path: the file.
            run: what the command line wants to know again; plain values.

        Raises:
            OSError: it cannot be written.
        """
        self.stepper.settle()
        film = {"spacing": self.film.spacing, "radius": self.film.radius, "room": self.film.room}
        checkpoint.write(path, self.scene, film, self.state, self.notices, run)

    def load_checkpoint(self, path: str | os.PathLike, changed: bool = False) -> None:
        """Go on from a checkpoint of the same scene, bit for bit on the CPU.

        The file may be anybody's: it is checked before anything changes.

        Args:
            path: the file.
            changed: whether the scene may differ from that of the file in what may change during a run.

        Raises:
            InputError: the file cannot be read or does not fit the scene.
        """
        read = checkpoint.read(path, self.scene, changed)
        compile_kernels(kernel_files(Features.of(self.scene, read.course.holed)), self.device)
        state = read.make_state(self.scene, self.device)
        self.stepper = make_stepper(film_of(self.scene, state, **read.film), state)
        self.notices.load(read.notices)
        self._good = None
        self._keep()
