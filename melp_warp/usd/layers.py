"""Layers of USD: opened, declared, filled and put on disk."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from melp_warp.errors import InputError, require
from melp_warp.files import digest, replacing
from melp_warp.frame import ParticleFrame
from melp_warp.optics import display_color
from melp_warp.usd.packing import pack_colors, pack_normals, round_widths
from melp_warp.usd.schema import (
    CLIP_TEMPLATE,
    FILM_SETS,
    FREE_RIMS,
    LARGEST,
    MANIFEST,
    METADATA_KEY,
    PLAIN,
    RIM,
    RIM_CURVES,
    ROOT,
    SCHEMA_VERSION,
    SURFACE,
    THICKNESS_UNIT,
    Frame,
    Layout,
    array_of,
    attributes_of,
    fixed_of,
    is_mesh,
    prims_of,
    type_of,
    with_rows,
)

MOST_TEXT = 4_000_000
"""Bytes of a root or manifest: ours have some ten thousand."""


DEEPEST = 64
"""Brackets within brackets in a root or manifest: USD reads them by recursion."""


_COOKIES = {".usda": b"#usda 1.0", ".usdc": b"PXR-USDC"}


WIRE_WIDTH = 0.01
"""Diameter of the wire that holds a film, over the film's size."""


BRIGHT = 0.9
"""Colour of free rims: thick liquid has none of its own."""


MATERIAL = "/World/Looks/SoapFilm"


_TRANSLATE = "xformOp:translate"


def reason(error: Exception) -> str:
    """The cause of a failed write in a few words; pxr reports it within a block of source locations."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    found = re.search(r"writing file: ([^'\n]+)'", str(error)) or re.search(r": '([^\n]+)'", str(error))
    return found[1] if found else str(error).strip()


def export(layer, path: Path) -> str:
    """Write `layer` to `path` such that there is never a part of a file under that name; its SHA-256."""
    from pxr import Tf

    try:
        with replacing(path) as partial:
            if not layer.Export(str(partial)):
                raise OSError(f"USD did not write {partial.name}")
            return digest(partial)
    except (OSError, Tf.ErrorException) as error:
        raise InputError(f"cannot write {path}: {reason(error)}; files written before are complete") from error


def open_layer(path: Path):
    """Return the layer in a file, read afresh rather than from USD's cache of open layers.

    What it can be told by without USD is told first. USD itself may still hang on what nobody's USD wrote: what comes
    from elsewhere is opened in a process of its own, see apart.py.

    Raises:
        InputError: the file is missing, truncated, damaged or no such file as a cache has.
    """
    from pxr import Sdf

    if not path.is_file():
        raise InputError(f"there is no file {path}")
    _check_cookie(path)
    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(path))
    except Exception as error:  # USD's own, and what becomes of text that is not UTF-8
        raise InputError(f"{path} cannot be opened: {reason(error)}") from error
    if layer is None:
        raise InputError(f"{path} cannot be opened: it is truncated or damaged")
    return layer


def _check_cookie(path: Path) -> None:
    """Refuse another kind of file, and text that is too long or too deep for USD's reader."""
    cookie = _COOKIES.get(path.suffix, b"")
    try:
        with path.open("rb") as file:
            begin = file.read(MOST_TEXT + 1 if path.suffix == ".usda" else len(cookie))
    except OSError as error:
        raise InputError(f"{path} cannot be opened: {error.strerror or error}") from error
    if not begin.startswith(cookie):
        raise InputError(f"{path} cannot be opened: it is no {path.suffix} file, or damaged")
    if len(begin) > MOST_TEXT:
        raise InputError(f"{path} cannot be opened: it is larger than {MOST_TEXT:,} bytes")
    if path.suffix == ".usda":
        deep, deepest = 0, 0
        for bracket in re.findall(rb"[{}()\[\]]", begin):
            deep += 1 if bracket in b"{([" else -1
            deepest = max(deepest, deep)
        if deepest > DEEPEST:
            raise InputError(f"{path} cannot be opened: more than {DEEPEST} brackets within brackets")


def new_layer(extension: str, fps: float):
    """An empty layer in memory with the units and rate that every layer of a cache carries."""
    from pxr import Sdf

    layer = Sdf.Layer.CreateAnonymous(extension)
    layer.pseudoRoot.SetInfo("upAxis", "Y")
    layer.pseudoRoot.SetInfo("metersPerUnit", 1.0)
    layer.timeCodesPerSecond = layer.framesPerSecond = fps
    layer.defaultPrim = "World"
    return layer


Origin = tuple[float, float, float]


def declare(
    layer, prims: Sequence[str], origin: Origin = (0.0, 0.0, 0.0), layout: Layout = PLAIN, fixed: bool = True
) -> None:
    """Add /World and the prims with every attribute, without values; moved to `origin` where it is elsewhere.

    With `fixed`, meshes and curves say besides what holds for all frames: that they are as they are, and meshes that
    they are seen from both sides.
    """
    from pxr import Sdf

    world = layer.GetPrimAtPath("/World") or Sdf.PrimSpec(layer, "World", Sdf.SpecifierDef, "Xform")
    world.kind = "component"
    for prim in prims:
        mesh = is_mesh(prim)
        if mesh and not layer.GetPrimAtPath(f"/World/{SURFACE}"):
            Sdf.PrimSpec(world, SURFACE, Sdf.SpecifierDef, "Xform")
        parent = layer.GetPrimAtPath(f"/World/{SURFACE}") if mesh else world
        spec = Sdf.PrimSpec(parent, prim.rsplit("/", 1)[-1], Sdf.SpecifierDef, type_of(prim))
        for attribute in with_rows(attributes_of(prim, layout)):
            found = Sdf.AttributeSpec(spec, attribute.name, Sdf.ValueTypeNames.Find(attribute.type_name))
            if attribute.interpolation:
                found.SetInfo("interpolation", attribute.interpolation)
        if fixed:
            for name, kind, value in fixed_of(prim):
                Sdf.AttributeSpec(spec, name, Sdf.ValueTypeNames.Find(kind), Sdf.VariabilityUniform).default = value
        _translate(spec, origin)


def _translate(spec, origin: Origin) -> None:
    """Move a prim to `origin`, in float64; nothing for the world's."""
    from pxr import Gf, Sdf, Vt

    if any(origin):
        Sdf.AttributeSpec(spec, _TRANSLATE, Sdf.ValueTypeNames.Double3).default = Gf.Vec3d(*origin)
        order = Sdf.AttributeSpec(spec, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, Sdf.VariabilityUniform)
        order.default = Vt.TokenArray([_TRANSLATE])


def origin_of(layer, prim: str) -> Origin:
    """Return where the points of a prim are measured from in this layer, m."""
    from pxr import Gf

    spec = layer.GetAttributeAtPath(f"/World/{prim}.{_TRANSLATE}")
    if spec is None:
        return (0.0, 0.0, 0.0)
    place = spec.default
    if not isinstance(place, Gf.Vec3d) or not np.abs(place).max() <= LARGEST:  # not so for NaN either
        raise InputError(f"/World/{prim}.{_TRANSLATE} must be three numbers within {LARGEST:g}, got {place!r:.80}")
    return tuple(place)


def frame_layer(frame_index: int, fps: float, frames: Mapping, layout: Layout, gain: float, index: float):
    """The layer of one frame: every attribute with one sample at its own time code."""
    layer = new_layer(".usdc", fps)
    layer.startTimeCode = layer.endTimeCode = frame_index
    layer.customLayerData = {METADATA_KEY: {"schemaVersion": SCHEMA_VERSION, "thicknessUnit": THICKNESS_UNIT}}
    declare(layer, list(frames), next(iter(frames.values())).origin, layout)
    for prim, frame in frames.items():
        set_values(layer, frame_index, prim, frame, layout, gain, index)
    return layer


def set_values(
    layer,
    frame_index: int,
    prim: str,
    frame: Frame,
    layout: Layout,
    gain: float,
    index: float,
) -> None:
    """Write the samples of one prim at its frame's time code."""
    from pxr import UsdGeom, Vt

    values = {}
    attributes = with_rows(attributes_of(prim, layout)[:-1])
    pack = _packed_arrays(frame, gain, index) if prim in layout.packed else {}
    for attribute in attributes:
        if attribute.name in pack:
            array = pack[attribute.name]
        elif attribute.name == "primvars:displayColor":
            array = display_color(frame.thickness, gain, index)
        elif attribute.name == "faceVertexCounts":
            array = np.full(len(frame.faces), 3, np.int32)
        else:
            array = array_of(frame, attribute)
        flat = array.reshape(-1) if attribute.columns == 1 else array
        values[attribute.name] = getattr(Vt, attribute.array).FromNumpy(np.ascontiguousarray(flat))
    if is_mesh(prim):
        values["extent"] = UsdGeom.PointBased.ComputeExtent(values["points"])
    else:
        values["extent"] = UsdGeom.Points.ComputeExtent(values["points"], values["widths"])
    for name, value in values.items():
        layer.SetTimeSample(f"/World/{prim}.{name}", float(frame_index), value)


def _packed_arrays(frame: ParticleFrame, gain: float, index: float) -> dict[str, np.ndarray]:
    """What a packed set stores in another form, by attribute."""
    normals, of_normals = pack_normals(frame.normals)
    colors, of_colors = pack_colors(frame.thickness, gain, index)
    return {
        "widths": round_widths(frame.widths),
        "primvars:normals": normals,
        "primvars:normals:indices": of_normals,
        "primvars:displayColor": colors,
        "primvars:displayColor:indices": of_colors,
    }


def _add_preview_material(stage, prims: Sequence[str]) -> None:
    """A UsdPreviewSurface that shows displayColor, bound to every prim."""
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, "/World/Looks")
    material = UsdShade.Material.Define(stage, MATERIAL)
    surface = UsdShade.Shader.Define(stage, f"{MATERIAL}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    reader = UsdShade.Shader.Define(stage, f"{MATERIAL}/DisplayColor")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    color = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(color)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.1)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    for prim in prims:
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(f"/World/{prim}")).Bind(material)


def root_layer(
    fps: float,
    prims: Sequence[str],
    layout: Layout,
    metadata: dict,
    origin: Origin,
    rims: Sequence[np.ndarray],
):
    """The root without its time range and clips, see `set_range`."""
    from pxr import Gf, Usd, UsdGeom

    layer = new_layer(".usda", fps)
    layer.documentation = "Soap film cache. SI units, except primvars:thickness, which is in nanometres."
    layer.customLayerData = {METADATA_KEY: metadata}
    declare(layer, prims, origin, layout)
    if rims:
        _add_rims(layer, rims, origin)
    stage = Usd.Stage.Open(layer)
    if RIM_CURVES in prims:
        UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/World/{RIM_CURVES}")).CreateDisplayColorAttr([Gf.Vec3f(BRIGHT)])
    _add_preview_material(stage, prims)
    set_purposes(stage, prims)
    return layer


def set_purposes(stage, prims: Sequence[str]) -> None:
    """Show one thing by default, the meshes or else the first set of particles; the others are guides, as are beads."""
    from pxr import UsdGeom

    points = [prim for prim in prims if prim in FILM_SETS]
    guides = points if any(map(is_mesh, prims)) else points[1:]
    for prim in (*guides, *([FREE_RIMS] if RIM_CURVES in prims else [])):
        UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/{prim}")).CreatePurposeAttr(UsdGeom.Tokens.guide)


def _add_rims(layer, rims: Sequence[np.ndarray], origin: Origin) -> None:
    """The wires that hold the film, as closed curves that stay where they are."""
    from pxr import Gf, Usd, UsdGeom, Vt

    stage = Usd.Stage.Open(layer)
    curves = UsdGeom.BasisCurves.Define(stage, f"/World/{RIM}")
    points = Vt.Vec3fArray.FromNumpy(np.concatenate(rims).astype(np.float32))
    size = float(np.ptp(np.concatenate(rims), axis=0).max())
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateWrapAttr(UsdGeom.Tokens.periodic)
    curves.CreatePointsAttr(points)
    curves.CreateCurveVertexCountsAttr([len(rim) for rim in rims])
    widths = Vt.FloatArray([WIRE_WIDTH * size])
    curves.CreateWidthsAttr(widths)
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    curves.CreateDisplayColorAttr([Gf.Vec3f(0.3)])
    curves.CreateExtentAttr(UsdGeom.Curves.ComputeExtent(points, widths))
    _translate(layer.GetPrimAtPath(f"/World/{RIM}"), origin)


def read_rims(directory: str | os.PathLike) -> list[np.ndarray]:
    """Return the points [k, 3] along each wire that holds the film, in order, from its prim's place, m.

    Raises:
        InputError: there is no root, or what it says of its wires is no such thing.
    """
    path = Path(directory) / ROOT
    try:
        return rims_of(open_layer(path))
    except (TypeError, ValueError, RuntimeError) as error:  # what Python makes of values of another kind
        raise InputError(f"{path}: /World/{RIM} cannot be read: {reason(error)}") from None


def rims_of(root) -> list[np.ndarray]:
    """The same of a root that is open."""
    points = root.GetAttributeAtPath(f"/World/{RIM}.points")
    counts = root.GetAttributeAtPath(f"/World/{RIM}.curveVertexCounts")
    if points is None or counts is None:
        return []
    points, counts = np.array(points.default, dtype=np.float64), np.array(counts.default, dtype=np.int64)
    sound = points.ndim == 2 and points.shape[1] == 3 and bool((np.abs(points) <= LARGEST).all())
    fit = counts.ndim == 1 and len(counts) and counts.min() >= 3 and counts.sum() == len(points)
    require(sound and bool(fit), f"/World/{RIM}", points.shape, "closed curves of three points or more")
    return np.split(points, np.cumsum(counts)[:-1])


def manifest_layer(fps: float, prims: Sequence[str], layout: Layout):
    """What the frames hold."""
    layer = new_layer(".usda", fps)
    declare(layer, prims, layout=layout, fixed=False)
    return layer


def set_range(layer, first: int, last: int) -> None:
    """Give the root its time range, and each prim the value clips of these frames."""
    from pxr import Sdf

    layer.startTimeCode, layer.endTimeCode = first, last
    for prim in prims_of(layer):
        clips = {
            "primPath": f"/World/{prim}",
            "manifestAssetPath": Sdf.AssetPath(f"./{MANIFEST}"),
            "templateAssetPath": CLIP_TEMPLATE,
            "templateStartTime": float(first),
            "templateEndTime": float(last),
            "templateStride": 1.0,
        }
        layer.GetPrimAtPath(f"/World/{prim}").SetInfo("clips", {"default": clips})
