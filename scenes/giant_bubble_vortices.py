"""Vortices of both signs chase each other over a bubble a metre across (Tao et al. 2024).

Gaussian vortices of circulation +-Gamma at random places, as many of one sign as of the other. The bubble hovers, and
its shape hardly changes.
"""

import numpy as np

try:
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Key, Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Sphere, fibonacci_sphere
    from melp_warp.vortices import sphere_vortex
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    radius=0.5,
    pairs=(6, Key("-", "number of vortices of each sign", 1, 100, whole=True)),
    core=(0.1, Key("m", "radius a of the vortices", 0.0, 10.0, above=True)),
    circulation=(0.3, Key("m^2/s", "circulation of each vortex, of both signs", -100.0, 100.0)),
    thickness=400e-9,
    noise=0.4,
    noise_frequency=4.0,
    noise_octaves=2,
    surfactant=4e-6,
    carrier="circulation",
    mixing=1.0,
    e_count=4000,
    l_per_e=16,
    frames=192,
    fps=24.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches = Perlin(p.seed, p.noise_frequency, p.noise_octaves)
    return p.scene(
        "giant_bubble_vortices",
        Sphere(p.radius),
        thickness=lambda x: p.thickness * (1.0 + p.noise * patches.even(x)),
        velocity=lambda x: flow(x, p),
        waves={"core": 4.0 * p.core},
    )


def flow(x: np.ndarray, p: Values) -> np.ndarray:
    """Sum of the vortices, [n, 3] m/s."""
    random = np.random.default_rng(p.seed)
    centres = fibonacci_sphere(2 * p.pairs)
    turn = p.circulation * random.permutation(np.resize([1.0, -1.0], 2 * p.pairs))
    pairs = zip(centres, turn, strict=True)
    return sum(sphere_vortex(x, centre, p.core, strength) for centre, strength in pairs)


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
