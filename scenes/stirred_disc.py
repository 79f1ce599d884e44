"""A disc of uneven thickness that whirls stir.

The whirls of MELP 2022, Figure 15, are stirred by a force; here they are there from the start. They fold the dye into
layers that get thinner until L no longer tell them apart.
"""

import numpy as np

try:
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Disc
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    radius=0.05,
    swirl=0.05,
    thickness=400e-9,
    noise=0.3,
    noise_frequency=25.0,
    noise_octaves=2,
    surfactant=4e-6,
    carrier="circulation",
    mixing=1.0,
    e_count=2500,
    l_per_e=16,
    frames=192,
    fps=24.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches = Perlin(p.seed, p.noise_frequency, p.noise_octaves)
    return p.scene(
        "stirred_disc",
        Disc(p.radius),
        thickness=lambda x: p.thickness * (1.0 + p.noise * patches.even(x)),
        velocity=whirls(Disc(p.radius), Perlin(p.seed + 1, 1.2 / p.radius), p.radius, p.swirl),
    )


def whirls(shape: Disc, stream: Perlin, radius: float, speed: float):
    """Flow of rms `speed` of a stream function, noise that falls to 0 at the rim, a function of points [n, 3] m."""

    def flow(x):
        inside = 1.0 - np.sum(x**2, axis=1, keepdims=True) / radius**2
        slope = inside**2 * stream.gradient(x) - 4.0 / radius**2 * inside * x * stream(x)[:, None]
        return np.cross([0.0, 1.0, 0.0], slope)

    rms = np.sqrt(np.mean(np.sum(flow(shape.sample(2000).points) ** 2, axis=1)))
    return lambda x: speed / rms * flow(x)


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
