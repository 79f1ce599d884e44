"""Checks a USD point cache for what USD itself and its validators take without a word."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from melp_warp.errors import InputError
from melp_warp.optics import display_color
from melp_warp.usd import (
    ATTRIBUTES,
    CLIP_TEMPLATE,
    FRAMES,
    MANIFEST,
    MAX_FRAME,
    METADATA_KEY,
    ROOT,
    SCHEMA_VERSION,
    THICKNESS_UNIT,
    Attribute,
    frame_path,
    list_frames,
    open_layer,
    origin_of,
)

PLAUSIBLE_THICKNESS = (1.0, 1e5)
"""nm; the median of a frame lies within, or the unit is wrong."""

NORMAL_TOLERANCE = 1e-4
COLOR_TOLERANCE = 1e-4
EXTENT_TOLERANCE = 4.0 * float(np.finfo(np.float32).eps)
"""Relative to the largest coordinate."""


def check_cache(directory: str | os.PathLike) -> list[str]:
    """Return the problems of a cache, one line each: file, attribute, what is wrong. Empty: the cache is sound.

    Read are the root, the manifest and every frame, and the root is opened as a stage to see that the values arrive
    through the clips. The validators of `pxr.UsdValidation` run over the root and the first frame.

    Args:
        directory: folder with film.usda.
    """
    directory = Path(directory)
    problems = _leftovers(directory)
    try:
        root = open_layer(directory / ROOT)
    except InputError as error:
        return [*problems, f"{ROOT}: {error}"]
    prims = _point_prims(root)
    problems += _check_root(root, prims)
    problems += _check_manifest(directory, prims)
    on_disk = list_frames(directory)
    problems += _check_range(root, on_disk)
    broken = False
    for frame in on_disk:
        try:
            layer = open_layer(frame_path(directory, frame))
        except InputError as error:
            problems.append(f"{_frame_name(frame)}: {error}")
            broken = True
            continue
        problems += _check_frame(layer, frame, root, prims)
    if on_disk and not broken:  # USD cannot open a stage over a damaged frame
        problems += _check_stages(directory, on_disk[0], root, prims)
    return problems


def _frame_name(frame: int) -> str:
    return f"{FRAMES}/{frame_path('', frame).name}"


def _leftovers(directory: Path) -> list[str]:
    folders = (("", directory), (f"{FRAMES}/", directory / FRAMES))
    return [
        f"{prefix}{name}: left over from a write that did not finish; it can be deleted"
        for prefix, folder in folders
        if folder.is_dir()
        for name in sorted(os.listdir(folder))
        if ".tmp" in name
    ]


def _point_prims(root) -> list[str]:
    world = root.GetPrimAtPath("/World")
    return [child.name for child in world.nameChildren if child.typeName == "Points"] if world else []


# --- layers --------------------------------------------------------------------------------------------------------


def _expect(where: str, found: object, wanted: object) -> list[str]:
    return [] if found == wanted else [f"{where}: is {found!r}, must be {wanted!r}"]


def _check_units(name: str, layer, fps: float) -> list[str]:
    """Axis, scale, rate and default prim, the same in every layer."""
    info = layer.pseudoRoot.GetInfo
    return [
        *_expect(f"{name}: upAxis", info("upAxis"), "Y"),
        *_expect(f"{name}: metersPerUnit", info("metersPerUnit"), 1.0),
        *_expect(f"{name}: framesPerSecond", layer.framesPerSecond, fps),
        *_expect(f"{name}: timeCodesPerSecond", layer.timeCodesPerSecond, fps),
        *_expect(f"{name}: defaultPrim", layer.defaultPrim, "World"),
    ]


def _check_declaration(name: str, layer, prim: str, attribute: Attribute) -> list[str]:
    """The attribute is there with its type and interpolation, and has no default value."""
    where = f"{name}: /World/{prim}.{attribute.name}"
    spec = layer.GetAttributeAtPath(f"/World/{prim}.{attribute.name}")
    if spec is None:
        return [f"{where}: missing"]
    problems = _expect(f"{where}: type", str(spec.typeName), attribute.type_name)
    if attribute.interpolation:
        problems += _expect(f"{where}: interpolation", spec.GetInfo("interpolation"), attribute.interpolation)
    if spec.default is not None:
        problems.append(f"{where}: has a default value, which hides the frames")
    return problems


def _check_declarations(name: str, layer, prims: list[str]) -> list[str]:
    """Declarations only: in the root and the manifest no attribute of a frame has a value."""
    problems = []
    for prim in prims:
        for attribute in ATTRIBUTES:
            problems += _check_declaration(name, layer, prim, attribute)
            if layer.GetNumTimeSamplesForPath(f"/World/{prim}.{attribute.name}"):
                problems.append(f"{name}: /World/{prim}.{attribute.name}: has time samples, which hide the frames")
    return problems


def _check_root(root, prims: list[str]) -> list[str]:
    problems = _check_units(ROOT, root, root.framesPerSecond)
    if not (root.HasStartTimeCode() and root.HasEndTimeCode()):
        problems.append(f"{ROOT}: startTimeCode or endTimeCode is missing")
    data = root.customLayerData.get(METADATA_KEY, {})
    problems += _expect(f"{ROOT}: {METADATA_KEY}.schemaVersion", data.get("schemaVersion"), SCHEMA_VERSION)
    problems += _expect(f"{ROOT}: {METADATA_KEY}.thicknessUnit", data.get("thicknessUnit"), THICKNESS_UNIT)
    for key in ("refractiveIndex", "colorGain", "scene", "seed", "versions"):
        if key not in data:
            problems.append(f"{ROOT}: {METADATA_KEY}.{key}: missing from customLayerData")
    if "Film" not in prims:
        problems.append(f"{ROOT}: /World/Film: no such point prim")
    world = root.GetPrimAtPath("/World")
    if world is None:
        return problems
    problems += _expect(f"{ROOT}: /World: kind", world.kind, "component")
    problems += _check_clips(root, world)
    problems += _check_declarations(ROOT, root, prims)
    for prim in prims:
        binding = root.GetRelationshipAtPath(f"/World/{prim}.material:binding")
        targets = list(binding.targetPathList.GetAppliedItems()) if binding else []
        if not targets or root.GetPrimAtPath(targets[0]) is None:
            problems.append(f"{ROOT}: /World/{prim}.material:binding: names no material")
    return problems


def _check_clips(root, world) -> list[str]:
    clips = (world.GetInfo("clips") or {}).get("default")
    if clips is None:
        return [f"{ROOT}: /World: has no value clips"]
    manifest = clips.get("manifestAssetPath")
    wanted = {
        "primPath": "/World",
        "templateAssetPath": CLIP_TEMPLATE,
        "templateStartTime": root.startTimeCode,
        "templateEndTime": root.endTimeCode,
        "templateStride": 1.0,
        "templateActiveOffset": None,
    }
    problems = _expect(f"{ROOT}: /World: clips manifestAssetPath", getattr(manifest, "path", None), f"./{MANIFEST}")
    for key, value in wanted.items():
        problems += _expect(f"{ROOT}: /World: clips {key}", clips.get(key), value)
    return problems


def _check_manifest(directory: Path, prims: list[str]) -> list[str]:
    try:
        manifest = open_layer(directory / MANIFEST)
    except InputError as error:
        return [f"{MANIFEST}: {error}"]
    return _check_declarations(MANIFEST, manifest, prims)


def _check_range(root, on_disk: list[int]) -> list[str]:
    """Every frame of the root's range is on disk; one more may be there, written just before a run was killed."""
    first, last = root.startTimeCode, root.endTimeCode
    if not (first == int(first) and last == int(last) and 0 <= first <= last <= MAX_FRAME):
        return [f"{ROOT}: time range {first} to {last}: must be whole numbers from 0 to {MAX_FRAME}, ascending"]
    wanted = range(int(first), int(last) + 1)
    problems = [
        f"{_frame_name(frame)}: missing, the range is {wanted[0]} to {wanted[-1]}"
        for frame in sorted(set(wanted) - set(on_disk))
    ]
    for frame in sorted(set(on_disk) - set(wanted) - {wanted[-1] + 1}):
        problems.append(f"{_frame_name(frame)}: outside the range {wanted[0]} to {wanted[-1]} of {ROOT}")
    return problems


# --- one frame -----------------------------------------------------------------------------------------------------


def _check_frame(layer, frame: int, root, prims: list[str]) -> list[str]:
    name = _frame_name(frame)
    problems = _check_units(name, layer, root.framesPerSecond)
    problems += _expect(f"{name}: startTimeCode", layer.startTimeCode, float(frame))
    problems += _expect(f"{name}: endTimeCode", layer.endTimeCode, float(frame))
    unit = layer.customLayerData.get(METADATA_KEY, {}).get("thicknessUnit")
    problems += _expect(f"{name}: {METADATA_KEY}.thicknessUnit", unit, THICKNESS_UNIT)
    for prim in prims:
        problems += _expect(f"{name}: /World/{prim}: origin", origin_of(layer, prim), origin_of(root, prim))
        arrays = {}
        for attribute in ATTRIBUTES:
            found = _check_declaration(name, layer, prim, attribute)
            if not found:
                found, array = _read_array(name, layer, frame, prim, attribute)
                if not found:
                    arrays[attribute.name] = array
            problems += found
        problems += _check_arrays(f"{name}: /World/{prim}", arrays, root.customLayerData.get(METADATA_KEY, {}))
    return problems


def _read_array(name: str, layer, frame: int, prim: str, attribute: Attribute) -> tuple[list[str], np.ndarray | None]:
    """The one sample of an attribute, [n] or [n, 3]; or what is wrong with it."""
    path = f"/World/{prim}.{attribute.name}"
    times = layer.ListTimeSamplesForPath(path)
    if times != [float(frame)]:
        return [f"{name}: {path}: has samples at {times}, must have one at {frame}"], None
    array = np.array(layer.QueryTimeSample(path, float(frame)))
    array = array.reshape(-1, 3) if attribute.columns == 3 else array
    finite = np.isfinite(array)
    if not finite.all():
        at = int(np.argmin(finite.reshape(len(array), -1).all(axis=1)))
        return [
            f"{name}: {path}: not finite in {len(array) - finite.reshape(len(array), -1).all(axis=1).sum()} "
            f"entries, first at {at}"
        ], None
    return [], array


def _check_arrays(where: str, arrays: dict[str, np.ndarray], metadata: dict) -> list[str]:
    """What the arrays of one particle set must fulfil; each rule applies where the arrays it needs are sound."""
    problems = []
    if "points" not in arrays:
        return problems
    count = len(arrays["points"])
    for attribute in ATTRIBUTES[1:-1]:
        array = arrays.get(attribute.name)
        if array is not None and len(array) != count:
            problems.append(f"{where}.{attribute.name}: {len(array)} values for {count} points")
            del arrays[attribute.name]
    for name, rule in _RULES:
        if name in arrays:
            problems += [f"{where}.{name}: {problem}" for problem in rule(arrays, metadata)]
    return problems


def _check_ids(arrays: dict, metadata: dict) -> list[str]:
    step = np.diff(arrays["ids"])
    problems = []
    if (step < 0).any():
        problems.append(f"not in ascending order, first at entry {int(np.argmax(step < 0)) + 1}")
    values, counts = np.unique(arrays["ids"], return_counts=True)
    if (counts > 1).any():
        problems.append(f"id {values[np.argmax(counts > 1)]} occurs {counts[np.argmax(counts > 1)]} times")
    return problems


def _check_widths(arrays: dict, metadata: dict) -> list[str]:
    negative = arrays["widths"] < 0.0
    return [f"negative in {negative.sum()} entries, first at {np.argmax(negative)}"] if negative.any() else []


def _check_normals(arrays: dict, metadata: dict) -> list[str]:
    length = np.linalg.norm(arrays["normals"].astype(np.float64), axis=1)
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
    return [f"negative in {negative.sum()} entries, first at {np.argmax(negative)}"] if negative.any() else []


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
    error = np.abs(color - display_color(thickness, gain, index)).max()
    if error <= COLOR_TOLERANCE:
        return []
    return [f"off by up to {error:.3g} from the colour of the thickness at the gain and index of {ROOT}"]


def _check_extent(arrays: dict, metadata: dict) -> list[str]:
    extent, points, widths = arrays["extent"], arrays["points"], arrays.get("widths")
    if extent.shape != (2, 3):
        return [f"has {len(extent)} vectors, must have 2"]
    if widths is None:
        return []
    if not len(points):
        return [] if (extent[0] > extent[1]).all() else ["must be empty (minimum above maximum) without points"]
    radius = 0.5 * widths[:, None].astype(np.float64)
    wanted = np.array([(points - radius).min(axis=0), (points + radius).max(axis=0)])
    if np.abs(extent - wanted).max() <= EXTENT_TOLERANCE * np.abs(wanted).max():
        return []
    return [f"is {extent.tolist()}, points and widths fill {wanted.tolist()}"]


_RULES = (
    ("ids", _check_ids),
    ("widths", _check_widths),
    ("normals", _check_normals),
    ("primvars:thickness", _check_thickness),
    ("primvars:region", _check_region),
    ("primvars:blackFilm", _check_black_film),
    ("primvars:displayColor", _check_color),
    ("extent", _check_extent),
)


# --- stages --------------------------------------------------------------------------------------------------------


def _check_stages(directory: Path, first: int, root, prims: list[str]) -> list[str]:
    """Values arrive through the clips, and USD's own validators report nothing."""
    from pxr import Tf, Usd, UsdUtils

    problems = []
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = Usd.Stage.Open(str(directory / ROOT))
        stage.Reload()
        problems += _check_through_clips(stage, root, prims)
        problems += _validate(ROOT, stage)
        stage = Usd.Stage.Open(str(frame_path(directory, first)))
        stage.Reload()
        problems += _validate(_frame_name(first), stage)
    except Tf.ErrorException as error:
        problems.append(f"{ROOT}: USD cannot open the cache: {' '.join(str(error).split())}")
    for diagnostic in diagnostics.TakeUncoalescedDiagnostics():
        # USD's list of dependencies knows no templates and takes this one for a file.
        if CLIP_TEMPLATE not in diagnostic.commentary:
            problems.append(f"{ROOT}: USD warns: {' '.join(diagnostic.commentary.split())}")
    return problems


def _check_through_clips(stage, root, prims: list[str]) -> list[str]:
    from pxr import Usd

    wanted = [float(time) for time in range(int(root.startTimeCode), int(root.endTimeCode) + 1)]
    problems = []
    for prim in prims:
        uneven, elsewhere = [], []
        for name in (attribute.name for attribute in ATTRIBUTES):
            found = stage.GetAttributeAtPath(f"/World/{prim}.{name}")
            if not found or found.GetTimeSamples() != wanted:
                uneven.append(name)
            elif found.GetResolveInfo(wanted[0]).GetSource() != Usd.ResolveInfoSourceValueClips:
                elsewhere.append(name)
        for names, fault in ((uneven, "not one sample for each frame"), (elsewhere, "values from outside the frames")):
            if names:
                problems.append(f"{ROOT}: /World/{prim}: {', '.join(names)}: the stage has {fault}")
    return problems


def _validate(name: str, stage) -> list[str]:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    return [f"{name}: UsdValidation: {' '.join(error.GetErrorAsString().split())}" for error in errors]
