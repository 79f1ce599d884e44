"""Two holes open in a flat film and meet: their rims hit each other and fly off in drops."""

try:
    from melp_warp.bursting import Puncture
    from melp_warp.noise import Perlin
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import Rectangle
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    width=0.15,
    height=0.1,
    thickness=400e-9,
    noise=0.2,
    noise_frequency=60.0,
    noise_octaves=2,
    puncture_time=0.0,
    hole=0.002,
    separation=0.06,
    breakup=20.0,
    e_count=3000,
    l_per_e=16,
    frames=130,
    fps=60.0,
    slow_motion=500.0,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    patches = Perlin(p.seed, p.noise_frequency, p.noise_octaves)
    places = [(-0.5 * p.separation, 0.0, 0.0), (0.5 * p.separation, 0.0, 0.0)]
    holes = [] if p.puncture_time is None else [Puncture(place, p.puncture_time, p.hole) for place in places]
    return p.scene(
        "burst_pair",
        Rectangle(p.width, p.height),
        punctures=holes,
        thickness=lambda x: p.thickness * (1.0 + p.noise * patches.even(x)),
    )


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
