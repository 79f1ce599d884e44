"""A flat disc of uneven thickness that the Marangoni flow evens out.

MELP 2022, Figure 16: thick places hold more surfactant, whose spreading carries the liquid along until both are even.
The drag of the air (held still 0.7 mm away on both sides) makes that a slow creep instead of a wave.
"""

try:
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Disc
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    radius=0.05,
    thickness=400e-9,
    noise=0.4,
    noise_frequency=25.0,
    noise_octaves=2,
    surfactant=1e-7,
    drag=0.05,
    e_count=1050,
    l_per_e=16,
    frames=36,
    fps=120.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches = Perlin(p.seed, p.noise_frequency, p.noise_octaves)

    def unevenness(x):
        return 1.0 + p.noise * patches.even(x)

    return p.scene(
        "equilibrium",
        Disc(p.radius),
        thickness=lambda x: p.thickness * unevenness(x),
        concentration=lambda x: p.surfactant * unevenness(x),
    )


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
