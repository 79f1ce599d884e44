"""What a run is to do, checked before anything is done."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from melp_warp.errors import require
from melp_warp.parameters import Value
from melp_warp.program.resume import (
    Start,
)
from melp_warp.program.room import ALL, Room, Written, check_disk, check_memory
from melp_warp.program.writers import find_writers
from melp_warp.scene import Scene

if TYPE_CHECKING:
    pass

MOST_TRIANGLES = 100_000_000


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


def check_numbers(plan: Plan) -> None:
    """Refuse numbers of frames that a cache cannot have."""
    from melp_warp.usd.schema import MAX_FRAME

    most = MAX_FRAME - plan.scene.frames
    require(0 <= plan.first <= most, "--start", plan.first, f"a whole number from 0 to {most}")
    check_triangles(plan.triangles)
    find_writers(plan.writers)


def check_triangles(triangles: int | None) -> None:
    """Refuse a number of triangles that is none."""
    allowed = f"a whole number from 1 to {MOST_TRIANGLES}"
    require(triangles is None or 1 <= triangles <= MOST_TRIANGLES, "--triangles", triangles, allowed)


def check_room(plan: Plan) -> None:
    """Refuse at once what cannot fit."""
    scene = plan.scene
    check_memory(scene, plan.device, plan.room)
    counts = scene.e_count, scene.e_count * scene.l_per_e
    done = plan.start.frame - plan.first + 1 if plan.start else 0
    sizes = written(plan)
    need = sizes.cache_bytes(*counts, scene.frames + 1 - done) + sizes.other_bytes(*counts)
    check_disk(plan.out, need, plan.room)


def written(plan: Plan) -> Written:
    """What the run writes."""
    with_l = plan.scene.l_per_e > 0 and plan.export != "e"
    e_sets = int(not with_l) + int(plan.export in ("e", "both"))
    return Written(e_sets, int(with_l), plan.full, plan.mesh, plan.triangles, plan.preview, plan.whole)


def begin_warp() -> None:
    """Start Warp; nothing before that needs it."""
    from melp_warp.device.environment import start_warp

    start_warp()
