"""Runs that go on: the checkpoints of a folder, what else belongs to a run, and how it is cut back to one of them."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from melp_warp.errors import InputError, require
from melp_warp.files import is_systems, replacing
from melp_warp.parameters import Value
from melp_warp.program.blender import SCRIPT, TABLES
from melp_warp.usd.schema import FRAMES, LOOK, MANIFEST, ROOT, STAGE, frame_path, list_frames

LOG = "run.jsonl"
CHECKPOINT = "checkpoint.npz"
OLDER, NEWER = "checkpoint.old.npz", "checkpoint.new.npz"
CONTACT = "contact.png"
EXTRAS = "writers"
PICTURES = {"preview.png", CONTACT, "budget.png"}

OURS = {ROOT, MANIFEST, LOOK, STAGE, SCRIPT, TABLES, FRAMES, LOG, CHECKPOINT, OLDER, NEWER, EXTRAS, *PICTURES}
"""What a run, and what draws it, writes into its folder."""

_LEFTOVER = re.compile(r"\..+\.tmp\.\w+")
"""Temporaries of a writer that was killed, see `files.replacing`; USD has its own, which end in six random letters."""


NAMES = {"first": "start", "budget": "no-budget", "punctures": "puncture", "writers": "writer"}
"""Options of the command line that have another name."""

OPTIONS = {
    "export": str | None,
    "full": bool,
    "mesh": bool,
    "triangles": int | None,
    "whole": bool,
    "first": int,
    "budget": bool,
    "punctures": str,
    "writers": str,
}
"""What a run writes besides the numbers of its scene, see `Start`."""


@dataclass(frozen=True)
class Start:
    """Where a run goes on from.

    Attributes:
        path: the checkpoint.
        folder: that of the run that wrote it.
        scene: name of its scene.
        parameters: keys and values of the scene; None for "auto".
        options: what it writes, by the names of `Plan`: export, full, mesh, triangles, whole, first,
            punctures; and budget.
        frame: number of the checkpoint's frame.
        line: what the log says of that frame; without "sha256" where the frame was not written.
        empty_from: see `Output`.
    """

    path: Path
    folder: Path
    scene: str
    parameters: dict[str, Value]
    options: dict[str, str | int | bool | None]
    frame: int
    line: dict
    empty_from: int | None

    @property
    def written(self) -> bool:
        """Whether cache and log have the checkpoint's frame."""
        return "sha256" in self.line

    @classmethod
    def of(cls, path: Path, run: Mapping) -> Start:
        """From what a checkpoint says of its run.

        Raises:
            InputError: it is not what a run of the command line says.
        """
        kinds = {
            "scene": str,
            "parameters": dict,
            "options": dict,
            "frame": int,
            "line": dict,
            "empty_from": int | None,
        }
        right = isinstance(run, dict) and set(run) == set(kinds)
        right = right and all(isinstance(run[name], kind) for name, kind in kinds.items()) and _is_plain(run["line"])
        if right:
            run = {**run, "options": {"writers": "", **run["options"]}}  # which runs had not from the beginning
        if not right or set(run["options"]) != set(OPTIONS) or run["options"]["export"] not in (None, "l", "e", "both"):
            raise InputError(f"checkpoint {path} was not written by a run of the command line")
        for name, kind in OPTIONS.items():
            require(isinstance(run["options"][name], kind), f"{name} in {path}", run["options"][name], "ours")
        require(0 <= run["options"]["first"] <= run["frame"], f"frame in {path}", run["frame"], "one of the run's")
        return cls(path, path.parent, **run)


def _is_plain(line: dict) -> bool:
    """Whether a line of the log is one that JSON can say."""
    try:
        return bool(json.dumps(line, allow_nan=False))
    except ValueError:
        return False


def find_start(folder: Path) -> Start:
    """The newest sound checkpoint of a folder.

    Raises:
        InputError: there is none.
    """
    from melp_warp.stepping import checkpoint

    problems = []
    for name in (NEWER, CHECKPOINT, OLDER):
        path = folder / name
        if path.exists():
            try:
                checkpoint.check_sum(path)
                return Start.of(path, checkpoint.read_header(path)["run"])
            except InputError as error:
                problems.append(str(error))
    raise InputError("; ".join(problems) or f"{folder} holds no checkpoint to go on from: start anew with --overwrite")


def numbers_of(start: Start, scene: str, given: Mapping[str, Value], same: bool) -> dict[str, Value]:
    """The numbers of a run that goes on: those it had, and those that are `given` now.

    Args:
        start: where it goes on from.
        scene: name of the scene that is asked for.
        given: values of keys that are asked for.
        same: whether it goes on as it was, so that none but the number of frames may differ.

    Raises:
        InputError: the scene or a number differs; it tells which.
    """
    require(scene == start.scene, "scene", scene, f"{start.scene}, which {start.folder} holds")
    differ = [key for key, value in given.items() if key != "frames" and start.parameters.get(key) != value]
    told = "; ".join(f"{key} is {_shown(start.parameters.get(key))} there, {_shown(given[key])} here" for key in differ)
    if differ and same:
        raise InputError(f"{start.folder} holds a run of other numbers: {told}; start a new folder with --branch")
    numbers = {**start.parameters, **given}
    done = start.frame - start.options["first"]
    require(numbers["frames"] >= done, "frames", numbers["frames"], f"at least {done}, which are there")
    return numbers


def options_of(start: Start, given: Mapping[str, object], same: bool) -> dict[str, object]:
    """What a run that goes on writes: what it wrote, and what is `given` now (None: nothing is).

    Raises:
        InputError: it differs where it must be the `same`.
    """
    for name, value in given.items():
        was = start.options[name]
        fixed = same or name == "first"
        require(not fixed or value in (None, was), f"--{NAMES.get(name, name)}", value, f"{was}, as it was")
    return {**start.options, **{name: value for name, value in given.items() if value is not None}}


def _shown(value: Value) -> str:
    return "auto" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def check_folder(folder: Path, overwrite: bool) -> None:
    """Refuse, before anything costly, a folder that is taken or that cannot be written.

    Raises:
        InputError: it is; with `overwrite` a folder may hold a run, but nothing else.
    """
    if folder.is_dir():
        held = sorted(os.listdir(folder))
        if overwrite:
            held = [name for name in held if name not in OURS and not _LEFTOVER.fullmatch(name)]
        if held:
            more = f" and {len(held) - 1} more" if len(held) > 1 else ""
            allowed = "a folder that holds a run and nothing else" if overwrite else "a new or empty folder"
            raise InputError(f"--out must be {allowed}, got {str(folder)!r}, which holds {held[0]}{more}")
    require(not is_systems(folder), "--out", str(folder), "a folder of a disk")
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    require(existing.is_dir(), "--out", str(folder), f"a folder; {existing} is a file")
    require(os.access(existing, os.W_OK | os.X_OK), "--out", str(folder), f"writable; {existing} is not")


def clear(folder: Path) -> None:
    """Remove what a run wrote into a folder, and nothing else."""
    for frame in list_frames(folder):
        frame_path(folder, frame).unlink()
    remove_leftovers(folder)
    with contextlib.suppress(OSError):  # there is something of somebody else's in it
        (folder / FRAMES).rmdir()
    shutil.rmtree(folder / EXTRAS, ignore_errors=True)
    for name in OURS - {FRAMES, EXTRAS}:
        (folder / name).unlink(missing_ok=True)


def remove_leftovers(folder: Path) -> None:
    """Remove the temporaries of a writer that was killed."""
    for place in (folder, folder / FRAMES):
        for name in os.listdir(place) if place.is_dir() else ():
            if _LEFTOVER.fullmatch(name):
                (place / name).unlink(missing_ok=True)


def cut_back(start: Start) -> tuple[int, int]:
    """Cut cache and log of a run back to its checkpoint; the first and the last frame that are there then.

    The last one is the checkpoint's, or the one before where that was not written. A branch keeps its own first frame.

    Raises:
        InputError: frames or lines before the checkpoint are missing.
    """
    folder, last = start.folder, start.frame if start.written else start.frame - 1
    frames = [frame for frame in list_frames(folder) if frame <= last]
    first = frames[0] if frames else last + 1
    whole = frames == list(range(first, last + 1)) and (frames or not start.written)
    require(whole, str(folder), f"frames {frames[:3]} to {frames[-3:]}", f"all frames up to {last}, the checkpoint's")
    kept = _lines_before(folder / LOG, first, start.frame)
    lines = [*kept, *([json.dumps(start.line, allow_nan=False)] if start.written else [])]
    _promote(start.path)
    for frame in list_frames(folder):
        if frame > last:
            frame_path(folder, frame).unlink()
    remove_leftovers(folder)
    with replacing(folder / LOG) as new:
        new.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return first, last


def _promote(path: Path) -> None:
    """Make the checkpoint that a run goes on from the newest one, without those that are not sound."""
    folder = path.parent
    if path.name != NEWER:
        (folder / NEWER).unlink(missing_ok=True)
        if path.name == OLDER:
            (folder / CHECKPOINT).unlink(missing_ok=True)
    elif (folder / CHECKPOINT).exists():
        os.replace(folder / CHECKPOINT, folder / OLDER)
    os.replace(path, folder / CHECKPOINT)


def _lines_before(path: Path, first: int, last: int) -> list[str]:
    """The lines of a log for frames `first` to `last` - 1; what follows, a half line perhaps, is left out."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()[: last - first]
        found = [json.loads(line)["frame"] for line in lines]
    except FileNotFoundError:
        lines, found = [], []
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is damaged: {error}") from None
    require(found == list(range(first, last)), str(path), f"{len(found)} lines", f"a line for each frame before {last}")
    return lines
