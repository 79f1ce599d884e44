"""One frame of a particle set or of a mesh as plain NumPy arrays: what is written to USD and what is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

BLACK_FILM = 12.0
"""Thickness up to which a film is Newton black film, nm: in equilibrium it is 4 to 12 nm thick."""


@dataclass
class ParticleFrame:
    """A particle set at one instant, sorted by id. SI units, except thickness (nanometres).

    Attributes:
        points: [n, 3] float32, m, from `origin`.
        velocities: [n, 3] float32, m/s: d(points)/dt. L move with the liquid, E with the surface, past which it flows.
        ids: [n] int64, stable over the run, ascending.
        widths: [n] float32, m, particle diameter for display.
        normals: [n, 3] float32, outward unit normals.
        thickness: [n] float32, nm.
        region: [n] int32, index of the film region.
        black_film: [n] int32, 1 where the film is at most `BLACK_FILM` thick, else 0.
        origin: where the points are measured from, m; the same in all frames of a run.
        carried: name -> [n] float32, what the scene declares besides, in its unit.
    """

    points: np.ndarray
    velocities: np.ndarray
    ids: np.ndarray
    widths: np.ndarray
    normals: np.ndarray
    thickness: np.ndarray
    region: np.ndarray
    black_film: np.ndarray
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    carried: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def empty(cls, origin: tuple[float, float, float] = (0.0, 0.0, 0.0), carried: Sequence[str] = ()) -> ParticleFrame:
        """A frame without particles."""
        vectors, numbers = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
        integers = np.zeros(0, np.int32)
        ids = np.zeros(0, np.int64)
        more = dict.fromkeys(carried, numbers)
        return cls(vectors, vectors, ids, numbers, vectors, numbers, integers, integers, origin, more)


def beads(x, u, width, normal, origin: np.ndarray, ids: np.ndarray | None = None) -> ParticleFrame:
    """Particles that are no film: their `thickness` is the diameter `width` (m)."""
    return ParticleFrame(
        points=x.astype(np.float32),
        velocities=u.astype(np.float32),
        ids=(np.arange(len(x)) if ids is None else ids).astype(np.int64),
        widths=width.astype(np.float32),
        normals=normal.astype(np.float32),
        thickness=(1e9 * width).astype(np.float32),
        region=np.zeros(len(x), dtype=np.int32),
        black_film=np.zeros(len(x), dtype=np.int32),
        origin=tuple(origin.tolist()),
    )


@dataclass
class CurveFrame:
    """Curves at one instant, piecewise straight. SI units.

    Attributes:
        points: [n, 3] float32, m, from `origin`, curve by curve; one that is closed ends where it begins.
        velocities: [n, 3] float32, m/s, of the points.
        counts: [k] int32, points of each curve, two at least.
        widths: [n] float32, m, diameters.
        origin: where the points are measured from, m; the same in all frames of a run.
    """

    points: np.ndarray
    velocities: np.ndarray
    counts: np.ndarray
    widths: np.ndarray
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass
class MeshFrame:
    """The surface of one region at one instant, as triangles. SI units, except thickness (nanometres).

    Attributes:
        points: [n, 3] float32, m, from `origin`; the first are the region's E in the order of their ids.
        velocities: [n, 3] float32, m/s, of the points.
        normals: [n, 3] float32, outward unit normals.
        thickness: [n] float32, nm.
        black_film: [n] int32, 1 where the film is Newton black film.
        faces: [f, 3] int32, corners, counterclockwise seen from outside.
        origin: where the points are measured from, m; the same in all frames of a run.
        carried: name -> [n] float32, what the scene declares besides, in its unit.
    """

    points: np.ndarray
    velocities: np.ndarray
    normals: np.ndarray
    thickness: np.ndarray
    black_film: np.ndarray
    faces: np.ndarray
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    carried: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def empty(cls, origin: tuple[float, float, float] = (0.0, 0.0, 0.0), carried: Sequence[str] = ()) -> MeshFrame:
        """The mesh of a region that is not there."""
        none = np.zeros((0, 3), np.float32)
        more = dict.fromkeys(carried, none[:, 0])
        return cls(none, none, none, none[:, 0], np.zeros(0, np.int32), np.zeros((0, 3), np.int32), origin, more)


@dataclass
class WholeFrame:
    """One mesh of a whole foam at one instant, partitions once and borders shared. SI units, except thickness (nm).

    Attributes:
        points: [n, 3] float32, m, from `origin`.
        velocities: [n, 3] float32, m/s, of the points.
        normals: [3 f, 3] float32, unit normals at the corners of each face, out of the region inside.
        thickness: [3 f] float32, nm, at the corners: of both sheets together in a partition.
        black_film: [3 f] int32, 1 where the film is Newton black film.
        faces: [f, 3] int32, corners, counterclockwise seen from outside.
        inside: [f] int32, the region that each face looks out of.
        outside: [f] int32, the one that it looks into, a higher number; -1 for the air around the foam.
        origin: where the points are measured from, m; the same in all frames of a run.
        carried: name -> [3 f] float32, what the scene declares besides, of the sheet inside, in its unit.
    """

    points: np.ndarray
    velocities: np.ndarray
    normals: np.ndarray
    thickness: np.ndarray
    black_film: np.ndarray
    faces: np.ndarray
    inside: np.ndarray
    outside: np.ndarray
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    carried: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def empty(cls, origin: tuple[float, float, float] = (0.0, 0.0, 0.0), carried: Sequence[str] = ()) -> WholeFrame:
        """The mesh of a foam without bubbles."""
        none, numbers = np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
        more = dict.fromkeys(carried, none[:, 0])
        return cls(none, none, none, none[:, 0], numbers, np.zeros((0, 3), np.int32), numbers, numbers, origin, more)

    def skin(self, region: int) -> MeshFrame:
        """The faces around a region, looking out of it; normals are means of the films at a vertex."""
        out, into = self.inside == region, self.outside == region
        faces = np.concatenate([self.faces[out], self.faces[into][:, ::-1]])
        corner = np.arange(3 * len(self.faces)).reshape(-1, 3)
        corners = np.concatenate([corner[out], corner[into][:, ::-1]]).reshape(-1)
        sign = np.repeat([1.0, -1.0], [3 * out.sum(), 3 * into.sum()])[:, None]
        used, at = np.unique(faces, return_inverse=True)
        normals = np.zeros((len(used), 3))
        np.add.at(normals, at.reshape(-1), sign * self.normals[corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        thickness, black = np.zeros(len(used), np.float32), np.zeros(len(used), np.int32)
        thickness[at.reshape(-1)], black[at.reshape(-1)] = self.thickness[corners], self.black_film[corners]
        arrays = self.points[used], self.velocities[used], normals.astype(np.float32), thickness, black
        return MeshFrame(*arrays, at.reshape(-1, 3).astype(np.int32), self.origin)
