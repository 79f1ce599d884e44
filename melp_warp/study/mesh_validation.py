"""Measures surface meshes: closed, oriented, of the right area, volume and liquid. Results of tools/mesh.py."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from melp_warp.frame import MeshFrame, ParticleFrame, WholeFrame
from melp_warp.mesh.surfaces import make_meshes
from melp_warp.shapes import Jittered, Samples, Shape, Sphere
from melp_warp.usd.check_surfaces import check_surface


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


def face_vectors(mesh: MeshFrame | WholeFrame) -> np.ndarray:
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


def whole_areas(whole: WholeFrame) -> dict[tuple[int, int], float]:
    """Area of each film by the regions on its two sides, m^2."""
    area = np.linalg.norm(face_vectors(whole), axis=1)
    pairs, which = np.unique(np.stack([whole.inside, whole.outside], axis=1), axis=0, return_inverse=True)
    return dict(zip(map(tuple, pairs.tolist()), np.bincount(which.reshape(-1), area).tolist(), strict=True))


def whole_liquid(whole: WholeFrame) -> float:
    """Integral of the thickness, nm m^2."""
    mean = whole.thickness.reshape(-1, 3).mean(axis=1, dtype=float)
    return float((np.linalg.norm(face_vectors(whole), axis=1) * mean).sum())


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


SCENES = {
    "cluster": {"e_count": 2600, "l_per_e": 1},
    "deforming_rectangle_2m": {"e_count": 400, "l_per_e": 4},
    "double_bubble": {"e_count": 500, "l_per_e": 4},
    "drainage": {"e_count": 300, "l_per_e": 4},
    "equilibrium": {"e_count": 300, "l_per_e": 4},
    "foam_mountain": {"e_count": 1000, "bubbles": 5},
    "foam_pops": {"e_count": 2000, "l_per_e": 1, "pop_time": None},
    "four_bubbles": {"e_count": 800, "l_per_e": 2},
    "giant_bubble": {"e_count": 400, "l_per_e": 4},
    "giant_bubble_vortices": {"e_count": 500, "l_per_e": 4},
    "inflation": {"e_count": 400, "l_per_e": 4},
    "leapfrog": {"e_count": 800, "l_per_e": 4},
    "oscillating_bubble": {"e_count": 400},
    "quadruple_bubble": {"e_count": 800, "l_per_e": 2},
    "size_ratio": {"e_count": 480, "l_per_e": 2},
    "stirred_disc": {"e_count": 400, "l_per_e": 4},
    "taylor_vortices": {"e_count": 400, "l_per_e": 4},
    "triple_bubble": {"e_count": 600, "l_per_e": 2},
    "turbulent_film": {"e_count": 600, "l_per_e": 4},
}
"""Each scene, small: about 200 E a bubble, as few as foams take."""


@dataclass
class SceneRecord:
    """How the meshes of all frames of a run are.

    Attributes:
        name: of the scene.
        frames: looked at.
        meshes: regions of all frames.
        faces: triangles of a frame, the most.
        liquid: largest relative error of a region's thickness integral against its liquid.
        moved: largest distance of a vertex from its E, m.
        share: time of making the meshes over that of the run.
        problems: what is not closed or inside out, with its frame.
    """

    name: str
    frames: int = 0
    meshes: int = 0
    faces: int = 0
    liquid: float = 0.0
    moved: float = 0.0
    share: float = 0.0
    problems: list[str] = field(default_factory=list)


def prove_scene(name: str, frames: int | None = None) -> SceneRecord:
    """Run a scene of `SCENES` and look at the meshes of every frame.

    Args:
        name: of the scene.
        frames: after the first; None for as many as the scene has.
    """
    from melp_warp.registry import load_scene
    from melp_warp.simulation import Simulation

    script = load_scene(name)
    overrides = SCENES[name] if frames is None else SCENES[name] | {"frames": frames}
    scene = script.build(script.parameters.values(overrides))
    simulation, record = Simulation(scene), SceneRecord(name)
    began, spent = time.perf_counter(), 0.0
    rims = scene.shape.edges()
    while True:
        few = simulation.particles("e")
        many = simulation.particles("l") if simulation.has_l else None
        start = time.perf_counter()
        meshes, problems = make_meshes(few, many, [rim - np.array(few.origin) for rim in rims])
        spent += time.perf_counter() - start
        record.problems += [f"frame {simulation.frame}: {problem}" for problem in problems]
        _look_at(record, simulation.frame, meshes, few, many or few, len(rims))
        if simulation.frame == scene.frames:
            break
        simulation.advance_frame()
    record.share = spent / (time.perf_counter() - began)
    return record


def _look_at(record: SceneRecord, frame: int, meshes: dict, few: ParticleFrame, full: ParticleFrame, rims: int) -> None:
    record.frames += 1
    record.meshes += len(meshes)
    record.faces = max(record.faces, sum(len(mesh.faces) for mesh in meshes.values()))
    for region, mesh in meshes.items():
        record.problems += [f"frame {frame}: region {region}: {problem}" for problem in problems_of(mesh, rims)]
        held = full.region == region
        liquid = float((0.25 * np.pi * full.widths[held].astype(float) ** 2 * full.thickness[held]).sum())
        if liquid > 0.0:
            record.liquid = max(record.liquid, abs(liquid_of(mesh) / liquid - 1.0))
        own = few.points[few.region == region]
        record.moved = max(record.moved, float(np.abs(mesh.points[: len(own)] - own).max(initial=0.0)))
