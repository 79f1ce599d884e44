"""Checks a USD point cache for what USD itself and its validators take without a word."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from melp_warp.errors import InputError
from melp_warp.files import digest
from melp_warp.frame import WholeFrame
from melp_warp.optics import display_color
from melp_warp.usd.layers import open_layer, origin_of, rims_of
from melp_warp.usd.packing import shown_thickness
from melp_warp.usd.reading import read_sample, refers_to
from melp_warp.usd.schema import (
    CLIP_TEMPLATE,
    FILM_SETS,
    FRAMES,
    FREE_RIMS,
    LARGEST,
    MANIFEST,
    MAX_FRAME,
    METADATA_KEY,
    MOST_REGIONS,
    PACKED_NORMALS,
    ROOT,
    SCHEMA_VERSION,
    THICKNESS_UNIT,
    WHOLE,
    Attribute,
    Layout,
    attributes_of,
    entries_of,
    frame_path,
    is_mesh,
    layout_of,
    list_frames,
    prims_of,
    with_rows,
)

LOG = "run.jsonl"
READABLE = (2, SCHEMA_VERSION)
"""Versions of the schema that can be checked."""

PLAUSIBLE_THICKNESS = (1.0, 1e5)
"""nm; the median of a frame lies within, or the unit is wrong."""

NORMAL_TOLERANCE = 1e-4
COLOR_TOLERANCE = 1e-4
EXTENT_TOLERANCE = 4.0 * float(np.finfo(np.float32).eps)
"""Relative to the largest coordinate."""

MOST_NAMED = 10
"""Problems of one kind that are told one by one; of more the number is told."""

MOST_PRIMS = 100
LONGEST_LINE = 1_000_000
"""Bytes of a line of run.jsonl: one of 10,000 regions has some 300,000."""


def check_cache(directory: str | os.PathLike, at: Callable[[str], None] = lambda name: None) -> list[str]:
    """Return the problems of a cache, one line each: file, attribute, what is wrong. Empty: the cache is sound.

    Read are the root, the manifest, every frame and run.jsonl, where their checksums are. The root is opened as a stage
    to see that the values arrive through the clips, and the validators of `pxr.UsdValidation` run over it and the first
    frame: only if they take nothing from elsewhere. The files may be anybody's, but USD itself may hang on what it did
    not write; `apart.check_cache` outlives that.

    Args:
        directory: folder with film.usda.
        at: told the name of each file before it is opened.
    """
    directory = Path(directory)
    problems = _leftovers(directory)
    on_disk = list_frames(directory)
    problems += _guarded(LOG, _check_log, directory, on_disk, at)
    at(ROOT)
    try:
        root = open_layer(directory / ROOT)
        prims = prims_of(root)
        layout = layout_of(root, prims)
    except InputError as error:
        return [*problems, f"{ROOT}: {error}"]
    except Exception as error:  # a name that Python cannot hold
        return [*problems, f"{ROOT}: cannot be checked: {_words(error)}"]
    if len(prims) > MOST_PRIMS:
        return [*problems, f"{ROOT}: has {len(prims)} prims, more than {MOST_PRIMS}"]
    of_root = _guarded(ROOT, _check_root, root, prims)
    try:
        rims = len(rims_of(root))
    except Exception as error:
        of_root.append(f"{ROOT}: cannot be checked: {_words(error)}")
        rims = 0
    elsewhere = _guarded(ROOT, _check_elsewhere, ROOT, root)
    at(MANIFEST)
    of_manifest, readable = _check_manifest(directory, prims, layout)
    missing, fit = _check_range(root, on_disk)
    problems += of_root + elsewhere + of_manifest + missing
    whole = fit and readable and _clips_are_ours(root, prims) and not elsewhere
    for frame in on_disk:
        at(_frame_name(frame))
        try:
            layer = open_layer(frame_path(directory, frame))
        except InputError as error:
            problems.append(f"{_frame_name(frame)}: {error}")
            whole = False  # USD cannot open a stage over a damaged frame
            continue
        found = _guarded(_frame_name(frame), _check_elsewhere, _frame_name(frame), layer)
        whole = whole and not found
        problems += found + _guarded(_frame_name(frame), _check_frame, layer, frame, root, prims, layout, rims)
    if on_disk and whole:
        at(ROOT)
        problems += _guarded(ROOT, _check_stages, directory, on_disk[0], root, prims)
    return problems


def _guarded(name: str, check: Callable[..., list[str]], *arguments) -> list[str]:
    """The problems that a check finds; what a file from elsewhere makes of it besides is one, too."""
    try:
        return check(*arguments)
    except Exception as error:
        return [f"{name}: cannot be checked: {_words(error)}"]


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def _check_elsewhere(name: str, layer) -> list[str]:
    """A cache is of its own files alone: a stage over others could open any file there is."""
    return [f"{name}: refers to {what[:200]}, which no cache does" for what in refers_to(layer)[:MOST_NAMED]]


# --- run.jsonl -----------------------------------------------------------------------------------------------------


def _check_log(directory: Path, on_disk: Sequence[int], at: Callable[[str], None]) -> list[str]:
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
        problems.append(f"{LOG}: has lines for {_listed(frames)}, on disk are frames {_listed(on_disk)}")
    if on_disk and (not frames or frames[-1] != on_disk[-1]):
        digests.pop(ROOT, None)  # the root is written once more before the line of a frame
    for name, digest_ in digests.items():
        at(name)
        if (directory / name).is_file() and digest(directory / name) != digest_:
            problems.append(f"{name}: is not what the run wrote: its SHA-256 is another than in {LOG}")
    return _few(problems)


def _read_line(line: bytes) -> tuple[int | None, dict[str, str] | str]:
    """Frame and checksums of a line of the log; or None and what is wrong with it."""
    try:
        entry = json.loads(line.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        return None, f"is not JSON: {_words(error)}"
    frame = entry.get("frame") if isinstance(entry, dict) else None
    if not isinstance(frame, int) or isinstance(frame, bool) or not 0 <= frame <= MAX_FRAME:
        return None, f'has no "frame" from 0 to {MAX_FRAME}'
    found = entry.get("sha256", {})
    names = (ROOT, MANIFEST, _frame_name(frame))
    if not isinstance(found, dict) or not all(k in names and isinstance(v, str) for k, v in found.items()):
        return None, '"sha256" must name the files of this frame alone'
    return frame, found


def _refuse(constant: str):
    raise ValueError(f"{constant} is no number of JSON")


def _listed(frames: Sequence[int]) -> str:
    """Frame numbers in few words."""
    return f"{frames[0]} to {frames[-1]} ({len(frames)})" if len(frames) else "none"


def _few(faults: Sequence, words: Callable[..., str] = str) -> list[str]:
    """The first faults of a kind in words, and how many there are besides."""
    named = [words(fault) for fault in faults[: MOST_NAMED + 1]]
    more = len(faults) - len(named)
    return named if more <= 0 else [*named[:-1], f"{named[-1]} (and {more} more)"]


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


# --- layers --------------------------------------------------------------------------------------------------------


def _expect(where: str, found: object, wanted: object) -> list[str]:
    return [] if found == wanted else [f"{where}: is {found!r:.200}, must be {wanted!r}"]


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


def _check_declarations(name: str, layer, prims: list[str], layout: Layout) -> list[str]:
    """Declarations only: in the root and the manifest no attribute of a frame has a value."""
    problems = []
    for prim in prims:
        for attribute in with_rows(attributes_of(prim, layout)):
            problems += _check_declaration(name, layer, prim, attribute)
            if layer.GetNumTimeSamplesForPath(f"/World/{prim}.{attribute.name}"):
                problems.append(f"{name}: /World/{prim}.{attribute.name}: has time samples, which hide the frames")
    return problems


def _check_root(root, prims: list[str]) -> list[str]:
    problems = _check_units(ROOT, root, root.framesPerSecond)
    if not (root.HasStartTimeCode() and root.HasEndTimeCode()):
        problems.append(f"{ROOT}: startTimeCode or endTimeCode is missing")
    data = _metadata(root)
    if data.get("schemaVersion") not in READABLE:
        problems += _expect(f"{ROOT}: {METADATA_KEY}.schemaVersion", data.get("schemaVersion"), SCHEMA_VERSION)
    problems += _expect(f"{ROOT}: {METADATA_KEY}.thicknessUnit", data.get("thicknessUnit"), THICKNESS_UNIT)
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
    problems += _expect(f"{ROOT}: /World: kind", world.kind, "component")
    if world.GetInfo("clips"):
        problems.append(f"{ROOT}: /World: has value clips, which belong on the prims")
    problems += _check_declarations(ROOT, root, prims, layout_of(root, prims))
    for prim in prims:
        problems += _check_clips(root, prim) + _check_fixed(ROOT, root, prim)
        binding = root.GetRelationshipAtPath(f"/World/{prim}.material:binding")
        targets = list(binding.targetPathList.GetAppliedItems()) if binding else []
        if not targets or root.GetPrimAtPath(targets[0]) is None:
            problems.append(f"{ROOT}: /World/{prim}.material:binding: names no material")
    return problems


def _metadata(layer) -> dict:
    """What a layer says of the run, {} where that is no dictionary."""
    data = layer.customLayerData.get(METADATA_KEY, {})
    return data if isinstance(data, dict) else {}


def _check_fixed(name: str, layer, prim: str) -> list[str]:
    """What meshes say once for all frames."""
    problems = []
    for attribute, wanted in (("subdivisionScheme", "none"), ("doubleSided", True)) if is_mesh(prim) else ():
        spec = layer.GetAttributeAtPath(f"/World/{prim}.{attribute}")
        problems += _expect(f"{name}: /World/{prim}.{attribute}", spec.default if spec else None, wanted)
    return problems


def _clips_are_ours(root, prims: list[str]) -> bool:
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
    problems = _expect(f"{where}: clips manifestAssetPath", getattr(manifest, "path", None), f"./{MANIFEST}")
    for key, value in wanted.items():
        problems += _expect(f"{where}: clips {key}", clips.get(key), value)
    others = sorted(set(clips) - set(wanted) - {"manifestAssetPath"})
    problems += [f"{where}: clips {key[:80]}: must not be there" for key in others[:MOST_NAMED]]
    return problems


def _check_manifest(directory: Path, prims: list[str], layout: Layout) -> tuple[list[str], bool]:
    """The problems of the manifest, and whether a stage may read it."""
    try:
        manifest = open_layer(directory / MANIFEST)
    except InputError as error:
        return [f"{MANIFEST}: {error}"], False
    elsewhere = _guarded(MANIFEST, _check_elsewhere, MANIFEST, manifest)
    return elsewhere + _guarded(MANIFEST, _check_declarations, MANIFEST, manifest, prims, layout), not elsewhere


def _check_range(root, on_disk: list[int]) -> tuple[list[str], bool]:
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
        *_few(missing, lambda frame: f"{_frame_name(frame)}: missing, the range is {wanted[0]} to {wanted[-1]}"),
        *_few(outside, lambda frame: f"{_frame_name(frame)}: outside the range {wanted[0]} to {wanted[-1]} of {ROOT}"),
    ]
    return problems, len(wanted) <= 2 * len(on_disk) + MOST_NAMED


# --- one frame -----------------------------------------------------------------------------------------------------


def _check_frame(layer, frame: int, root, prims: list[str], layout: Layout, rims: int | None) -> list[str]:
    name = _frame_name(frame)
    problems = _check_units(name, layer, root.framesPerSecond)
    problems += _expect(f"{name}: startTimeCode", layer.startTimeCode, float(frame))
    problems += _expect(f"{name}: endTimeCode", layer.endTimeCode, float(frame))
    unit = _metadata(layer).get("thicknessUnit")
    problems += _expect(f"{name}: {METADATA_KEY}.thicknessUnit", unit, THICKNESS_UNIT)
    beads = layer.QueryTimeSample(f"/World/{FREE_RIMS}.points", float(frame)) if FREE_RIMS in prims else None
    if beads is not None and len(beads):
        rims = None
    for prim in prims:
        problems += _expect(f"{name}: /World/{prim}: origin", origin_of(layer, prim), origin_of(root, prim))
        arrays = {}
        problems += _check_fixed(name, layer, prim)
        attributes = attributes_of(prim, layout)
        for attribute in with_rows(attributes):
            found = _check_declaration(name, layer, prim, attribute)
            if not found:
                found, array = _read_array(name, layer, frame, prim, attribute)
                if not found:
                    arrays[attribute.name] = array
            problems += found
        problems += _look_up(f"{name}: /World/{prim}", arrays, attributes)
        problems += _check_arrays(name, prim, arrays, attributes, _metadata(root), rims)
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
    count, faces = len(arrays["points"]), len(arrays.get("faceVertexCounts", ()))
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
    problems = _check_corners(arrays)
    inside, outside = (arrays[f"primvars:{name}"] for name in ("inside", "outside"))
    if len(inside) and not (
        0 <= inside.min() and -1 <= outside.min() and max(inside.max(), outside.max()) < MOST_REGIONS
    ):
        problems.append(f"primvars:inside and outside: must be regions from 0 to {MOST_REGIONS - 1}, outside or -1")
    if problems:
        return problems
    fields = {a.field: arrays[a.name] for a in attributes_of(WHOLE) if a.field}
    return check_whole(WholeFrame(**fields | {"faces": fields["faces"].reshape(-1, 3)}), rims)


def check_whole(whole: WholeFrame, rims: int = 0) -> list[str]:
    """What is wrong with the mesh of a whole foam.

    An edge has two faces, three on a border, and one on a rim. Those around each region are one closed surface.

    Args:
        whole: the mesh.
        rims: how many rims the film has; only a single region can have some.
    """
    n, faces, problems = len(whole.points), whole.faces.astype(np.int64), []
    ends = np.sort(np.concatenate([faces, np.roll(faces, -1, axis=1)], axis=0).reshape(2, -1).T, axis=1)
    _, times = np.unique(ends[:, 0] * n + ends[:, 1], return_counts=True)
    odd = (times > 3) | ((times < 2) & (rims == 0))
    if odd.any():
        problems.append(
            f"{odd.sum()} edges have {', '.join(map(str, np.unique(times[odd])))} faces, must be two or three"
        )
    unused = n - len(np.unique(faces))
    if unused:
        problems.append(f"{unused} points are in no face")
    p = whole.points.astype(np.float64)[faces]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    flipped = np.einsum("ij,ij->i", face, whole.normals.reshape(-1, 3, 3).sum(axis=1, dtype=float)) < 0.0
    if flipped.any():
        problems.append(f"{flipped.sum()} faces look away from their film, first {np.argmax(flipped)}")
    for region in np.setdiff1d(np.union1d(whole.inside, whole.outside), [-1]).tolist():
        skin = whole.skin(region)
        arrays = {
            "points": skin.points,
            "faceVertexCounts": np.full(len(skin.faces), 3),
            "faceVertexIndices": skin.faces.reshape(-1),
        }
        problems += [f"region {region}: {problem}" for problem in check_surface(arrays, rims)]
    return problems


def check_surface(arrays: dict, rims: int | None) -> list[str]:
    """Triangles that make one closed oriented surface, open at as many rims as the film has; empty for no region.

    Of a film with holes (None for `rims`) it may be in pieces, and open anywhere.
    """
    corners, n = arrays["faceVertexIndices"], len(arrays["points"])
    wrong = _check_corners(arrays)
    if wrong or n == 0:
        return wrong
    faces = corners.reshape(-1, 3).astype(np.int64)
    problems = []
    unused = n - len(np.unique(corners))
    if unused:
        problems.append(f"{unused} points are in no face")
    start, end = faces.T.reshape(-1), np.roll(faces, -1, axis=1).T.reshape(-1)
    sides, times = np.unique(start * n + end, return_counts=True)
    if (times > 1).any():
        at = int(sides[np.argmax(times > 1)])
        problems.append(f"{(times > 1).sum()} edges have two faces on one side, first {at // n} to {at % n}")
    bare = sides[~np.isin(sides % n * n + sides // n, sides, assume_unique=True)]
    pieces = len(np.unique(_pieces(start, end, n))) - unused
    problems += _expect("number of pieces", pieces, 1) if rims is not None else []
    loops = np.unique(_pieces(bare // n, bare % n, n)[bare // n]) if len(bare) else bare
    if rims is not None and len(loops) != rims:
        problems.append(f"open along {len(bare)} edges around {len(loops)} holes, the film has {rims} rims")
    edges = (len(sides) + len(bare)) // 2
    problems += _expect("Euler number", n - unused - edges + len(faces), 2 * pieces - len(loops))
    if "normals" in arrays:
        x = arrays["points"].astype(np.float64)
        face = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        flipped = np.einsum("ij,ij->i", face, arrays["normals"][faces].sum(axis=1)) < 0.0
        if flipped.any():
            problems.append(f"{flipped.sum()} faces look inwards, first {np.argmax(flipped)}")
    return problems


def _check_corners(arrays: dict) -> list[str]:
    """Triangles of points that are there."""
    counts, corners, n = arrays["faceVertexCounts"], arrays["faceVertexIndices"], len(arrays["points"])
    if (counts != 3).any() or 3 * len(counts) != len(corners):
        return [f"faceVertexCounts: {len(counts)} faces for {len(corners)} corners, must be triangles"]
    if len(corners) and not (corners.min() >= 0 and corners.max() < n):
        return [f"faceVertexIndices: from {corners.min()} to {corners.max()}, must be from 0 to {n - 1}"]
    return []


def _pieces(start: np.ndarray, end: np.ndarray, n: int) -> np.ndarray:
    """[n] the lowest vertex that each is connected with by edges."""
    label = np.arange(n)
    while True:
        lower = label.copy()
        np.minimum.at(lower, start, label[end])
        np.minimum.at(lower, end, label[start])
        lower = lower[lower]
        if np.array_equal(lower, label):
            return label
        label = lower


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
    return _few(problems)


def _check_through_clips(stage, root, prims: list[str]) -> list[str]:
    from pxr import Usd

    wanted = [float(time) for time in range(int(root.startTimeCode), int(root.endTimeCode) + 1)]
    problems = []
    for prim in prims:
        uneven, elsewhere = [], []
        for name in (attribute.name for attribute in with_rows(attributes_of(prim, layout_of(root, [prim])))):
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
