"""Checks of the root and the manifest of a cache: units, declarations, clips, the range of frames."""

from __future__ import annotations

from pathlib import Path

from melp_warp.errors import InputError
from melp_warp.usd.check_words import MOST_NAMED, expect, few, frame_name, guarded, metadata_of
from melp_warp.usd.layers import open_layer
from melp_warp.usd.reading import refers_to
from melp_warp.usd.schema import (
    CLIP_TEMPLATE,
    MANIFEST,
    MAX_FRAME,
    METADATA_KEY,
    ROOT,
    SCHEMA_VERSION,
    THICKNESS_UNIT,
    Attribute,
    Layout,
    attributes_of,
    fixed_of,
    layout_of,
    with_rows,
)

READABLE = (2, SCHEMA_VERSION)
"""Versions of the schema that can be checked."""


def check_elsewhere(name: str, layer) -> list[str]:
    """A cache is of its own files alone: a stage over others could open any file there is."""
    return [f"{name}: refers to {what[:200]}, which no cache does" for what in refers_to(layer)[:MOST_NAMED]]


def check_units(name: str, layer, fps: float) -> list[str]:
    """Axis, scale, rate and default prim, the same in every layer."""
    info = layer.pseudoRoot.GetInfo
    return [
        *expect(f"{name}: upAxis", info("upAxis"), "Y"),
        *expect(f"{name}: metersPerUnit", info("metersPerUnit"), 1.0),
        *expect(f"{name}: framesPerSecond", layer.framesPerSecond, fps),
        *expect(f"{name}: timeCodesPerSecond", layer.timeCodesPerSecond, fps),
        *expect(f"{name}: defaultPrim", layer.defaultPrim, "World"),
    ]


def check_declaration(name: str, layer, prim: str, attribute: Attribute) -> list[str]:
    """The attribute is there with its type and interpolation, and has no default value."""
    where = f"{name}: /World/{prim}.{attribute.name}"
    spec = layer.GetAttributeAtPath(f"/World/{prim}.{attribute.name}")
    if spec is None:
        return [f"{where}: missing"]
    problems = expect(f"{where}: type", str(spec.typeName), attribute.type_name)
    if attribute.interpolation:
        problems += expect(f"{where}: interpolation", spec.GetInfo("interpolation"), attribute.interpolation)
    if spec.default is not None:
        problems.append(f"{where}: has a default value, which hides the frames")
    return problems


def _check_declarations(name: str, layer, prims: list[str], layout: Layout) -> list[str]:
    """Declarations only: in the root and the manifest no attribute of a frame has a value."""
    problems = []
    for prim in prims:
        for attribute in with_rows(attributes_of(prim, layout)):
            problems += check_declaration(name, layer, prim, attribute)
            if layer.GetNumTimeSamplesForPath(f"/World/{prim}.{attribute.name}"):
                problems.append(f"{name}: /World/{prim}.{attribute.name}: has time samples, which hide the frames")
    return problems


def check_root(root, prims: list[str]) -> list[str]:
    """What is wrong with the root."""
    problems = check_units(ROOT, root, root.framesPerSecond)
    if not (root.HasStartTimeCode() and root.HasEndTimeCode()):
        problems.append(f"{ROOT}: startTimeCode or endTimeCode is missing")
    data = metadata_of(root)
    if data.get("schemaVersion") not in READABLE:
        problems += expect(f"{ROOT}: {METADATA_KEY}.schemaVersion", data.get("schemaVersion"), SCHEMA_VERSION)
    problems += expect(f"{ROOT}: {METADATA_KEY}.thicknessUnit", data.get("thicknessUnit"), THICKNESS_UNIT)
    for key in ("refractiveIndex", "colorGain", "scene", "seed", "versions"):
        if key not in data:
            problems.append(f"{ROOT}: {METADATA_KEY}.{key}: missing from customLayerData")
    units, carried = data.get("carried", {}), layout_of(root, prims).carried
    told = isinstance(units, dict) and all(isinstance(units.get(name), str) for name in carried)
    if not told or len(units) != len(carried):
        problems.append(f"{ROOT}: {METADATA_KEY}.carried: must name the unit of each of {', '.join(carried) or 'none'}")
    if "Film" not in prims:
        problems.append(f"{ROOT}: /World/Film: no such point prim")
    world = root.GetPrimAtPath("/World")
    if world is None:
        return problems
    problems += expect(f"{ROOT}: /World: kind", world.kind, "component")
    if world.GetInfo("clips"):
        problems.append(f"{ROOT}: /World: has value clips, which belong on the prims")
    problems += _check_declarations(ROOT, root, prims, layout_of(root, prims))
    for prim in prims:
        problems += _check_clips(root, prim) + check_fixed(ROOT, root, prim)
        binding = root.GetRelationshipAtPath(f"/World/{prim}.material:binding")
        targets = list(binding.targetPathList.GetAppliedItems()) if binding else []
        if not targets or root.GetPrimAtPath(targets[0]) is None:
            problems.append(f"{ROOT}: /World/{prim}.material:binding: names no material")
    return problems


def check_fixed(name: str, layer, prim: str) -> list[str]:
    """What meshes and curves say once for all frames."""
    problems = []
    for attribute, _, wanted in fixed_of(prim):
        spec = layer.GetAttributeAtPath(f"/World/{prim}.{attribute}")
        problems += expect(f"{name}: /World/{prim}.{attribute}", spec.default if spec else None, wanted)
    return problems


def clips_are_ours(root, prims: list[str]) -> bool:
    """Whether a stage over the root opens frames of this cache alone, and as many as there are."""
    clips = {}

    def visit(path) -> None:
        if path.IsPrimPath() and root.GetPrimAtPath(path).HasInfo("clips"):
            clips[str(path)] = set(root.GetPrimAtPath(path).GetInfo("clips"))

    try:
        root.Traverse("/", visit)
        ours = clips == {f"/World/{prim}": {"default"} for prim in prims}
        return ours and not any(_check_clips(root, prim) for prim in prims)
    except Exception:
        return False


def _check_clips(root, prim: str) -> list[str]:
    where = f"{ROOT}: /World/{prim}"
    clips = (root.GetPrimAtPath(f"/World/{prim}").GetInfo("clips") or {}).get("default")
    if not isinstance(clips, dict):
        return [f"{where}: has no value clips"]
    manifest = clips.get("manifestAssetPath")
    wanted = {
        "primPath": f"/World/{prim}",
        "templateAssetPath": CLIP_TEMPLATE,
        "templateStartTime": root.startTimeCode,
        "templateEndTime": root.endTimeCode,
        "templateStride": 1.0,
        "templateActiveOffset": None,
    }
    problems = expect(f"{where}: clips manifestAssetPath", getattr(manifest, "path", None), f"./{MANIFEST}")
    for key, value in wanted.items():
        problems += expect(f"{where}: clips {key}", clips.get(key), value)
    others = sorted(set(clips) - set(wanted) - {"manifestAssetPath"})
    problems += [f"{where}: clips {key[:80]}: must not be there" for key in others[:MOST_NAMED]]
    return problems


def check_manifest(directory: Path, prims: list[str], layout: Layout) -> tuple[list[str], bool]:
    """The problems of the manifest, and whether a stage may read it."""
    try:
        manifest = open_layer(directory / MANIFEST)
    except InputError as error:
        return [f"{MANIFEST}: {error}"], False
    elsewhere = guarded(MANIFEST, check_elsewhere, MANIFEST, manifest)
    return elsewhere + guarded(MANIFEST, _check_declarations, MANIFEST, manifest, prims, layout), not elsewhere


def check_range(root, on_disk: list[int]) -> tuple[list[str], bool]:
    """Every frame of the root's range is on disk; one more may be there, written just before a run was killed.

    Returns:
        The problems, and whether a stage over the range has no more to open than there is.
    """
    first, last = root.startTimeCode, root.endTimeCode
    if not (0 <= first <= last <= MAX_FRAME and first == int(first) and last == int(last)):  # not so for NaN
        return [f"{ROOT}: time range {first} to {last}: must be whole numbers from 0 to {MAX_FRAME}, ascending"], False
    wanted = range(int(first), int(last) + 1)
    missing = sorted(set(wanted) - set(on_disk))
    outside = sorted(set(on_disk) - set(wanted) - {wanted[-1] + 1})
    problems = [
        *few(missing, lambda frame: f"{frame_name(frame)}: missing, the range is {wanted[0]} to {wanted[-1]}"),
        *few(outside, lambda frame: f"{frame_name(frame)}: outside the range {wanted[0]} to {wanted[-1]} of {ROOT}"),
    ]
    return problems, len(wanted) <= 2 * len(on_disk) + MOST_NAMED
