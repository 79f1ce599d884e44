"""A big wobbling soap bubble whose thin patches rise and thick ones sink.

The bubble of MELP 2022, Figure 19: radius 0.1 m, displaced by two octaves of Perlin noise. With `puncture_time` it is
punctured from the right, where `slow_motion` may begin: `puncture_time=1 slow_from=1 slow_motion=15`.
The surfactant starts even, so that thickness differences persist and gravity drives the flow.
"""

import numpy as np

try:
    from melp_warp.bursting import Puncture
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import StarShaped, displaced_sphere
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    radius=0.1,
    displacement=0.06,
    displacement_frequency=5.0,
    displacement_octaves=2,
    thickness=425e-9,
    noise=0.18,
    noise_frequency=10.0,
    noise_octaves=2,
    surfactant=1e-6,
    gravity=9.81,
    lift=1.0,
    air="added_mass",
    drag=2e-4,
    swirl=0.1,
    puncture_time=None,
    flip=0.95,
    mixing=1.0,
    opening=0.0,
    e_count=2000,
    l_per_e=16,
    frames=300,
    fps=60.0,
    dt=1.0 / 120.0,  # larger steps are stable, but damp the wobble within a period
    seed=1,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    bumps = Perlin(p.seed, p.displacement_frequency, p.displacement_octaves)
    patches = Perlin(p.seed + 1, p.noise_frequency, p.noise_octaves)
    shape = displaced_sphere(p.radius, lambda d: p.displacement / p.radius * bumps(p.radius * d))
    right = () if p.puncture_time is None else (Puncture((p.radius, 0.0, 0.0), p.puncture_time),)
    return p.scene(
        "giant_bubble",
        shape,
        punctures=right,
        thickness=lambda x: p.thickness * (1.0 + p.noise * patches.even(x)),
        velocity=whirls(shape, Perlin(p.seed + 2, 1.0 / p.radius), p.swirl),
    )


def whirls(shape: StarShaped, stream: Perlin, speed: float):
    """A flow along the film that neither compresses nor stretches it: u = n x grad(stream), of rms `speed`."""

    def flow(x: np.ndarray) -> np.ndarray:
        return np.cross(shape.normals(x), stream.gradient(x))

    rms = np.sqrt(np.mean(np.sum(flow(shape.sample(2000).points) ** 2, axis=1)))
    return lambda x: speed / rms * flow(x)


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
