"""Ten bubbles gather to a foam; now and then one is punctured, and the others jump into its place.

One in the middle, nine around it. From `pop_time` on the outer ones burst, every `pop_interval` or so, in an order that
`seed` decides: a rim runs over the free film, its liquid sprays, the partitions stay with the neighbours.
"""

import numpy as np

try:
    from melp_warp.cluster import Bubble, Cluster, Pop, e_spacing
    from melp_warp.parameters import FOAM, Key, Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import fibonacci_sphere
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    **FOAM | {"damping": 15.0},
    radius_low=0.03,
    radius_high=0.04,
    gap=0.5,
    approach_speed=0.3,
    pop_time=0.4,
    pop_interval=(0.3, Key("s", "time from one burst to the next, about", 0.0, 1e6, above=True)),
    pops=(5, Key("-", "number of bubbles that burst", 0, 9, whole=True)),
    thickness=400e-9,
    e_count=5000,
    l_per_e=8,
    frames=120,
    fps=60.0,
    seed=2,
)


def build(p: Values) -> Scene:
    """Build the scene: bubble 0 is the one in the middle and stays."""
    rng = np.random.default_rng(p.seed)
    place = np.concatenate([np.zeros((1, 3)), fibonacci_sphere(9)])
    radii = rng.uniform(*sorted((p.radius_low, p.radius_high)), 10)
    # as close as the closest pair allows
    first, second = np.triu_indices(10, 1)
    room = radii[first] + radii[second] + p.gap * e_spacing(radii, p.e_count)
    centres = place * np.max(room / np.linalg.norm(place[first] - place[second], axis=1))
    each = zip(centres, radii, -p.approach_speed * place, strict=True)
    bubbles = tuple(Bubble(tuple(c), r, tuple(v)) for c, r, v in each)
    chosen = 1 + rng.permutation(9)[: p.pops]
    times = p.pop_interval * (np.arange(p.pops) + rng.uniform(-0.2, 0.2, p.pops) * (np.arange(p.pops) > 0))
    events = (
        () if p.pop_time is None else tuple(Pop(p.pop_time + t, int(k)) for t, k in zip(times, chosen, strict=True))
    )
    return p.scene("foam_pops", Cluster(bubbles, events=events))


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
