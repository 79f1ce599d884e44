"""Checks of run.jsonl and of what lies beside a cache."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from melp_warp.files import digest
from melp_warp.usd.check_words import few, frame_name, in_words, listed
from melp_warp.usd.schema import (
    FRAMES,
    MANIFEST,
    MAX_FRAME,
    ROOT,
)

LOG = "run.jsonl"


LONGEST_LINE = 1_000_000
"""Bytes of a line of run.jsonl: one of 10,000 regions has some 300,000."""


def check_log(directory: Path, on_disk: Sequence[int], at: Callable[[str], None]) -> list[str]:
    """A line for each frame, and files that are what was written; a killed run may leave half a line or one too few."""
    path = directory / LOG
    if not os.path.lexists(path):
        return []
    if not path.is_file():
        return [f"{LOG}: is no file"]
    at(LOG)
    frames, digests, problems = [], {}, []
    with path.open("rb") as log:
        for number, line in enumerate(iter(lambda: log.readline(LONGEST_LINE), b""), 1):
            if not line.endswith(b"\n") and not log.read(1):
                break
            frame, found = _read_line(line)
            if frame is None:
                problems.append(f"{LOG}: line {number}: {found}")
                break
            frames.append(frame)
            digests |= found
    if problems:
        return problems
    wanted = list(on_disk) if len(frames) == len(on_disk) else list(on_disk)[:-1]
    if frames != wanted:
        problems.append(f"{LOG}: has lines for {listed(frames)}, on disk are frames {listed(on_disk)}")
    if on_disk and (not frames or frames[-1] != on_disk[-1]):
        digests.pop(ROOT, None)  # the root is written once more before the line of a frame
    for name, digest_ in digests.items():
        at(name)
        if (directory / name).is_file() and digest(directory / name) != digest_:
            problems.append(f"{name}: is not what the run wrote: its SHA-256 is another than in {LOG}")
    return few(problems)


def _read_line(line: bytes) -> tuple[int | None, dict[str, str] | str]:
    """Frame and checksums of a line of the log; or None and what is wrong with it."""
    try:
        entry = json.loads(line.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        return None, f"is not JSON: {in_words(error)}"
    frame = entry.get("frame") if isinstance(entry, dict) else None
    if not isinstance(frame, int) or isinstance(frame, bool) or not 0 <= frame <= MAX_FRAME:
        return None, f'has no "frame" from 0 to {MAX_FRAME}'
    found = entry.get("sha256", {})
    names = (ROOT, MANIFEST, frame_name(frame))
    if not isinstance(found, dict) or not all(k in names and isinstance(v, str) for k, v in found.items()):
        return None, '"sha256" must name the files of this frame alone'
    return frame, found


def _refuse(constant: str):
    raise ValueError(f"{constant} is no number of JSON")


def leftovers(directory: Path) -> list[str]:
    """Files that were never finished."""
    folders = (("", directory), (f"{FRAMES}/", directory / FRAMES))
    return [
        f"{prefix}{name}: left over from a write that did not finish; it can be deleted"
        for prefix, folder in folders
        if folder.is_dir()
        for name in sorted(os.listdir(folder))
        if ".tmp" in name
    ]
