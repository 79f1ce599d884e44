"""The USD cache of a run: one binary file a frame, bound by a small root layer with value clips.

    film.usda                 root: open this one
    film.manifest.usda        what the clips hold
    film_stage.usda           the root with a camera and lights, see `write_stage`
    film_look.usda            optional MaterialX look over the root, see `write_look`
    frames/film.000000.usdc   one file a frame

A frame holds point prims and, where they are asked for, a mesh of each region. Each prim has its clips on itself, so
that it can be referenced alone. File number, time code and frame are the same number. The first frame is the initial
state; seconds are the time codes since then divided by the frame rate. The cache is complete and valid after every
`CacheWriter.write`.
"""

from __future__ import annotations

import importlib.metadata
import os
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import melp_warp
from melp_warp.errors import InputError, SimulationError, require
from melp_warp.files import digest, replacing
from melp_warp.frame import MeshFrame, ParticleFrame, WholeFrame
from melp_warp.optics import DISPLAY_GAIN, WATER_INDEX, display_color
from melp_warp.usd.packing import pack_colors, pack_normals, refine_normals, round_widths

SCHEMA_VERSION = 3
"""Before 3 no set was packed."""

ROOT = "film.usda"
MANIFEST = "film.manifest.usda"
LOOK = "film_look.usda"
STAGE = "film_stage.usda"
FRAMES = "frames"
CLIP_TEMPLATE = f"./{FRAMES}/film.######.usdc"
METADATA_KEY = "melpWarp"
THICKNESS_UNIT = "nm"
MAX_FRAME = 999_999
LARGEST = 1e9
"""Largest number in an array of a cache, whatever its unit: its square and fourth power are numbers, too."""

MOST_REGIONS = 10_000
MOST_TEXT = 4_000_000
"""Bytes of a root or manifest: ours have some ten thousand."""

DEEPEST = 64
"""Brackets within brackets in a root or manifest: USD reads them by recursion."""

_COOKIES = {".usda": b"#usda 1.0", ".usdc": b"PXR-USDC"}

WIRE_WIDTH = 0.01
"""Diameter of the wire that holds a film, over the film's size."""

_FRAME_NAME = re.compile(r"film\.(\d{6})\.usdc")
_MATERIAL = "/World/Looks/SoapFilm"
_TRANSLATE = "xformOp:translate"
_OTHER_RUN = (ROOT, FRAMES, "run.jsonl")


class Attribute(NamedTuple):
    """How one attribute of a prim is stored.

    Attributes:
        name: USD attribute name.
        field: field of `ParticleFrame`, `MeshFrame` or `WholeFrame`; None where it is derived.
        type_name: USD value type.
        array: name of the `pxr.Vt` array class.
        dtype: NumPy type.
        columns: 1 for scalars, 3 for vectors.
        interpolation: USD interpolation; None where the schema fixes it.
        indexed: whether it is a table, and NAME:indices has the row of each particle.
    """

    name: str
    field: str | None
    type_name: str
    array: str
    dtype: type
    columns: int
    interpolation: str | None
    indexed: bool = False

    @property
    def rows(self) -> Attribute:
        """The attribute with the row of each particle."""
        return Attribute(f"{self.name}:indices", None, "int[]", "IntArray", np.int32, 1, None)


ATTRIBUTES = (
    Attribute("points", "points", "point3f[]", "Vec3fArray", np.float32, 3, None),
    Attribute("velocities", "velocities", "vector3f[]", "Vec3fArray", np.float32, 3, None),
    Attribute("ids", "ids", "int64[]", "Int64Array", np.int64, 1, None),
    Attribute("widths", "widths", "float[]", "FloatArray", np.float32, 1, "vertex"),
    Attribute("normals", "normals", "normal3f[]", "Vec3fArray", np.float32, 3, "vertex"),
    Attribute("primvars:thickness", "thickness", "float[]", "FloatArray", np.float32, 1, "vertex"),
    Attribute("primvars:region", "region", "int[]", "IntArray", np.int32, 1, "vertex"),
    Attribute("primvars:blackFilm", "black_film", "int[]", "IntArray", np.int32, 1, "vertex"),
    Attribute("primvars:displayColor", None, "color3f[]", "Vec3fArray", np.float32, 3, "vertex"),
    Attribute("extent", None, "float3[]", "Vec3fArray", np.float32, 3, None),
)
"""Every attribute of a point prim. Each frame holds all of them, the root and the manifest declare them."""

_SHARED = {attribute.name: attribute for attribute in ATTRIBUTES}

PACKED_NORMALS = _SHARED["normals"]._replace(name="primvars:normals", indexed=True)
PACKED_ATTRIBUTES = tuple(
    {"normals": PACKED_NORMALS, "primvars:displayColor": a._replace(indexed=True)}.get(a.name, a) for a in ATTRIBUTES
)
"""The same of a set that is packed, see packing.py."""

MESH_ATTRIBUTES = (
    *(_SHARED[name] for name in ("points", "velocities", "normals")),
    Attribute("faceVertexCounts", None, "int[]", "IntArray", np.int32, 1, None),
    Attribute("faceVertexIndices", "faces", "int[]", "IntArray", np.int32, 1, None),
    *(_SHARED[f"primvars:{name}"] for name in ("thickness", "blackFilm", "displayColor")),
    _SHARED["extent"],
)
"""Every attribute of the mesh of a region, likewise."""

WHOLE_ATTRIBUTES = (
    *(_SHARED[name] for name in ("points", "velocities")),
    *(attribute for attribute in MESH_ATTRIBUTES if attribute.name.startswith("faceVertex")),
    *(
        _SHARED[name]._replace(interpolation="faceVarying")
        for name in ("normals", "primvars:thickness", "primvars:blackFilm", "primvars:displayColor")
    ),
    *(
        Attribute(f"primvars:{name}", name, "int[]", "IntArray", np.int32, 1, "uniform")
        for name in ("inside", "outside")
    ),
    _SHARED["extent"],
)
"""Every attribute of the mesh of a whole foam, likewise: on a border a film has a thickness and a normal of its own."""

SURFACE = "FilmSurface"
WHOLE = f"{SURFACE}/Whole"
"""Name under /World of the mesh of a whole foam."""

FREE_RIMS, DROPS = "FreeRims", "Droplets"
"""Names under /World of the liquid that is no film: the rims of holes and the drops that they break into."""

FILM_SETS = ("Film", "FilmE")
"""Names under /World of the sets that are film: of all others `thickness` is a diameter."""

RIM = "Rim"
_NAMES_TAKEN = ("Looks", RIM, SURFACE)


def surface_prim(region: int) -> str:
    """Name under /World of the mesh of a region."""
    return f"{SURFACE}/Region_{region}"


def is_mesh(prim: str) -> bool:
    """Whether a prim of a cache, named from /World, is a mesh."""
    return prim.startswith(f"{SURFACE}/")


class Layout(NamedTuple):
    """What the particle sets of a cache have besides, or in another form.

    Attributes:
        packed: the sets that are packed, see packing.py.
        carried: primvars of what a scene declares, in the sets of E and L.
        meshed: those that meshes have.
    """

    packed: frozenset[str] = frozenset()
    carried: tuple[str, ...] = ()
    meshed: tuple[str, ...] = ()


PLAIN = Layout()


def attributes_of(prim: str, layout: Layout = PLAIN) -> tuple[Attribute, ...]:
    """The attributes of a prim of a cache, the extent last."""
    if is_mesh(prim):
        own, names = WHOLE_ATTRIBUTES if prim == WHOLE else MESH_ATTRIBUTES, layout.meshed
    else:
        own = PACKED_ATTRIBUTES if prim in layout.packed else ATTRIBUTES
        names = layout.carried if prim in FILM_SETS else ()
    thickness = next(attribute for attribute in own if attribute.name == "primvars:thickness")
    more = (thickness._replace(name=f"primvars:{name}", field=f"carried.{name}") for name in names)
    return (*own[:-1], *more, own[-1])


def array_of(frame: Frame, attribute: Attribute) -> np.ndarray:
    """What a frame has for an attribute."""
    if attribute.field.startswith("carried."):
        return frame.carried.get(attribute.field.removeprefix("carried."))
    return getattr(frame, attribute.field)


def with_rows(attributes: Sequence[Attribute]) -> list[Attribute]:
    """Attributes as USD has them: after each that is indexed the one with its rows."""
    return [one for a in attributes for one in ((a, a.rows) if a.indexed else (a,))]


def layout_of(layer, prims: Sequence[str]) -> Layout:
    """What the particle sets of a layer have."""
    packed = {prim for prim in prims if layer.GetAttributeAtPath(f"/World/{prim}.{PACKED_NORMALS.name}")}
    sets, meshes = [prim for prim in prims if prim in FILM_SETS], [prim for prim in prims if is_mesh(prim)]
    return Layout(frozenset(packed), _declared_in(layer, sets), _declared_in(layer, meshes))


def _declared_in(layer, prims: Sequence[str]) -> tuple[str, ...]:
    """Primvars of what a scene declares in the first of these prims."""
    known = {a.name for a in with_rows((*ATTRIBUTES, *PACKED_ATTRIBUTES, *MESH_ATTRIBUTES, *WHOLE_ATTRIBUTES))}
    specs = [layer.GetPrimAtPath(f"/World/{prim}") for prim in prims]
    names = [spec.name for spec in specs[0].attributes] if specs and specs[0] else []
    more = [name for name in names if name.startswith("primvars:") and name not in known]
    return tuple(name.removeprefix("primvars:") for name in more)


def frame_kind(prim: str) -> type[ParticleFrame] | type[MeshFrame] | type[WholeFrame]:
    """What a prim of a cache holds in a frame."""
    if prim == WHOLE:
        return WholeFrame
    return MeshFrame if is_mesh(prim) else ParticleFrame


def entries_of(attribute: Attribute, points: int, faces: int) -> int:
    """How many values an attribute has: one a point, corner or face."""
    if attribute.name == "faceVertexIndices":
        return 3 * faces
    counts = {"faceVarying": 3 * faces, "uniform": faces}
    return faces if attribute.name == "faceVertexCounts" else counts.get(attribute.interpolation, points)


def prims_of(layer) -> list[str]:
    """The particle sets and meshes of a layer of a cache, named from /World."""
    world = layer.GetPrimAtPath("/World")
    surface = layer.GetPrimAtPath(f"/World/{SURFACE}")
    points = [child.name for child in world.nameChildren if child.typeName == "Points"] if world else []
    meshes = [child.name for child in surface.nameChildren if child.typeName == "Mesh"] if surface else []
    return [*points, *(f"{SURFACE}/{name}" for name in meshes)]


def frame_path(directory: str | os.PathLike, frame: int) -> Path:
    """Return the path of the file of one frame."""
    return Path(directory) / FRAMES / f"film.{frame:06d}.usdc"


def list_frames(directory: str | os.PathLike) -> list[int]:
    """Return the frame numbers on disk, ascending; empty where there is no cache."""
    folder = Path(directory) / FRAMES
    if not folder.is_dir():
        return []
    return sorted(int(match[1]) for name in os.listdir(folder) if (match := _FRAME_NAME.fullmatch(name)))


# --- checks before anything is written -----------------------------------------------------------------------------


Frame = ParticleFrame | MeshFrame | WholeFrame


def _check_carried(layout: Layout) -> None:
    """Refuse names that are no primvars, or those of others."""
    taken = {a.name for a in with_rows((*ATTRIBUTES, *PACKED_ATTRIBUTES))}
    right = all(name.isidentifier() and f"primvars:{name}" not in taken for name in layout.carried)
    require(right, "carried", list(layout.carried), "names of primvars of their own")


def _check_arrays(label: str, frame: Frame, attributes: Sequence[Attribute]) -> None:
    """Refuse what USD would take silently: wrong shapes and types, NaN, negative thickness, no such corner."""
    count, meshed = len(frame.points), not isinstance(frame, ParticleFrame)
    many = len(frame.faces) if meshed and isinstance(frame.faces, np.ndarray) else 0
    stored = [attribute for attribute in attributes if attribute.field]
    for attribute in stored:
        array = array_of(frame, attribute)
        faces = attribute.field == "faces"
        rows = many if faces else entries_of(attribute, count, many)
        shape = (rows, 3) if faces or attribute.columns == 3 else (rows,)
        dtype = str(np.dtype(attribute.dtype))
        got = (array.shape, str(array.dtype)) if isinstance(array, np.ndarray) else type(array).__name__
        require(got == (shape, dtype), f"{label}.{attribute.field}", got, f"an array {list(shape)} of {dtype}")
    for attribute in stored:
        array = array_of(frame, attribute)
        finite = np.isfinite(array.reshape(len(array), -1 if len(array) else 1)).all(axis=1)
        if not finite.all():
            at = _name_of(frame, int(np.argmin(finite)))
            raise SimulationError(f"{label}.{attribute.field} is not finite at {at}")
    for field in ("widths", "thickness"):
        array = getattr(frame, field, np.zeros(0))
        if len(array) and array.min() < 0.0:
            at = int(np.argmin(array))
            raise SimulationError(f"{label}.{field} is negative at {_name_of(frame, at)}: {array[at]}")
    if meshed:
        low, high = frame.faces.min(initial=0), frame.faces.max(initial=-1)
        require(low >= 0 and high < count, f"{label}.faces", (int(low), int(high)), f"corners from 0 to {count - 1}")
        return
    rising = frame.ids[1:] > frame.ids[:-1]
    if not rising.all():
        at = int(np.argmin(rising))
        require(False, f"{label}.ids", frame.ids[at : at + 2].tolist(), "ascending, each once")


def _name_of(frame: Frame, at: int) -> str:
    return f"particle id {frame.ids[at]}" if isinstance(frame, ParticleFrame) else f"entry {at}"


def _checked_metadata(metadata: Mapping, name: str = "metadata") -> dict:
    """A copy of `metadata` that a USD dictionary can hold: nested mappings of names to text, bool and numbers."""
    result = {}
    for key, value in metadata.items():
        require(isinstance(key, str) and key.isidentifier(), f"{name} key", key, "a name of letters, digits and _")
        if isinstance(value, Mapping):
            result[key] = _checked_metadata(value, f"{name}.{key}")
        else:
            value = value.item() if isinstance(value, np.generic) else value
            allowed = isinstance(value, (str, bool, int, float))
            require(allowed, f"{name}.{key}", value, "text, a bool, a number or a mapping of these")
            small = not isinstance(value, int) or -(2**63) <= value < 2**63
            require(small, f"{name}.{key}", value, "within 64 bits")
            result[key] = value
    return result


def _versions() -> dict[str, str]:
    from pxr import Usd

    return {
        "melpWarp": melp_warp.__version__,
        "warp": importlib.metadata.version("warp-lang"),
        "numpy": np.__version__,
        "usd": ".".join(map(str, Usd.GetVersion())),
    }


def _claim(directory: Path) -> None:
    """Create `directory` and its frames folder; `InputError` if it holds another run or cannot be written."""
    if directory.exists() and not directory.is_dir():
        raise InputError(f"output folder {directory} is a file: choose another folder")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name in _OTHER_RUN:
            if (directory / name).exists():
                raise InputError(f"output folder {directory} already holds a run ({name}): choose another folder")
        (directory / FRAMES).mkdir()
    except OSError as error:
        raise InputError(f"cannot use output folder {directory}: {error.strerror or error}") from error


# --- layers --------------------------------------------------------------------------------------------------------


def _reason(error: Exception) -> str:
    """The cause of a failed write in a few words; pxr reports it within a block of source locations."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    found = re.search(r"writing file: ([^'\n]+)'", str(error)) or re.search(r": '([^\n]+)'", str(error))
    return found[1] if found else str(error).strip()


def _export(layer, path: Path) -> str:
    """Write `layer` to `path` such that there is never a part of a file under that name; its SHA-256."""
    from pxr import Tf

    try:
        with replacing(path) as partial:
            if not layer.Export(str(partial)):
                raise OSError(f"USD did not write {partial.name}")
            return digest(partial)
    except (OSError, Tf.ErrorException) as error:
        raise InputError(f"cannot write {path}: {_reason(error)}; files written before are complete") from error


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
        raise InputError(f"{path} cannot be opened: {_reason(error)}") from error
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


def _new_layer(extension: str, fps: float):
    """An empty layer in memory with the units and rate that every layer of a cache carries."""
    from pxr import Sdf

    layer = Sdf.Layer.CreateAnonymous(extension)
    layer.pseudoRoot.SetInfo("upAxis", "Y")
    layer.pseudoRoot.SetInfo("metersPerUnit", 1.0)
    layer.timeCodesPerSecond = layer.framesPerSecond = fps
    layer.defaultPrim = "World"
    return layer


Origin = tuple[float, float, float]


def _declare(
    layer, prims: Sequence[str], origin: Origin = (0.0, 0.0, 0.0), layout: Layout = PLAIN, fixed: bool = True
) -> None:
    """Add /World and the prims with every attribute, without values; moved to `origin` where it is elsewhere.

    With `fixed`, meshes say besides what holds for all frames: that they are as they are, and seen from both sides.
    """
    from pxr import Sdf

    world = layer.GetPrimAtPath("/World") or Sdf.PrimSpec(layer, "World", Sdf.SpecifierDef, "Xform")
    world.kind = "component"
    for prim in prims:
        mesh = is_mesh(prim)
        if mesh and not layer.GetPrimAtPath(f"/World/{SURFACE}"):
            Sdf.PrimSpec(world, SURFACE, Sdf.SpecifierDef, "Xform")
        parent = layer.GetPrimAtPath(f"/World/{SURFACE}") if mesh else world
        spec = Sdf.PrimSpec(parent, prim.rsplit("/", 1)[-1], Sdf.SpecifierDef, "Mesh" if mesh else "Points")
        for attribute in with_rows(attributes_of(prim, layout)):
            found = Sdf.AttributeSpec(spec, attribute.name, Sdf.ValueTypeNames.Find(attribute.type_name))
            if attribute.interpolation:
                found.SetInfo("interpolation", attribute.interpolation)
        if mesh and fixed:
            for name, kind, value in (("subdivisionScheme", "token", "none"), ("doubleSided", "bool", True)):
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


def _frame_layer(frame_index: int, fps: float, frames: Mapping, layout: Layout, gain: float, index: float):
    """The layer of one frame: every attribute with one sample at its own time code."""
    layer = _new_layer(".usdc", fps)
    layer.startTimeCode = layer.endTimeCode = frame_index
    layer.customLayerData = {METADATA_KEY: {"schemaVersion": SCHEMA_VERSION, "thicknessUnit": THICKNESS_UNIT}}
    _declare(layer, list(frames), next(iter(frames.values())).origin, layout)
    for prim, frame in frames.items():
        _set_values(layer, frame_index, prim, frame, layout, gain, index)
    return layer


def _set_values(
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
    material = UsdShade.Material.Define(stage, _MATERIAL)
    surface = UsdShade.Shader.Define(stage, f"{_MATERIAL}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    reader = UsdShade.Shader.Define(stage, f"{_MATERIAL}/DisplayColor")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    color = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(color)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.1)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    for prim in prims:
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(f"/World/{prim}")).Bind(material)


def _root_layer(
    fps: float,
    prims: Sequence[str],
    layout: Layout,
    metadata: dict,
    origin: Origin,
    rims: Sequence[np.ndarray],
):
    """The root without its time range and clips, see `_set_range`."""
    from pxr import Usd

    layer = _new_layer(".usda", fps)
    layer.documentation = "Soap film cache. SI units, except primvars:thickness, which is in nanometres."
    layer.customLayerData = {METADATA_KEY: metadata}
    _declare(layer, prims, origin, layout)
    if rims:
        _add_rims(layer, rims, origin)
    stage = Usd.Stage.Open(layer)
    _add_preview_material(stage, prims)
    _set_purposes(stage, prims)
    return layer


def _set_purposes(stage, prims: Sequence[str]) -> None:
    """Show one thing by default, the meshes or else the first set of particles; the others are guides."""
    from pxr import UsdGeom

    points = [prim for prim in prims if prim in FILM_SETS]
    for prim in points if any(map(is_mesh, prims)) else points[1:]:
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
        raise InputError(f"{path}: /World/{RIM} cannot be read: {_reason(error)}") from None


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


def _manifest_layer(fps: float, prims: Sequence[str], layout: Layout):
    """What the frames hold."""
    layer = _new_layer(".usda", fps)
    _declare(layer, prims, layout=layout, fixed=False)
    return layer


def _set_range(layer, first: int, last: int) -> None:
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


# --- writing -------------------------------------------------------------------------------------------------------


class CacheWriter:
    """Writes a cache frame by frame; after every frame the cache on disk is complete and can be opened.

    A frame goes to a temporary file first, is flushed to the disk and renamed; the root, whose time range follows
    the frames, is replaced last. A run that is killed leaves all frames before.

    Args:
        directory: output folder; created if needed. It must not hold another run (film.usda, frames/, run.jsonl).
        fps: frames per second, above 0.
        metadata: stored in the root's customLayerData under "melpWarp". Needs "scene" (text) and "seed" (whole
            number); may hold more text, bools, numbers and mappings of these. Schema version, thickness unit,
            refractive index, colour gain and program versions are added.
        prims: names of the prims under /World: point prims, "Film" first, then meshes (`surface_prim`, `WHOLE`).
            Particles have purpose "guide" where there are meshes, and other sets ("FilmE") always: viewers show them
            on demand.
        gain: factor on the reflectance in displayColor.
        index: refractive index of the film.
        origin: where the points of all frames are measured from, m: the prims are translated there, in float64.
        rims: points [k, 3] along each wire that holds the film, from `origin`, m.
        packed: sets of particles whose widths, normals and colours are stored with less precision, in half the bytes
            (packing.py); all else is stored to the bit.
        carried: names and units of what the sets of E and L have in `ParticleFrame.carried`.
        there: first and last frame of a cache in the folder that goes on; None for a new one. The last may be one
            before the first, for none.

    Attributes:
        sums: SHA-256 of the root and the manifest as they are now, by their paths in the folder.

    Raises:
        InputError: an argument is out of range, or the folder holds a run, is a file or cannot be written.
    """

    def __init__(
        self,
        directory: str | os.PathLike,
        fps: float,
        metadata: Mapping,
        prims: Sequence[str] = ("Film",),
        gain: float = DISPLAY_GAIN,
        index: float = WATER_INDEX,
        origin: Origin = (0.0, 0.0, 0.0),
        rims: Sequence[np.ndarray] = (),
        packed: Collection[str] = (),
        carried: Mapping[str, str] | None = None,
        there: tuple[int, int] | None = None,
    ):
        require(np.isscalar(fps) and np.isfinite(fps) and fps > 0.0, "fps", fps, "a number above 0")
        require(isinstance(metadata.get("scene"), str), "metadata.scene", metadata.get("scene"), "text")
        require(
            isinstance(metadata.get("seed"), (int, np.integer)), "metadata.seed", metadata.get("seed"), "a whole number"
        )
        names = len(set(prims)) == len(prims) and not set(prims) & set(_NAMES_TAKEN)
        names = names and all(str(p).removeprefix(f"{SURFACE}/").isidentifier() for p in prims)
        require(names and list(prims[:1]) == ["Film"], "prims", list(prims), '"Film" and then other names, each once')
        display_color(np.zeros(0, np.float32), gain, index)  # checks gain and index
        own = {
            "schemaVersion": SCHEMA_VERSION,
            "thicknessUnit": THICKNESS_UNIT,
            "refractiveIndex": float(index),
            "colorGain": float(gain),
            "versions": _versions(),
            **({"carried": dict(carried)} if carried else {}),
        }
        taken = sorted(own.keys() & metadata.keys())
        require(not taken, "metadata", taken, "without the keys that the writer sets")
        require(len(origin) == 3 and bool(np.all(np.isfinite(origin))), "origin", origin, "three finite numbers")
        self.directory = Path(directory)
        self._fps, self._prims, self._gain, self._index = float(fps), tuple(prims), float(gain), float(index)
        self._layout = Layout(frozenset(packed), tuple(carried or ()), tuple(carried or ()))
        _check_carried(self._layout)
        self._first: int | None = None
        self._last: int | None = None
        self._origin = tuple(float(x) for x in origin)
        own_metadata = _checked_metadata(metadata) | own
        self._root = _root_layer(self._fps, self._prims, self._layout, own_metadata, self._origin, rims)
        if there is None:
            _claim(self.directory)
        self.sums = {
            MANIFEST: _export(_manifest_layer(self._fps, self._prims, self._layout), self.directory / MANIFEST)
        }
        if there is not None and there[0] <= there[1]:
            self._first, self._last = there
            _set_range(self._root, *there)
            self.sums[ROOT] = _export(self._root, self.directory / ROOT)

    def write(self, frame_index: int, frames: Mapping[str, Frame]) -> dict[str, str]:
        """Add one frame and bring the root up to date.

        Args:
            frame_index: number of the frame, file and time code, 0 to 999999; one more than the frame before.
            frames: a frame for each of the prims. Counts may differ from frame to frame, and be 0.

        Returns:
            SHA-256 of the frame's file, the root and the manifest, by their paths in the folder.

        Raises:
            InputError: a wrong number, prim, shape, type or order of ids, or the disk refused the file (full). The
                frames before stay valid and no temporary file is left.
            SimulationError: a value is not finite, or a width or thickness is negative; the particle is named.
        """
        numbered = isinstance(frame_index, (int, np.integer)) and 0 <= frame_index <= MAX_FRAME
        require(numbered, "frame_index", frame_index, f"a whole number from 0 to {MAX_FRAME}")
        frame_index = int(frame_index)
        follows = self._last is None or frame_index == self._last + 1
        require(follows, "frame_index", frame_index, f"{self._last} + 1, the frame after the one before")
        require(set(frames) == set(self._prims), "frames", sorted(frames), f"one for each of {list(self._prims)}")
        for prim in self._prims:
            _check_arrays(
                f"frame {frame_index} {prim}",
                frames[prim],
                attributes_of(prim, self._layout._replace(packed=frozenset())),
            )
            found = frames[prim].origin
            require(
                found == self._origin, f"frame {frame_index} {prim}.origin", found, f"that of the cache, {self._origin}"
            )
        ordered = {prim: frames[prim] for prim in self._prims}
        layer = _frame_layer(frame_index, self._fps, ordered, self._layout, self._gain, self._index)
        path = frame_path(self.directory, frame_index)
        digests = {f"{FRAMES}/{path.name}": _export(layer, path)}
        first = frame_index if self._first is None else self._first
        _set_range(self._root, first, frame_index)
        self.sums[ROOT] = _export(self._root, self.directory / ROOT)
        self._first, self._last = first, frame_index
        return digests | self.sums


# --- reading -------------------------------------------------------------------------------------------------------


def read_frame(directory: str | os.PathLike, frame: int, prim: str = "Film") -> ParticleFrame:
    """Return one particle set of one frame, bit for bit as it was written.

    Of a packed set the widths are in steps, and the normals are those of a surface through the points, see packing.py.

    Raises:
        InputError: the frame or prim is not there, the file is damaged, or it holds what `CacheWriter` would not write.
    """
    read, packed = read_prim(directory, frame, prim)
    return refine_normals(read) if packed else read


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
        _check_arrays(prim, read, attributes_of(prim, layout))
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
        return f"cannot be read: {_reason(error)}"
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
        raise InputError(f"{path} cannot be read: {_reason(error)}") from error
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


def check_sizes(path: Path, frame: Frame) -> None:
    """Refuse numbers with which nothing can be drawn or measured, though they can be stored.

    Raises:
        InputError: names the array.
    """
    if not len(frame.points):
        return
    for name in ("points", "velocities", "widths", "normals", "thickness"):
        largest = float(np.abs(getattr(frame, name, np.zeros(1))).max())
        require(largest <= LARGEST, f"{path}: {name}", largest, f"at most {LARGEST:g}")
    if isinstance(frame, WholeFrame) and len(frame.faces):
        low, high = int(min(frame.inside.min(), frame.outside.min())), int(max(frame.inside.max(), frame.outside.max()))
        require(
            -1 <= low <= high < MOST_REGIONS, f"{path}: inside and outside", [low, high], f"-1 to {MOST_REGIONS - 1}"
        )
    if isinstance(frame, ParticleFrame):
        low, high = int(frame.region.min()), int(frame.region.max())
        require(0 <= low <= high < MOST_REGIONS, f"{path}: region", [low, high], f"from 0 to {MOST_REGIONS - 1}")


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
    points = [prim for prim in sets if prim not in (FREE_RIMS, DROPS)]
    numbers = list_frames(directory)
    require("Film" in points and bool(numbers), "directory", str(directory), "a cache with frames and /World/Film")
    origin, layout = origin_of(root, "Film"), layout_of(root, points)
    layout = layout._replace(meshed=layout.carried)
    for frame in numbers:
        path = frame_path(directory, frame)
        made, layer = make(frame), open_layer(path)
        _drop_meshes(layer)
        _declare(layer, meshes, origin, layout)
        for prim in meshes:
            mesh = made.get(prim) or frame_kind(prim).empty(origin, layout.meshed)
            _check_arrays(f"frame {frame} {prim}", mesh, attributes_of(prim, layout))
            _set_values(layer, frame, prim, mesh, layout, gain, index)
        sums[f"{FRAMES}/{path.name}"] = _export(layer, path)
    manifest = _manifest_layer(fps, [*sets, *meshes], layout)
    sums[MANIFEST] = _export(manifest, directory / MANIFEST)
    _drop_meshes(root)
    _declare(root, meshes, origin, layout)
    _set_range(root, numbers[0], numbers[-1])  # before USD opens it as a stage: no clips but these
    _bind(root, meshes)
    return sums | {ROOT: _export(root, directory / ROOT)}


def _drop_meshes(layer) -> None:
    surface = layer.GetPrimAtPath(f"/World/{SURFACE}")
    if surface:
        del layer.GetPrimAtPath("/World").nameChildren[SURFACE]


def _bind(root, meshes: Sequence[str]) -> None:
    """Give meshes that were added the material of the cache, and make them what is shown."""
    from pxr import Usd, UsdShade

    stage = Usd.Stage.Open(root)
    material = UsdShade.Material(stage.GetPrimAtPath(_MATERIAL))
    for prim in meshes:
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(f"/World/{prim}")).Bind(material)
    _set_purposes(stage, prims_of(root))


# --- other forms ---------------------------------------------------------------------------------------------------


def flatten(directory: str | os.PathLike, path: str | os.PathLike) -> Path:
    """Write a cache as one file without clips, for programs that do not read clips.

    All frames are held in memory at once: count on 72 bytes a particle and frame.

    Args:
        directory: folder of the cache.
        path: file to write, .usdc, .usd or .usda; it must not exist.

    Returns:
        `path`.

    Raises:
        InputError: no cache, a wrong ending, the file exists, or it cannot be written.
    """
    from pxr import Usd

    path = Path(path)
    require(path.suffix in (".usd", ".usda", ".usdc"), "path", str(path), "a file name ending in .usdc, .usd or .usda")
    require(not path.exists(), "path", str(path), "a new file")
    root = Path(directory) / ROOT
    require(not refers_to(open_layer(root)), "directory", str(directory), "a cache that refers to its own frames alone")
    stage = Usd.Stage.Open(str(root))
    stage.Reload()
    _export(stage.Flatten(addSourceFileComment=False), path)
    return path


def write_look(directory: str | os.PathLike) -> Path:
    """Write film_look.usda: the cache under a MaterialX OpenPBR thin-film look, which computes its own colours.

    The file lies over film.usda and copies its time range, so write it after the last frame. A free film is a
    thin-walled sheet of index 1 (specular_ior) under a film of the liquid's index. OpenPBR takes micrometres.

    Returns:
        The path of the file; one that exists is replaced.

    Raises:
        InputError: no cache, or the file cannot be written.
    """
    metadata = read_metadata(directory)
    layer = _look_layer(metadata["framesPerSecond"], metadata["refractiveIndex"])
    layer.startTimeCode, layer.endTimeCode = metadata["startTimeCode"], metadata["endTimeCode"]
    layer.subLayerPaths.append(f"./{ROOT}")
    path = Path(directory) / LOOK
    _export(layer, path)
    return path


def write_stage(directory: str | os.PathLike, eye: Sequence[float], target: Sequence[float], up, fov: float) -> Path:
    """Write film_stage.usda: the cache under a camera and lights of its own, apart from what is referenced elsewhere.

    Args:
        directory: folder of the cache.
        eye: [3] where the camera stands, from the place of the cache's prims, m.
        target: [3] what is in the middle of the picture, m.
        up: [3] direction that points up in the picture.
        fov: angle of view over the picture's height, degrees.

    Returns:
        The path of the file; one that exists is replaced.

    Raises:
        InputError: no cache, or the file cannot be written.
    """
    from pxr import Gf

    directory = Path(directory)
    root, metadata = open_layer(directory / ROOT), read_metadata(directory)
    origin = Gf.Vec3d(*origin_of(root, metadata["prims"][0]))
    view = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*eye) + origin, Gf.Vec3d(*target) + origin, Gf.Vec3d(*up))
    away = float(np.linalg.norm(np.subtract(eye, target)))
    layer = _stage_layer(metadata["framesPerSecond"], view.GetInverse(), away, fov)
    layer.startTimeCode, layer.endTimeCode = metadata["startTimeCode"], metadata["endTimeCode"]
    layer.subLayerPaths.append(f"./{ROOT}")
    path = directory / STAGE
    _export(layer, path)
    return path


def _stage_layer(fps: float, place, away: float, fov: float):
    """A camera at the transform `place`, `away` (m) from what it looks at, and lights."""
    from pxr import Gf, Usd, UsdGeom, UsdLux

    layer = _new_layer(".usda", fps)
    stage = Usd.Stage.Open(layer)
    UsdGeom.Xform.Define(stage, "/Stage")
    camera = UsdGeom.Camera.Define(stage, "/Stage/Camera")
    camera.AddTransformOp().Set(place)
    camera.CreateVerticalApertureAttr(24.0)
    camera.CreateHorizontalApertureAttr(24.0 * 16.0 / 9.0)
    camera.CreateFocalLengthAttr(12.0 / float(np.tan(0.5 * np.radians(fov))))
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01 * away, 100.0 * away))
    UsdLux.DomeLight.Define(stage, "/Stage/Sky").CreateIntensityAttr(0.4)
    for name, turn, intensity in (("Key", (-40.0, 35.0, 0.0), 1.2), ("Fill", (-10.0, -70.0, 0.0), 0.5)):
        light = UsdLux.DistantLight.Define(stage, f"/Stage/{name}")
        light.CreateIntensityAttr(intensity)
        light.AddRotateXYZOp().Set(Gf.Vec3f(*turn))
    return layer


def _look_layer(fps: float, index: float):
    """Opinions that add a MaterialX output to the cache's material."""
    from pxr import Sdf, Usd, UsdShade

    kinds = Sdf.ValueTypeNames
    layer = _new_layer(".usda", fps)
    stage = Usd.Stage.Open(layer)
    surface = UsdShade.Shader.Define(stage, f"{_MATERIAL}/OpenPbr")
    surface.CreateIdAttr("ND_open_pbr_surface_surfaceshader")
    for name, value in {
        "base_weight": 0.0,
        "specular_ior": 1.0,
        "specular_roughness": 0.0,
        "transmission_weight": 1.0,
        "thin_film_weight": 1.0,
        "thin_film_ior": index,
    }.items():
        surface.CreateInput(name, kinds.Float).Set(value)
    surface.CreateInput("geometry_thin_walled", kinds.Bool).Set(True)
    reader = UsdShade.Shader.Define(stage, f"{_MATERIAL}/Thickness")
    reader.CreateIdAttr("ND_geompropvalue_float")
    reader.CreateInput("geomprop", kinds.String).Set("thickness")
    scale = UsdShade.Shader.Define(stage, f"{_MATERIAL}/NanometresToMicrometres")
    scale.CreateIdAttr("ND_multiply_float")
    scale.CreateInput("in1", kinds.Float).ConnectToSource(reader.CreateOutput("out", kinds.Float))
    scale.CreateInput("in2", kinds.Float).Set(0.001)
    thickness = surface.CreateInput("thin_film_thickness", kinds.Float)
    thickness.ConnectToSource(scale.CreateOutput("out", kinds.Float))
    output = UsdShade.Material(stage.GetPrimAtPath(_MATERIAL)).CreateSurfaceOutput("mtlx")
    output.ConnectToSource(surface.CreateOutput("surface", kinds.Token))
    for path in Sdf.Path(_MATERIAL).GetPrefixes():
        layer.GetPrimAtPath(path).specifier = Sdf.SpecifierOver
    return layer
