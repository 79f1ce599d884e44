"""Measures surface meshes: closed, oriented, of the right area, volume and liquid. Results of tools/mesh.py."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from melp_warp.check import check_surface
from melp_warp.frame import MeshFrame, ParticleFrame
from melp_warp.mesh import make_meshes
from melp_warp.shapes import Jittered, Samples, Shape, Sphere


def frame_of(samples: Samples, thickness: np.ndarray | float = 400.0) -> ParticleFrame:
    """Particles at rest at the samples of a shape, with a thickness (nm)."""
    n = len(samples.points)
    return ParticleFrame(
        points=samples.points.astype(np.float32),
        velocities=np.zeros((n, 3), np.float32),
        ids=np.arange(n),
        widths=np.sqrt(4.0 / np.pi * samples.area).astype(np.float32),
        normals=samples.normals.astype(np.float32),
        thickness=np.broadcast_to(thickness, n).astype(np.float32),
        region=np.zeros(n, np.int32),
        black_film=np.zeros(n, np.int32),
    )


def face_vectors(mesh: MeshFrame) -> np.ndarray:
    """[f, 3] area times normal of each triangle, m^2."""
    a, b, c = (mesh.points.astype(np.float64)[mesh.faces[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def area_of(mesh: MeshFrame) -> float:
    """Area, m^2."""
    return float(np.linalg.norm(face_vectors(mesh), axis=1).sum())


def volume_of(mesh: MeshFrame) -> float:
    """Volume within a closed mesh, m^3."""
    corners = mesh.points.astype(np.float64)[mesh.faces[:, 0]]
    return float(np.einsum("ij,ij->", corners, face_vectors(mesh)) / 3.0)


def liquid_of(mesh: MeshFrame) -> float:
    """Integral of the thickness, nm m^2."""
    mean = mesh.thickness[mesh.faces].mean(axis=1, dtype=float)
    return float((np.linalg.norm(face_vectors(mesh), axis=1) * mean).sum())


def liquid_in(frame: ParticleFrame) -> float:
    """Liquid of particles, nm m^2."""
    return float((0.25 * np.pi * frame.widths.astype(float) ** 2 * frame.thickness).sum())


def problems_of(mesh: MeshFrame, rims: int = 0) -> list[str]:
    """What `melp-warp check` would find: edges used other than twice, pieces, Euler number, flipped faces."""
    arrays = {
        "points": mesh.points,
        "normals": mesh.normals,
        "faceVertexCounts": np.full(len(mesh.faces), 3),
        "faceVertexIndices": mesh.faces.reshape(-1),
    }
    return check_surface(arrays, rims)


def unsettled(
    shape: Shape, e_count: int, l_per_e: int, jitter: float = 0.15, thickness=lambda x: 400.0
) -> tuple[ParticleFrame, ParticleFrame | None]:
    """E and L on a shape as in the middle of a run: E moved by up to `jitter` spacings at random along it."""
    e = Jittered(shape, jitter).sample(e_count)
    e.normals = shape.normals(e.points)
    few = frame_of(e, thickness(e.points))
    if l_per_e == 0:
        return few, None
    many = shape.sample(e_count * l_per_e, 0.5)
    return few, frame_of(many, thickness(many.points))


@dataclass(frozen=True)
class SphereRecord:
    """How well the mesh of a sphere is that sphere.

    Attributes:
        e_count: E.
        faces: triangles.
        area: relative error of the area.
        volume: relative error of the volume.
        liquid: relative error of the thickness integral against the L's liquid.
        seconds: wall time of making the mesh.
        problems: what is not closed or inside out.
    """

    e_count: int
    faces: int
    area: float
    volume: float
    liquid: float
    seconds: float
    problems: list[str]


def measure_sphere(e_count: int, l_per_e: int = 16, jitter: float = 0.15, radius: float = 0.1) -> SphereRecord:
    """Make the mesh of a sphere whose film is thicker below, and compare it with the sphere."""
    e, many = unsettled(Sphere(radius), e_count, l_per_e, jitter, lambda x: 400.0 - 1000.0 * x[:, 1])
    began = time.perf_counter()
    meshes, problems = make_meshes(e, many)
    seconds = time.perf_counter() - began
    mesh = meshes[0]
    return SphereRecord(
        e_count,
        len(mesh.faces),
        area_of(mesh) / (4.0 * np.pi * radius**2) - 1.0,
        volume_of(mesh) / (4.0 / 3.0 * np.pi * radius**3) - 1.0,
        liquid_of(mesh) / liquid_in(many or e) - 1.0,
        seconds,
        problems + problems_of(mesh),
    )
