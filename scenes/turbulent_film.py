"""Decaying two-dimensional turbulence: a frame full of whirls of both signs.

Like whirls merge into larger ones, and what lies between them is drawn out to filaments. Energy stays with the large
whirls, enstrophy goes with the filaments. The stream function is a random sum of sin(k x) sin(h y), 0 along the
frame, of `whirls` half waves across the height and a quarter more or less.
"""

import numpy as np

try:
    from melp_warp.errors import require
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Key, Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Rectangle
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    width=1.5,
    height=1.0,
    whirls=(8, Key("-", "half waves of the first flow across the height", 1, 100, whole=True)),
    swirl=0.3,
    thickness=400e-9,
    noise=0.12,
    noise_frequency=3.0,
    noise_octaves=2,
    surfactant=4e-6,
    carrier="circulation",
    mixing=1.0,
    e_count=6000,
    l_per_e=16,
    frames=192,
    fps=24.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches = Perlin(p.seed + 1, p.noise_frequency, p.noise_octaves)
    return p.scene(
        "turbulent_film",
        Rectangle(p.width, p.height),
        thickness=lambda x: p.thickness * (1.0 + p.noise * patches.even(x)),
        velocity=whirls(p),
        waves={"whirls": 2.0 * p.height / p.whirls},
    )


def whirls(p: Values):
    """Flow of rms `swirl` of the random sum, a function of points [n, 3] m."""
    wave = np.pi / p.height * p.whirls
    k, h = (np.pi / size * np.arange(1, int(1.25 * wave * size / np.pi) + 1) for size in (p.width, p.height))
    k, h = (a.ravel() for a in np.meshgrid(k, h))
    shell = np.abs(np.hypot(k, h) - wave) <= 0.25 * wave
    require(shell.any(), "whirls", p.whirls, "at least the height over the width")
    k, h = k[shell], h[shell]
    share = np.random.default_rng(p.seed).normal(size=len(k))
    share *= p.swirl / np.sqrt(0.25 * np.sum(share**2 * (k**2 + h**2)))

    def flow(x):
        across, up = np.outer(x[:, 0] + 0.5 * p.width, k), np.outer(x[:, 1] + 0.5 * p.height, h)
        u = np.sin(across) * np.cos(up) @ (share * h)
        v = -np.cos(across) * np.sin(up) @ (share * k)
        return np.stack([u, v, 0.0 * u], axis=1)

    return flow


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
