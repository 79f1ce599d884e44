"""A soap film in an upright frame drains until the surfactant carries its weight.

MELP 2022, Figures 13 and 16: at rest eta(z) = eta_0 (h/l) exp(-z/l) / (1 - exp(-h/l)) above the bottom, with
l = 2 R T Gamma_0 / (rho g eta_0) (Couder et al. 1989, normalised by mass). The drag of the air brings it to rest.
"""

try:
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Rectangle
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    width=0.15,
    height=0.2,
    tilt=0.0,
    thickness=400e-9,
    noise=0.0,
    noise_frequency=40.0,
    noise_octaves=2,
    surfactant=1e-7,
    gravity=9.81,
    drag=0.02,
    e_count=1200,
    l_per_e=16,
    frames=36,
    fps=60.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches = Perlin(p.seed, p.noise_frequency, p.noise_octaves)
    return p.scene(
        "drainage",
        Rectangle(p.width, p.height, p.tilt),
        thickness=lambda x: p.thickness * (1.0 + p.noise * patches.even(x)),
    )


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
