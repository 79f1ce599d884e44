"""Surface meshes: the E of each region as vertices of one closed, oriented triangle mesh; see docs/mesh.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
import warp as wp

from melp_warp.device.launch import Shared, launch, launch_rows
from melp_warp.errors import InputError
from melp_warp.frame import MeshFrame, ParticleFrame
from melp_warp.kernels import mesh as km
from melp_warp.kernels import subdivide as ks
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.stages.neighbors import GRID_CELLS, fixed_rows

DEVICE = "cpu"
"""Meshes are made where they are written from: closing holes is a task for one thread."""

REACH = 3.0
"""Distance within which the neighbours of a vertex are sought, spacings: cells are no wider."""

LIST_ROOM = 64
"""Neighbours that a vertex may have at first."""

RING_ROOM = 24
"""Neighbours that a vertex may have in the mesh."""

MOST_CORNERS = 40
"""Most corners of a hole that is filled. A wider one is the end of the film, whose rim nobody told."""

RIM_STEP = 0.8
"""Distance between rim points, spacings: E stay half a spacing away, so no E lies within a circle over two of them."""

CLOSE = 0.6
"""An E less than this far from the rim gets a rim point at its foot, if there is none as close to that, steps."""

CORNER = 0.35
"""Turn of a rim, rad, from which there is a rim point at it."""

NEAR, HOME = 0.8, 2.0
"""Distances within which the nearest vertex of an L is sought, spacings: the second where the first holds none."""

EVEN = 0.85
"""Least distance of the L that a mesh is made of, E spacings: as many as there are E fit with that."""

_FIELDS = [field.name for field in fields(ParticleFrame) if field.name not in ("origin", "carried")]

CURVE_POINTS = 17
"""Points of the rim from one rim point to the next."""

FOLDED = "triangles look inwards"
"""End of the line that tells of them: such a mesh is closed, and can be drawn."""

LEAST_PARTS, MOST_PARTS = 2, 32
"""Fewest and most parts of a triangle's edge: with 2 its middle is on the curved surface already."""


@dataclass
class Coarse:
    """The triangles between E and rim points.

    Attributes:
        x: [n] points, m; E first, in the order they came in, then rim points. On `DEVICE`, as all arrays of Warp here.
        normal: [n] outward unit normals.
        region: [n] index of the region, from 0 without gaps.
        rings: neighbours of each vertex.
        face: [f] corners, counterclockwise seen from outside.
        side: [f] number of the edge after each corner.
        edge: [m] ends, the lower one first.
        face_at: [entries of the rings] number of the triangle of a vertex, its neighbour and the next one, -1 for none.
        rim: rim points.
        left_out: [k] E that are no corner of any triangle.
        agreed: triangles that all three corners had in their stars.
        filled: sides of holes that were closed.
        flips: edges flipped beside them.
    """

    x: wp.array
    normal: wp.array
    region: np.ndarray
    rings: km.Rings
    face: wp.array
    side: wp.array
    edge: wp.array
    face_at: wp.array
    rim: Rim
    left_out: np.ndarray
    agreed: int
    filled: int
    flips: int


def make_meshes(
    e: ParticleFrame,
    lagrangian: ParticleFrame | None = None,
    rims: Sequence[np.ndarray] = (),
    triangles: int | None = None,
) -> tuple[dict[int, MeshFrame], list[str]]:
    """A mesh of each region.

    Args:
        e: the E; of a film with a rim, of one region.
        lagrangian: the L, whose liquid the mesh then has; None to take it from the E.
        rims: [k, 3] dense points along each rim of an open film, m, from the origin of `e`.
        triangles: how many there are to be in all, about; by default as many as L, and at least four times what lies
            between the E.

    Returns:
        Meshes by region, and what could not be closed, a line each with its region.
    """
    if not len(e.points):
        return {}, []
    wp.init()
    labels, region = np.unique(e.region, return_inverse=True)
    area = 0.25 * np.pi * e.widths.astype(np.float64) ** 2
    spacing = np.sqrt(np.bincount(region, area) / np.bincount(region))
    coarse = triangulate(e.points, e.normals, region, spacing, rims)
    wanted = triangles or (len(lagrangian.points) if lagrangian else 0)
    parts = round(np.sqrt(wanted / max(1, coarse.face.shape[0])))
    parts = int(np.clip(parts, 1 if triangles else LEAST_PARTS, MOST_PARTS))
    fine = _subdivide(coarse, e, parts)
    if lagrangian is not None and len(lagrangian.points):
        own = np.searchsorted(labels, lagrangian.region).clip(0, len(labels) - 1)
        own = np.where(labels[own] == lagrangian.region, own, -1)
        _take_liquid(coarse, fine, lagrangian, own, spacing)
    else:
        liquid = np.bincount(region, area * e.thickness)
        _scale(fine, liquid, len(labels))
    problems = _problems(coarse, labels)
    for k in np.flatnonzero(np.bincount(fine.of_face, fine.folded, minlength=len(labels))):
        problems.append(f"region {labels[k]}: {fine.folded[fine.of_face == k].sum()} {FOLDED}")
    return _split(coarse, fine, labels, e.origin), problems


def thin_out(many: ParticleFrame, l_per_e: int) -> ParticleFrame:
    """A part of the L, evenly spread, about as many as there were E: what a mesh is made of where E are not at hand."""
    regions, region = np.unique(many.region, return_inverse=True)
    area = 0.25 * np.pi * many.widths.astype(np.float64) ** 2
    own = np.bincount(region, area, minlength=len(regions))
    apart = EVEN * np.sqrt(max(l_per_e, 1) * own / np.maximum(np.bincount(region), 1))
    n = len(many.points)
    wp.init()
    kept = _zeros(n)
    if n:
        x = wp.array(many.points, dtype=wp.vec3, device=DEVICE)
        grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=DEVICE)
        grid.build(x, float(apart.max()))
        reach = wp.array(apart, dtype=wp.float32, device=DEVICE)
        normal = wp.array(many.normals, dtype=wp.vec3, device=DEVICE)
        launch(km.keep_apart_l, 1, [grid.id, x, normal, _ints(region), reach], [kept], DEVICE)
    few = np.flatnonzero(kept.numpy())
    share = own / np.maximum(np.bincount(region[few], minlength=len(regions)), 1)
    arrays = {name: getattr(many, name)[few] for name in _FIELDS}
    arrays["widths"] = np.sqrt(4.0 / np.pi * share[region[few]]).astype(np.float32)
    return ParticleFrame(**arrays, origin=many.origin)


def triangulate(
    points: np.ndarray,
    normals: np.ndarray,
    region: np.ndarray,
    spacing: np.ndarray,
    rims: Sequence[np.ndarray] = (),
) -> Coarse:
    """Mesh the sheets through points.

    Args:
        points: [n, 3] m.
        normals: [n, 3] outward unit normals.
        region: [n] index of the region of each, from 0 without gaps.
        spacing: [regions] mean distance between points, m.
        rims: [k, 3] dense points along each rim of a film of one region, m.
    """
    rim = Rim.around(points, normals, rims, RIM_STEP * float(spacing.max()))
    n_e, n = len(points), len(points) + len(rim.points)
    points, normals = np.concatenate([points, rim.points]), np.concatenate([normals, rim.normals])
    region = np.concatenate([region, np.zeros(n - n_e)]).astype(np.int32)
    x, normal = (wp.array(a, dtype=wp.vec3, device=DEVICE) for a in (points, normals))
    of, reach = _ints(region), wp.array(REACH * spacing, dtype=wp.float32, device=DEVICE)
    rows = _neighbors(x, normal, of, reach)
    star, nudged = fixed_rows(n, RING_ROOM, DEVICE), wp.empty_like(x)
    launch(km.nudge_v, n, [x, normal, of, reach, n_e], [nudged], DEVICE)
    launch(km.find_star_v, n, [nudged, normal, of, reach, rows], [star, _zeros(n * RING_ROOM, wp.float32)], DEVICE)
    if rims:
        launch(
            km.open_star_v,
            n - n_e,
            [nudged, normal, _ints(rim.ahead + n_e), _ints(rim.behind + n_e), _ints(rim.number + n), n_e],
            [star],
            DEVICE,
        )
        star = _with_caps(star, rim, n_e)
    return _close(x, normal, region, rim, rows, star)


def _close(x: wp.array, normal: wp.array, region: np.ndarray, rim: Rim, rows: Neighbors, star: Neighbors) -> Coarse:
    """From stars to a closed mesh; vertices after the n of the film close its rims."""
    n, total = x.shape[0], star.start.shape[0]
    agreed = _zeros(star.index.shape[0])
    launch(km.find_agreed_v, total, [star], [agreed], DEVICE)
    rings = km.Rings()
    rings.start, rings.count, rings.index = star.start, _zeros(total), _zeros(star.index.shape[0])
    rings.room = _ints(np.diff(np.append(star.start.numpy(), star.index.shape[0])))
    launch(km.keep_agreed_v, total, [star, agreed], [rings], DEVICE)
    regions = int(region.max(initial=-1)) + 1
    of = _ints(np.concatenate([region, np.zeros(total - n)]))
    launch(km.drop_pieces, 1, [of, _ints(np.full(regions, -1))], [rings, _zeros(total), _zeros(total)], DEVICE)
    opening, found = wp.zeros(max(64, total), dtype=wp.vec2i, device=DEVICE), _zeros(1)
    launch(km.find_open_v, 1, [rings], [opening, found], DEVICE)
    sides, touched, flips = min(int(found.numpy()[0]), opening.shape[0]), _zeros(total), _zeros(1)
    scratch = _zeros(MOST_CORNERS + 1)
    launch(km.fill_openings, 1, [opening, sides, x, normal, MOST_CORNERS], [rings, scratch, touched], DEVICE)
    launch(km.insert_missing, 1, [x, normal, rows, n], [rings, touched], DEVICE)
    launch(km.flip_edges, 1, [x, normal, n], [rings, touched, flips], DEVICE)
    faces, edges = _zeros(n), _zeros(n)
    launch(km.count_faces_v, n, [rings, n], [faces, edges], DEVICE)
    first = [np.concatenate([[0], np.cumsum(a.numpy())]) for a in (faces, edges)]
    face, side = (wp.zeros(int(first[0][-1]), dtype=wp.vec3i, device=DEVICE) for _ in range(2))
    edge = wp.zeros(int(first[1][-1]), dtype=wp.vec2i, device=DEVICE)
    starts = [_ints(a) for a in first]
    face_at = wp.full(rings.index.shape[0], -1, dtype=wp.int32, device=DEVICE)
    launch(km.list_faces_v, n, [rings, n, *starts], [face, side, edge, face_at], DEVICE)
    _check_faces(face.numpy(), side.numpy(), len(edge))
    return Coarse(
        x,
        normal,
        region,
        rings,
        face,
        side,
        edge,
        face_at,
        rim,
        left_out=np.flatnonzero(rings.count.numpy()[:n] == 0),
        agreed=int(agreed.numpy().sum()) // 3,
        filled=sides,
        flips=int(flips.numpy()[0]),
    )


def _check_faces(face: np.ndarray, side: np.ndarray, edges: int) -> None:
    """Refuse points without order, as of a cache from elsewhere, where triangles lack a corner or an edge."""
    corners = (face != np.roll(face, 1, axis=1)).all()
    if not corners or not ((side >= 0) & (side < edges)).all():
        raise InputError("no mesh can be laid through these E: they are on no surface")


def _neighbors(x: wp.array, normal: wp.array, region: wp.array, reach: wp.array) -> Neighbors:
    """The neighbours of each vertex in its sheet."""
    n, radius = x.shape[0], float(reach.numpy().max(initial=0.0))
    grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=DEVICE)
    grid.build(x, radius)
    room = LIST_ROOM
    while True:
        rows, most = fixed_rows(n, room, DEVICE), _zeros(1)
        launch(km.list_facing_v, n, [grid.id, x, normal, region, reach, room], [rows, most], DEVICE)
        wanted = int(most.numpy()[0])
        if wanted <= room:
            return rows
        room = wanted


@dataclass
class _Fine:
    """The subdivided mesh; lengths in m, `depth` the thickness in nm."""

    parts: int
    place: wp.array
    normal: wp.array
    velocity: wp.array
    depth: wp.array
    black: wp.array
    face: wp.array
    region: np.ndarray
    of_face: np.ndarray
    folded: np.ndarray


def _subdivide(coarse: Coarse, e: ParticleFrame, parts: int) -> _Fine:
    """Curved patches over the triangles, each edge cut into `parts`; velocities and thickness of the E between them."""
    n, n_e = coarse.x.shape[0], len(e.points)
    faces, edges = coarse.face.shape[0], coarse.edge.shape[0]
    inner = parts - 1
    total = n + edges * inner + faces * (inner * (inner - 1) // 2)
    edge = coarse.edge.numpy()
    u, eta, black = np.zeros((n, 3), np.float32), np.zeros(n, np.float32), np.zeros(n, np.int32)
    u[:n_e], eta[:n_e], black[:n_e] = e.velocities, e.thickness, e.black_film
    if n > n_e:
        eta[n_e:] = _beside(edge, eta, n_e, n)
    fine = _Fine(
        parts,
        *(wp.zeros(total, dtype=wp.vec3, device=DEVICE) for _ in range(3)),
        depth=_zeros(total, wp.float32),
        black=_zeros(total),
        face=wp.zeros(faces * parts * parts, dtype=wp.vec3i, device=DEVICE),
        region=np.concatenate([coarse.region, np.repeat(coarse.region[edge[:, 0]], inner), np.zeros(0, int)]),
        of_face=coarse.region[coarse.face.numpy()[:, 0]],
        folded=np.zeros(faces, int),
    )
    fine.region = np.concatenate([fine.region, np.repeat(fine.of_face, inner * (inner - 1) // 2)])
    given = [
        coarse.x,
        coarse.normal,
        wp.array(u, dtype=wp.vec3, device=DEVICE),
        wp.array(eta, dtype=wp.float32, device=DEVICE),
    ]
    made = [fine.place, fine.normal, fine.velocity, fine.depth]
    for target, source in zip(made, given, strict=True):
        wp.copy(target, source, count=n)
    wp.copy(fine.black, _ints(black), count=n)
    bend = wp.full(edges, 1.0, dtype=wp.float32, device=DEVICE)
    while True:
        launch(ks.place_on_edges_v, edges, [*given, coarse.edge, bend, parts], made, DEVICE)
        launch(ks.place_in_faces_v, faces, [*given, coarse.face, coarse.side, bend, parts], [*made, fine.face], DEVICE)
        if n > n_e and inner:
            _follow_rim(coarse, fine, edge, n_e)
        if not _straighten(coarse, fine, bend):
            return fine


def _straighten(coarse: Coarse, fine: _Fine, bend: wp.array) -> bool:
    """Make the edges of patches straight that fold over, as in sharp corners; whether there were any to straighten."""
    folded = _zeros(coarse.face.shape[0])
    given = [fine.place, fine.normal, fine.face, fine.parts**2]
    launch(ks.find_folded_v, folded.shape[0], given, [folded], DEVICE)
    found, straight = folded.numpy(), bend.numpy()
    fine.folded = found
    sides = np.unique(coarse.side.numpy()[found > 0])
    if not straight[sides].any():
        return False
    straight[sides] = 0.0
    bend.assign(straight)
    return True


def _beside(edge: np.ndarray, values: np.ndarray, n_e: int, n: int) -> np.ndarray:
    """Mean of what E have that share an edge with each rim point."""
    total, count = np.zeros(n), np.zeros(n)
    across = edge[(edge[:, 0] < n_e) & (edge[:, 1] >= n_e)]
    np.add.at(total, across[:, 1], values[across[:, 0]])
    np.add.at(count, across[:, 1], 1.0)
    return (total / np.maximum(count, 1.0))[n_e:]


def _follow_rim(coarse: Coarse, fine: _Fine, edge: np.ndarray, n_e: int) -> None:
    """Put the vertices between rim points onto the rim."""
    inner = fine.parts - 1
    place = fine.place.numpy()
    along = np.flatnonzero(edge[:, 0] >= n_e)
    number = {tuple(ends): k for k, ends in zip(along.tolist(), edge[along].tolist(), strict=True)}
    between = coarse.rim.between(fine.parts)
    for k, ahead in enumerate(coarse.rim.ahead):
        ends = (n_e + k, n_e + int(ahead))
        found = number.get(ends, number.get(ends[::-1]))
        if found is None:
            continue
        first = len(coarse.region) + found * inner
        place[first : first + inner] = between[k] if ends[0] < ends[1] else between[k, ::-1]
    fine.place.assign(place)


def _take_liquid(coarse: Coarse, fine: _Fine, lagrangian: ParticleFrame, own: np.ndarray, spacing: np.ndarray) -> None:
    """Thickness and black film of the L: volume over area of those around, scaled to the liquid of each region."""
    n, n_l = coarse.x.shape[0], len(lagrangian.points)
    grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=DEVICE)
    near, radius = NEAR * float(spacing.max()), HOME * float(spacing.max())
    grid.build(coarse.x, radius)
    point, side = (wp.array(a, dtype=wp.vec3, device=DEVICE) for a in (lagrangian.points, lagrangian.normals))
    area = 0.25 * np.pi * lagrangian.widths.astype(np.float64) ** 2
    volume = area * lagrangian.thickness
    home, lies_in, share = _zeros(n_l), _zeros(n_l), wp.zeros(n_l, dtype=wp.vec3, device=DEVICE)
    shared = [Shared(coarse.x), Shared(coarse.normal), Shared(_ints(coarse.region)), coarse.rings]
    launch_rows(ks.find_home_l, n_l, [grid.id, *shared, point, side, _ints(own), near, radius], [home], DEVICE)
    slope = wp.empty((coarse.face.shape[0], 2), dtype=wp.vec3, device=DEVICE)
    launch(ks.slope_faces_v, slope.shape[0], [coarse.x, coarse.face], [slope], DEVICE)
    faces = [Shared(a) for a in (coarse.face_at, coarse.face, slope)]
    given = [Shared(coarse.x), coarse.rings, *faces, point, home]
    launch_rows(ks.find_face_l, n_l, given, [lies_in, share], DEVICE)
    floats = [wp.array(a, dtype=wp.float32, device=DEVICE) for a in (volume, area, lagrangian.black_film)]
    sums, wider = (wp.zeros(fine.place.shape[0], dtype=wp.vec3, device=DEVICE) for _ in range(2))
    counts = [n, coarse.edge.shape[0], fine.parts]
    launch(ks.spread_liquid, 1, [coarse.face, coarse.side, *counts, lies_in, share, *floats], [sums], DEVICE)
    launch(ks.spread_sums, 1, [fine.face, sums], [wider], DEVICE)
    least = 1e-3 * float(area.mean())
    launch(ks.mean_depth_v, wider.shape[0], [wider, least], [fine.depth, fine.black], DEVICE)
    regions = len(spacing)
    _scale(fine, np.bincount(own[own >= 0], volume[own >= 0], minlength=regions), regions)


def _scale(fine: _Fine, liquid: np.ndarray, regions: int) -> None:
    """Scale the thickness of each region such that its integral is its liquid, nm m^2."""
    area = _zeros(fine.place.shape[0], wp.float32)
    launch(ks.spread_area, 1, [fine.face, fine.place], [area], DEVICE)
    depth = fine.depth.numpy()
    held = np.bincount(fine.region, area.numpy().astype(np.float64) * depth, minlength=regions)
    factor = np.divide(liquid, held, out=np.ones(regions), where=held > 0.0)
    fine.depth.assign(depth * factor[fine.region])


def _split(coarse: Coarse, fine: _Fine, labels: np.ndarray, origin) -> dict[int, MeshFrame]:
    """The mesh of each region, its E first."""
    floats = [a.numpy().astype(np.float32) for a in (fine.place, fine.velocity, fine.normal, fine.depth)]
    arrays = [*floats, fine.black.numpy()]
    faces = fine.face.numpy()
    of_face = np.repeat(fine.of_face, fine.parts**2)
    meshes = {}
    for k, label in enumerate(labels.tolist()):
        mine = np.flatnonzero(fine.region == k) if len(labels) > 1 else slice(None)
        corners = faces
        if len(labels) > 1:
            number = np.zeros(len(fine.region), np.int32)
            number[mine] = np.arange(len(mine), dtype=np.int32)
            corners = number[faces[of_face == k]]
        meshes[label] = MeshFrame(*(a[mine] for a in arrays), corners, origin)
    return meshes


def _problems(coarse: Coarse, labels: np.ndarray) -> list[str]:
    """What is not closed."""
    faces, edge, n = coarse.face.numpy(), coarse.edge.numpy(), len(coarse.region)
    count = len(labels)
    euler = (
        np.bincount(coarse.region, minlength=count)
        - np.bincount(coarse.region[coarse.left_out], minlength=count)
        - np.bincount(coarse.region[edge[:, 0]], minlength=count)
        + np.bincount(coarse.region[faces[:, 0]], minlength=count)
    )
    euler[0] += coarse.rim.count
    problems = []
    x = coarse.x.numpy()
    for k in np.flatnonzero(euler != 2):
        problems.append(f"region {labels[k]}: the mesh is no sphere, its Euler number is {euler[k]}")
    for i in coarse.left_out[:3]:
        problems.append(f"region {labels[coarse.region[i]]}: E {i} at {_at(x[i])} m is not in the mesh")
    for loop in _holes(coarse, faces, n):
        where = labels[coarse.region[loop[0]]]
        problems.append(f"region {where}: a hole of {len(loop)} corners at {_at(x[loop].mean(axis=0))} m")
    return problems


def _at(p: np.ndarray) -> str:
    return "(" + ", ".join(f"{c:.4g}" for c in p) + ")"


def _holes(coarse: Coarse, faces: np.ndarray, n: int) -> list[list[int]]:
    """Corners of what is open, but for the rims."""
    if 2 * coarse.edge.shape[0] - 3 * len(faces) == len(coarse.rim.points):  # each other edge has two faces
        return []
    ends = np.concatenate([faces, np.roll(faces, -1, axis=1)], axis=0).reshape(2, -1).T.astype(np.int64)
    key, back = ends[:, 0] * n + ends[:, 1], ends[:, 1] * n + ends[:, 0]
    n_e = n - len(coarse.rim.points)
    k = np.arange(n_e, n, dtype=np.int64)
    rim = k * n + n_e + coarse.rim.ahead
    bare = np.setdiff1d(np.setdiff1d(back, key), (rim % n) * n + rim // n)
    following = dict(zip((bare // n).tolist(), (bare % n).tolist(), strict=True))
    loops = []
    while following:
        start = next(iter(following))
        loop, at = [], start
        while at in following:
            loop.append(at)
            at = following.pop(at)
        loops.append(loop)
    return loops


@dataclass
class Rim:
    """Points of all rims, one after the other, and the neighbours of each along its rim, by number.

    Attributes:
        points: [n, 3] m.
        normals: [n, 3] of the film there.
        ahead: [n] the next one, with the film on the left.
        behind: [n] the one before.
        number: [n] its rim.
        count: rims.
        curve: [n, k, 3] dense points from each to the next, m.
    """

    points: np.ndarray
    normals: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray
    number: np.ndarray
    count: int
    curve: np.ndarray

    @classmethod
    def around(cls, points: np.ndarray, normals: np.ndarray, rims: Sequence[np.ndarray], step: float) -> Rim:
        """Rim points about `step` (m) apart, with normals as the film has them there."""
        nothing = np.zeros(0, int)
        made, first = [[np.zeros((0, 3)), np.zeros((0, 3)), *[nothing] * 3, np.zeros((0, CURVE_POINTS, 3))]], 0
        for number, dense in enumerate(rims):
            dense = np.asarray(dense, dtype=np.float64)
            rim, curve = _resample(dense, *_feet(points, dense, step), step)
            nearest = _nearest(points, rim, 4.0 * step)
            along = np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0)
            inward = points[nearest] - rim
            if np.einsum("ij,ij->", np.cross(along, inward), normals[nearest]) < 0.0:
                rim, nearest, along, inward = rim[::-1], nearest[::-1], -along[::-1], inward[::-1]
                curve = np.concatenate([curve[-2::-1], curve[-1:]])[:, ::-1]
            n = _rim_normals(normals[nearest], inward, along)
            k = np.arange(len(rim))
            number_of = np.full(len(rim), number)
            made.append([rim, n, first + np.roll(k, -1), first + np.roll(k, 1), number_of, curve])
            first += len(rim)
        arrays = [np.concatenate(parts) for parts in zip(*made, strict=True)]
        return cls(*arrays[:5], len(rims), arrays[5])

    def between(self, parts: int) -> np.ndarray:
        """Points that cut the rim from each point to the next into equal parts, [n, parts - 1, 3]."""
        size = np.linalg.norm(np.diff(self.curve, axis=1), axis=2)
        length = np.concatenate([np.zeros((len(size), 1)), np.cumsum(size, axis=1)], axis=1)
        wanted = length[:, -1:] * np.arange(1, parts) / parts
        at = (length[:, 1:-1, None] <= wanted[:, None]).sum(axis=1)
        rows = np.arange(len(size))[:, None]
        t = ((wanted - length[rows, at]) / np.maximum(size[rows, at], 1e-300))[..., None]
        return (1.0 - t) * self.curve[rows, at] + t * self.curve[rows, at + 1]


def _nearest(source: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """[n] the nearest source of each point, -1 where none is within `radius`."""
    grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=DEVICE)
    source, points = (wp.array(a, dtype=wp.vec3, device=DEVICE) for a in (source, points))
    grid.build(source, radius)
    nearest = _zeros(points.shape[0])
    launch(km.find_nearest_v, points.shape[0], [grid.id, source, points, radius], [nearest], DEVICE)
    return nearest.numpy()


def _feet(points: np.ndarray, dense: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Place along a closed curve, m, and distance of the points that are less than a step from it, nearest first."""
    ahead = np.roll(dense, -1, axis=0) - dense
    size = np.linalg.norm(ahead, axis=1)
    length = np.cumsum(size) - size
    nearest = _nearest(dense, points, step + float(size.max()))
    near = np.flatnonzero(nearest >= 0)
    at = nearest[near]
    offset = points[near] - dense[at]
    forward, back = ahead[at] / size[at, None], ahead[at - 1] / size[at - 1, None]
    along = np.maximum(np.sum(offset * forward, axis=1), 0.0) + np.minimum(np.sum(offset * back, axis=1), 0.0)
    order = np.argsort(np.linalg.norm(offset, axis=1), kind="stable")
    return (length[at] + along)[order] % size.sum(), np.linalg.norm(offset, axis=1)[order]


def _rim_normals(normals: np.ndarray, inward: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Normals at a rim from those of the E beside it: on a circle through both the one mirrors the other."""
    chord = inward / np.linalg.norm(inward, axis=1, keepdims=True)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    n = normals - 2.0 * np.sum(normals * chord, axis=1, keepdims=True) * chord
    n = n - np.sum(n * along, axis=1, keepdims=True) * along
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def _resample(dense: np.ndarray, feet: np.ndarray, distance: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of a closed curve about `step` apart, and the curve from each to the next, [n, k, 3].

    Among them are the corners of the curve and the feet of the E beside it, so that no E lies within a circle over two
    rim points that follow each other.
    """
    closed = np.concatenate([dense, dense[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    whole = length[-1]
    kept = length[:-1][_turns(dense) > CORNER].tolist()
    for foot in feet[distance < CLOSE * step].tolist():
        gaps = np.abs(np.array(kept) - foot)
        if not kept or np.minimum(gaps, whole - gaps).min() > CLOSE * step:
            kept.append(foot)
    kept = sorted(kept) or [0.0]
    places = []
    for first, last in pairwise([*kept, kept[0] + whole]):
        count = max(1 if len(kept) > 2 else 3, round((last - first) / step))
        places += [first + (last - first) * k / count for k in range(count)]
    places = np.array(places)
    ends = np.append(places[1:], places[0] + whole)

    def at(s):
        return np.stack([np.interp(s % whole, length, closed[:, axis]) for axis in range(3)], axis=-1)

    return at(places), at(np.linspace(places, ends, CURVE_POINTS, axis=1))


def _turns(dense: np.ndarray) -> np.ndarray:
    """Angle by which a closed curve turns at each of its points, rad."""
    ahead = np.roll(dense, -1, axis=0) - dense
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.arccos(np.clip(np.sum(ahead * np.roll(ahead, 1, axis=0), axis=1), -1.0, 1.0))


def _with_caps(star: Neighbors, rim: Rim, n_e: int) -> Neighbors:
    """The stars and, for each rim, that of the vertex that closes the mesh beyond it: the rim the other way round."""
    loops = [n_e + np.flatnonzero(rim.number == k)[::-1] for k in range(rim.count)]
    starts, stops, index = star.start.numpy(), star.stop.numpy(), star.index.numpy()
    capped = Neighbors()
    ends = len(index) + np.cumsum([len(loop) for loop in loops])
    capped.start = _ints(np.concatenate([starts, ends - [len(loop) for loop in loops]]))
    capped.stop = _ints(np.concatenate([stops, ends]))
    capped.index = _ints(np.concatenate([index, *loops]))
    return capped


def _ints(values) -> wp.array:
    return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=DEVICE)


def _zeros(n: int, dtype=wp.int32) -> wp.array:
    return wp.zeros(n, dtype=dtype, device=DEVICE)
