"""The outline of a film with holes: what is left of its wires, joined with its free rims to closed curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from melp_warp.fits import nearest_distance
from melp_warp.frame import ParticleFrame
from melp_warp.surface import next_beads

NEAR = 1.2
"""Distance from an E, in widths of one, within which a wire still holds film."""


CLEAR = 0.3
"""Distance of the vertices of a mesh from its free rims, in widths of an E: nearer ones make folds."""


def clear_of_rims(e: ParticleFrame, beads: ParticleFrame | None) -> ParticleFrame:
    """The E that are not too near a free rim to be vertices of a mesh that ends there."""
    if beads is None or not len(beads.points) or not len(e.points):
        return e
    away = nearest_distance(e.points, beads.points.astype(np.float64))
    kept = away > CLEAR * float(e.widths.mean())
    return ParticleFrame(**{k: v[kept] if isinstance(v, np.ndarray) else v for k, v in vars(e).items()})


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
            turn = int(np.argmin(held))
            rim, held = np.roll(rim, -turn, axis=0), np.roll(held, -turn)
            edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
            open_runs += [rim[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
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
