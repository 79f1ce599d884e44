"""What a scene declares, at the vertices of its meshes: a mean over the particles near each, see docs/carried.md."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.device.launch import launch_rows
from melp_warp.frame import MeshFrame, ParticleFrame, WholeFrame
from melp_warp.kernels import mesh as km
from melp_warp.mesh.surfaces import DEVICE
from melp_warp.stages.neighbors import GRID_CELLS

NEAR = 2.0
"""Distance within which the mean is taken, in the mean distance of the particles."""

ROUNDS = 6
"""How often that may double where there are none."""


def shade(mesh: MeshFrame | WholeFrame, region: int, source: ParticleFrame) -> None:
    """Give a mesh what the particles `source`, L or E, carry: at its points, of a whole foam at the corners of faces.

    Args:
        mesh: changed in place.
        region: of a mesh of one; of a whole foam each corner has that of the sheet on its inside.
        source: particles of all regions.
    """
    if isinstance(mesh, WholeFrame):
        point, of = mesh.points[mesh.faces.reshape(-1)], np.repeat(mesh.inside, 3)
    else:
        point, of = mesh.points, np.full(len(mesh.points), region)
    mesh.carried = _means(source, point, of)


def _means(source: ParticleFrame, point: np.ndarray, of: np.ndarray) -> dict[str, np.ndarray]:
    """What the particles have near points [k, 3] of regions [k]."""
    if not source.carried:
        return {}
    if not len(source.points) or not len(point):
        return {name: np.zeros(len(point), np.float32) for name in source.carried}
    area = 0.25 * np.pi * source.widths.astype(np.float64) ** 2
    radius = NEAR * float(np.sqrt(area.mean()))
    x, at = (wp.array(np.ascontiguousarray(a), dtype=wp.vec3, device=DEVICE) for a in (source.points, point))
    grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=DEVICE)
    grid.build(x, radius)
    regions = [wp.array(np.asarray(a, dtype=np.int32), dtype=wp.int32, device=DEVICE) for a in (source.region, of)]
    weights, found = wp.array(area, dtype=wp.float32, device=DEVICE), {}
    for name, held in source.carried.items():
        value, mean = wp.array(held, dtype=wp.float32, device=DEVICE), wp.zeros(len(point), dtype=float, device=DEVICE)
        given = [grid.id, x, regions[0], weights, value, at, regions[1], radius, ROUNDS]
        launch_rows(km.mean_near_v, len(point), given, [mean], DEVICE)
        found[name] = mean.numpy().astype(np.float32)
    return found
