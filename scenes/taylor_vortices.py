"""Two like vortices on a flat film: 0.81 m apart they must part, nearer they merge.

Vortex particle-on-mesh 2024, Figures 10 and 11, after McKenzie (2007): a Taylor vortex of core radius a and speed U
turns at U (r/a) exp((1 - r^2/a^2)/2), so its vorticity U/a (2 - r^2/a^2) exp((1 - r^2/a^2)/2) adds up to nothing.
With a = 0.3 m, a separation of 0.81 m lies just above the critical one. The surfactant keeps the film as good as
incompressible, and the thickness is dye, a little more in the vortices than around them.
"""

import numpy as np

try:
    from melp_warp.errors import require
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Rectangle
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    width=4.0,
    height=4.0,
    separation=0.81,
    vortex_radius=0.3,
    vortex_speed=1.0,
    thickness=400e-9,
    noise=0.12,
    noise_frequency=1.5,
    noise_octaves=2,
    surfactant=4e-6,
    carrier="circulation",
    mixing=0.5,
    e_count=4900,
    l_per_e=16,
    frames=192,
    fps=24.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    require(p.separation < p.width, "separation", p.separation, f"below width = {p.width:g} m")
    patches = Perlin(p.seed, p.noise_frequency, p.noise_octaves)
    centers = 0.5 * p.separation * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])

    def velocity(x):
        """Sum of both vortices, [n, 3] m/s."""
        return sum(vortex(x - center, p.vortex_radius, p.vortex_speed) for center in centers)

    def thickness(x):
        """Dye, [n] m."""
        cores = sum(np.exp(-0.5 * np.sum((x - center) ** 2, axis=1) / p.vortex_radius**2) for center in centers)
        return p.thickness * (1.0 + p.noise * (0.8 * (2.0 * cores - 1.0) + 0.2 * patches.even(x)))

    shape = Rectangle(p.width, p.height)
    waves = {"vortex_radius": 4.0 * p.vortex_radius}  # from the fastest flow to the fastest flow the other way, twice
    return p.scene("taylor_vortices", shape, thickness=thickness, velocity=velocity, waves=waves)


def vortex(x: np.ndarray, radius: float, speed: float) -> np.ndarray:
    """[n, 3] m/s velocity of a Taylor vortex about z at offsets x [n, 3] m from its centre."""
    squared = np.sum(x * x, axis=1) / radius**2
    turning = speed / radius * np.exp(0.5 * (1.0 - squared))
    return turning[:, None] * np.cross([0.0, 0.0, 1.0], x)


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
