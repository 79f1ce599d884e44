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

FULL_BYTES, PACKED_BYTES = 57, 32
"""On disk, a particle and frame: fourteen float32 and what the ids and flags take; seven, and what all else takes."""

TRIANGLE_BYTES = 40
"""The same of a triangle of a mesh."""

WHOLE_BYTES, WHOLE_TRIANGLES = 100, 30
"""The same of a triangle of a whole foam's mesh, which has values at corners; and how many of these there are an E."""

FRAME_BYTES = 6000
"""The same of a frame without particles, with its line of the log."""

CHECKPOINT_E, CHECKPOINT_L, CHECKPOINTS = 360, 110, 3
"""The same of an E and an L in a checkpoint, and how many there are while one is written."""

PICTURE_BYTES = 4_000_000
"""Of the pictures at a run's end, at most."""

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


@dataclass(frozen=True)
class Written:
    """What a run writes.

    Attributes:
        e_sets: how often each frame stores the E.
        l_sets: how often it stores the L.
        full: whether all of the L's arrays are stored to the bit.
        mesh: whether it stores meshes.
        triangles: how many; None for about as many as there are L.
        pictures: whether pictures are drawn at the end.
        whole: whether the mesh is one of the whole foam.
    """

    e_sets: int = 0
    l_sets: int = 1
    full: bool = False
    mesh: bool = False
    triangles: int | None = None
    pictures: bool = False
    whole: bool = False

    def cache_bytes(self, e_count: int, l_count: int, frames: int) -> int:
        """Bytes of the cache and its log."""
        usual = WHOLE_TRIANGLES * e_count if self.whole else l_count or 2 * e_count
        triangles = (self.triangles or usual) * (WHOLE_BYTES if self.whole else TRIANGLE_BYTES) if self.mesh else 0
        an_l = FULL_BYTES if self.full else PACKED_BYTES
        particles = FULL_BYTES * self.e_sets * e_count + an_l * self.l_sets * l_count
        return frames * (FRAME_BYTES + particles + triangles)

    def other_bytes(self, e_count: int, l_count: int) -> int:
        """Bytes of checkpoints and pictures."""
        return CHECKPOINTS * (CHECKPOINT_E * e_count + CHECKPOINT_L * l_count) + PICTURE_BYTES * self.pictures


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
    """Refuse a run that does not fit onto the disk of its folder.

    Raises:
        InputError: it does not.
    """
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    limit = min(room.disk or free, free)
    what = "--max-disk" if limit < free else f"the disk of {existing}"
    told = f"about {size_text(need)} with checkpoints"
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
