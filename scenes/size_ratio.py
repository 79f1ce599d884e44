"""A large and a small bubble meet; the small one, at the higher pressure, bulges into the large one.

Once at rest the film between them has the radius R_P = R1 R2/(R1 - R2). `ratio` is R2/R1; the six of MELP 2022,
Table 3, are 0.4, 0.5, ... 0.9.
"""

try:
    from melp_warp.cluster import Bubble, Cluster, e_spacing
    from melp_warp.parameters import FOAM, Key, Values, declare
    from melp_warp.scene import Scene
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    **FOAM | {"damping": 15.0},
    mixing=2.0,
    radius_1=0.05,
    ratio=(0.6, Key("-", "radius of the second bubble over that of the first", 0.05, 1.0)),
    gap=1.0,
    approach_speed=0.1,
    thickness=400e-9,
    e_count=2000,
    l_per_e=16,
    frames=90,
    fps=60.0,
)


def build(p: Values) -> Scene:
    """Build the scene: the first bubble on the left, both on their way to each other."""
    radius_2 = p.ratio * p.radius_1
    half = 0.5 * p.gap * e_spacing([p.radius_1, radius_2], p.e_count)
    left = Bubble((-p.radius_1 - half, 0.0, 0.0), p.radius_1, (p.approach_speed, 0.0, 0.0))
    right = Bubble((radius_2 + half, 0.0, 0.0), radius_2, (-p.approach_speed, 0.0, 0.0))
    return p.scene("size_ratio", Cluster((left, right)))


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
