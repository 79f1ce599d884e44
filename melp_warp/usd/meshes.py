"""Meshes put into a cache that is there."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from melp_warp.errors import InputError, require
from melp_warp.frame import MeshFrame, WholeFrame
from melp_warp.optics import display_color
from melp_warp.usd.conditions import check_arrays
from melp_warp.usd.layers import (
    MATERIAL,
    declare,
    export,
    manifest_layer,
    open_layer,
    origin_of,
    set_purposes,
    set_range,
    set_values,
)
from melp_warp.usd.reading import read_metadata, refers_to
from melp_warp.usd.schema import (
    DROPS,
    FRAMES,
    FREE_RIMS,
    MANIFEST,
    RIM_CURVES,
    ROOT,
    SURFACE,
    attributes_of,
    frame_kind,
    frame_path,
    is_mesh,
    layout_of,
    list_frames,
    prims_of,
)


def add_meshes(
    directory: str | os.PathLike, make: Callable[[int], Mapping[str, MeshFrame | WholeFrame]], meshes: Sequence[str]
) -> dict[str, str]:
    """Put meshes into the frames of a cache, in place of those that are there.

    Frame after frame is replaced as a whole, the manifest and the root last: what was there stays valid throughout.

    Args:
        directory: folder of the cache.
        make: gives the meshes of a frame by prim; those that are left out are not there.
        meshes: names of all meshes from /World: `surface_prim` of each region of the run, or `WHOLE`.

    Returns:
        SHA-256 of the files that were written, by their paths in the folder.

    Raises:
        InputError: no cache, a damaged frame, or a file that cannot be written.
    """
    directory = Path(directory)
    root, sums = open_layer(directory / ROOT), {}
    require(not refers_to(root), "directory", str(directory), "a cache that refers to its own frames alone")
    metadata = read_metadata(directory)
    fps, gain, index = (metadata.get(name) for name in ("framesPerSecond", "colorGain", "refractiveIndex"))
    try:
        display_color(np.zeros(0, np.float32), gain, index)
    except (InputError, TypeError):
        raise InputError(f"{directory / ROOT}: colorGain and refractiveIndex are {gain!r:.80}, {index!r:.80}") from None
    sets = [prim for prim in prims_of(root) if not is_mesh(prim)]
    points = [prim for prim in sets if prim not in (FREE_RIMS, RIM_CURVES, DROPS)]
    numbers = list_frames(directory)
    require("Film" in points and bool(numbers), "directory", str(directory), "a cache with frames and /World/Film")
    origin, layout = origin_of(root, "Film"), layout_of(root, points)
    layout = layout._replace(meshed=layout.carried)
    for frame in numbers:
        path = frame_path(directory, frame)
        made, layer = make(frame), open_layer(path)
        _drop_meshes(layer)
        declare(layer, meshes, origin, layout)
        for prim in meshes:
            mesh = made.get(prim) or frame_kind(prim).empty(origin, layout.meshed)
            check_arrays(f"frame {frame} {prim}", mesh, attributes_of(prim, layout))
            set_values(layer, frame, prim, mesh, layout, gain, index)
        sums[f"{FRAMES}/{path.name}"] = export(layer, path)
    manifest = manifest_layer(fps, [*sets, *meshes], layout)
    sums[MANIFEST] = export(manifest, directory / MANIFEST)
    _drop_meshes(root)
    declare(root, meshes, origin, layout)
    set_range(root, numbers[0], numbers[-1])  # before USD opens it as a stage: no clips but these
    _bind(root, meshes)
    return sums | {ROOT: export(root, directory / ROOT)}


def _drop_meshes(layer) -> None:
    surface = layer.GetPrimAtPath(f"/World/{SURFACE}")
    if surface:
        del layer.GetPrimAtPath("/World").nameChildren[SURFACE]


def _bind(root, meshes: Sequence[str]) -> None:
    """Give meshes that were added the material of the cache, and make them what is shown."""
    from pxr import Usd, UsdShade

    stage = Usd.Stage.Open(root)
    material = UsdShade.Material(stage.GetPrimAtPath(MATERIAL))
    for prim in meshes:
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(f"/World/{prim}")).Bind(material)
    set_purposes(stage, prims_of(root))
