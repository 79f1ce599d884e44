"""Preview pictures of a film: its points blended to a smooth surface, in interference colours under studio lights.

The pictures need no other program and are drawn on the CPU or a CUDA device. The same input gives the same picture,
bit for bit.

    frame = ...  # ParticleFrame
    save_image(render(frame), "film.png")
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import warp as wp
from PIL import Image, ImageDraw, ImageFont

from melp_warp import optics
from melp_warp.device.launch import launch
from melp_warp.errors import require
from melp_warp.files import replacing
from melp_warp.frame import MeshFrame, ParticleFrame
from melp_warp.kernels import raster
from melp_warp.kernels import render as kernels
from melp_warp.preview import surface
from melp_warp.preview.surface import Surface

ENVIRONMENTS = {"white": kernels.WHITE, "studio": kernels.STUDIO, "panel": kernels.PANEL}
"""Lights to see a film by; see `render`."""

_OUTLINES = {"ring": kernels.RING, "frame": kernels.FRAME}
_TABLE_NM = optics.DISPLAY_MAX_THICKNESS
_PICTURE_SIZES = (8, 8192)
_FIT_POINTS = 4096
FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".webp": "WEBP",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".bmp": "BMP",
}
_QUALITY = {"PNG": {"compress_level": 4}, "JPEG": {"quality": 93}, "WEBP": {"quality": 93}}
_FILMS = (ParticleFrame, MeshFrame, Surface)
_CROWD = 18
"""Particles within a splat's radius: enough that points of no order leave no holes."""


@dataclass(frozen=True)
class Outline:
    """The wire that holds a flat film; the film is drawn inside of it only.

    Attributes:
        kind: "ring" or "frame" (rectangle).
        center: m.
        axis_x: unit vector in the film's plane.
        axis_y: unit vector in the film's plane, across `axis_x`.
        half_x: radius of the ring or half the width of the frame, m.
        half_y: half the height of the frame, m; the radius again for a ring.
    """

    kind: str
    center: tuple[float, float, float]
    axis_x: tuple[float, float, float]
    axis_y: tuple[float, float, float]
    half_x: float
    half_y: float


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. Make one with `Camera.fit` and use it for all frames of a sequence.

    Attributes:
        eye: where it stands, m.
        target: what is in the middle of the picture, m.
        up: direction that points up in the picture.
        fov: angle of view over the shorter side of the picture, degrees.
        flat: whether it faces a flat film; `render` then takes the "panel" lights by default.
        outline: wire around a flat film, None for none.
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov: float = 22.0
    flat: bool = False
    outline: Outline | None = None

    def __post_init__(self):
        for name in ("eye", "target", "up"):
            value = getattr(self, name)
            require(np.shape(value) == (3,) and bool(np.all(np.isfinite(value))), name, value, "three finite numbers")
        require(0.0 < self.fov < 150.0, "fov", self.fov, "an angle between 0 and 150 degrees")
        back = np.subtract(self.eye, self.target)
        require(bool(np.any(back)), "eye", self.eye, "away from the target")
        require(np.linalg.norm(np.cross(back, self.up)) > 0.0, "up", self.up, "not along the line of sight")

    @classmethod
    def fit(
        cls,
        what: np.ndarray | ParticleFrame | Iterable[ParticleFrame],
        direction: Sequence[float] | None = None,
        fov: float = 22.0,
        margin: float = 1.18,
        aspect: float = 1.0,
    ) -> Camera:
        """Place a camera so that everything given is in the picture.

        A closed film is seen slightly from above, an open sheet face-on with a small angle, y up. A flat film whose
        edge is a circle or a rectangle gets its wire.

        Args:
            what: points [n, 3] in m (the corners of a box, for one), a frame, or all frames of a sequence.
            direction: vector from the film to the camera; None for the default view.
            fov: angle of view over the shorter side of the picture, degrees.
            margin: room around the film, 1 for none.
            aspect: width over height of the pictures to be made.

        Raises:
            InputError: no points in any frame, a number that is not finite, or an option out of range.
        """
        require(np.isfinite(margin) and margin >= 1.0, "margin", margin, "a number of at least 1")
        require(np.isfinite(aspect) and 0.05 <= aspect <= 20.0, "aspect", aspect, "a number from 0.05 to 20")
        require(0.0 < fov < 150.0, "fov", fov, "an angle between 0 and 150 degrees")
        points, normal, spacing = _gather(what)
        low, high = points.min(axis=0), points.max(axis=0)
        target = 0.5 * (low + high)
        size = max(float(np.linalg.norm(high - low)), spacing, 1e-9)
        flat = _plane_normal(points, size)
        facing = flat if flat is not None else normal
        outline = _find_outline(points, flat, spacing) if flat is not None else None
        up = np.array([0.0, 1.0, 0.0])
        if direction is not None:
            require(np.shape(direction) == (3,) and np.linalg.norm(direction) > 0, "direction", direction, "a vector")
            back = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        elif facing is not None:
            back = _face_on(facing, 0.21 if flat is not None else 0.75)
        else:
            back = np.array([0.28, 0.2, 0.94]) / np.linalg.norm([0.28, 0.2, 0.94])
        if abs(back[1]) > 0.8:
            up = np.array([0.0, 0.0, -1.0])
        right, up_axis, _ = _axes(back, up)
        slope = np.tan(0.5 * np.radians(fov)) / margin
        p = points - target
        needed = p @ back + np.maximum(
            np.abs(p @ right) / (slope * max(aspect, 1.0)), np.abs(p @ up_axis) / (slope * max(1.0 / aspect, 1.0))
        )
        edge = 0.5 * spacing / slope if facing is not None else 0.0
        away = max(float(needed.max()) + edge, size)
        return cls(
            tuple((target + away * back).tolist()),
            tuple(target.tolist()),
            tuple(up.tolist()),
            fov,
            flat is not None and direction is None,
            outline,
        )

    def turned(self, angle: float) -> Camera:
        """The camera gone around its target by an angle (rad), about what points up in the picture."""
        axis = np.asarray(self.up, dtype=float) / np.linalg.norm(self.up)
        back = np.subtract(self.eye, self.target)
        along = axis * (axis @ back)
        moved = along + np.cos(angle) * (back - along) + np.sin(angle) * np.cross(axis, back)
        return replace(self, eye=tuple((np.asarray(self.target) + moved).tolist()))


def _axes(back: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors right, up, back of a camera."""
    back = back / np.linalg.norm(back)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return right, np.cross(back, right), back


def _gather(what) -> tuple[np.ndarray, np.ndarray | None, float]:
    """Points [m, 3] of what is to be seen, the common normal where there is one, and the spacing of the points."""
    frames = [what] if isinstance(what, (np.ndarray, *_FILMS)) else list(what)
    if len(frames) > 1:  # films that popped leave frames without particles
        frames = [one for one in frames if not (isinstance(one, _FILMS) and len(one.points) == 0)]
    require(len(frames) > 0, "frames", frames, "at least one frame with particles")
    points, normals = [], []
    spacing = 0.0
    for frame in frames:
        p = _checked_points(frame.points if isinstance(frame, _FILMS) else frame)
        few = p[:: max(1, len(p) // _FIT_POINTS)]
        points += [few, p[p.argmin(axis=0)], p[p.argmax(axis=0)]]
        if isinstance(frame, _FILMS):
            normals.append(np.asarray(frame.normals, dtype=float).mean(axis=0))
            spacing = max(spacing, _spacing(frame))
    normal = np.mean(normals, axis=0) if normals else np.zeros(3)
    size = float(np.linalg.norm(normal))
    return np.concatenate(points), normal / size if size > 0.8 else None, spacing


def _checked_points(points: object) -> np.ndarray:
    """Points [n, 3] as float64; `InputError` if there are none or they are not finite."""
    points = np.asarray(points)
    require(points.ndim == 2 and points.shape[1] == 3 and len(points) > 0, "points", points.shape, "[n, 3], n > 0")
    points = points.astype(np.float64)
    require(bool(np.all(np.isfinite(points))), "points", "NaN or infinity", "finite")
    return points


def _plane_normal(points: np.ndarray, size: float) -> np.ndarray | None:
    """Normal of the plane of points that lie in one, None where they do not."""
    if len(points) < 4:
        return None
    _, _, v = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    height = (points - points.mean(axis=0)) @ v[2]
    return v[2] if np.ptp(height) < 0.004 * size else None


def _face_on(normal: np.ndarray, lean: float) -> np.ndarray:
    """Direction to a camera that looks at a sheet with `normal`, `lean` (rad) off it."""
    side = normal[np.argmax(np.abs(normal) - [0.02, 0.01, 0.0])]
    normal = normal * np.sign(side)
    right, up, back = _axes(normal, np.array([0.0, 0.0, -1.0]) if abs(normal[1]) > 0.8 else np.array([0.0, 1.0, 0.0]))
    tilt = 0.9 * right - 0.44 * up if lean < 0.5 else -up
    return np.cos(lean) * back + np.sin(lean) * tilt / np.linalg.norm(tilt)


def _find_outline(points: np.ndarray, normal: np.ndarray, spacing: float) -> Outline | None:
    """The circle or rectangle that flat points fill up to half a spacing from its edge."""
    x_axis = np.cross(normal, [0.0, 0.0, 1.0] if abs(normal[1]) > 0.8 else [0.0, 1.0, 0.0])
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(normal, x_axis)
    flat = np.stack([points @ x_axis, points @ y_axis], axis=1)
    angles = np.radians(np.arange(0.0, 180.0, 1.0))
    along = flat @ np.stack([np.cos(angles), np.sin(angles)])
    low, high = along.min(axis=0), along.max(axis=0)
    width = high - low
    first = int(np.argmin(width[:90] * width[90:]))
    if width.max() < 1.05 * width.min():
        kind, first, half = "ring", 0, np.full(2, 0.5 * width.mean() + 0.5 * spacing)
    elif _fills_corners(along[:, [first, first + 90]]):
        kind, half = "frame", 0.5 * (width[[first, first + 90]] + spacing)
    else:
        return None
    middle = 0.5 * (low + high)[[first, first + 90]]
    c, s = np.cos(angles[first]), np.sin(angles[first])
    axes = np.array([[c, s], [-s, c]]) @ np.stack([x_axis, y_axis])
    center = middle @ axes + normal * (points @ normal).mean()
    return Outline(kind, *(tuple(v.tolist()) for v in (center, *axes)), float(half[0]), float(half[1]))


def _fills_corners(flat: np.ndarray) -> bool:
    """Whether points [n, 2] reach into all four corners of their bounding rectangle."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    if np.any(high <= low):
        return False
    cell = np.minimum((flat - low) / (high - low) * 12.0, 11.0).astype(int)
    corner = np.isin(cell, (0, 11)).all(axis=1)
    return len(np.unique(cell[corner], axis=0)) == 4


def _spacing(frame: ParticleFrame) -> float:
    """Usual distance of neighbours, m: from the distance to the eighth nearest of some particles."""
    points = np.asarray(frame.points, dtype=np.float64)
    if len(points) < 16:
        widths = np.asarray(getattr(frame, "widths", ()), dtype=np.float64)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        return max(float(np.median(widths)) if widths.size else 0.0, 0.1 * size, 1e-6)
    nearest = []
    for i in range(0, len(points), -(-len(points) // 64)):
        distance = ((points - points[i]) ** 2).sum(axis=1)
        nearest.append(np.sqrt(np.partition(distance, 8)[8]))
    return max(float(np.median(nearest)) * float(np.sqrt(np.pi / 8.5)), 1e-9)


def render(
    frame: ParticleFrame | MeshFrame | Surface,
    width: int = 960,
    height: int = 960,
    camera: Camera | None = None,
    device: str = "cpu",
    exposure: float = optics.DISPLAY_GAIN,
    layers: int | None = None,
    samples: int = 2,
    environment: str = "auto",
    index: float = optics.WATER_INDEX,
    background: str = "dark",
    colors: np.ndarray | None = None,
) -> np.ndarray:
    """Draw one frame; one without film, as after the last bubble popped, is the backdrop alone.

    Args:
        frame: the film: a mesh, meshes with what belongs to them, or particles. Of particles points, normals,
            thickness and region are used; widths where there are few points.
        width: of the picture, pixels.
        height: of the picture, pixels.
        camera: None to fit one to this frame.
        device: Warp device.
        exposure: gain on the light; 13 shows the brightest interference colour in white light as white.
        layers: films seen behind one another at most: of meshes 1 to 8, None for 8; of particles 1 to 12, None for 4
            and, with several regions, 12.
        samples: samples along a pixel's side, 1 to 4.
        environment: "studio" (dark room, window, soft boxes), "panel" (large diffuser behind the camera), "sky" (a day
            outdoors, y up), a picture file with the light from all directions (sky and files for meshes only), "white"
            (light of 1 from everywhere, black backdrop: for measuring) or "auto": panel where the camera faces a flat
            film, else studio.
        index: refractive index of the film.
        background: "dark", "light", "#rrggbb" or "around" (what the environment shows there); particles have "dark".
        colors: [k, 3] linear sRGB of thicknesses from 0 to `optics.DISPLAY_MAX_THICKNESS`, in place of interference
            colours; None for these.

    Returns:
        [height, width, 3] uint8, sRGB.

    Raises:
        InputError: a frame that is not finite or of wrong shape, one that is empty without a camera, or an option out
            of range.
    """
    frame = Surface({0: frame}) if isinstance(frame, MeshFrame) else frame
    meshed = isinstance(frame, Surface)
    if environment == "auto" and camera is not None:
        environment = "panel" if camera.flat else "studio"
    _check_options(width, height, exposure, layers, samples, environment, background, meshed)
    device = _checked_device(device)
    camera = camera or Camera.fit(frame, aspect=width / height)
    if environment == "auto":
        environment = "panel" if camera.flat else "studio"
    view = _view(camera, width, height, samples)
    table = _color_table(float(index), str(device)) if colors is None else _table_of(colors, device)
    if meshed:
        films = layers or int(raster.MOST_FILMS)
        look = (environment, background, exposure, films, table, device)
        radiance = surface.draw(frame, view, np.array(camera.target), *look)
    else:
        radiance = _draw_particles(frame, view, camera, environment, exposure, layers, table, device)
    return _develop(radiance, samples, environment == "white")


def _draw_particles(frame: ParticleFrame, view, camera: Camera, environment: str, exposure, layers, table, device):
    """Radiance of each sample of a picture of particles."""
    if len(frame.points) == 0:
        frame = _out_of_sight(camera)
    data = _checked_frame(frame)
    if layers is None:
        layers = 4 if np.ptp(data["region"]) == 0 else int(kernels.MAX_LAYERS)
    wire = _wire(camera, view.columns // view.samples, view.rows // view.samples, environment)
    splats = _splats(frame, data, camera, wire.kind != kernels.NO_OUTLINE, device)
    boxes = wp.empty(len(splats), dtype=wp.vec4i, device=device)
    launch(kernels.box_splats, len(splats), [view, splats], [boxes], device)
    begins, ends, members = surface.bin_tiles(boxes, view.tile_columns, -(-view.rows // int(kernels.TILE)))
    radiance = wp.empty((view.rows, view.columns), dtype=wp.vec3, device=device)
    inputs = [view, _look(environment, exposure, layers), wire, splats, begins, ends, members, table]
    surface.share(kernels.draw_samples, len(begins) * int(kernels.TILE) ** 2, inputs, [radiance], device)
    return radiance


def _develop(radiance: wp.array, samples: int, plain: bool) -> np.ndarray:
    """The picture of the radiance of its samples: film response, mean about each pixel, a glow about what is bright."""
    device = radiance.device
    rows, columns = radiance.shape
    height, width = rows // samples, columns // samples
    sigma = max(width, height) / 90.0
    block = max(1, int(sigma / 3.0))
    means = wp.empty((-(-height // block), -(-width // block)), dtype=wp.vec3, device=device)
    if not plain:
        surface.share(raster.average_glare, means.size, [radiance, block * samples], [means], device)
        means.assign(0.06 * _blurred(means.numpy(), sigma / block))
    surface.share(raster.respond, rows * columns, [plain], [radiance], device)
    weights = wp.array(_weights(samples), dtype=wp.float32, device=device)
    picture = wp.empty((height, width, 3), dtype=wp.uint8, device=device)
    inputs = [radiance, weights, samples, means, float(block), plain]
    surface.share(raster.develop, height * width, inputs, [picture], device)
    return picture.numpy()


@lru_cache(maxsize=8)
def _weights(samples: int) -> np.ndarray:
    """[k, k] weights of the samples about a pixel, a Gaussian of their distance from its middle."""
    reach = samples // 2
    k = np.arange(-reach, samples + reach)
    sub = (k % samples + 0.5) / samples - 0.5
    x = (k[None, :] + 0.5 + sub[:, None]) / samples - 0.5
    y = (k[:, None] + 0.5 - sub[None, :]) / samples - 0.5
    return np.exp(-2.6 * (x**2 + y**2)).astype(np.float32)


def _out_of_sight(camera: Camera) -> ParticleFrame:
    """A frame of one particle behind the camera."""
    behind = 2.0 * np.array(camera.eye) - np.array(camera.target)
    one, zero = np.ones(1, np.float32), np.zeros(1, np.int32)
    up = np.array([[0.0, 1.0, 0.0]], np.float32)
    return ParticleFrame(behind[None].astype(np.float32), 0.0 * up, zero.astype(np.int64), one, up, one, zero, zero)


def _check_options(width, height, exposure, layers, samples, environment, background, meshed) -> None:
    """`InputError` for an option of `render` that is out of range."""
    low, high = _PICTURE_SIZES
    for name, value, least, most in (
        ("width", width, low, high),
        ("height", height, low, high),
        ("layers", 4 if layers is None else layers, 1, int(raster.MOST_FILMS if meshed else kernels.MAX_LAYERS)),
        ("samples", samples, 1, 4),
    ):
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        require(whole and least <= value <= most, name, value, f"a whole number from {least} to {most}")
    ok = isinstance(exposure, (int, float)) and np.isfinite(exposure) and exposure > 0.0
    require(ok, "exposure", exposure, "a number above 0")
    if meshed:
        if environment != "auto":
            surface.check_light(environment)
        surface.ground_color(background)
    else:
        known = ("auto", *ENVIRONMENTS)
        require(environment in known, "environment", environment, f"{', '.join(known)} for particles without a mesh")
        require(background == "dark", "background", background, "dark for particles without a mesh")


def _checked_device(device: str):
    """The Warp device of that name."""
    try:
        return wp.get_device(device)
    except ValueError:
        known = ", ".join(str(d) for d in wp.get_devices())
        require(False, "device", device, f"one of {known}")


def _checked_frame(frame: ParticleFrame) -> dict[str, np.ndarray]:
    """Points (float64), normals, thickness and region of a frame that can be drawn."""
    data = {"points": _checked_points(frame.points)}
    n = len(data["points"])
    for name, shape in (("normals", (n, 3)), ("thickness", (n,)), ("region", (n,))):
        value = np.asarray(getattr(frame, name))
        require(value.shape == shape, name, value.shape, f"of shape {list(shape)}")
        require(bool(np.all(np.isfinite(value))), name, "NaN or infinity", "finite")
        data[name] = value
    require(float(data["thickness"].min()) >= 0.0, "thickness", float(data["thickness"].min()), "at least 0 nm")
    size = np.linalg.norm(data["normals"], axis=1, keepdims=True)
    require(float(size.min()) > 1e-3, "normals", "a normal of length 0", "unit vectors")
    data["normals"] = data["normals"] / size
    return data


def _view(camera: Camera, width: int, height: int, samples: int) -> kernels.View:
    """The camera in the target's coordinates."""
    right, up, back = _axes(np.subtract(camera.eye, camera.target), np.asarray(camera.up, dtype=float))
    slope = np.tan(0.5 * np.radians(camera.fov)) / min(width, height)
    view = kernels.View()
    view.eye = wp.vec3(*np.subtract(camera.eye, camera.target))
    view.right, view.up, view.back = wp.vec3(*right), wp.vec3(*up), wp.vec3(*back)
    view.slope_x, view.slope_y = slope * width, slope * height
    view.columns, view.rows, view.samples = width * samples, height * samples, samples
    view.tile_columns = -(-view.columns // int(kernels.TILE))
    return view


def _look(environment: str, exposure: float, layers: int) -> kernels.Look:
    """The options of `render` as the kernels take them."""
    look = kernels.Look()
    look.environment = ENVIRONMENTS[environment]
    look.gain, look.layers, look.max_thickness = float(exposure), layers, _TABLE_NM
    return look


def _wire(camera: Camera, width: int, height: int, environment: str) -> kernels.Outline:
    """The camera's outline in the target's coordinates; its wire is about three pixels thick at 960."""
    out = kernels.Outline()
    source = camera.outline
    out.kind = kernels.NO_OUTLINE
    if source is not None and environment != "white":
        out.kind = _OUTLINES[source.kind]
        out.center = wp.vec3(*np.subtract(source.center, camera.target))
        out.axis_x, out.axis_y = wp.vec3(*source.axis_x), wp.vec3(*source.axis_y)
        out.half_x, out.half_y = source.half_x, source.half_y
        away = np.linalg.norm(np.subtract(camera.eye, camera.target))
        out.wire = 0.006 * away * np.tan(0.5 * np.radians(camera.fov)) * max(1.0, 640.0 / min(width, height))
    return out


def _splats(frame: ParticleFrame, data: dict[str, np.ndarray], camera: Camera, wired: bool, device) -> wp.array:
    """Patches of the particles, nearest to the eye first."""
    points = data["points"] - camera.target
    eye = np.subtract(camera.eye, camera.target)
    order = np.argsort(((points - eye) ** 2).sum(axis=1), kind="stable")
    spacing = _spacing(frame)

    def upload(name, dtype, kind):
        value = points if name == "points" else data[name]
        return wp.array(value[order].astype(kind), dtype=dtype, device=device)

    inputs = [
        upload("points", wp.vec3, np.float32),
        upload("normals", wp.vec3, np.float32),
        upload("thickness", wp.float32, np.float32),
        upload("region", wp.int32, np.int32),
    ]
    grid = wp.HashGrid(64, 64, 64, device=device)
    grid.build(inputs[0], 2.4 * spacing)
    splats = wp.empty(len(points), dtype=kernels.Splat, device=device)
    crowd = float(min(_CROWD, len(points)))
    launch(kernels.fit_splats, len(points), [grid.id, *inputs, spacing, crowd, wired], [splats], device)
    return splats


@lru_cache(maxsize=4)
def _color_table(index: float, device: str) -> wp.array:
    table = optics.color_table(_TABLE_NM, 2048, 64, index)
    return wp.array(table, dtype=wp.vec3, device=device)


def _table_of(colors: np.ndarray, device) -> wp.array:
    """Colours that are the same from all sides."""
    return wp.array(np.repeat(colors[:, None], 2, axis=1), dtype=wp.vec3, device=device)


def _blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur of [h, w, 3] by `sigma` pixels."""
    reach = max(1, int(3.0 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        padded = np.pad(image, [(reach, reach) if a == axis else (0, 0) for a in range(3)])
        length = image.shape[axis]
        image = sum(w * padded.take(range(k, k + length), axis=axis) for k, w in enumerate(weights.astype(np.float32)))
    return image


def save_image(image: np.ndarray, path: str | os.PathLike) -> None:
    """Write a picture [h, w, 3] uint8 in the format of the file's ending; a file of this name is replaced as a whole.

    Raises:
        InputError: `image` is not such a picture, or the ending is none of `FORMATS`.
        OSError: the file cannot be written.
    """
    image, kind = _checked_image(image), check_format(path)
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format=kind, **_QUALITY.get(kind, {}))


def check_format(path: str | os.PathLike) -> str:
    """Pillow's name of the format of a file, by its ending; `InputError` if there is none."""
    ending = Path(path).suffix.lower()
    require(ending in FORMATS, "picture", str(path), f"a file ending in {', '.join(FORMATS)}")
    return FORMATS[ending]


def _checked_image(image: object) -> np.ndarray:
    """`image` if it is a picture [h, w, 3] uint8."""
    ok = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3
    got = (image.shape, str(image.dtype)) if isinstance(image, np.ndarray) else type(image).__name__
    require(ok and image.size > 0, "image", got, "an array [h, w, 3] of uint8")
    return image


def contact_sheet(
    images: Sequence[np.ndarray], labels: Sequence[str] | None = None, columns: int | None = None
) -> np.ndarray:
    """Set pictures of one size in a grid, row by row.

    Args:
        images: pictures [h, w, 3] uint8.
        labels: a caption for each, such as its time; None for none.
        columns: pictures in a row; None for a nearly square sheet.

    Returns:
        [rows (h + gap) + gap, columns (w + gap) + gap, 3] uint8.

    Raises:
        InputError: no pictures, different sizes, or another number of labels.
    """
    images = [_checked_image(image) for image in images]
    require(len(images) > 0, "images", images, "at least one picture")
    for image in images:
        require(image.shape == images[0].shape, "images", image.shape, f"of one size, {images[0].shape}")
    require(labels is None or len(labels) == len(images), "labels", labels, f"{len(images)} captions")
    columns = int(np.ceil(np.sqrt(len(images)))) if columns is None else columns
    require(isinstance(columns, int) and columns >= 1, "columns", columns, "a whole number above 0")
    height, width = images[0].shape[:2]
    gap = max(2, width // 120)
    rows = -(-len(images) // columns)
    sheet = Image.new("RGB", (columns * (width + gap) + gap, rows * (height + gap) + gap), (24, 24, 27))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(max(9, height // 26))
    for k, image in enumerate(images):
        x, y = gap + (k % columns) * (width + gap), gap + (k // columns) * (height + gap)
        sheet.paste(Image.fromarray(image), (x, y))
        if labels is not None:
            inset = max(3, height // 40)
            draw.text((x + inset, y + height - inset), labels[k], (205, 205, 210), font, anchor="ls")
    return np.asarray(sheet)
