"""The outline of a film with holes: what is left of its wires, joined with its free rims to closed curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from melp_warp.errors import InputError
from melp_warp.frame import MeshFrame, ParticleFrame
from melp_warp.measure.fits import close_pairs, connected, nearest_distance, spans, squares, turned
from melp_warp.mesh.surfaces import FOLDED, make_meshes
from melp_warp.preview.surface import next_beads

NEAR = 1.2
"""Distance from an E, in widths of one, within which a wire still holds film."""

CLEAR = 0.3
"""Distance of the vertices of a mesh from its free rims, in widths of an E: nearer ones make folds."""

APART = 1.8
"""Distance up to which E belong to one piece of a film, in widths of one."""

FILL = 0.75
"""Distance of the middle of a triangle from the nearest E, in widths of one, beyond which it closes a hole."""

DRAWN = 1.5
"""Distance of a mesh's edge from a free rim, in widths of an E, up to which it is put onto the rim."""

FEWEST = 6
"""E of the smallest piece that gets a mesh."""

AT_POINTS = ("points", "velocities", "normals", "thickness", "black_film")
"""What a mesh has at its points."""


def mesh_torn(
    e: ParticleFrame,
    lagrangian: ParticleFrame | None,
    rims: Sequence[np.ndarray],
    beads: ParticleFrame | None,
    triangles: int | None = None,
) -> tuple[dict[int, MeshFrame], list[str]]:
    """`make_meshes` of a film that may have holes and be in pieces: each is closed on its own, and all are one mesh.

    Args:
        e: the E.
        lagrangian: the L, or None.
        rims: points [k, 3] along each wire, m, closed.
        beads: free rims as a cache stores them; None or empty for a film without holes.
        triangles: how many there are to be in all, about.
    """
    if beads is None or not len(beads.points) or not len(e.points):
        return make_meshes(e, lagrangian, rims, triangles)
    if len(np.unique(e.region)) > 1:
        return _torn_foam(e, lagrangian, beads, triangles)
    film, curves = _clear_of_rims(e, beads), outlines(rims, beads, e)
    piece, region = _pieces(film), int(e.region[0])
    made, problems = [], []
    for k in np.unique(piece):
        part = _some(film, piece == k)
        if len(part.points) < FEWEST:
            continue  # a few drops' worth
        own = [curve for curve in curves if np.bincount(_nearest(curve, film, piece)).argmax() == k]
        many = lagrangian and _some(lagrangian, _nearest(lagrangian.points, film, piece) == k)
        meshes, found = _lay(part, many, own, _share(triangles, part, film))
        made, problems = [*made, *meshes.values()], problems + found
    return ({region: _merged(made)} if made else {}), problems


def _torn_foam(
    e: ParticleFrame, lagrangian: ParticleFrame | None, beads: ParticleFrame, triangles: int | None
) -> tuple[dict[int, MeshFrame], list[str]]:
    """The closed meshes of all bubbles, those that burst without what closes their holes.

    A hole in a bubble of a foam ends at borders as well as at its rim, so its edge is that of the last E, put onto the
    rim where that is near.
    """
    torn, width = _regions_of(beads, e), float(e.widths.mean())
    made, problems = {}, []
    for regions in (np.setdiff1d(e.region, torn), *torn):
        part = _some(e, np.isin(e.region, regions))
        many = lagrangian and _some(lagrangian, np.isin(lagrangian.region, regions))
        if not np.isin(regions, torn).any():
            meshes, found = make_meshes(part, many, [], _share(triangles, part, e))
        elif len(part.points) < FEWEST:
            continue
        else:
            meshes, found = _lay(part, many, [], _share(triangles, part, e))
            open_ones = {k: _without_fill(m, part.points.astype(np.float64), FILL * width) for k, m in meshes.items()}
            meshes = {k: _drawn_to(m, beads, DRAWN * width) for k, m in open_ones.items()}
            found = [one for one in found if not one.endswith(FOLDED)]
        made, problems = made | meshes, problems + found
    return made, problems


def _share(triangles: int | None, part: ParticleFrame, whole: ParticleFrame) -> int | None:
    """How many triangles a part of the film gets, of all that there are to be."""
    return triangles and max(1, round(triangles * len(part.points) / len(whole.points)))


def _lay(
    part: ParticleFrame, many: ParticleFrame | None, rims: Sequence[np.ndarray], triangles: int | None
) -> tuple[dict[int, MeshFrame], list[str]]:
    """`make_meshes` of a piece of torn film; where there can be no mesh of it, none, and a line that says so."""
    try:
        meshes, found = make_meshes(part, many, rims, triangles)
    except InputError as error:
        meshes, found = {}, [str(error)]
    sound = {k: mesh for k, mesh in meshes.items() if np.isfinite(mesh.normals).all()}
    return sound, found if sound else [f"region {part.region[0]}: a piece of {len(part.points)} E makes no mesh"]


def _regions_of(beads: ParticleFrame, e: ParticleFrame) -> list[int]:
    """The regions over whose films free rims run: those of most of the E that are nearest to their beads."""
    nearest = e.region[_nearest(beads.points, e, np.arange(len(e.points)))]
    found = []
    for number in np.unique(beads.region):
        regions, counts = np.unique(nearest[beads.region == number], return_counts=True)
        found += regions[counts > 0.3 * counts.sum()].tolist()
    return sorted(set(found))


def _without_fill(mesh: MeshFrame, points: np.ndarray, reach: float) -> MeshFrame:
    """A mesh without what closes its holes, and the vertices of that alone.

    That are the faces that are farther than `reach` (m) from all E at `points`, or look inwards.
    """
    middle = mesh.points.astype(np.float64)[mesh.faces].mean(axis=1)
    faces = mesh.faces[_outwards(mesh) & (nearest_distance(middle, points) < reach)]
    while (pinched := _pinched(faces, len(mesh.points))).any():
        faces = faces[~pinched[faces].any(axis=1)]
    used = np.unique(faces)
    number = np.zeros(len(mesh.points), dtype=np.int32)
    number[used] = np.arange(len(used))
    return MeshFrame(*(getattr(mesh, name)[used] for name in AT_POINTS), number[faces], mesh.origin)


def _drawn_to(mesh: MeshFrame, beads: ParticleFrame, reach: float) -> MeshFrame:
    """A mesh whose edges end on the free rims that are within `reach` (m), but for points that would fold a face."""
    edge = np.flatnonzero(_edges_at(mesh.faces, len(mesh.points)))
    x, rim, after = mesh.points[edge].astype(np.float64), beads.points.astype(np.float64), next_beads(beads)
    nearest = _nearest(x, beads, np.arange(len(rim)))
    before = np.full(len(rim), -1)
    before[after[after >= 0]] = np.flatnonzero(after >= 0)
    best = rim[nearest]
    for other in (after[nearest], before[nearest]):
        along = rim[np.where(other >= 0, other, nearest)] - rim[nearest]
        share = np.sum((x - rim[nearest]) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-30)
        foot = rim[nearest] + np.clip(share, 0.0, 1.0)[:, None] * along
        nearer = np.sum((x - foot) ** 2, axis=1) < np.sum((x - best) ** 2, axis=1)
        best[nearer] = foot[nearer]
    near = np.sum((x - best) ** 2, axis=1) < reach**2
    drawn = replace(mesh, points=mesh.points.copy())
    drawn.points[edge[near]] = best[near]
    while (folded := ~_outwards(drawn)).any():
        corners = np.unique(drawn.faces[folded])
        if (drawn.points[corners] == mesh.points[corners]).all():
            break
        drawn.points[corners] = mesh.points[corners]
    return drawn


def _outwards(mesh: MeshFrame) -> np.ndarray:
    """[f] whether each face looks where its points' normals do."""
    a, b, c = (mesh.points[corner].astype(np.float64) for corner in mesh.faces.T)
    return (np.cross(b - a, c - a) * mesh.normals[mesh.faces].sum(axis=1)).sum(axis=1) > 0.0


def _pinched(faces: np.ndarray, count: int) -> np.ndarray:
    """[count] points in which edges of a mesh meet, so that it hangs together by a point alone."""
    return _edges_at(faces, count) > 1


def _edges_at(faces: np.ndarray, count: int) -> np.ndarray:
    """[count] edges of one face alone that begin at each point of a mesh."""
    start, end = faces.T.reshape(-1).astype(np.int64), np.roll(faces, -1, axis=1).T.reshape(-1)
    bare = ~np.isin(end * count + start, start * count + end)
    return np.bincount(start[bare], minlength=count)


def _clear_of_rims(e: ParticleFrame, beads: ParticleFrame) -> ParticleFrame:
    """The E that are not too near a free rim to be vertices of a mesh that ends there."""
    away = nearest_distance(e.points, beads.points.astype(np.float64))
    kept = away > CLEAR * float(e.widths.mean())
    return _some(e, kept)


def _some(frame: ParticleFrame, kept: np.ndarray) -> ParticleFrame:
    """The particles of a mask."""
    some = {name: values[kept] for name, values in vars(frame).items() if isinstance(values, np.ndarray)}
    return replace(frame, **some, carried={name: held[kept] for name, held in frame.carried.items()})


def _pieces(e: ParticleFrame) -> np.ndarray:
    """[n] the piece of film that each E belongs to."""
    radius = APART * float(e.widths.mean())
    i, j = (np.concatenate(ends) for ends in zip(*close_pairs(e.points.astype(np.float64), radius), strict=True))
    return connected(len(e.points), np.concatenate([i, j]), np.concatenate([j, i]))


def _nearest(x: np.ndarray, e: ParticleFrame, piece: np.ndarray) -> np.ndarray:
    """[n] the piece of the E nearest to each point."""
    if (piece == piece[0]).all():
        return np.full(len(x), piece[0])
    points = e.points.astype(np.float64)
    parts = np.array_split(np.asarray(x, dtype=np.float64), 1 + len(x) * len(points) // 2_000_000)
    return piece[np.concatenate([np.argmin(squares(part, points), axis=1) for part in parts])]


def _merged(meshes: list[MeshFrame]) -> MeshFrame:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(mesh.points) for mesh in meshes[:-1])])
    faces = [(mesh.faces + at).astype(np.int32) for mesh, at in zip(meshes, first, strict=True)]
    return MeshFrame(
        *(np.concatenate([getattr(mesh, name) for mesh in meshes]) for name in AT_POINTS),
        np.concatenate(faces),
        meshes[0].origin,
    )


def outlines(rims: Sequence[np.ndarray], beads: ParticleFrame | None, e: ParticleFrame) -> list[np.ndarray]:
    """Closed curves around a film.

    Args:
        rims: points [k, 3] along each wire, m, closed.
        beads: free rims as a cache stores them; None or empty for a film without holes.
        e: the E that there are.

    Returns:
        Points along each curve, [k, 3], m.
    """
    if beads is None or not len(beads.points) or not len(e.points):
        return list(rims)
    x, after = beads.points.astype(np.float64), next_beads(beads)
    whole, open_runs = [], []
    for number in np.unique(beads.region):
        index = np.flatnonzero(beads.region == number)
        (whole if after[index[-1]] >= 0 else open_runs).append(x[index])
    for rim in rims:
        held = nearest_distance(rim, e.points.astype(np.float64)) < NEAR * float(e.widths.mean())
        if held.all():
            whole.append(rim)
        elif held.any():
            rim, held = turned(rim, held)
            open_runs += [rim[start:stop] for start, stop in spans(held)]
    return whole + _joined(open_runs)


def _joined(runs: list[np.ndarray]) -> list[np.ndarray]:
    """Closed curves from open ones: each goes on with the nearest end of another, turned where it has to be."""
    left, curves = list(runs), []
    while left:
        curve = left.pop(0)
        while left:
            end = curve[-1]
            gaps = [min(np.linalg.norm(run[0] - end), np.linalg.norm(run[-1] - end)) for run in left]
            k = int(np.argmin(gaps))
            if np.linalg.norm(curve[0] - end) <= gaps[k]:
                break
            run = left.pop(k)
            curve = np.concatenate([curve, run if np.linalg.norm(run[0] - end) == gaps[k] else run[::-1]])
        if len(curve) >= 3:
            curves.append(curve)
    return curves
