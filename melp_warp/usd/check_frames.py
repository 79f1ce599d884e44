"""Checks of a frame of a cache: what each array must fulfil."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from melp_warp.errors import InputError
from melp_warp.frame import WholeFrame
from melp_warp.optics import display_color
from melp_warp.usd.check_layers import check_declaration, check_fixed, check_units
from melp_warp.usd.check_surfaces import check_corners, check_surface, check_whole
from melp_warp.usd.check_words import expect, frame_name, metadata_of
from melp_warp.usd.layers import origin_of
from melp_warp.usd.packing import shown_thickness
from melp_warp.usd.reading import read_sample
from melp_warp.usd.schema import (
    FILM_SETS,
    FREE_RIMS,
    LARGEST,
    METADATA_KEY,
    MOST_REGIONS,
    PACKED_NORMALS,
    RIM_CURVES,
    ROOT,
    THICKNESS_UNIT,
    WHOLE,
    Attribute,
    Layout,
    attributes_of,
    entries_of,
    is_mesh,
    with_rows,
)

PLAUSIBLE_THICKNESS = (1.0, 1e5)
"""nm; the median of a frame lies within, or the unit is wrong."""


NORMAL_TOLERANCE = 1e-4


COLOR_TOLERANCE = 1e-4


EXTENT_TOLERANCE = 4.0 * float(np.finfo(np.float32).eps)
"""Relative to the largest coordinate."""


def check_frame(layer, frame: int, root, prims: list[str], layout: Layout, rims: int | None) -> list[str]:
    """What is wrong with the file of a frame."""
    name = frame_name(frame)
    problems = check_units(name, layer, root.framesPerSecond)
    problems += expect(f"{name}: startTimeCode", layer.startTimeCode, float(frame))
    problems += expect(f"{name}: endTimeCode", layer.endTimeCode, float(frame))
    unit = metadata_of(layer).get("thicknessUnit")
    problems += expect(f"{name}: {METADATA_KEY}.thicknessUnit", unit, THICKNESS_UNIT)
    beads = layer.QueryTimeSample(f"/World/{FREE_RIMS}.points", float(frame)) if FREE_RIMS in prims else None
    if beads is not None and len(beads):
        rims = None
    for prim in prims:
        problems += expect(f"{name}: /World/{prim}: origin", origin_of(layer, prim), origin_of(root, prim))
        arrays = {}
        problems += check_fixed(name, layer, prim)
        attributes = attributes_of(prim, layout)
        for attribute in with_rows(attributes):
            found = check_declaration(name, layer, prim, attribute)
            if not found:
                found, array = _read_array(name, layer, frame, prim, attribute)
                if not found:
                    arrays[attribute.name] = array
            problems += found
        problems += _look_up(f"{name}: /World/{prim}", arrays, attributes)
        problems += _check_arrays(name, prim, arrays, attributes, metadata_of(root), rims)
    return problems


def _look_up(where: str, arrays: dict[str, np.ndarray], attributes: Sequence[Attribute]) -> list[str]:
    """Put what each particle has in place of tables and rows, as far as they fit together."""
    problems = []
    for attribute in attributes:
        if attribute.indexed:
            table, rows = (arrays.pop(one.name, None) for one in (attribute, attribute.rows))
            if table is None or rows is None:
                continue
            if len(rows) and not (rows.min() >= 0 and rows.max() < len(table)):
                what = f"from {rows.min()} to {rows.max()}, must be from 0 to {len(table) - 1}"
                problems.append(f"{where}.{attribute.rows.name}: {what}")
            else:
                arrays[attribute.name] = table[rows]
    return problems


def _read_array(name: str, layer, frame: int, prim: str, attribute: Attribute) -> tuple[list[str], np.ndarray | None]:
    """The one sample of an attribute, [n] or [n, 3]; or what is wrong with it."""
    path = f"/World/{prim}.{attribute.name}"
    times = layer.ListTimeSamplesForPath(path)
    if times != [float(frame)]:
        return [f"{name}: {path}: has samples at {times!s:.200}, must have one at {frame}"], None
    array = read_sample(layer, prim, attribute, frame)
    if isinstance(array, str):
        return [f"{name}: {path}: {array}"], None
    finite = np.isfinite(array)
    if not finite.all():
        at = int(np.argmin(finite.reshape(len(array), -1).all(axis=1)))
        return [
            f"{name}: {path}: not finite in {len(array) - finite.reshape(len(array), -1).all(axis=1).sum()} "
            f"entries, first at {at}"
        ], None
    # the bounds of no points are as large as can be
    large = array.dtype.kind == "f" and attribute.name != "extent" and np.abs(array).max(initial=0.0) > LARGEST
    return ([f"{name}: {path}: has numbers above {LARGEST:g}"], None) if large else ([], array)


def _check_arrays(
    name: str,
    prim: str,
    arrays: dict[str, np.ndarray],
    attributes: Sequence[Attribute],
    metadata: dict,
    rims: int,
) -> list[str]:
    """What the arrays of one prim must fulfil; each rule applies where the arrays it needs are sound."""
    where, problems = f"{name}: /World/{prim}", []
    if "points" not in arrays:
        return problems
    count = len(arrays["points"])
    faces = len(arrays.get("curveVertexCounts" if prim == RIM_CURVES else "faceVertexCounts", ()))
    for attribute in attributes[1:-1]:
        array, wanted = arrays.get(attribute.name), entries_of(attribute, count, faces)
        if array is not None and len(array) != wanted and not attribute.name.startswith("faceVertex"):
            what = f"{count} points" if wanted == count else f"{count} points and {faces} faces"
            problems.append(f"{where}.{attribute.name}: {len(array)} values for {what}")
            del arrays[attribute.name]
    for rule_name, rule in _RULES:
        if rule_name in arrays and not (rule is _check_thickness and not is_mesh(prim) and prim not in FILM_SETS):
            problems += [f"{where}.{rule_name}: {problem}" for problem in rule(arrays, metadata)]
    if prim == WHOLE and {a.name for a in attributes_of(prim)} <= set(arrays):
        problems += [f"{where}: {problem}" for problem in _check_whole_arrays(arrays, rims)]
    elif is_mesh(prim) and prim != WHOLE and {"faceVertexCounts", "faceVertexIndices"} <= set(arrays):
        problems += [f"{where}: {problem}" for problem in check_surface(arrays, rims)]
    return problems


def _check_whole_arrays(arrays: dict, rims: int) -> list[str]:
    """`check_whole` of what a file says, after what it needs."""
    problems = check_corners(arrays)
    inside, outside = (arrays[f"primvars:{name}"] for name in ("inside", "outside"))
    if len(inside) and not (
        0 <= inside.min() and -1 <= outside.min() and max(inside.max(), outside.max()) < MOST_REGIONS
    ):
        problems.append(f"primvars:inside and outside: must be regions from 0 to {MOST_REGIONS - 1}, outside or -1")
    if problems:
        return problems
    fields = {a.field: arrays[a.name] for a in attributes_of(WHOLE) if a.field}
    return check_whole(WholeFrame(**fields | {"faces": fields["faces"].reshape(-1, 3)}), rims)


def _check_curves(arrays: dict, metadata: dict) -> list[str]:
    counts, points = arrays["curveVertexCounts"], len(arrays["points"])
    if counts.min(initial=2) < 2 or counts.sum(dtype=np.int64) != points:
        return [f"must be two or more each and {points} in all, the least is {counts.min(initial=2)}"]
    return []


def _check_ids(arrays: dict, metadata: dict) -> list[str]:
    falls = arrays["ids"][1:] < arrays["ids"][:-1]
    problems = []
    if falls.any():
        problems.append(f"not in ascending order, first at entry {int(np.argmax(falls)) + 1}")
    values, counts = np.unique(arrays["ids"], return_counts=True)
    if (counts > 1).any():
        problems.append(f"id {values[np.argmax(counts > 1)]} occurs {counts[np.argmax(counts > 1)]} times")
    return problems


def _check_widths(arrays: dict, metadata: dict) -> list[str]:
    negative = arrays["widths"] < 0.0
    return [f"negative in {negative.sum()} entries, first at {np.argmax(negative)}"] if negative.any() else []


def _check_normals(arrays: dict, metadata: dict) -> list[str]:
    normals = arrays[PACKED_NORMALS.name if PACKED_NORMALS.name in arrays else "normals"]
    length = np.linalg.norm(normals.astype(np.float64), axis=1)
    bad = np.abs(length - 1.0) > NORMAL_TOLERANCE
    if not bad.any():
        return []
    return [
        f"not of unit length in {bad.sum()} entries, first at {np.argmax(bad)}: length {length[np.argmax(bad)]:.6g}"
    ]


def _check_thickness(arrays: dict, metadata: dict) -> list[str]:
    thickness = arrays["primvars:thickness"]
    if not len(thickness):
        return []
    if thickness.min() < 0.0:
        return [f"negative in {(thickness < 0.0).sum()} entries, first at {np.argmax(thickness < 0.0)}"]
    low, high = PLAUSIBLE_THICKNESS
    median = float(np.median(thickness))
    if low <= median <= high:
        return []
    return [f"median {median:.3g} is not within {low:g} to {high:g} nanometres: is the unit wrong?"]


def _check_region(arrays: dict, metadata: dict) -> list[str]:
    negative = arrays["primvars:region"] < 0
    if negative.any():
        return [f"negative in {negative.sum()} entries, first at {np.argmax(negative)}"]
    above = arrays["primvars:region"] >= MOST_REGIONS
    return [f"{MOST_REGIONS} or above in {above.sum()} entries, first at {np.argmax(above)}"] if above.any() else []


def _check_black_film(arrays: dict, metadata: dict) -> list[str]:
    bad = ~np.isin(arrays["primvars:blackFilm"], (0, 1))
    return [f"neither 0 nor 1 in {bad.sum()} entries, first at {np.argmax(bad)}"] if bad.any() else []


def _check_color(arrays: dict, metadata: dict) -> list[str]:
    color = arrays["primvars:displayColor"]
    bad = ((color < 0.0) | (color > 1.0)).any(axis=1)
    if bad.any():
        return [f"outside 0..1 in {bad.sum()} entries, first at {np.argmax(bad)}"]
    thickness = arrays.get("primvars:thickness")
    gain, index = metadata.get("colorGain"), metadata.get("refractiveIndex")
    if thickness is None or not len(thickness) or thickness.min() < 0.0 or gain is None or index is None:
        return []
    shown = shown_thickness(thickness) if PACKED_NORMALS.name in arrays else thickness
    try:
        error = np.abs(color - display_color(shown, gain, index)).max()
    except (InputError, TypeError) as problem:
        return [f"cannot be compared with the thickness: {problem}"]
    if error <= COLOR_TOLERANCE:
        return []
    return [f"off by up to {error:.3g} from the colour of the thickness at the gain and index of {ROOT}"]


def _check_extent(arrays: dict, metadata: dict) -> list[str]:
    extent, points = arrays["extent"], arrays["points"]
    widths = np.zeros(len(points)) if "faceVertexCounts" in arrays else arrays.get("widths")
    if extent.shape != (2, 3):
        return [f"has {len(extent)} vectors, must have 2"]
    if widths is None:
        return []
    if not len(points):
        return [] if (extent[0] > extent[1]).all() else ["must be empty (minimum above maximum) without points"]
    radius = 0.5 * widths[:, None].astype(np.float64)
    wanted = np.array([(points - radius).min(axis=0), (points + radius).max(axis=0)])
    if np.abs(extent.astype(np.float64) - wanted).max() <= EXTENT_TOLERANCE * np.abs(wanted).max():
        return []
    return [f"is {extent.tolist()}, points and widths fill {wanted.tolist()}"]


_RULES = (
    ("curveVertexCounts", _check_curves),
    ("ids", _check_ids),
    ("widths", _check_widths),
    ("normals", _check_normals),
    (PACKED_NORMALS.name, _check_normals),
    ("primvars:thickness", _check_thickness),
    ("primvars:region", _check_region),
    ("primvars:blackFilm", _check_black_film),
    ("primvars:displayColor", _check_color),
    ("extent", _check_extent),
)
