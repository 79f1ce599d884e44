"""What a cache holds: names of its files and prims, the attributes of each and how they are stored."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from melp_warp.frame import CurveFrame, MeshFrame, ParticleFrame, WholeFrame

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


_FRAME_NAME = re.compile(r"film\.(\d{6})\.usdc")


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


CURVE_ATTRIBUTES = (
    *(_SHARED[name] for name in ("points", "velocities")),
    Attribute("curveVertexCounts", "counts", "int[]", "IntArray", np.int32, 1, None),
    *(_SHARED[name] for name in ("widths", "extent")),
)
"""Every attribute of curves, likewise."""


SURFACE = "FilmSurface"


WHOLE = f"{SURFACE}/Whole"
"""Name under /World of the mesh of a whole foam."""


FREE_RIMS, DROPS = "FreeRims", "Droplets"
"""Names under /World of the liquid that is no film: the rims of holes and the drops that they break into."""


RIM_CURVES = "FreeRimCurves"
"""Name under /World of the rims as curves; the beads of `FREE_RIMS` are the same liquid."""


FILM_SETS = ("Film", "FilmE")
"""Names under /World of the sets that are film: of all others `thickness` is a diameter."""


RIM = "Rim"


NAMES_TAKEN = ("Looks", RIM, SURFACE)


def surface_prim(region: int) -> str:
    """Name under /World of the mesh of a region."""
    return f"{SURFACE}/Region_{region}"


def is_mesh(prim: str) -> bool:
    """Whether a prim of a cache, named from /World, is a mesh."""
    return prim.startswith(f"{SURFACE}/")


def fixed_of(prim: str) -> tuple[tuple[str, str, object], ...]:
    """Attributes of a prim that are the same in all frames: names, USD types and values."""
    if is_mesh(prim):
        return (("subdivisionScheme", "token", "none"), ("doubleSided", "bool", True))
    return (("type", "token", "linear"), ("wrap", "token", "nonperiodic")) if prim == RIM_CURVES else ()


def type_of(prim: str) -> str:
    """USD type of a prim."""
    return "Mesh" if is_mesh(prim) else "BasisCurves" if prim == RIM_CURVES else "Points"


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
    if prim == RIM_CURVES:
        return CURVE_ATTRIBUTES
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


def frame_kind(prim: str) -> type[ParticleFrame] | type[CurveFrame] | type[MeshFrame] | type[WholeFrame]:
    """What a prim of a cache holds in a frame."""
    kinds = {WHOLE: WholeFrame, RIM_CURVES: CurveFrame}
    return kinds.get(prim, MeshFrame if is_mesh(prim) else ParticleFrame)


def entries_of(attribute: Attribute, points: int, faces: int) -> int:
    """How many values an attribute has: one a point, corner or face; `faces` may be curves."""
    if attribute.name == "faceVertexIndices":
        return 3 * faces
    counts = {"faceVarying": 3 * faces, "uniform": faces}
    each = attribute.name in ("faceVertexCounts", "curveVertexCounts")
    return faces if each else counts.get(attribute.interpolation, points)


def prims_of(layer) -> list[str]:
    """The particle sets, curves and meshes of a layer of a cache, named from /World."""
    world = layer.GetPrimAtPath("/World")
    surface = layer.GetPrimAtPath(f"/World/{SURFACE}")
    held = [child for child in world.nameChildren if child.typeName == type_of(child.name)] if world else []
    points = [child.name for child in held if child.typeName in ("Points", "BasisCurves")]
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


Frame = ParticleFrame | CurveFrame | MeshFrame | WholeFrame
