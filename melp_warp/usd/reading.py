"""Frames, meshes and metadata of a cache, read back."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from melp_warp.errors import InputError, SimulationError, require
from melp_warp.frame import CurveFrame, MeshFrame, ParticleFrame, WholeFrame
from melp_warp.usd.conditions import check_arrays
from melp_warp.usd.layers import open_layer, origin_of, reason
from melp_warp.usd.packing import refine_normals
from melp_warp.usd.schema import (
    LARGEST,
    METADATA_KEY,
    RIM_CURVES,
    ROOT,
    WHOLE,
    Attribute,
    Frame,
    attributes_of,
    frame_kind,
    frame_path,
    is_mesh,
    layout_of,
    prims_of,
    surface_prim,
)


def read_frame(directory: str | os.PathLike, frame: int, prim: str = "Film") -> ParticleFrame:
    """Return one particle set of one frame, bit for bit as it was written.

    Of a packed set the widths are in steps, and the normals are those of a surface through the points, see packing.py.

    Raises:
        InputError: the frame or prim is not there, the file is damaged, or it holds what `CacheWriter` would not write.
    """
    read, packed = read_prim(directory, frame, prim)
    return refine_normals(read) if packed else read


def read_curves(directory: str | os.PathLike, frame: int) -> CurveFrame:
    """Return the free rims of one frame as curves, bit for bit as they were written.

    Raises:
        InputError: as `read_frame`.
    """
    return read_prim(directory, frame, RIM_CURVES)[0]


def read_mesh(directory: str | os.PathLike, frame: int, region: int = 0) -> MeshFrame:
    """Return the mesh of one region in one frame, bit for bit as it was written; empty where the region is not there.

    Raises:
        InputError: as `read_frame`.
    """
    return read_prim(directory, frame, surface_prim(region))[0]


def read_whole(directory: str | os.PathLike, frame: int) -> WholeFrame:
    """Return the mesh of the whole foam in one frame, bit for bit as it was written.

    Raises:
        InputError: as `read_frame`.
    """
    return read_prim(directory, frame, WHOLE)[0]


def read_prim(directory: str | os.PathLike, frame: int, prim: str) -> tuple[Frame, bool]:
    """Either of them by the prim's name from /World, as it is stored; and whether it is packed."""
    path = frame_path(directory, frame)
    layer = open_layer(path)
    layout, arrays, more = layout_of(layer, [prim]), {}, {}
    for attribute in attributes_of(prim, layout):
        if attribute.field is None:
            continue
        array = read_values(layer, prim, attribute, frame)
        if isinstance(array, str):
            raise InputError(f"{path}: /World/{prim}.{attribute.name} {array}")
        (more if attribute.field.startswith("carried.") else arrays)[attribute.field.removeprefix("carried.")] = array
    try:
        if is_mesh(prim):
            require(len(arrays["faces"]) % 3 == 0, f"{prim}.faces", len(arrays["faces"]), "three corners a face")
            arrays["faces"] = arrays["faces"].reshape(-1, 3)
        arrays |= {"carried": more} if more else {}
        read = frame_kind(prim)(**arrays, origin=origin_of(layer, prim))
        check_arrays(prim, read, attributes_of(prim, layout))
    except (InputError, SimulationError) as error:
        raise InputError(f"{path}: {error}") from None
    return read, bool(layout.packed)


def read_values(layer, prim: str, attribute: Attribute, frame: int) -> np.ndarray | str:
    """The value of an attribute for each particle at a frame, [n] or [n, 3]; or what is wrong with it, in words."""
    table = read_sample(layer, prim, attribute, frame)
    if isinstance(table, str) or not attribute.indexed:
        return table
    rows = read_sample(layer, prim, attribute.rows, frame)
    if isinstance(rows, str):
        return f"indices: {rows}"
    if len(rows) and not (rows.min() >= 0 and rows.max() < len(table)):
        return f"has indices from {rows.min()} to {rows.max()}, must be from 0 to {len(table) - 1}"
    return table[rows]


def read_sample(layer, prim: str, attribute: Attribute, frame: int) -> np.ndarray | str:
    """The sample of an attribute at a frame, [n] or [n, 3]; or what is wrong with it, in words."""
    from pxr import Vt

    try:
        value = layer.QueryTimeSample(f"/World/{prim}.{attribute.name}", float(frame))
        if value is None:
            return f"has no value at time code {frame}"
        if not isinstance(value, getattr(Vt, attribute.array)):
            return f"is {type(value).__name__}, must be {attribute.type_name}"
        array = np.array(value, dtype=attribute.dtype)
    except Exception as error:  # a value that Python cannot hold
        return f"cannot be read: {reason(error)}"
    return array.reshape(-1, 3) if attribute.columns == 3 else array


def read_metadata(directory: str | os.PathLike) -> dict:
    """Return what the root says of the run.

    Returns:
        The metadata given to `CacheWriter` with schemaVersion, thicknessUnit, refractiveIndex, colorGain and
        versions, and besides framesPerSecond, startTimeCode, endTimeCode and prims (list of names from /World).

    Raises:
        InputError: there is no cache, or it is not one of this program.
    """
    path = Path(directory) / ROOT
    layer = open_layer(path)
    try:
        data = layer.customLayerData.get(METADATA_KEY)
        times = {name: getattr(layer, name) for name in ("framesPerSecond", "startTimeCode", "endTimeCode")}
        prims = prims_of(layer)
    except Exception as error:  # values that Python cannot hold
        raise InputError(f"{path} cannot be read: {reason(error)}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: customLayerData has no {METADATA_KEY}; this is not a cache of melp-warp")
    if not all(np.isfinite(time) for time in times.values()) or times["framesPerSecond"] <= 0.0:
        raise InputError(f"{path}: framesPerSecond, startTimeCode and endTimeCode must be numbers, got {times}")
    return data | times | {"prims": prims}


def holds_l(metadata: Mapping) -> tuple[bool, int]:
    """Whether /World/Film of a cache holds L rather than E, and how many L there are an E, from its metadata."""
    particles, parameters = metadata.get("particles"), metadata.get("parameters")
    count = parameters.get("l_per_e", 0) if isinstance(parameters, dict) else 0
    count = int(count) if isinstance(count, (int, float)) and 0 <= count <= LARGEST else 0
    film = particles.get("Film") if isinstance(particles, dict) else None
    return (film == "l" if film in ("l", "e") else count > 0), max(count, 1)


def store_floors(floors: Sequence[tuple[Sequence[float], Sequence[float]]]) -> dict:
    """Point and normal of each floor as metadata, {} for none; see `floors_of`."""
    named = {}
    for k, (point, normal) in enumerate(floors):
        named[f"floor_{k}"] = {
            f"{name}_{axis}": float(v)
            for name, vector in (("point", point), ("normal", normal))
            for axis, v in zip("xyz", vector, strict=True)
        }
    return {"floors": named} if named else {}


def floors_of(metadata: Mapping) -> list[tuple[list[float], list[float]]]:
    """Point (m, from the place of the prims) and unit normal of each plate that the film stands on."""
    found = []
    named = metadata.get("floors")
    for _, floor in sorted(named.items()) if isinstance(named, dict) else ():
        numbers = [
            floor.get(f"{name}_{axis}") if isinstance(floor, dict) else None
            for name in ("point", "normal")
            for axis in "xyz"
        ]
        if all(isinstance(v, float) and abs(v) <= LARGEST for v in numbers) and any(numbers[3:]):
            normal = np.array(numbers[3:]) / np.linalg.norm(numbers[3:])
            found.append((numbers[:3], normal.tolist()))
    return found


def refers_to(layer) -> list[str]:
    """What a layer takes from elsewhere besides its clips: files that it is composed of or names, and other prims.

    Nothing but the root's clips is in a cache of ours, and a stage over anything else could open any file there is.
    """
    found = [f"file {path}" for path in layer.GetCompositionAssetDependencies()]
    arcs = ("references", "payload", "inheritPaths", "specializes", "variantSetNames")

    def visit(path) -> None:
        spec = layer.GetObjectAtPath(path)
        if path.IsPrimPath() and any(spec.HasInfo(arc) for arc in arcs):
            found.append(f"other prims at {path}")
        if path.IsPropertyPath() and str(getattr(spec, "typeName", "")).startswith("asset"):
            found.append(f"files at {path}")

    layer.Traverse("/", visit)
    return found
