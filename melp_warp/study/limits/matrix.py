"""All extremes, and the outcome that each must have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from melp_warp.cluster import Bubble, Wall
from melp_warp.registry import load_scene
from melp_warp.shapes import Disc, Ellipsoid, Rectangle, Shape, Sphere
from melp_warp.study.limits.judging import (
    REFUSED,
    STOPPED,
    WRONG,
    Case,
    Error,
    emptied,
    energy,
    fall,
    flight,
    pressure,
    round_,
    spread_mass,
)
from melp_warp.study.limits.scenes import (
    RADIUS,
    along,
    carried_out,
    collinear,
    dumbbell,
    duplicated,
    film,
    foam,
    halves,
    meeting,
    moved_by,
    ringing,
    spiky,
    stray,
    thrown,
)
from melp_warp.study.validation import GRAVITY, small_giant

_BALL = Sphere(RADIUS)


_FAR = (1000.0, 0.0, 0.0)


_STILL = (pressure, round_)


_FRAME = Rectangle(0.1, 0.1)


_FLOOR = Wall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def _squashed() -> Ellipsoid:
    return Ellipsoid(0.05, 0.01, 0.05)


def _ringing_scene(**given) -> Callable[[], list[Error]]:
    script = load_scene("oscillating_bubble")
    return lambda: carried_out(script.build(script.parameters.values(given)), 1)


def _needle() -> Shape:
    return Ellipsoid(0.1, 0.02, 0.02)


def _turning(x: np.ndarray) -> np.ndarray:
    return 100.0 / 0.05 * np.stack([x[:, 1], -x[:, 0], 0.0 * x[:, 0]], axis=1)


def _swirling(speed: float, **given) -> Callable[[], list[Error]]:
    return lambda: carried_out(small_giant(600, 4, swirl=speed, **given), 3)


def _whole_giant(**given) -> Callable[[], list[Error]]:
    return lambda: carried_out(small_giant(600, 4, **given), 24, (round_, pressure))


MATRIX = (
    Case("thickness", "5 nm", film(_BALL, *_STILL, thickness=5e-9)),
    Case("thickness", "5 nm, falling", film(_BALL, fall(GRAVITY), thickness=5e-9, gravity=(0, -GRAVITY, 0))),
    Case("thickness", "20 um", film(_BALL, *_STILL, thickness=20e-6)),
    Case("thickness", "20 um, falling", film(_BALL, fall(GRAVITY), thickness=2e-5, gravity=(0, -GRAVITY, 0))),
    Case("thickness", "100:1 across a spacing, bubble", film(_BALL, *_STILL, thickness=halves(4e-8, 4e-6))),
    Case("thickness", "100:1 across a spacing, flat film", film(_FRAME, thickness=halves(4e-8, 4e-6), frames=20)),
    Case("tension", "1e-3 N/m", film(_BALL, *_STILL, tension=1e-3)),
    Case("tension", "0.5 N/m", film(_BALL, *_STILL, tension=0.5)),
    Case("surfactant", "0, bubble", film(_BALL, *_STILL, surfactant=0.0)),
    Case("surfactant", "0, flat film at rest", film(Disc(0.05), spread_mass, surfactant=0.0)),
    Case(
        "surfactant",
        "0, upright film under gravity",
        film(_FRAME, emptied(GRAVITY, _FRAME.height), surfactant=0.0, gravity=(0, -GRAVITY, 0), frames=6),
    ),
    Case("surfactant", "1e-5 mol/m^2", film(_BALL, *_STILL, surfactant=1e-5)),
    Case("surfactant", "3e-5 mol/m^2: no tension left", film(_BALL, *_STILL, surfactant=3e-5), REFUSED),
    Case("radius", "1 mm", film(Sphere(1e-3), *_STILL)),
    Case("radius", "1 mm, added mass of the air", film(Sphere(1e-3), *_STILL, air="added_mass")),
    Case("radius", "1 mm, ringing", ringing(radius=1e-3)),
    Case("radius", "10 m", film(Sphere(10.0), *_STILL)),
    Case("radius", "10 m, added mass of the air", film(Sphere(10.0), *_STILL, air="added_mass")),
    Case("radius", "10 m, ringing", ringing(radius=10.0), slow=True),
    Case("E", "60, support 4", film(_BALL, *_STILL, e_count=60, support=4.0), REFUSED),
    Case("E", "60, support 2", film(_BALL, *_STILL, e_count=60, support=2.0)),
    Case("E", "60, support 2, ringing in air", ringing(air="added_mass", e_count=60, support=2.0), WRONG),
    Case("E", "20,000", film(_BALL, *_STILL, e_count=20_000, l_per_e=1, frames=2), slow=True),
    Case("E", "200,000", film(_BALL, *_STILL, e_count=200_000, l_per_e=0, frames=2), slow=True),
    Case("L per E", "0", film(_BALL, *_STILL, l_per_e=0)),
    Case("L per E", "0, flat film", film(_FRAME, l_per_e=0), REFUSED),
    Case("L per E", "1", film(_BALL, *_STILL, l_per_e=1)),
    Case("L per E", "64", film(_BALL, *_STILL, l_per_e=64, frames=1)),
    Case("L per E", "256", film(_BALL, *_STILL, l_per_e=256, frames=3), slow=True),
    Case("dt", "1e-6 s", film(_BALL, *_STILL, dt=1e-6, fps=1e5, frames=2)),
    Case("dt", "1e-8 s at 60 frames a second", film(_BALL, dt=1e-8), REFUSED),
    Case("dt", "0.1 s", film(_BALL, *_STILL, dt=0.1, fps=10.0)),
    Case("dt", "0.1 s, giant_bubble", lambda: carried_out(small_giant(600, 4, dt=0.1, fps=10.0), 3, (pressure,))),
    Case(
        "dt", "1/60 s, midpoint rule, giant_bubble without air", _whole_giant(scheme="trapezoid", air="none", dt=1 / 60)
    ),
    Case("dt", "1/120 s, explicit, giant_bubble", _whole_giant(scheme="explicit"), STOPPED),
    Case("speed", "bubble flying at 100 m/s", film(_BALL, *_STILL, flight(100.0), velocity=along(100, 0, 0))),
    Case(
        "speed",
        "the same for 50 m, 500 diameters",
        film(_BALL, *_STILL, flight(100.0), velocity=along(100, 0, 0), frames=30),
    ),
    Case("speed", "whirls of 10 m/s, giant_bubble", _swirling(10.0), slow=True),
    Case("speed", "whirls of 100 m/s, giant_bubble", _swirling(100.0), STOPPED, slow=True),
    Case(
        "speed",
        "flat film turning at 100 m/s in its frame",
        film(_FRAME, velocity=_turning, frames=2),
        STOPPED,
        slow=True,
    ),
    Case(
        "speed",
        "every particle at random, 100 m/s",
        film(_BALL, energy, velocity=lambda x: 100.0 * np.random.default_rng(0).normal(size=x.shape), frames=1),
        STOPPED,
        slow=True,
    ),
    Case("place", "1 km from the origin, spacing 1 mm", film(Sphere(0.01, _FAR), *_STILL, e_count=1000)),
    Case(
        "place",
        "1 km from the origin, flying at 10 m/s",
        film(Sphere(0.01, _FAR), *_STILL, flight(10.0), velocity=along(10, 0, 0), frames=30),
    ),
    Case("gravity", "100 g, falling", film(_BALL, fall(981.0), gravity=(0, -981.0, 0))),
    Case("gravity", "100 g, hovering", film(_BALL, gravity=(0, -981.0, 0), lift=1.0, frames=3), STOPPED, slow=True),
    Case(
        "gravity",
        "100 g, upright film",
        film(_FRAME, emptied(981.0, _FRAME.height), gravity=(0, -981.0, 0), frames=6),
        slow=True,
    ),
    Case("solves", "one iteration, giant_bubble", _whole_giant(max_iterations=1), STOPPED),
    Case("solves", "liquid of 1e-30 kg/m^3", _whole_giant(density=1e-30), STOPPED),
    Case("pressure", "0", film(_BALL, *_STILL, pressure=0.0)),
    Case("pressure", "1e8 Pa", film(_BALL, *_STILL, pressure=1e8)),
    Case("shape", "squashed 5:1, 600 E", film(_squashed, energy), REFUSED),
    Case(
        "shape",
        "squashed 5:1, in air",
        film(_squashed, energy, e_count=1700, air="added_mass", dt=None, l_per_e=1, frames=3),
        slow=True,
    ),
    Case(
        "shape",
        "squashed 5:1, in a vacuum, dt 1/60 s",
        film(_squashed, energy, e_count=1700, frames=3),
        STOPPED,
        slow=True,
    ),
    Case("shape", "dumbbell, in a vacuum", film(dumbbell, energy, e_count=1200, frames=6), slow=True),
    Case("shape", "the same, support 4", film(dumbbell, energy, e_count=1200, support=4.0, frames=6), slow=True),
    Case(
        "shape",
        "dumbbell, in air",
        film(dumbbell, energy, e_count=1000, air="added_mass", frames=6),
        slow=True,
    ),
    Case(
        "shape",
        "needle 5:1, in air",
        film(_needle, energy, e_count=3000, air="added_mass", dt=None, l_per_e=1, frames=3),
        slow=True,
    ),
    Case("shape", "waves of mode 12, 2.1 spacings each", _ringing_scene(mode=12, amplitude=0.5, e_count=300), REFUSED),
    Case(
        "shape",
        "the same, by a script that does not tell of them",
        film(spiky, e_count=300, l_per_e=0, scheme="trapezoid", fps=2500.0, dt=2e-4),
        STOPPED,
    ),
    Case("particles", "five E and five L on top of others", film(_BALL, *_STILL, touch=duplicated, frames=10)),
    Case("particles", "E of a patch on one line", film(_BALL, *_STILL, touch=collinear, frames=10), STOPPED),
    Case("particles", "the same, support 4", film(_BALL, *_STILL, touch=collinear, support=4.0, frames=10), slow=True),
    Case("particles", "one L ten radii off", film(_BALL, *_STILL, touch=stray(0.0))),
    Case("particles", "a tenth of the L ten radii off", film(_BALL, *_STILL, touch=stray(0.1)), STOPPED),
    Case("foam", "two bubbles meeting at 2 m/s", foam(meeting(2.0), frames=3)),
    Case("foam", "two bubbles meeting at 20 m/s", foam(meeting(20.0), frames=2), STOPPED, slow=True),
    Case("foam", "the same, in a vacuum", foam(meeting(20.0), air="none"), STOPPED, slow=True),
    Case("foam", "at 3 m/s, in a vacuum", foam(meeting(3.0), air="none", frames=3), slow=True),
    Case(
        "foam",
        "a bubble inside another",
        foam(lambda: (Bubble((0, 0, 0), 0.05), Bubble((0, 0, 0), 0.02))),
        REFUSED,
    ),
    Case("foam", "two bubbles 1 km from the origin", foam(lambda: moved_by(meeting(0.2), _FAR), frames=6)),
    Case("foam", "two bubbles thrown at a wall at 1 m/s", foam(lambda: thrown(1.0), walls=(_FLOOR,), frames=3)),
    Case("foam", "the same at 18 m/s", foam(lambda: thrown(18.0), walls=(_FLOOR,), frames=2), slow=True),
    Case("foam", "the same at 26 m/s", foam(lambda: thrown(26.0), walls=(_FLOOR,), frames=2), STOPPED, slow=True),
    Case("foam", "midpoint rule", foam(meeting(0.2), scheme="trapezoid"), REFUSED),
    Case("foam", "lift", foam(meeting(0.2), lift=1.0), REFUSED),
)
"""All cases."""
