"""Whether a run fits: memory and disk, told from its numbers before anything is made."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from melp_warp.errors import require
from melp_warp.scene import Scene

LEAST_E, LEAST_L = 2000, 800
"""Bytes that the arrays of an E and of an L take at least: foams take thrice that an E, films of E alone just that."""

FRAME_BYTES = 60
"""On disk, a particle and frame: fourteen float32 and what the ids and flags are packed to."""

TRIANGLE_BYTES = 40
"""The same of a triangle of a mesh."""

_SIZE = re.compile(r"(\d{1,12}(?:\.\d{1,6})?) ?([kMGT]?)B?")


@dataclass(frozen=True)
class Room:
    """The most that a run may take; None for what there is.

    Attributes:
        memory: bytes.
        disk: bytes.
    """

    memory: float | None = None
    disk: float | None = None


ALL = Room()
"""No limit but what there is."""


def parse_size(name: str, text: str | None) -> float | None:
    """Bytes from "500MB" or "1.5 GB"; None from None.

    Raises:
        InputError: it is no size.
    """
    if text is None:
        return None
    found = _SIZE.fullmatch(text)
    require(found is not None and float(found[1]) > 0.0, name, text, "a size above 0 such as 500MB or 1.5GB")
    return float(found[1]) * 1000.0 ** " kMGT".index(found[2] or " ")


def size_text(count: float) -> str:
    """Bytes in words."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} TB"


def disk_bytes(e_count: int, l_count: int, frames: int, triangles: int = 0) -> int:
    """Bytes of a cache whose `frames` hold so many particles and triangles each."""
    return frames * (FRAME_BYTES * (e_count + l_count) + TRIANGLE_BYTES * triangles)


def check_memory(scene: Scene, device: str, room: Room) -> None:
    """Refuse a scene whose particles cannot fit into memory.

    Raises:
        InputError: they cannot, whatever else is in it.
    """
    count = scene.e_count * scene.l_per_e
    need = LEAST_E * scene.e_count + LEAST_L * count
    there = memory_of(device)
    limit = min(room.memory or there, there)
    what = "--max-memory" if limit < there else f"the memory of {device}"
    told = f"{scene.e_count:,} E and {count:,} L, which take {size_text(need)} at least"
    require(need <= limit, "e_count and l_per_e", told, f"few enough for {what}, {size_text(limit)}")


def check_disk(folder: Path, need: float, room: Room) -> None:
    """Refuse a cache that does not fit onto the disk of its folder.

    Raises:
        InputError: it does not.
    """
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    limit = min(room.disk or free, free)
    what = "--max-disk" if limit < free else f"the disk of {existing}"
    told = f"a cache of about {size_text(need)}"
    require(need <= limit, "frames and particles", told, f"few enough for {what}, {size_text(limit)}")


def memory_of(device: str) -> float:
    """Bytes that a device has in all."""
    if device != "cpu":
        from melp_warp.simulation import find_device

        return float(find_device(device).total_memory)
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):  # not every system tells
        return float("inf")
