"""A bubble is blown up to twice its radius, rests, and is let out again."""

try:
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Sphere
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    radius=0.04,
    growth=2.0,
    growth_time=2.0,
    thickness=1000e-9,
    noise=0.2,
    noise_frequency=40.0,
    noise_octaves=2,
    air="added_mass",
    drag=1e-3,
    respacing=1.2,
    e_count=2000,
    l_per_e=16,
    frames=300,
    fps=60.0,
    dt=1.0 / 240.0,  # the pressure lags behind by a step
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches, blown = Perlin(p.seed, p.noise_frequency, p.noise_octaves), p.growth**3
    times = (p.growth_time, p.growth_time + 0.5, 2.0 * p.growth_time + 0.5)
    return p.scene(
        "inflation",
        Sphere(p.radius),
        gas=tuple(zip(times, (blown, blown, 1.0), strict=True)),
        thickness=lambda x: p.thickness * (1.0 + p.noise * patches.even(x)),
    )


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
