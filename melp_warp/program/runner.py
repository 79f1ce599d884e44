"""The frame loop: simulate, write the cache and run.jsonl, show progress, stop cleanly."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import re
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.device.interrupt import end_like_ctrl_c, finish_first, let_through
from melp_warp.errors import InputError, SimulationError, require
from melp_warp.files import append
from melp_warp.parameters import Value
from melp_warp.program.resume import (
    CHECKPOINT,
    CONTACT,
    EXTRAS,
    LOG,
    NEWER,
    OLDER,
    OPTIONS,
    Start,
    check_folder,
    clear,
    cut_back,
    find_start,
)
from melp_warp.program.room import ALL, Room, Written, check_disk, check_memory
from melp_warp.program.writers import USD, Moment, find_writer, find_writers, make_surfaces, mesh_prims
from melp_warp.scene import Scene

if TYPE_CHECKING:
    from melp_warp.preview.pictures import Shot
    from melp_warp.program.estimate import Estimate
    from melp_warp.registry import SceneScript
    from melp_warp.simulation import Simulation
    from melp_warp.stages.notices import Notices

CONTACT_FRAMES = 9
PREVIEW_SIZE, CONTACT_SIZE = 800, 400
MOST_TRIANGLES = 100_000_000
INTERRUPTED = 128
"""Exit code of a run that a signal ended, less the signal's number."""


@dataclass(frozen=True)
class Every:
    """When a run writes a checkpoint between its first and its last: after so many seconds or frames, 0 for never."""

    seconds: float = 300.0
    frames: int = 0

    @classmethod
    def parse(cls, text: str) -> Every:
        """From "20" for frames, "30s" or "5min" for a time.

        Raises:
            InputError: neither.
        """
        found = re.fullmatch(r"(\d{1,9}(?:\.\d{0,9})?)(s|min)?", text)
        allowed = 'a number of frames or a time as "30s" or "5min"'
        require(found is not None and (found[2] is not None or found[1].isdigit()), "--checkpoint", text, allowed)
        if found[2] is None:
            return cls(0.0, int(found[1]))
        return cls(float(found[1]) * (60.0 if found[2] == "min" else 1.0))

    def due(self, seconds: float, frames: int) -> bool:
        """Whether one is due after a time and a number of frames."""
        return 0.0 < self.seconds <= seconds or 0 < self.frames <= frames


@dataclass(frozen=True)
class Plan:
    """A run that is asked for.

    Attributes:
        scene: what to simulate.
        name: its name, recorded in the cache.
        parameters: its keys and values, recorded in the cache.
        out: folder to write, new or empty, or that of a run that goes on.
        device: Warp's name of the device.
        export: "l", "e", "both", or None for L where there are any and E otherwise.
        full: whether L are stored to the bit, not packed.
        preview: whether to draw preview.png and contact.png at the end.
        quiet: whether to print nothing but errors.
        strict: whether a run that has notices (`melp_warp.stages.notices`) counts as failed.
        mesh: whether to write a surface mesh of each region.
        triangles: how many a frame's meshes are to have in all, about; None for as many as there are L.
        whole: whether to write one mesh of the whole foam in their place.
        first: number of the first frame.
        writers: names of writers besides that of the cache, "NAME;NAME", see `writers.find_writer`.
        punctures: those that were asked for besides the scene's, "x,y,z,t;..."; the scene has them.
        every: when to write checkpoints.
        overwrite: whether `out` may hold a run, which is removed then.
        start: where the run goes on from: in its own folder as it was, or from another one with other numbers.
        room: the most memory and disk that it may take.
    """

    scene: Scene
    name: str
    parameters: Mapping[str, Value]
    out: Path
    device: str = "cpu"
    export: str | None = None
    full: bool = False
    preview: bool = False
    quiet: bool = False
    strict: bool = False
    mesh: bool = False
    triangles: int | None = None
    whole: bool = False
    first: int = 0
    punctures: str = ""
    writers: str = ""
    every: Every = Every()
    overwrite: bool = False
    start: Start | None = None
    room: Room = ALL

    @property
    def goes_on(self) -> bool:
        """Whether the run goes on in its own folder."""
        return self.start is not None and self.start.folder == self.out


def run(plan: Plan) -> int:
    """Carry out a run.

    The first frame is the initial state. /World/Film holds L, or E where the scene has no L or only E are exported.
    What else is asked for goes to /World/FilmE and, meshes, to /World/FilmSurface/Region_k or /World/FilmSurface/Whole.

    Returns:
        0; 1 where the plan is strict and there are notices; 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP. The
        cache holds each frame that was done, and a checkpoint the state of the last one.

    Raises:
        InputError: the output folder is taken or cannot be written, the disk is full, or the solver refuses the scene.
        SimulationError: the run cannot go on; the cache holds the frames before, checkpoint.npz the last good state.
    """
    require(plan.export != "l" or plan.scene.l_per_e > 0, "--export", plan.export, "e or both: the scene has no L")
    _check_numbers(plan)
    if not plan.goes_on:
        check_folder(plan.out, plan.overwrite)
    _start_warp()
    _check_room(plan)
    simulation = None
    try:
        with end_like_ctrl_c():
            with _Progress(plan) as progress:
                simulation = _simulation(plan)
                simulation.notices.first = plan.first
                with finish_first(), _unblocked(plan):
                    output = _Output(plan, simulation)
                    with contextlib.closing(output):
                        _simulate(simulation, plan.scene.frames, output, progress)
            _write_stage(plan.out)
            images = _draw_run(plan) if plan.preview else []
    except KeyboardInterrupt as error:
        more = "; --resume goes on" if (plan.out / CHECKPOINT).exists() else ""
        print(f"melp-warp: interrupted: {_kept(plan.out)}{more}{_noticed(simulation)}", file=sys.stderr)
        return INTERRUPTED + getattr(error, "number", signal.SIGINT)
    if not plan.quiet:
        _say_finished(plan.out, images, simulation.notices, output.empty_from)
    return int(plan.strict and bool(simulation.notices))


def _check_numbers(plan: Plan) -> None:
    from melp_warp.usd.schema import MAX_FRAME

    most = MAX_FRAME - plan.scene.frames
    require(0 <= plan.first <= most, "--start", plan.first, f"a whole number from 0 to {most}")
    _check_triangles(plan.triangles)
    find_writers(plan.writers)


def _check_triangles(triangles: int | None) -> None:
    allowed = f"a whole number from 1 to {MOST_TRIANGLES}"
    require(triangles is None or 1 <= triangles <= MOST_TRIANGLES, "--triangles", triangles, allowed)


def _check_room(plan: Plan) -> None:
    """Refuse at once what cannot fit."""
    scene = plan.scene
    check_memory(scene, plan.device, plan.room)
    counts = scene.e_count, scene.e_count * scene.l_per_e
    done = plan.start.frame - plan.first + 1 if plan.start else 0
    written = _written(plan)
    need = written.cache_bytes(*counts, scene.frames + 1 - done) + written.other_bytes(*counts)
    check_disk(plan.out, need, plan.room)


def _written(plan: Plan) -> Written:
    """What the run writes."""
    with_l = plan.scene.l_per_e > 0 and plan.export != "e"
    e_sets = int(not with_l) + int(plan.export in ("e", "both"))
    return Written(e_sets, int(with_l), plan.full, plan.mesh, plan.triangles, plan.preview, plan.whole)


def start_from(folder: Path) -> Start:
    """The newest sound checkpoint of a folder, see `resume.find_start`.

    Raises:
        InputError: there is none.
    """
    _start_warp()
    return find_start(folder)


def estimate(plan: Plan) -> Estimate:
    """What a run would cost, from a few of its steps; nothing is written.

    Raises:
        InputError: the solver refuses the scene or the device.
        SimulationError: one of the steps failed.
    """
    _start_warp()
    from melp_warp.program.estimate import measure_cost

    _check_room(plan)
    return measure_cost(plan.scene, plan.device, _written(plan))


def trade(script: SceneScript, overrides: Mapping[str, Value], e_count: int, frames: int, out: Path | None) -> str:
    """Measure speed against accuracy for a scene; see `melp_warp.study.tradeoff.scene_study`.

    Args:
        script: the scene.
        overrides: values that replace its own.
        e_count: E of the standard run.
        frames: frames of each run.
        out: folder for tradeoff.csv, tradeoff.json and, with matplotlib, tradeoff.png; None to write nothing.

    Returns:
        The table to print.

    Raises:
        InputError: the folder is taken, or the solver refuses the scene.
        SimulationError: the run that the others are compared with stopped.
    """
    if out is not None:
        check_folder(out, overwrite=False)
    _start_warp()
    from melp_warp.study import tradeoff

    records, began = [], time.perf_counter()
    for record in tradeoff.scene_study(script, overrides, e_count, frames):
        records.append(record)
        print(f"{len(records)} {record.knob or '-'} {record.setting}", file=sys.stderr)
    if out is not None:
        tradeoff.save(records, out, "tradeoff", time.perf_counter() - began)
        if importlib.util.find_spec("matplotlib"):
            measure = "thickness and surface against the reference run"
            tradeoff.plot(records, out / "tradeoff.png", script.name, measure)
    return tradeoff.table(records)


def _simulation(plan: Plan) -> Simulation:
    try:
        from melp_warp.simulation import Simulation
    except ModuleNotFoundError as error:
        if error.name and error.name.startswith("melp_warp.kernels"):
            raise InputError("melp-warp is not installed: run `pip install -e .` in the checkout first") from error
        raise
    if plan.start is None:
        return Simulation(plan.scene, plan.device)
    return Simulation(plan.scene, plan.device, plan.start.path, changed=not plan.goes_on)


@contextlib.contextmanager
def _unblocked(plan: Plan) -> Iterator[None]:
    """Where not even a first frame was written, leave the folder as it was: the next run finds it free."""
    try:
        yield
    except BaseException:
        from melp_warp.usd.schema import list_frames

        if not plan.goes_on and not list_frames(plan.out):
            with contextlib.suppress(OSError):
                clear(plan.out)
        raise


def _simulate(simulation: Simulation, frames: int, output: _Output, progress: _Progress) -> None:
    """Write the first frame, advance and write frame after frame; signals come through between steps and frames."""
    if not output.has_present:
        output.write(simulation)
        output.keep(simulation)
    progress.say(simulation.notices)
    try:
        let_through()
        while simulation.frame < frames:
            start = time.perf_counter()
            simulation.advance_frame()
            diagnostics = output.write(simulation)
            progress.say(simulation.notices)
            progress.advance(simulation, diagnostics, time.perf_counter() - start)
            output.keep_if_due(simulation)
            let_through()
    except KeyboardInterrupt:
        simulation.back()
        output.keep(simulation)
        raise
    except (InputError, SimulationError) as error:
        raise type(error)(f"{error}; {output.keep(simulation)}{_noticed(simulation)}") from error
    output.keep(simulation)
    simulation.conclude()
    progress.say(simulation.notices)


class _Progress:
    """A bar on stderr with frame, simulated time, time step, steps a second and time left."""

    def __init__(self, plan: Plan):
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TextColumn("{task.fields[state]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=Console(stderr=True, quiet=plan.quiet),
            disable=plan.quiet,
        )
        self._name = plan.name
        self._task = self._bar.add_task(f"{plan.name}: preparing", total=plan.scene.frames, state="")

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # an error is told in one line: no bar before it
        failed = kind is not None and issubclass(kind, Exception)
        self._bar.live.transient = failed
        self._bar.live.stop()
        if not failed and not self._bar.console.is_interactive:
            self._bar.console.print()  # without a terminal the bar is written once, and its line left open

    def say(self, notices: Notices) -> None:
        """Print the notices that are new, above the bar."""
        for line in notices.fresh():
            self._bar.console.print(f"melp-warp: notice: {line}", markup=False, highlight=False, soft_wrap=True)

    def advance(self, simulation: Simulation, diagnostics: Mapping, seconds: float) -> None:
        """A frame is done, which took `seconds` of wall time."""
        rate = diagnostics["substeps"] / max(seconds, 1e-9)
        state = f"t {simulation.time:.4g} s, dt {diagnostics['dt']:.3g} s, {rate:.3g} steps/s,{_busy()}"
        self._bar.update(self._task, completed=simulation.frame, description=self._name, state=state)


def _busy() -> str:
    """What to say of the speed while one thread works for all."""
    from melp_warp.device.launch import crew

    return "" if crew.together else " one thread (other programs have the cores),"


class _Output:
    """The folder of a run: the cache, a line of run.jsonl for every frame, and checkpoints.

    Attributes:
        empty_from: first of the last frames without particles, None where the last one has some.
        has_present: whether cache and log have the frame that the simulation starts from.
    """

    def __init__(self, plan: Plan, simulation: Simulation):
        self._folder, self._plan = plan.out, plan
        self.empty_from: int | None = plan.start.empty_from if plan.start else None
        there = cut_back(plan.start) if plan.goes_on else None
        if plan.overwrite:
            clear(plan.out)
        self._cache, self._others = find_writer(USD)(), find_writers(plan.writers)
        self._cache.open(plan.out, plan, simulation, there)
        for writer in self._others:
            writer.open(plan.out / EXTRAS, plan, simulation, there)
        self.has_present = plan.goes_on and plan.start.written
        self._line = plan.start.line if plan.goes_on else {}
        self._kept, self._when = simulation.frame, time.monotonic()

    def write(self, simulation: Simulation) -> dict:
        """Write the present frame and return its diagnostics."""
        moment = Moment(self._plan, simulation)
        problems = moment.problems
        diagnostics = self._line
        if diagnostics.get("frame") != moment.number:  # else it failed to be written before the run was resumed
            diagnostics = simulation.diagnostics() | ({"mesh_problems": problems} if self._plan.mesh else {})
            if problems:
                simulation.notices.add(simulation.frame, "mesh not closed", len(problems), "; ".join(problems))
        self._line = _plain({**diagnostics, "frame": moment.number})
        for writer in self._others:
            writer.write(moment)
        self._line["sha256"] = self._cache.write(moment)
        self._log(self._line)
        if not moment.empty:
            self.empty_from = None
        elif self.empty_from is None:
            self.empty_from = moment.number
        return diagnostics

    def close(self) -> None:
        """Let the writers end."""
        for writer in (self._cache, *self._others):
            writer.close()

    def _log(self, line: Mapping) -> None:
        """Append a line to the log, whole or not at all."""
        path = self._folder / LOG
        try:
            append(path, (json.dumps(line, allow_nan=False) + "\n").encode())
        except OSError as error:
            del line["sha256"]
            raise InputError(f"cannot write {path}: {error.strerror}; the frames before are complete") from error

    def keep_if_due(self, simulation: Simulation) -> None:
        """Save the state where it is time to."""
        if self._plan.every.due(time.monotonic() - self._when, simulation.frame - self._kept):
            self.keep(simulation)

    def keep(self, simulation: Simulation) -> str:
        """Save the last good state, with the one saved before as the older one, and say what there is of the run."""
        kept, plan = _kept(self._folder), self._plan
        if self._line.get("frame") != plan.first + simulation.frame:
            return kept
        run = {
            "scene": plan.name,
            "parameters": dict(plan.parameters),
            "options": {name: getattr(plan, name) for name in OPTIONS if name != "budget"}
            | {"budget": plan.scene.budget},
            "frame": self._line["frame"],
            "line": self._line,
            "empty_from": self.empty_from,
        }
        newer, newest, older = (self._folder / name for name in (NEWER, CHECKPOINT, OLDER))
        try:
            simulation.save_checkpoint(newer, run)
            if newest.exists() and self._kept != simulation.frame:
                os.replace(newest, older)
            os.replace(newer, newest)
        except OSError as error:
            return f"{kept}, {CHECKPOINT} could not be written: {error.strerror}"
        self._kept, self._when = simulation.frame, time.monotonic()
        return f"{kept} and the last good state in {CHECKPOINT}"


def _plain(value: object) -> object:
    """The value with NumPy numbers made Python's, and what is not finite made null, which JSON can say."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _kept(folder: Path) -> str:
    """What is left of a run that did not end, in words."""
    from melp_warp.usd.schema import list_frames

    frames = list_frames(folder)
    if not frames:
        return "no frame was written"
    return f"{folder} holds {len(frames)} frame{'s' if len(frames) > 1 else ''}, {frames[0]} to {frames[-1]}"


def _noticed(simulation: Simulation | None) -> str:
    """The notices of a run that did not end, as the end of a line."""
    return f"; noticed: {simulation.notices.summary()}" if simulation and simulation.notices else ""


def _say_finished(folder: Path, images: list[Path], notices: Notices, empty_from: int | None) -> None:
    from melp_warp.usd.schema import ROOT

    print(f"{_kept(folder)}: {folder / ROOT}")
    if empty_from is not None:
        print(f"The last film is gone: from frame {empty_from} on there are no particles")
    for image in images:
        print(f"drawn: {image}")
    print(f"Open the .usda in usdview, Houdini or Omniverse, or draw a frame: melp-warp preview {folder}")
    if notices:
        print(f"Noticed: {notices.summary()}")


def draw(shot: Shot) -> list[Path]:
    """Draw frames of a cache; see `melp_warp.preview.pictures.shoot`."""
    _start_warp()
    from melp_warp.preview import pictures

    return pictures.shoot(shot)


def write_blender(folder: Path) -> Path:
    """Put the script that opens a cache in Blender beside it; see `melp_warp.program.blender`."""
    _start_warp()
    from melp_warp.preview.pictures import Cache
    from melp_warp.program.blender import write_script

    Cache(folder)
    return write_script(folder)


def mesh_cache(folder: Path, triangles: int | None = None, whole: bool = False) -> list[str]:
    """Put surface meshes into the frames of a cache, in place of those that are there.

    Args:
        folder: folder of the cache.
        triangles: how many a frame's meshes are to have in all, about; None for as many as there are L.
        whole: whether to make one mesh of the whole foam instead.

    Returns:
        What could not be closed, a line each with frame and region.

    Raises:
        InputError: there is no such cache, or it has no E.
    """
    _check_triangles(triangles)
    _start_warp()
    from melp_warp.usd.apart import read_frame, read_root, try_frame
    from melp_warp.usd.meshes import add_meshes
    from melp_warp.usd.schema import FREE_RIMS, list_frames

    frames = list_frames(folder)
    require(bool(frames), "DIR", str(folder), "a folder that a run wrote, with frames in it")
    root = read_root(folder)
    require(
        not root["with_l"] or "FilmE" in root["prims"],
        "DIR",
        str(folder),
        "a cache with E, which meshes are made of: run again with --mesh, or with --export both",
    )
    source = "FilmE" if "FilmE" in root["prims"] else "Film"
    regions = sorted({int(k) for frame in frames for k in np.unique(read_frame(folder, frame, source).region)})
    rims, problems = [np.array(rim) for rim in root["rims"]], []

    def make(frame: int):
        try_frame(folder, frame)
        lagrangian = read_frame(folder, frame) if root["with_l"] else None
        e = read_frame(folder, frame, source)
        beads = read_frame(folder, frame, FREE_RIMS) if FREE_RIMS in root["prims"] else None
        meshes, found = make_surfaces(e, lagrangian, rims, triangles, whole, beads)
        problems.extend(f"frame {frame}: {problem}" for problem in found)
        return meshes

    _renew_sums(folder, add_meshes(folder, make, mesh_prims(regions, whole)))
    return problems


def _renew_sums(folder: Path, sums: Mapping[str, str]) -> None:
    """Put the checksums of files that were written anew into run.jsonl, where there is one that has some."""
    from melp_warp.files import replacing

    path = folder / LOG
    if not path.is_file():
        return
    with replacing(path) as partial, path.open("rb") as before, partial.open("wb") as after:
        for line in before:
            with contextlib.suppress(
                ValueError, TypeError, AttributeError, KeyError
            ):  # half a line that a killed run left
                entry = json.loads(line)
                entry["sha256"] = {name: sums.get(name, old) for name, old in entry["sha256"].items()}
                line = json.dumps(entry).encode() + b"\n"
            after.write(line)


def _write_stage(folder: Path) -> None:
    """A layer with a camera and lights for the run."""
    from melp_warp.preview.pictures import Cache
    from melp_warp.usd.forms import write_stage

    camera = Cache(folder).camera()
    write_stage(folder, camera.eye, camera.target, camera.up, camera.fov)


def _draw_run(plan: Plan) -> list[Path]:
    """Draw the last frame, and a sheet of frames spread over the run."""
    from melp_warp.preview import draw as preview
    from melp_warp.preview.pictures import PREVIEW, Cache, spread

    cache = Cache(plan.out)
    camera, last, sheet = cache.camera(), plan.out / PREVIEW, plan.out / CONTACT
    preview.save_image(preview.render(cache.film(cache.frames[-1]), *[PREVIEW_SIZE] * 2, camera, plan.device), last)
    picked = spread(cache.frames, CONTACT_FRAMES)
    images = [preview.render(cache.film(frame), *[CONTACT_SIZE] * 2, camera, plan.device) for frame in picked]
    times = [f"{plan.scene.film_time(frame - cache.frames[0]):.3g} s" for frame in picked]
    preview.save_image(preview.contact_sheet(images, times), sheet)
    return [last, sheet]


def _start_warp() -> None:
    from melp_warp.device.environment import start_warp

    start_warp()
