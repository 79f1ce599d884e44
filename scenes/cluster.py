"""Thirteen bubbles, one in the middle of twelve, gather to a foam.

MELP 2022, Figure 9: centres of a cubic close packing, moved at random; radii of 43.5 to 60 mm, films of 400 to 600 nm.
At `merge_time` the film between the middle one and a neighbour breaks.
"""

from itertools import product

import numpy as np

try:
    from melp_warp.cluster import Bubble, Cluster, Merge, e_spacing
    from melp_warp.parameters import FOAM, Key, Values, declare
    from melp_warp.scene import Scene
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    **FOAM | {"damping": 20.0},
    mixing=2.0,
    radius_low=0.0435,
    radius_high=0.06,
    offset=(0.1, Key("-", "largest random move of a centre along each axis, relative to the packing", 0.0, 0.3)),
    gap=0.5,
    approach_speed=0.2,
    thickness_1=400e-9,
    thickness_2=600e-9,
    merge_time=None,
    thickness=500e-9,
    e_count=6500,
    l_per_e=8,
    frames=60,
    fps=60.0,
    seed=1,
)


def build(p: Values) -> Scene:
    """Build the scene: bubble 0 is the middle one; thickness_1 and thickness_2 bound the thicknesses."""
    rng = np.random.default_rng(p.seed)
    ring = [c for c in product((-1, 0, 1), repeat=3) if np.abs(c).sum() == 2]
    place = np.array([(0, 0, 0), *ring]) / np.sqrt(2.0) + rng.uniform(-p.offset, p.offset, (13, 3))
    radii = rng.uniform(*sorted((p.radius_low, p.radius_high)), 13)
    thickness = rng.uniform(*sorted((p.thickness_1, p.thickness_2)), 13)
    # as close as the closest pair allows
    first, second = np.triu_indices(13, 1)
    room = radii[first] + radii[second] + p.gap * e_spacing(radii, p.e_count)
    centres = place * np.max(room / np.linalg.norm(place[first] - place[second], axis=1))
    inward = -centres / np.maximum(np.linalg.norm(centres, axis=1, keepdims=True), p.radius_low)
    velocities = p.approach_speed * inward
    each = zip(centres, radii, velocities, thickness, strict=True)
    bubbles = [Bubble(tuple(c), r, tuple(v), t) for c, r, v, t in each]
    events = () if p.merge_time is None else (Merge(p.merge_time, 0, 1),)
    return p.scene("cluster", Cluster(tuple(bubbles), events=events))


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
