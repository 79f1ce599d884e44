"""Four equal bubbles meet: six films, four lines that join in a point at 109.47 degrees.

The centres start at the corners of a regular tetrahedron and move to its middle; Table 2 of MELP 2022.
"""

import numpy as np

try:
    from melp_warp.cluster import Cluster, approaching, e_spacing
    from melp_warp.parameters import FOAM, Values, declare
    from melp_warp.scene import Scene
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    **FOAM | {"damping": 20.0},
    radius=0.05,
    gap=1.0,
    approach_speed=0.2,
    thickness=400e-9,
    e_count=3200,
    l_per_e=16,
    frames=45,
    fps=60.0,
)


def build(p: Values) -> Scene:
    """Build the scene: one bubble on top of three."""
    angle = np.radians([90.0, 210.0, 330.0])
    ring = np.column_stack([np.sqrt(8.0) * np.sin(angle), np.full(3, -1.0), np.sqrt(8.0) * np.cos(angle)]) / 3.0
    corners = np.vstack([[0.0, 1.0, 0.0], ring])
    gap = p.gap * e_spacing(4 * [p.radius], p.e_count)
    return p.scene("quadruple_bubble", Cluster(approaching(corners, p.radius, gap, p.approach_speed)))


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
