"""Bubbles pour from five taps and pile up to a mountain of foam.

MELP 2022, Figure 18, which has 300: `--set bubbles=300`. Each tap lets one bubble go after the other, as soon as the
last is out of the way; those that touch a side of the container pop. `e_count` is for the first five: later ones
come at the same spacing. For a high mountain raise `tap_height` as well.
"""

import numpy as np

try:
    from melp_warp.cluster import Bubble, Cluster, Wall
    from melp_warp.parameters import FOAM, Key, Values, declare
    from melp_warp.scene import Scene
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

TAPS = np.array([(0, 0), (-1, -1), (1, -1), (-1, 1), (1, 1)])

PARAMETERS = declare(
    **FOAM | {"damping": 50.0, "border": 1.0},
    bubbles=15,
    radius_low=0.008,
    radius_high=0.012,
    container=(0.3, Key("m", "width of the container", 1e-3, 100.0)),
    tap_height=(0.03, Key("m", "height of the taps over the floor", 1e-3, 100.0)),
    tap_spacing=(0.025, Key("m", "distance of the outer taps from the one in the middle, along x and z", 1e-3, 100.0)),
    interval=(0.3, Key("s", "time between two bubbles of a tap", 1e-3, 1e3)),
    speed=(0.5, Key("m/s", "speed with which bubbles leave the taps, downwards", 0.0, 100.0)),
    gravity=9.81,
    thickness=600e-9,
    e_count=1000,
    l_per_e=0,
    frames=90,
    fps=60.0,
    seed=1,
)


def build(p: Values) -> Scene:
    """Build the scene: bubble k comes from tap k mod 5."""
    rng = np.random.default_rng(p.seed)
    radii = rng.uniform(*sorted((p.radius_low, p.radius_high)), p.bubbles)
    bubbles = []
    for k, radius in enumerate(radii):
        x, z = p.tap_spacing * TAPS[k % 5]
        # each tap a little later than the one before: the first five are there from the start
        born = 0.0 if k < 5 else p.interval * (k // 5 + 0.2 * (k % 5))
        bubbles.append(Bubble((x, p.tap_height, z), radius, (0.0, -p.speed, 0.0), born=born))
    half = 0.5 * p.container
    walls = [Wall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    for side in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)):
        walls.append(Wall(tuple(-half * s for s in side), side, pops=True))
    return p.scene("foam_mountain", Cluster(tuple(bubbles), tuple(walls)))


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
