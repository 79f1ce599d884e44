"""What a picture of meshes shows: the films, the borders where they meet, the wires that hold them, floors.

`draw` gives the radiance of each sample; preview.py makes a picture of it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import warp as wp
from PIL import Image

from melp_warp import optics
from melp_warp.device.launch import launch
from melp_warp.errors import InputError, require
from melp_warp.frame import MeshFrame, ParticleFrame, WholeFrame
from melp_warp.kernels import raster as kr
from melp_warp.kernels import tiles

SPLIT = (0.012, 0.05)
"""Two sheets part where they are farther from one another than this, over the radius of a bubble: at least and at most,
and `LOOSE` times what is usual within walls, as few E leave the two sheets apart."""

LOOSE = 4.0
NEAR = 0.06
"""Vertices nearer than this to another sheet are within walls for the most part, likewise."""

WALL = 0.02
"""They are not if this is not usual: bubbles that come near but do not touch."""

TOUCH = 2.0
"""Two sheets nearer than this are one film, over where they part; from half of it on the two pictures blend."""

BORDER = 0.008
"""Radius of a border, likewise."""

EVENED = 0.08
"""Borders are smoothed over this length, likewise."""

WIRE = 0.011
"""Diameter of a wire over the size of what is seen."""

MOST_POINTS = 1000
"""Points that a border is smoothed by."""

LIGHT_SIZE = 1024
"""Cells along a side of the table of a light."""

LIGHTS = {"white": kr.WHITE, "studio": kr.STUDIO, "panel": kr.PANEL, "sky": kr.SKY}
GROUNDS = ("dark", "light", "around")


@dataclass
class Surface:
    """A film at one instant, to be drawn.

    Attributes:
        meshes: by region, or by film where `lines` are given; empty ones are left out.
        rims: points [k, 3] along each wire, m, closed.
        floors: point and normal, into the room, of each plate, m.
        lines: ends [k, 2, 3] of the pieces of all borders, m, and the radius of the smallest bubble there [k], m; None
            to find them, and to take sheets that touch for one film.
        beads, drops: free rims and drops as a cache stores them; None for none.
    """

    meshes: Mapping[int, MeshFrame]
    rims: Sequence[np.ndarray] = ()
    floors: Sequence[tuple[Sequence[float], Sequence[float]]] = ()
    lines: tuple[np.ndarray, np.ndarray] | None = None
    beads: ParticleFrame | None = None
    drops: ParticleFrame | None = None
    points: np.ndarray = field(init=False)
    normals: np.ndarray = field(init=False)
    thickness: np.ndarray = field(init=False)
    faces: np.ndarray = field(init=False)
    region: np.ndarray = field(init=False)

    def __post_init__(self):
        kept = [mesh for _, mesh in sorted(self.meshes.items()) if len(mesh.faces)]
        none = MeshFrame.empty()
        first = np.cumsum([0, *(len(mesh.points) for mesh in kept)])
        self.points = np.concatenate([none.points, *(mesh.points for mesh in kept)])
        self.normals = np.concatenate([none.normals, *(mesh.normals for mesh in kept)])
        self.thickness = np.concatenate([none.thickness, *(mesh.thickness for mesh in kept)])
        self.faces = np.concatenate(
            [none.faces, *(mesh.faces + at for mesh, at in zip(kept, first[:-1], strict=True))], dtype=np.int32
        )
        self.region = np.repeat(np.arange(len(kept), dtype=np.int32), np.diff(first))

    @classmethod
    def of_whole(cls, whole: WholeFrame, rims: Sequence[np.ndarray] = (), floors: Sequence[tuple] = ()) -> Surface:
        """The films of one mesh of a whole foam, and the borders that three of them share."""
        films, which = np.unique(whole.inside * (whole.outside.max(initial=0) + 2) + whole.outside, return_inverse=True)
        corner, meshes = np.arange(3 * len(whole.faces)).reshape(-1, 3), {}
        for film in range(len(films)):
            mine = which == film
            used, first, at = np.unique(whole.faces[mine], return_index=True, return_inverse=True)
            some = corner[mine].reshape(-1)[first]
            carried = whole.normals[some], whole.thickness[some], whole.black_film[some]
            arrays = whole.points[used], whole.velocities[used], *carried, at.reshape(-1, 3).astype(np.int32)
            meshes[film] = MeshFrame(*arrays, whole.origin)
        return cls(meshes, rims, floors, _shared_edges(whole))

    @property
    def regions(self) -> int:
        """Bubbles that are there."""
        return int(self.region.max(initial=-1)) + 1

    def radii(self) -> np.ndarray:
        """[regions] radius of a sphere of each region's area, m."""
        a, b, c = (self.points.astype(np.float64)[self.faces[:, k]] for k in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return np.sqrt(np.bincount(self.region[self.faces[:, 0]], area, minlength=self.regions) / (4.0 * np.pi))


def threads(liquid: ParticleFrame | None, joined: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Ends [k, 2, 3] (m) and radii [k] (m) of pieces of rims from bead to bead, or of drops as pieces of no length."""
    if liquid is None or not len(liquid.points):
        return np.zeros((0, 2, 3)), np.zeros(0)
    x, radius = liquid.points.astype(np.float64), 0.5 * liquid.widths.astype(np.float64)
    if not joined:
        return np.stack([x, x], axis=1), radius
    after = next_beads(liquid)
    here = np.flatnonzero(after >= 0)
    return np.stack([x[here], x[after[here]]], axis=1), radius[here]


def next_beads(beads: ParticleFrame) -> np.ndarray:
    """[n] the bead that follows each one along its rim; -1 after the last of a rim that is not closed."""
    n, rim = len(beads.points), beads.region
    after = np.arange(1, n + 1)
    last = np.flatnonzero(np.append(rim[1:] != rim[:-1], True))
    first = np.concatenate([[0], last[:-1] + 1])
    x = beads.points.astype(np.float64)
    step = np.linalg.norm(x[np.minimum(first + 1, n - 1)] - x[first], axis=1)
    closed = np.linalg.norm(x[first] - x[last], axis=1) < 2.0 * step
    after[last] = np.where(closed, first, -1)
    return after


def _shared_edges(whole: WholeFrame) -> tuple[np.ndarray, np.ndarray]:
    """Edges of three films [k, 2, 3], m, and the radius of a sphere of the area of the smallest bubble there [k], m."""
    faces = whole.faces
    n, other = len(whole.points), np.roll(faces, -1, axis=1)
    key = np.minimum(faces, other).astype(np.int64) * n + np.maximum(faces, other)
    key, which, times = np.unique(key, return_inverse=True, return_counts=True)
    a, b, c = (whole.points.astype(np.float64)[faces[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    many = 2 + int(max(whole.inside.max(initial=0), whole.outside.max(initial=0)))
    held = sum(np.bincount(side + 1, area, minlength=many)[1:] for side in (whole.inside, whole.outside))
    radius = np.append(np.sqrt(held / (4.0 * np.pi)), np.inf)  # the last one for -1
    least = np.full(len(key), np.inf)
    smaller = np.minimum(radius[whole.inside], radius[whole.outside])
    np.minimum.at(least, which.reshape(-1), np.repeat(smaller, 3))
    ends = np.stack([key // max(n, 1), key % max(n, 1)], axis=1)[times == 3]
    return whole.points.astype(np.float64)[ends], least[times == 3]


def borders(surface: Surface, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Lines along which films meet.

    A vertex is next to the region whose surface is nearest, or to the outside where none is near; a border runs where
    that changes.

    Args:
        surface: the films.
        radii: [regions] m.

    Returns:
        Ends of pieces of line [k, 2, 3], m, their radius [k], m, and where sheets part, over the radius of a bubble.
    """
    if surface.lines is not None:
        ends, size = surface.lines
        return ends.astype(np.float32), (BORDER * size).astype(np.float32), 0.0
    if surface.regions < 2:
        return np.zeros((0, 2, 3), np.float32), np.zeros(0, np.float32), SPLIT[0]
    other, gap = _neighbors(surface, radii)
    nearest = np.argmin(gap, axis=1)
    away = np.take_along_axis(gap, nearest[:, None], 1)[:, 0]
    relative = away / radii[surface.region]
    usual = float(np.median(relative[relative < NEAR])) if (relative < NEAR).any() else np.inf
    loose = float(np.clip(LOOSE * usual, *SPLIT)) if usual < WALL else SPLIT[0]
    split = loose * radii[surface.region]
    label = np.where(away < split, np.take_along_axis(other, nearest[:, None], 1)[:, 0], -1)
    lines, meeting = _isolines(surface, label, other, gap, split)
    size = np.where(meeting < 0, np.inf, radii[meeting]).min(axis=1, initial=np.inf)
    for key in np.unique(meeting, axis=0):
        same = np.flatnonzero((meeting == key).all(axis=1))
        lines[same] = _evened(lines[same].reshape(-1, 3), EVENED * size[same[0]]).reshape(-1, 2, 3)
    return lines.astype(np.float32), (BORDER * size).astype(np.float32), loose


def _neighbors(surface: Surface, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The other regions near each vertex [n, 3], -1 for none, and how far their surfaces are [n, 3], m."""
    n, owner = len(surface.points), surface.region[surface.faces[:, 0]]
    edge = np.linalg.norm(surface.points[surface.faces[:, 1]] - surface.points[surface.faces[:, 0]], axis=1)
    radius = float(max(2.0 * NEAR * np.median(radii), 2.5 * np.quantile(edge, 0.98)))
    point = wp.array(surface.points, dtype=wp.vec3, device="cpu")
    grid = wp.HashGrid(64, 64, 64, device="cpu")
    grid.build(point, radius)
    order = np.argsort(owner, kind="stable")
    corners = np.split(surface.faces[order], np.cumsum(np.bincount(owner, minlength=surface.regions))[:-1])
    made = [wp.Mesh(point, wp.array(one.reshape(-1), dtype=wp.int32, device="cpu")) for one in corners]
    ids = wp.array([mesh.id for mesh in made], dtype=wp.uint64, device="cpu")
    other, gap = wp.zeros(n, dtype=wp.vec3i, device="cpu"), wp.zeros(n, dtype=wp.vec3, device="cpu")
    region = wp.array(surface.region, dtype=wp.int32, device="cpu")
    launch(kr.find_near_v, n, [grid.id, point, region, ids, radius], [other, gap], "cpu")
    return other.numpy(), gap.numpy().astype(np.float64)


def _evened(points: np.ndarray, width: float) -> np.ndarray:
    """Points [k, 3] of one border, told by each of the films that meet there, put onto the line through those near."""
    source = points[:: -(-len(points) // MOST_POINTS)]
    made = []
    for some in np.array_split(points, -(-len(points) // 256)):
        weight = np.exp(-0.5 * ((some[:, None] - source[None]) ** 2).sum(axis=2) / width**2)
        weight /= weight.sum(axis=1, keepdims=True)
        middle = weight @ source
        spread = np.einsum("ij,jk,jl->ikl", weight, source, source) - np.einsum("ik,il->ikl", middle, middle)
        along = np.linalg.eigh(spread)[1][:, :, 2]
        made.append(middle + along * np.einsum("ij,ij->i", some - middle, along)[:, None])
    return np.concatenate(made)


def _isolines(surface: Surface, label, other, gap, split) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of line [k, 2, 3] across triangles whose corners are next to different regions, and who meets [k, 3]."""

    def distance(vertex, to):
        """From vertices to regions; the outside is `split` away from everywhere."""
        hit = other[vertex] == to[:, None]
        found = np.where(hit.any(axis=1), np.where(hit, gap[vertex], np.inf).min(axis=1), gap[vertex].max(axis=1))
        return np.where(to < 0, split[vertex], found)

    corners = surface.faces[np.ptp(label[surface.faces], axis=1) > 0]
    crossing, parted = [], []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        i, j = corners[:, a], corners[:, b]
        here = distance(i, label[j]) - distance(i, label[i])
        there = distance(j, label[i]) - distance(j, label[j])
        t = np.clip(here / np.maximum(here + there, 1e-30), 0.02, 0.98)[:, None]
        crossing.append((1.0 - t) * surface.points[i] + t * surface.points[j])
        parted.append(label[i] != label[j])
    crossing, parted = np.stack(crossing, axis=1), np.stack(parted, axis=1)
    middle = (crossing * parted[..., None]).sum(axis=1) / np.maximum(parted.sum(axis=1), 1)[:, None]
    whole = parted.all(axis=1)
    two = np.argsort(~parted[~whole], axis=1, kind="stable")[:, :2]
    pairs = np.take_along_axis(crossing[~whole], two[..., None], 1)
    stars = np.stack([crossing[whole], np.broadcast_to(middle[whole][:, None], crossing[whole].shape)], axis=2)
    owner, near = surface.region[corners[:, 0]], label[corners]
    sides = np.stack([near, np.roll(near, -1, axis=1), np.broadcast_to(owner[:, None], near.shape)], axis=2)
    meeting = np.concatenate([sides[~whole][np.arange(len(two)), two[:, 0]], sides[whole].reshape(-1, 3)])
    return np.concatenate([pairs, stars.reshape(-1, 2, 3)]).astype(np.float64), np.sort(meeting, axis=1)


def load_light(path: str | Path) -> np.ndarray:
    """A light from all directions in a picture, left to right once around and top to bottom: PNG, JPEG and so on.

    Returns:
        [h, w, 3] linear radiance, 1 for white.

    Raises:
        InputError: there is no such picture.
    """
    try:
        with Image.open(path) as picture:
            picture.draft("RGB", (2048, 1024))
            values = np.asarray(picture.convert("RGB"), dtype=np.float32) / 255.0
    except Exception as error:  # Pillow raises a dozen kinds on damaged files
        raise InputError(f"environment {path} cannot be read: {' '.join(str(error).split())}") from None
    return _linear(values)


@lru_cache(maxsize=4)
def light_table(environment: str, device: str) -> wp.array:
    """Radiance from all directions, on the device; see `kernels.raster.bake_light`."""
    table = wp.zeros((LIGHT_SIZE, LIGHT_SIZE), dtype=wp.vec3, device=device)
    if environment in LIGHTS:
        launch(kr.bake_light, LIGHT_SIZE**2, [LIGHTS[environment]], [table], device)
        return table
    picture = load_light(environment)
    height, width = picture.shape[:2]
    u, v = np.meshgrid(*(2.0 * (np.arange(LIGHT_SIZE) + 0.5) / LIGHT_SIZE - 1.0,) * 2)
    z = 1.0 - np.abs(u) - np.abs(v)
    x = np.where(z < 0.0, (1.0 - np.abs(v)) * np.sign(u), u)
    y = np.where(z < 0.0, (1.0 - np.abs(u)) * np.sign(v), v)
    around = (np.arctan2(x, -z) / (2.0 * np.pi) + 0.5) * width
    down = np.arccos(y / np.sqrt(x * x + y * y + z * z)) / np.pi * height
    table.assign(picture[down.astype(int).clip(0, height - 1), around.astype(int) % width])
    return table


def check_light(environment: str) -> None:
    """`InputError` for a light that is neither a name nor a file."""
    known = environment in LIGHTS or Path(environment).is_file()
    require(known, "environment", environment, f"auto, {', '.join(LIGHTS)} or a picture file")


def ground_color(background: str) -> np.ndarray:
    """Radiance of a ground "light" or "#rrggbb" that looks like this colour; black for "dark" and "around".

    Raises:
        InputError: it is none of them.
    """
    if background in ("dark", "around"):
        return np.zeros(3)
    text = "e4e5e8" if background == "light" else background.removeprefix("#")
    ok = (background == "light" or background.startswith("#")) and len(text) == 6
    ok = ok and all(c in "0123456789abcdefABCDEF" for c in text)
    require(ok, "background", background, f"{', '.join(GROUNDS)} or #rrggbb")
    linear = _linear(np.array([int(text[k : k + 2], 16) for k in (0, 2, 4)]) / 255.0)
    low, high = np.zeros(3), np.full(3, 1e3)
    for _ in range(60):  # the film response has no inverse in closed form
        middle = 0.5 * (low + high)
        x = 0.62 * (0.91 * middle + 0.09 * middle.mean())
        above = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14) > linear
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return 0.5 * (low + high)


def _linear(encoded: np.ndarray) -> np.ndarray:
    """Of sRGB."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def draw(
    surface: Surface,
    view,
    target: np.ndarray,
    environment: str,
    background: str,
    gain: float,
    films: int,
    table,
    device,
) -> wp.array:
    """Radiance of each sample of a picture.

    Args:
        surface: what there is.
        view: `kernels.render.View`, relative to `target`.
        target: [3] m.
        environment: a name of `LIGHTS` or a picture file.
        background: "dark", "light", "around" (the light itself) or "#rrggbb".
        gain: on what films mirror.
        films: drawn behind one another at most.
        table: colours of films.
        device: Warp device.

    Returns:
        [rows, columns] vec3.
    """
    view.tile_columns = -(-view.columns // int(kr.TILE))
    radii = surface.radii()
    size = float(np.linalg.norm(np.ptp(surface.points, axis=0))) if len(surface.points) else 1.0
    look = _look(surface, view, environment, background, gain, films, size, target)
    lines, loose = _lines(surface, view, target, radii, size, environment != "white", device)
    seen = _seen(surface, view, target, TOUCH * loose * radii, device)
    boxes = wp.empty(seen.face.shape[0] + lines.radius.shape[0], dtype=wp.vec4i, device=device)
    launch(kr.box_seen, len(boxes), [view, look, seen, lines], [boxes], device)
    begins, ends, members = bin_tiles(boxes, view.tile_columns, -(-view.rows // int(kr.TILE)))
    floors = [
        wp.array(np.array(a, np.float32).reshape(-1, 3), dtype=wp.vec3, device=device)
        for a in ([np.subtract(p, target) for p, _ in surface.floors], [n for _, n in surface.floors])
    ]
    image = wp.empty((view.rows, view.columns), dtype=wp.vec3, device=device)
    inputs = [view, look, seen, lines, begins, ends, members, table, light_table(environment, str(device)), *floors]
    share(kr.draw_surfaces, len(begins) * int(kr.TILE) ** 2, inputs, [image], device)
    return image


def share(kernel: wp.Kernel, count: int, inputs: list, outputs: list, device) -> None:
    """Launch a kernel whose last input is its first thread; on a CPU in parts, on all cores."""
    workers = min(os.cpu_count() or 1, 16) if device.is_cpu else 1
    part = -(-count // (8 * workers)) if workers > 1 else count

    def launch_part(first):
        launch(kernel, min(part, count - first), [*inputs, first], outputs, device)

    starts = range(0, count, max(part, 1))
    if workers == 1:
        for first in starts:
            launch_part(first)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(launch_part, starts))


def _look(surface, view, environment, background, gain, films, size, target) -> kr.Look:
    look = kr.Look()
    look.gain, look.films, look.max_thickness = float(gain), films, optics.DISPLAY_MAX_THICKNESS
    look.ground = {"dark": kr.GLOW, "around": kr.AROUND}.get(background, kr.PLAIN)
    look.color = wp.vec3(*ground_color(background))
    look.world = int(environment not in ("white", "studio", "panel"))
    look.dim = 1.0 if background == "dark" else 0.25 * float(gain)
    if environment == "white":
        look.ground, look.color = kr.PLAIN, wp.vec3(0.0, 0.0, 0.0)
    look.scale = 0.5 * view.columns / view.slope_x
    look.thin = 0.75 * view.samples * max(1.0, min(view.rows, view.columns) / view.samples / 720.0)
    look.floors = 0 if environment == "white" else len(surface.floors)
    middle = 0.5 * (surface.points.min(axis=0) + surface.points.max(axis=0)) if len(surface.points) else target
    look.pool, look.reach = wp.vec3(*np.subtract(middle, target)), 0.5 * size
    return look


def _seen(surface: Surface, view, target: np.ndarray, touch: np.ndarray, device) -> kr.Surface:
    n = len(surface.points)
    seen = kr.Surface()
    seen.place, seen.nearness = (wp.empty(n, dtype=kind, device=device) for kind in (wp.vec2, wp.float32))
    seen.normal = wp.empty(n, dtype=wp.vec3, device=device)
    points = wp.array((surface.points - target).astype(np.float32), dtype=wp.vec3, device=device)
    normals = wp.array(surface.normals, dtype=wp.vec3, device=device)
    launch(kr.project_v, n, [view, points, normals], [seen.place, seen.nearness, seen.normal], device)
    seen.thickness = wp.array(surface.thickness, dtype=wp.float32, device=device)
    seen.face = wp.array(surface.faces, dtype=wp.vec3i, device=device)
    seen.region = wp.array(surface.region[surface.faces[:, 0]], dtype=wp.int32, device=device)
    seen.touch = wp.array(touch, dtype=wp.float32, device=device)
    return seen


def _lines(
    surface: Surface, view, target: np.ndarray, radii: np.ndarray, size: float, shown: bool, device
) -> tuple[kr.Lines, float]:
    ends, radius, loose = borders(surface, radii)
    if not shown:
        ends, radius = ends[:0], radius[:0]
    kind = np.full(len(ends), int(kr.BORDER))
    for rim in surface.rims if shown else ():
        ends = np.concatenate([ends, np.stack([rim, np.roll(rim, -1, axis=0)], axis=1)])
        radius = np.concatenate([radius, np.full(len(rim), 0.5 * WIRE * size)])
        kind = np.concatenate([kind, np.full(len(rim), int(kr.WIRE))])
    for more, thick in (threads(surface.beads), threads(surface.drops, joined=False)):
        ends, radius = np.concatenate([ends, more]), np.concatenate([radius, thick])
    kind = np.concatenate([kind, np.full(len(ends) - len(kind), int(kr.BORDER))])
    n = len(ends)
    lines = kr.Lines()
    lines.start, lines.stop = (wp.empty(n, dtype=wp.vec2, device=device) for _ in range(2))
    lines.near_start, lines.near_stop = (wp.empty(n, dtype=wp.float32, device=device) for _ in range(2))
    lines.radius = wp.array(radius, dtype=wp.float32, device=device)
    lines.kind = wp.array(kind, dtype=wp.int32, device=device)
    points = wp.array((ends - target).astype(np.float32).reshape(-1, 2, 3), dtype=wp.vec3, ndim=2, device=device)
    launch(kr.project_lines, n, [view, points], [lines], device)
    return lines, loose


def bin_tiles(boxes: wp.array, columns: int, rows: int) -> tuple[wp.array, wp.array, wp.array]:
    """For each of `columns` x `rows` tiles where what lies in it begins and ends in the list of members.

    Args:
        boxes: [n] vec4i, first and last tile column and first and last tile row of each thing.
        columns: tiles along a row of the picture.
        rows: rows of tiles.
    """
    n, device = len(boxes), boxes.device
    begins, tile_ends = (wp.zeros(columns * rows, dtype=wp.int32, device=device) for _ in range(2))
    counts = wp.zeros(max(n, 1), dtype=wp.int32, device=device)
    launch(tiles.count_tiles, n, [boxes], [counts], device)
    ends = wp.empty_like(counts)
    wp.utils.array_scan(counts, ends, inclusive=True)
    total = int(ends[-1:].numpy()[0])
    tile, members = (wp.empty(2 * total, dtype=wp.int32, device=device) for _ in range(2))
    if total > 0:
        launch(tiles.list_tiles, n, [boxes, columns, ends, counts], [tile, members], device)
        wp.utils.radix_sort_pairs(tile, members, total)
        launch(tiles.find_tile_ends, total, [tile[:total]], [begins, tile_ends], device)
    return begins, tile_ends, members
