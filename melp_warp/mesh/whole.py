"""One mesh of a whole foam: every partition once, borders shared by the three films that meet there; see docs/mesh.md.

Space is cut into tetrahedra (of a body-centred lattice). Each corner is in one region or outside. The mesh has a vertex
in each tetrahedron whose corners differ, and a polygon around each edge whose ends differ. A face of a tetrahedron is
an edge of the mesh: of two films where its corners are of two regions, of three where they are of three. So whatever
the corners are, an edge has two or three faces, and the faces around a region are a closed surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import warp as wp

from melp_warp.device.launch import launch_rows
from melp_warp.errors import require
from melp_warp.frame import BLACK_FILM, MeshFrame, ParticleFrame, WholeFrame
from melp_warp.kernels import whole as kw
from melp_warp.mesh.surfaces import DEVICE, FOLDED, make_meshes

OUT, MIXED = -1, -2

CELL = 0.8
"""Size of a cell of the lattice, spacings of E, unless a number of triangles is asked for."""

LARGEST_CELL = 2.0
"""Likewise, at most: coarser ones would miss whole films."""

SMALLEST_CELL = 0.05

TRIANGLES = 17.0
"""Triangles on a cell's face squared."""

ROUNDS = 8
"""Steps by which vertices come to where regions meet."""

EVENED = 4
"""Rounds that even the mesh out."""

MENDED = 6
"""Rounds that mend labels, at most."""

UNTANGLED = 40
"""Rounds that move vertices of flipped faces to their neighbours, at most."""

WIDER = 6
"""After as many rounds those next to them move, too."""

POCKET = 0.6
"""Air between sheets that nowhere leaves them farther apart is none, spacings."""

SMOOTHED = 10
"""Rounds that smooth normals next to borders."""

BENT = (1.0, 2.0)
"""Spacings from a border up to which a film's normal is that of its faces, and from which it is that of its sheets."""

FARTHEST = 10
"""Edges along which the distance from a border is told."""


def make_whole(
    e: ParticleFrame,
    lagrangian: ParticleFrame | None = None,
    rims: Sequence[np.ndarray] = (),
    triangles: int | None = None,
) -> tuple[WholeFrame, list[str]]:
    """One mesh of a whole foam, partitions once and borders shared; that of its only region where there is one.

    Args:
        e: the E.
        lagrangian: the L, whose liquid the mesh then has; None to take it from the E.
        rims: [k, 3] dense points along each rim of an open film, which is a single region, m, from the origin of `e`.
        triangles: how many there are to be, about; by default some 25 an E.

    Returns:
        The mesh, and what is not as it must be, a line each with its region.
    """
    alone = len(np.unique(e.region)) < 2
    meshes, problems = make_meshes(e, lagrangian, rims, triangles if alone else None)
    holes = [problem for problem in problems if alone or not problem.endswith(FOLDED)]
    whole, more = join_meshes(meshes, e, triangles, len(rims))
    return whole, holes + more


def join_meshes(
    meshes: Mapping[int, MeshFrame], e: ParticleFrame, triangles: int | None = None, rims: int = 0
) -> tuple[WholeFrame, list[str]]:
    """One mesh of all regions.

    Args:
        meshes: closed mesh of each region, as `make_meshes` gives them; that of a single one may be open.
        e: the E that they were made of.
        triangles: how many there are to be, about; by default some 25 an E.
        rims: how many rims the film has.

    Returns:
        The mesh, and what is not as it must be, a line each with its region.
    """
    from melp_warp.usd.check_surfaces import check_whole

    require(triangles is None or triangles > 0, "triangles", triangles, "above 0")
    labels = [label for label, mesh in sorted(meshes.items()) if len(mesh.faces)]
    kept = [meshes[label] for label in labels]
    if len(labels) < 2:
        return _alone(kept[0] if kept else MeshFrame.empty(e.origin), labels[0] if labels else 0), []
    spacing = _spacings(e, labels)
    made = [_on_device(mesh) for mesh in kept]
    skins, held = _skins(kept, made, spacing)
    size = _cell(kept, spacing, triangles)
    points = np.concatenate([mesh.points for mesh in kept])
    low = points.min(axis=0) - 0.37 * size  # no surface of rest lies along the lattice
    node, tets = _lattice(points, low, size)
    label = wp.zeros(len(node), dtype=wp.int32, device=DEVICE)
    place = low + 0.5 * size * node
    launch_rows(kw.find_labels_n, len(node), [skins, _vectors(place)], [label], DEVICE)
    label = _mended(label.numpy(), tets, place, skins)
    for _ in range(MENDED):
        mixed = tets[np.ptp(label[tets], axis=1) > 0]
        ring, length, sides, ends, problems = _rings(node, mixed, label)
        better = _without_tips(label, mixed, ring, length, ends)
        if better is None:
            break
        label = _mended(better, tets, place, skins)
    tets = mixed
    own, outside = _around(label[tets])
    film = sides[0] * (len(labels) + 1) + sides[1]
    x = _place(skins, own, outside, place[tets].mean(axis=1), ring, length, film, size)
    faces = _triangles(x, ring, length)
    inside_of, outside_of = (np.repeat(side, length - 2) for side in sides)
    whole = _carry(skins, own, x, faces, inside_of, outside_of, held, float(spacing.mean()), e.origin)
    names = np.array([*labels, OUT], np.int32)
    whole.inside, whole.outside = names[whole.inside], names[whole.outside]
    return whole, problems + check_whole(whole)


def _alone(mesh: MeshFrame, label: int) -> WholeFrame:
    """The mesh of the only region."""
    n = len(mesh.faces)
    at = mesh.faces.reshape(-1)
    return WholeFrame(
        mesh.points,
        mesh.velocities,
        mesh.normals[at],
        mesh.thickness[at],
        mesh.black_film[at],
        mesh.faces,
        np.full(n, label, np.int32),
        np.full(n, OUT, np.int32),
        mesh.origin,
    )


def _spacings(e: ParticleFrame, labels: list[int]) -> np.ndarray:
    """[regions] mean distance between the E of each region, m."""
    area = 0.25 * np.pi * e.widths.astype(np.float64) ** 2
    return np.array([np.sqrt(area[e.region == label].mean()) for label in labels])


def _on_device(mesh: MeshFrame) -> wp.Mesh:
    return wp.Mesh(_vectors(mesh.points), wp.array(mesh.faces.reshape(-1), dtype=wp.int32, device=DEVICE))


def _skins(kept: list[MeshFrame], made: list[wp.Mesh], spacing: np.ndarray) -> tuple[kw.Skins, np.ndarray]:
    """The regions' meshes, which must live as long, and the liquid of each, nm m^2."""
    skins = kw.Skins()
    skins.mesh = wp.array([m.id for m in made], dtype=wp.uint64, device=DEVICE)
    first = np.cumsum([0, *(len(m.points) for m in kept[:-1])])
    skins.begin = wp.array(first, dtype=wp.int32, device=DEVICE)
    skins.normal, skins.velocity = (
        _vectors(np.concatenate([getattr(m, name) for m in kept])) for name in ("normals", "velocities")
    )
    skins.thickness = wp.array(np.concatenate([m.thickness for m in kept]), dtype=wp.float32, device=DEVICE)
    skins.low, skins.high = (_vectors(np.array([edge(m.points, axis=0) for m in kept])) for edge in (np.min, np.max))
    skins.spacing = wp.array(spacing, dtype=wp.float32, device=DEVICE)
    held = [(_areas(m.points, m.faces) * m.thickness[m.faces].mean(axis=1, dtype=float)).sum() for m in kept]
    return skins, np.array(held)


def _cell(kept: list[MeshFrame], spacing: np.ndarray, triangles: int | None) -> float:
    """Size of a cell, m."""
    if triangles is None:
        return CELL * float(spacing.min())
    area = sum(_areas(m.points, m.faces).sum() for m in kept)
    wanted = np.sqrt(TRIANGLES * area / triangles)
    return float(np.clip(wanted, SMALLEST_CELL * spacing.min(), LARGEST_CELL * spacing.min()))


# --- the lattice -----------------------------------------------------------------------------------------------------


def _lattice(points: np.ndarray, low: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [n, 3] in half cells from `low`, and tetrahedra [t, 4], around all points.

    Centres of cells are odd, their corners even. Between two cells that share a face, four tetrahedra have both centres
    and an edge of the face.
    """
    cell = np.floor((points - low) / size).astype(np.int64) + 3
    count = cell.max(axis=0) + 4
    stride = np.array([count[1] * count[2], count[2], 1])
    key = np.unique(cell @ stride)
    for step in stride:
        key = np.unique(np.concatenate([key - step, key, key + step]))
    wide = 2 * count + 2
    half = np.array([wide[1] * wide[2], wide[2], 1])
    corners = []
    for axis in range(3):
        first = np.union1d(key, key - stride[axis])
        at = 2 * np.stack(np.unravel_index(first, count), axis=1) + 1
        centre = at @ half
        u, v = half[(axis + 1) % 3], half[(axis + 2) % 3]
        middle = centre + half[axis]
        around = [middle + u + v, middle - u + v, middle - u - v, middle + u - v]
        for k in range(4):
            corners.append(np.stack([centre, centre + 2 * half[axis], around[k], around[k - 3]], axis=1))
    node, tets = np.unique(np.concatenate(corners), return_inverse=True)
    return np.stack(np.unravel_index(node, wide), axis=1) - 6, tets.reshape(-1, 4).astype(np.int32)


def _mended(label: np.ndarray, tets: np.ndarray, place: np.ndarray, skins: kw.Skins) -> np.ndarray:
    """Labels without crumbs: each region is one piece, and there is no air in pockets between sheets that cling."""
    sides, _ = _sides(np.concatenate([tets[:, pair] for pair in combinations(range(4), 2)]), len(label))
    for _ in range(4):
        same = sides[label[sides[:, 0]] == label[sides[:, 1]]]
        piece = _pieces(same, len(label))
        roots, which, size = np.unique(piece, return_inverse=True, return_counts=True)
        kind = label[roots]
        largest = np.zeros(len(roots), bool)
        for k in np.unique(kind):
            mine = np.flatnonzero(kind == k)
            largest[mine[np.argmax(size[mine])]] = True
        crumb = ~largest
        for k in np.flatnonzero(crumb & (kind == OUT)):
            crumb[k] = _is_pocket(place[which == k], skins)
        if not crumb.any():
            return label
        label = _worn(label, crumb[which], sides)
    return label


def _sides(ends: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Edges [m, 2], the lower end first, each once, and how often each is among `ends` [k, 2]."""
    low, high = ends.min(axis=1).astype(np.int64), ends.max(axis=1)
    key, times = np.unique(low * n + high, return_counts=True)
    return np.stack([key // n, key % n], axis=1), times


def _pieces(sides: np.ndarray, n: int) -> np.ndarray:
    """[n] the lowest node that each is connected with by edges."""
    piece = np.arange(n)
    while True:
        lower = piece.copy()
        np.minimum.at(lower, sides[:, 0], piece[sides[:, 1]])
        np.minimum.at(lower, sides[:, 1], piece[sides[:, 0]])
        lower = lower[lower]
        if np.array_equal(lower, piece):
            return piece
        piece = lower


def _is_pocket(place: np.ndarray, skins: kw.Skins) -> bool:
    """Whether all of these points are next to sheets."""
    regions = skins.mesh.shape[0]
    away = wp.zeros(len(place), dtype=wp.float32, device=DEVICE)
    launch_rows(kw.find_away_n, len(place), [skins, _vectors(place)], [away], DEVICE)
    return regions > 0 and bool(away.numpy().max() < POCKET)


def _worn(label: np.ndarray, crumb: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Crumbs take the label that most of their neighbours have, from the outside inwards."""
    label = label.copy()
    while crumb.any():
        both = np.concatenate([sides, sides[:, ::-1]])
        both = both[crumb[both[:, 0]] & ~crumb[both[:, 1]]]
        if not len(both):
            break
        many = int(label.max()) + 2
        pairs, votes = np.unique(both[:, 0].astype(np.int64) * many + label[both[:, 1]] + 1, return_counts=True)
        pairs = pairs[np.argsort(votes, kind="stable")]
        label[pairs // many] = pairs % many - 1
        crumb = crumb.copy()
        crumb[both[:, 0]] = False
    return label


# --- faces -----------------------------------------------------------------------------------------------------------


def _rings(node: np.ndarray, tets: np.ndarray, label: np.ndarray):
    """The polygons: around each edge whose ends differ, the tetrahedra in order.

    Returns:
        Tetrahedra of all polygons one after the other, corners of each polygon, the index of the region that each
        polygon looks out of and of that it looks into (-1 for the outside), the nodes of its edge, and problems.
    """
    made = []
    for a, b in combinations(range(4), 2):
        ends = np.sort(tets[:, [a, b]], axis=1)
        mine = np.flatnonzero(label[ends[:, 0]] != label[ends[:, 1]])
        made.append(np.column_stack([ends[mine], mine]))
    start, stop, tet = np.concatenate(made).T
    along = node[stop] - node[start]
    least = np.eye(3, dtype=np.int64)[np.argmin(np.abs(along), axis=1)]
    u = np.cross(along, least).astype(float)
    v = np.cross(along, u)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    away = node[tets[tet]].sum(axis=1) / 4.0 - 0.5 * (node[start] + node[stop])
    turn = np.arctan2(np.einsum("ij,ij->i", away, v), np.einsum("ij,ij->i", away, u))
    edge = start.astype(np.int64) * len(node) + stop
    order = np.lexsort((turn, edge))
    first = np.flatnonzero(np.append(True, np.diff(edge[order]) > 0))
    length = np.diff(np.append(first, len(order)))
    a, b = label[start[order[first]]], label[stop[order[first]]]
    back = np.where(a == OUT, True, (b != OUT) & (b < a))
    ring, place = tet[order], np.arange(len(order)) - np.repeat(first, length)
    turned = np.repeat(first + length - 1, length) - place
    ring = np.where(np.repeat(back, length), ring[turned], ring)
    sides = np.where(back, b, a), np.where(back, a, b)
    whole = (length == 4) | (length == 6)
    problems = [] if whole.all() else [f"{(~whole).sum()} faces reach out of the lattice"]
    return ring, length, sides, np.stack([start[order[first]], stop[order[first]]], axis=1), problems


def _without_tips(label, tets, ring, length, ends) -> np.ndarray | None:
    """Labels without polygons all of whose corners lie on borders with the same third region; None if there are none.

    On a straight border they have no area. One end of the edge that such a polygon is around goes to the third region.
    """
    corners = label[tets[ring]]
    own = np.repeat(label[ends], length, axis=0)
    third = np.where((corners != own[:, :1]) & (corners != own[:, 1:]), corners, MIXED).max(axis=1)
    at = np.cumsum(length) - length
    other = (third == MIXED) | (third != np.repeat(third[at], length))
    tips = np.bincount(np.repeat(np.arange(len(length)), length), other, minlength=len(length)) == 0
    if not tips.any():
        return None
    better = label.copy()
    better[ends[tips, 0]] = third[at[tips]]
    return better


def _around(label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The regions around each tetrahedron [t, 4], -1 after the last, and whether the outside is there, [t] 0 or 1."""
    own = np.sort(label, axis=1)[:, ::-1]
    again = np.zeros(own.shape, bool)
    again[:, 1:] = own[:, 1:] == own[:, :-1]
    outside = (own == OUT).any(axis=1)
    own = np.sort(np.where(again | (own == OUT), np.iinfo(np.int32).max, own), axis=1)
    return np.where(own == np.iinfo(np.int32).max, -1, own).astype(np.int32), outside.astype(np.int32)


def _place(skins, own, outside, start, ring, length, film, size) -> np.ndarray:
    """Where the vertices are, [t, 3] m: onto films and borders, and evenly spread along them."""
    x = _vectors(start)
    labels, free = wp.array(own, dtype=wp.vec4i, device=DEVICE), wp.array(outside, dtype=wp.int32, device=DEVICE)
    launch_rows(kw.place_v, len(own), [skins, labels, free, 0.5 * size, ROUNDS], [x], DEVICE)
    first = np.cumsum(length) - length
    after = np.arange(len(ring)) + 1
    after[first + length - 1] = first
    sides, times = _sides(np.stack([ring, ring[after]], axis=1), len(own))
    kinds = (own >= 0).sum(axis=1) + outside
    ways = [(kinds == 2, sides), (kinds == 3, sides[times == 3]), (kinds == 4, sides[times == 3])]
    for _ in range(EVENED):
        x = _vectors(_evened(x.numpy(), ways[:2], np.ones(len(own), bool)))
        launch_rows(kw.draw_back_v, len(own), [skins, labels, free], [x], DEVICE)
    return _untangled(x.numpy(), ways, sides, ring, length, film)


def _untangled(x, ways, sides, ring, length, film) -> np.ndarray:
    """Vertices of faces that look away from their film, and those next to them, moved to their neighbours."""
    first = np.cumsum(length) - length
    at = np.repeat(np.arange(len(length)), length)
    watched, crowd = np.ones(len(length), bool), np.zeros(len(x), bool)
    for turn in range(UNTANGLED):
        some = np.flatnonzero(watched)
        entries = np.repeat(first[some], length[some]) + np.arange(length[some].sum())
        entries -= np.repeat(np.cumsum(length[some]) - length[some], length[some])
        faces = _triangles(x, ring[entries], length[some])
        wrong = _flipped(x, faces, np.repeat(film[some], length[some] - 2))
        if not wrong.any():
            break
        crowd[faces[wrong]] = True
        if turn % WIDER == 0:
            crowd[sides[crowd[sides].any(axis=1)]] = True
        x = _evened(x, ways, crowd).astype(np.float32)
        # the polygons around them, and those next to these, by which normals are told
        near = crowd.copy()
        for _ in range(2):
            watched = np.bincount(at, near[ring], minlength=len(length)) > 0
            near[ring[watched[at]]] = True
    return x


def _evened(x: np.ndarray, ways: list[tuple[np.ndarray, np.ndarray]], some: np.ndarray) -> np.ndarray:
    """Vertices moved half way to the mean of their neighbours; those on borders along these."""
    moved = x.astype(np.float64)
    for mine, sides in ways:
        mine = mine & some
        moved[mine] = 0.5 * (x + _means(x, sides))[mine]
    return moved


def _means(x: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Mean of the neighbours of each vertex."""
    a, b = np.concatenate([sides, sides[:, ::-1]]).T
    count = np.maximum(np.bincount(a, minlength=len(x)), 1)
    return np.stack([np.bincount(a, x[b, axis], minlength=len(x)) / count for axis in range(3)], axis=1)


def _fans(corners: int) -> np.ndarray:
    """All ways to cut a polygon into triangles, [ways, corners - 2, 3]."""

    def ways(first: int, last: int) -> list[list[tuple[int, int, int]]]:
        if last - first < 2:
            return [[]]
        return [
            [*one, (first, k, last), *two]
            for k in range(first + 1, last)
            for one in ways(first, k)
            for two in ways(k, last)
        ]

    return np.array(ways(0, corners - 1))


def _triangles(x: np.ndarray, ring: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Triangles of polygons with four or six corners, polygon by polygon: of all ways that whose worst one is best."""
    first = np.cumsum(length) - length
    at = np.cumsum(length - 2) - (length - 2)
    faces = np.zeros((int((length - 2).sum()), 3), np.int32)
    for corners in (4, 6):
        mine, ways = np.flatnonzero(length == corners), _fans(corners)
        polygon = ring[first[mine, None] + np.arange(corners)]
        place = x[polygon].astype(np.float64)
        up = np.cross(place, np.roll(place, -1, axis=1)).sum(axis=1)
        kinds, which = np.unique(ways.reshape(-1, 3), axis=0, return_inverse=True)
        good = _shape(place[:, kinds], up[:, None])[:, which.reshape(ways.shape[:2])].min(axis=2)
        chosen = ways[np.argmax(good, axis=1)]
        faces[at[mine, None] + np.arange(corners - 2)] = polygon[np.arange(len(mine))[:, None, None], chosen]
    return faces


def _shape(corner: np.ndarray, up: np.ndarray) -> np.ndarray:
    """How good triangles [..., 3, 3] are: area over squares of sides, below 0 where they look away from `up`."""
    a, b, c = (corner[..., k, :] for k in range(3))
    face = np.cross(b - a, c - a)
    sides = sum((d * d).sum(axis=-1) for d in (b - a, c - b, a - c))
    return (face * up).sum(axis=-1) / np.maximum(np.linalg.norm(up, axis=-1) * sides, 1e-300)


# --- what it carries -------------------------------------------------------------------------------------------------


def _carry(skins, own, x, faces, inside, outside, held, spacing, origin) -> WholeFrame:
    """Normals, thickness and velocities of the sheets on the mesh; the liquid of each region is `held` (nm m^2)."""
    n = len(x)
    normal = wp.zeros((n, 4), dtype=wp.vec3, device=DEVICE)
    depth = wp.zeros((n, 4), dtype=wp.float32, device=DEVICE)
    velocity = wp.zeros(n, dtype=wp.vec3, device=DEVICE)
    labels = wp.array(own, dtype=wp.vec4i, device=DEVICE)
    launch_rows(kw.read_skins_v, n, [skins, labels, _vectors(x)], [normal, depth, velocity], DEVICE)
    normal, depth = normal.numpy().astype(np.float64), depth.numpy().astype(np.float64)
    area = _areas(x, faces)
    corner, shared = faces.reshape(-1), outside >= 0
    normals, thickness = np.zeros((len(corner), 3)), np.zeros(len(corner))
    spread = np.zeros(len(held))
    depths = []
    for side, sign, there in ((inside, 1.0, np.ones(len(faces), bool)), (outside, -1.0, shared)):
        mine = np.repeat(np.where(there, side, -2), 3)
        at = np.argmax(own[corner] == mine[:, None], axis=1)
        found = mine >= 0
        normals[found] += sign * normal[corner, at][found]
        depths.append(np.where(found, depth[corner, at], 0.0))
        total = area * depths[-1].reshape(-1, 3).mean(axis=1)
        spread += np.bincount(side[there], total[there], minlength=len(held))
    factor = np.divide(held, spread, out=np.ones(len(held)), where=spread > 0.0)
    for side, one in zip((inside, outside), depths, strict=True):
        thickness += one * np.repeat(factor[side], 3)
    return WholeFrame(
        x.astype(np.float32),
        velocity.numpy(),
        _film_normals(x, faces, inside * (len(held) + 1) + outside, normals, spacing).astype(np.float32),
        thickness.astype(np.float32),
        (thickness <= BLACK_FILM).astype(np.int32),
        faces,
        inside.astype(np.int32),
        outside.astype(np.int32),
        origin,
    )


def _film_normals(x, faces, film: np.ndarray, sheets: np.ndarray, spacing: float) -> np.ndarray:
    """Normals of corners [3 f, 3]: of the sheets; next to borders, where these turn away, of the faces of the film."""
    plain, _, which = _corner_normals(x, faces, film)
    vertex, first = faces.reshape(-1), np.unique(which, return_index=True)[1]
    plain, sheets = plain[first], _units(sheets)[first]
    corner = which.reshape(-1, 3)
    sides, _ = _sides(np.concatenate([corner[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), len(first))
    place = x.astype(np.float64)[vertex[first]]
    away = np.where(np.bincount(vertex[first])[vertex[first]] > 1, 0.0, np.inf)
    size = np.linalg.norm(place[sides[:, 0]] - place[sides[:, 1]], axis=1)
    for _ in range(FARTHEST):
        near = away.copy()
        for one, other in (sides.T, sides.T[::-1]):
            np.minimum.at(near, one, away[other] + size)
        away = near
    t = np.clip((away / spacing - BENT[0]) / (BENT[1] - BENT[0]), 0.0, 1.0)[:, None]
    normal = plain
    for _ in range(SMOOTHED):
        normal = _units(t * sheets + (1.0 - t) * _units(normal + _means(normal, sides)))
    return normal[which]


def _corner_normals(x: np.ndarray, faces: np.ndarray, film: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals of corners [3 f, 3] from the faces of their film around them, those of the faces, times twice the area.

    Besides these, the number of each corner's vertex in its film, [3 f].
    """
    p = x.astype(np.float64)[faces]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    key = faces.reshape(-1) * (int(film.max()) + 2) + np.repeat(film, 3)
    _, which = np.unique(key, return_inverse=True)
    three = np.repeat(face, 3, axis=0)
    return _units(np.stack([np.bincount(which, three[:, axis]) for axis in range(3)], axis=1))[which], face, which


def _flipped(x: np.ndarray, faces: np.ndarray, film: np.ndarray) -> np.ndarray:
    """[f] whether a face looks away from those of its film around it."""
    plain, face, _ = _corner_normals(x, faces, film)
    return (np.einsum("ij,ikj->ik", face, plain.reshape(-1, 3, 3)) <= 0.0).any(axis=1)


def _units(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def _areas(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """[f] area of each triangle, m^2."""
    a, b, c = (x.astype(np.float64)[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _vectors(values: np.ndarray) -> wp.array:
    return wp.array(np.ascontiguousarray(values, dtype=np.float32), dtype=wp.vec3, device=DEVICE)
