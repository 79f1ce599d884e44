"""Four vortices, two pairs on one axis, run after and through each other (Tao et al. 2024).

Gaussian vortices of circulation Gamma and vorticity Gamma/(pi a^2) exp(-r^2/a^2), those above the axis turning one way
and those below the other. The inner pair is faster, runs ahead, widens and slows down, and the outer one passes through
it. Point vortices of this ratio of distances, 1/3, leapfrog (> 0.172) but not for good (< 0.382; Acheson 2000). The
surfactant keeps the film as good as incompressible.
"""

import numpy as np

try:
    from melp_warp.errors import require
    from melp_warp.parameters import Key, Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Rectangle
    from melp_warp.vortices import gaussian_vortex
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    width=6.0,
    height=3.0,
    core=(0.1, Key("m", "radius a of the vortices", 0.0, 10.0, above=True)),
    circulation=(1.0, Key("m^2/s", "circulation of each vortex", -100.0, 100.0)),
    spacing_inner=(0.4, Key("m", "distance within the inner pair", 0.0, 100.0, above=True)),
    spacing_outer=(1.2, Key("m", "distance within the outer pair", 0.0, 100.0, above=True)),
    thickness=400e-9,
    noise=0.05,
    surfactant=4e-6,
    carrier="circulation",
    mixing=0.5,
    e_count=8192,
    l_per_e=16,
    frames=192,
    fps=24.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    require(p.spacing_inner < p.spacing_outer, "spacing_inner", p.spacing_inner, "below spacing_outer")
    require(p.spacing_outer < p.height, "spacing_outer", p.spacing_outer, f"below height = {p.height:g} m")
    vortices = with_images(quartet(p), p.width, p.height)

    def velocity(x):
        """Sum of the vortices and of their images beyond the walls, [n, 3] m/s."""
        return sum(gaussian_vortex(x - center, p.core, turn) for center, turn in vortices)

    def thickness(x):
        """Dye: bands along the axis, [n] m."""
        return p.thickness * (1.0 + p.noise * np.cos(2.0 * np.pi * x[:, 1] / p.spacing_outer))

    return p.scene("leapfrog", Rectangle(p.width, p.height), thickness=thickness, velocity=velocity)


def quartet(p: Values) -> list[tuple[np.ndarray, float]]:
    """Centres (m) and circulations (m^2/s) of the four vortices, a quarter of the width from the left."""
    return [
        (np.array([-0.25 * p.width, 0.5 * side * spacing, 0.0]), side * p.circulation)
        for spacing in (p.spacing_inner, p.spacing_outer)
        for side in (1.0, -1.0)
    ]


def with_images(vortices, width: float, height: float):
    """The vortices and their nearest mirror images, so that nothing flows through the walls."""
    flips = [(sx, sy) for sx in (-1, 0, 1) for sy in (-1, 0, 1)]

    def image(center, sx, sy):
        x = sx * width - center[0] if sx else center[0]
        y = sy * height - center[1] if sy else center[1]
        return np.array([x, y, 0.0])

    return [
        (image(center, sx, sy), turn * (-1.0) ** (abs(sx) + abs(sy))) for center, turn in vortices for sx, sy in flips
    ]


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
