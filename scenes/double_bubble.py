"""Two bubbles meet and share a film; thick liquid above trades places with thin below.

The double bubble of MELP 2022, Figure 1, at a tenth of its size: 500 nm over 250 nm. Where the films touch, liquid
crosses; gravity then overturns the colours.
"""

try:
    from melp_warp.cluster import Bubble, Cluster, e_spacing
    from melp_warp.parameters import FOAM, Values, declare
    from melp_warp.scene import Scene
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    **FOAM | {"damping": 20.0, "exchange": 2.0},
    mixing=2.0,
    radius_1=0.05,
    radius_2=0.05,
    thickness_1=500e-9,
    thickness_2=250e-9,
    gap=1.0,
    approach_speed=0.2,
    gravity=9.81,
    thickness=375e-9,
    e_count=2000,
    l_per_e=16,
    frames=120,
    fps=60.0,
)


def build(p: Values) -> Scene:
    """Build the scene: the first bubble above the second, both on their way to the origin."""
    half = 0.5 * p.gap * e_spacing([p.radius_1, p.radius_2], p.e_count)
    above = Bubble((0.0, p.radius_1 + half, 0.0), p.radius_1, (0.0, -p.approach_speed, 0.0), p.thickness_1)
    below = Bubble((0.0, -p.radius_2 - half, 0.0), p.radius_2, (0.0, p.approach_speed, 0.0), p.thickness_2)
    return p.scene("double_bubble", Cluster((above, below)))


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
