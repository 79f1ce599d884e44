"""Four bubbles meet at 90 degrees, rearrange to 120, then two of them become one and one pops.

MELP 2022, Figure 20. Four films that meet along a line are not stable: two opposite bubbles with slightly less tension
come to touch, and the line parts into two. Later the film between the two bubbles on the right breaks
(`merge_time`), and what they have become is punctured at its top right (`pop_time`): the rest feels the recoil. A burst
takes some milliseconds: `slow_from=1.6 slow_motion=60` shows it.
"""

import numpy as np

try:
    from melp_warp.cluster import Cluster, Merge, Pop, approaching, e_spacing
    from melp_warp.parameters import FOAM, Values, declare
    from melp_warp.scene import Scene
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    **FOAM | {"damping": 20.0},
    mixing=2.0,
    radius=0.05,
    gap=0.5,
    approach_speed=0.2,
    tension_spread=0.02,
    merge_time=1.2,
    pop_time=1.6,
    thickness=400e-9,
    e_count=2800,
    l_per_e=8,
    frames=120,
    fps=60.0,
)


def build(p: Values) -> Scene:
    """Build the scene: bubbles 0 to 3 are top left, top right, bottom right and bottom left."""
    corners = np.array([(-1.0, 1.0, 0.0), (1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (-1.0, -1.0, 0.0)]) / np.sqrt(2.0)
    factors = 1.0 + p.tension_spread * np.array([-0.5, 0.5, -0.5, 0.5])
    gap = p.gap * e_spacing(4 * [p.radius], p.e_count)
    bubbles = approaching(corners, p.radius, gap, p.approach_speed, factors)
    merge = () if p.merge_time is None else (Merge(p.merge_time, 1, 2),)
    corner = tuple(4.0 * p.radius * corners[1])
    pop = () if p.pop_time is None else (Pop(p.pop_time, 1, corner),)
    return p.scene("four_bubbles", Cluster(bubbles, events=merge + pop))


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
