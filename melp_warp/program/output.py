"""What a run writes frame by frame: cache, log, other writers, checkpoints."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from melp_warp.errors import InputError
from melp_warp.files import append
from melp_warp.program.plan import Plan
from melp_warp.program.resume import (
    CHECKPOINT,
    EXTRAS,
    LOG,
    NEWER,
    OLDER,
    OPTIONS,
    clear,
    cut_back,
)
from melp_warp.program.writers import USD, Moment, find_writer, find_writers

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation


class Output:
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
        kept, plan = kept_frames(self._folder), self._plan
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


def kept_frames(folder: Path) -> str:
    """What is left of a run that did not end, in words."""
    from melp_warp.usd.schema import list_frames

    frames = list_frames(folder)
    if not frames:
        return "no frame was written"
    return f"{folder} holds {len(frames)} frame{'s' if len(frames) > 1 else ''}, {frames[0]} to {frames[-1]}"
