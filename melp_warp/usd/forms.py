"""Other forms of a cache: one file, a MaterialX look, a stage with camera and lights."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from melp_warp.errors import require
from melp_warp.usd.layers import MATERIAL, export, new_layer, open_layer, origin_of
from melp_warp.usd.reading import read_metadata, refers_to
from melp_warp.usd.schema import LOOK, ROOT, STAGE


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
    export(stage.Flatten(addSourceFileComment=False), path)
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
    export(layer, path)
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
    export(layer, path)
    return path


def _stage_layer(fps: float, place, away: float, fov: float):
    """A camera at the transform `place`, `away` (m) from what it looks at, and lights."""
    from pxr import Gf, Usd, UsdGeom, UsdLux

    layer = new_layer(".usda", fps)
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
    layer = new_layer(".usda", fps)
    stage = Usd.Stage.Open(layer)
    surface = UsdShade.Shader.Define(stage, f"{MATERIAL}/OpenPbr")
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
    reader = UsdShade.Shader.Define(stage, f"{MATERIAL}/Thickness")
    reader.CreateIdAttr("ND_geompropvalue_float")
    reader.CreateInput("geomprop", kinds.String).Set("thickness")
    scale = UsdShade.Shader.Define(stage, f"{MATERIAL}/NanometresToMicrometres")
    scale.CreateIdAttr("ND_multiply_float")
    scale.CreateInput("in1", kinds.Float).ConnectToSource(reader.CreateOutput("out", kinds.Float))
    scale.CreateInput("in2", kinds.Float).Set(0.001)
    thickness = surface.CreateInput("thin_film_thickness", kinds.Float)
    thickness.ConnectToSource(scale.CreateOutput("out", kinds.Float))
    output = UsdShade.Material(stage.GetPrimAtPath(MATERIAL)).CreateSurfaceOutput("mtlx")
    output.ConnectToSource(surface.CreateOutput("surface", kinds.Token))
    for path in Sdf.Path(MATERIAL).GetPrefixes():
        layer.GetPrimAtPath(path).specifier = Sdf.SpecifierOver
    return layer
