"""What is done with a folder that a run has written: pictures, meshes, a script for Blender."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.errors import require
from melp_warp.program.plan import Plan, begin_warp, check_triangles
from melp_warp.program.resume import (
    CONTACT,
    LOG,
)
from melp_warp.program.writers import make_surfaces, mesh_prims

if TYPE_CHECKING:
    from melp_warp.preview.pictures import Shot

CONTACT_FRAMES = 9


PREVIEW_SIZE, CONTACT_SIZE = 800, 400


def draw(shot: Shot) -> list[Path]:
    """Draw frames of a cache; see `melp_warp.preview.pictures.shoot`."""
    begin_warp()
    from melp_warp.preview import pictures

    return pictures.shoot(shot)


def write_blender(folder: Path) -> Path:
    """Put the script that opens a cache in Blender beside it; see `melp_warp.program.blender`."""
    begin_warp()
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
    check_triangles(triangles)
    begin_warp()
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


def write_stage(folder: Path) -> None:
    """A layer with a camera and lights for the run."""
    from melp_warp.preview.pictures import Cache
    from melp_warp.usd.forms import write_stage

    camera = Cache(folder).camera()
    write_stage(folder, camera.eye, camera.target, camera.up, camera.fov)


def draw_run(plan: Plan) -> list[Path]:
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
