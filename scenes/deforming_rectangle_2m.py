"""A swinging sheet of 4 x 2 m, thick on top and thin below, turns over (Tao et al. 2024).

The surfactant starts where it carries the film's weight, so that nothing falls as a whole. Thick film sinks through
thin in fingers whose edges roll up into vortices, while the sheet swings to and fro against the air.
"""

import numpy as np

try:
    from melp_warp.errors import require
    from melp_warp.keyframes import value_at
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Key, Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Rectangle
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    width=4.0,
    height=2.0,
    thickness=300e-9,
    contrast=(200e-9, Key("m", "thickness along the upper edge less that along the lower", -1e-4, 1e-4)),
    swing=(0.15, Key("m/s", "speed of the middle at the start, out of the plane", -10.0, 10.0)),
    noise=0.02,
    noise_frequency=2.0,
    noise_octaves=2,
    surfactant=4e-6,
    gravity=9.81,
    air="added_mass",
    carrier="circulation",
    mixing=2.0,
    e_count=4050,
    l_per_e=16,
    frames=96,
    fps=24.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches = Perlin(p.seed, p.noise_frequency, p.noise_octaves)
    mean, slope = p.thickness, p.contrast / p.height
    require(abs(p.contrast) < 2.0 * mean, "contrast", p.contrast, f"below twice the thickness, {2.0 * mean:g} m")
    weight = p.density * value_at(p.gravity, 0.0) / (2.0 * p.material.rt)

    def thickness(x):
        return (mean + slope * x[:, 1]) * (1.0 + p.noise * patches.even(x))

    def concentration(x):
        """Where 2 R T dGamma/dy = rho g eta, of mean `surfactant`."""
        below = mean * x[:, 1] + 0.5 * slope * (x[:, 1] ** 2 - p.height**2 / 12.0)
        return p.surfactant - weight * below

    def velocity(x):
        out = np.cos(np.pi * x[:, 0] / p.width) * np.cos(np.pi * x[:, 1] / p.height)
        return p.swing * out[:, None] * np.array([0.0, 0.0, 1.0])

    shape = Rectangle(p.width, p.height, flat=False)
    lowest = p.surfactant - weight * (0.5 * mean * p.height + slope * p.height**2 / 12.0)
    require(lowest > 0.0, "surfactant", p.surfactant, f"above {p.surfactant - lowest:.3g}, which carries the film")
    return p.scene("deforming_rectangle_2m", shape, thickness=thickness, concentration=concentration, velocity=velocity)


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
