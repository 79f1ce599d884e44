"""The frame loop: simulate, write the cache and run.jsonl, show progress, stop cleanly."""

from __future__ import annotations

import contextlib
import importlib.util
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from melp_warp.device.interrupt import end_like_ctrl_c, finish_first, let_through
from melp_warp.errors import InputError, SimulationError, require
from melp_warp.parameters import Value
from melp_warp.program.afterwards import draw_run, write_stage
from melp_warp.program.output import Output, kept_frames
from melp_warp.program.plan import Plan, begin_warp, check_numbers, check_room, written
from melp_warp.program.progress import ProgressLine, noticed_in, say_finished
from melp_warp.program.resume import (
    CHECKPOINT,
    Start,
    check_folder,
    clear,
    find_start,
)

if TYPE_CHECKING:
    from melp_warp.program.estimate import Estimate
    from melp_warp.registry import SceneScript
    from melp_warp.simulation import Simulation

INTERRUPTED = 128
"""Exit code of a run that a signal ended, less the signal's number."""


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
    check_numbers(plan)
    if not plan.goes_on:
        check_folder(plan.out, plan.overwrite)
    begin_warp()
    check_room(plan)
    simulation = None
    try:
        with end_like_ctrl_c():
            with ProgressLine(plan) as progress:
                simulation = _simulation(plan)
                simulation.notices.first = plan.first
                with finish_first(), _unblocked(plan):
                    output = Output(plan, simulation)
                    with contextlib.closing(output):
                        _simulate(simulation, plan.scene.frames, output, progress)
            write_stage(plan.out)
            images = draw_run(plan) if plan.preview else []
    except KeyboardInterrupt as error:
        more = "; --resume goes on" if (plan.out / CHECKPOINT).exists() else ""
        print(f"melp-warp: interrupted: {kept_frames(plan.out)}{more}{noticed_in(simulation)}", file=sys.stderr)
        return INTERRUPTED + getattr(error, "number", signal.SIGINT)
    if not plan.quiet:
        say_finished(plan.out, images, simulation, output.empty_from)
    return int(plan.strict and bool(simulation.notices))


def start_from(folder: Path) -> Start:
    """The newest sound checkpoint of a folder, see `resume.find_start`.

    Raises:
        InputError: there is none.
    """
    begin_warp()
    return find_start(folder)


def estimate(plan: Plan) -> Estimate:
    """What a run would cost, from a few of its steps; nothing is written.

    Raises:
        InputError: the solver refuses the scene or the device.
        SimulationError: one of the steps failed.
    """
    begin_warp()
    from melp_warp.program.estimate import measure_cost

    check_room(plan)
    return measure_cost(plan.scene, plan.device, written(plan))


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
    begin_warp()
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


def _simulate(simulation: Simulation, frames: int, output: Output, progress: ProgressLine) -> None:
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
        raise type(error)(f"{error}; {output.keep(simulation)}{noticed_in(simulation)}") from error
    output.keep(simulation)
    simulation.conclude()
    progress.say(simulation.notices)
