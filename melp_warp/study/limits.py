"""The extremes: runs at the edges of what can be asked for, each with a verdict.

A case is a run that ends in one of four ways, see `OUTCOMES`; anything else (a number that is not finite, liquid that
is lost, another exception) is an error of the program. The tests run the quick ones, `tools/limits.py` all of them, and
writes docs/limits.md. `random_scene` draws scenes from the whole range of every key.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from melp_warp.cluster import Bubble, Cluster, Merge, Pop, Wall, e_spacing
from melp_warp.errors import InputError, SimulationError
from melp_warp.material import GAS_CONSTANT, Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.parameters import Key, Value, Values
from melp_warp.registry import load_scene, scene_names
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Ellipsoid, Rectangle, Shape, Sphere, StarShaped, displaced_sphere
from melp_warp.simulation import Simulation
from melp_warp.study.validation import GRAVITY, e_points, oscillation, small_giant

ACCURATE, WRONG, REFUSED, STOPPED = "accurate", "stable, off", "refused", "stopped"
OUTCOMES = (ACCURATE, WRONG, REFUSED, STOPPED)
"""Stable and within the bounds; stable but beyond one of them; refused when made; stopped on the way, naming the stage,
with the last good frame kept."""

CONSERVED = 1e-5
"""Bound on the relative change of mass and surfactant."""


@dataclass(frozen=True)
class Error:
    """How far a run is from what it should be.

    Attributes:
        what: the quantity and what it is compared with.
        value: relative error.
        bound: up to which it counts as accurate.
    """

    what: str
    value: float
    bound: float

    def __str__(self) -> str:
        return f"{self.what} {100.0 * self.value:.2g} %" if self.value >= 1e-5 else f"{self.what} {self.value:.0e}"


@dataclass(frozen=True)
class Case:
    """One extreme.

    Attributes:
        topic: what is extreme.
        setting: how far.
        run: carries it out and returns the errors.
        expected: the outcome that it must have.
        slow: whether it takes more than about a second.
    """

    topic: str
    setting: str
    run: Callable[[], list[Error]]
    expected: str = ACCURATE
    slow: bool = False


@dataclass(frozen=True)
class Verdict:
    """What came of a case.

    Attributes:
        outcome: one of `OUTCOMES`.
        detail: the errors, or the message.
        seconds: wall time.
    """

    outcome: str
    detail: str
    seconds: float


class Nonsense(AssertionError):
    """A run that went on with numbers that cannot be."""


def judge(case: Case) -> Verdict:
    """Carry out a case.

    Raises:
        Nonsense: the run went on with numbers that cannot be.
    """
    began = time.perf_counter()
    try:
        errors = case.run()
    except (InputError, SimulationError) as error:
        outcome, detail = (REFUSED if isinstance(error, InputError) else STOPPED), str(error)
    else:
        worst = [e for e in errors if not e.value <= e.bound]
        outcome, detail = (WRONG if worst else ACCURATE), "; ".join(map(str, worst or errors))
    return Verdict(outcome, detail, time.perf_counter() - began)


# Runs of films


class Run:
    """A simulation before and after its frames.

    Attributes:
        simulation: as it is now.
        first: diagnostics at the start.
        centre: [3] middle of the E at the start, m.
    """

    def __init__(self, scene: Scene):
        self.scene, self.simulation = scene, Simulation(scene)
        self.first, self.centre = self.simulation.diagnostics(), self.middle()

    def middle(self) -> np.ndarray:
        """Middle of the E, [3] m."""
        return e_points(self.simulation).mean(axis=0) + self.simulation.state.origin

    def radii(self) -> np.ndarray:
        """Distance of the E from their middle, [n_e] m."""
        x = e_points(self.simulation)
        return np.linalg.norm(x - x.mean(axis=0), axis=1)

    def advance(self, frames: int) -> None:
        """Advance, and look at every frame.

        Raises:
            SimulationError: the run stopped; its state is the last good one.
            Nonsense: it did not, but should have.
        """
        for _ in range(frames):
            try:
                self.simulation.advance_frame()
            finally:
                check_sound(self.simulation)

    def conserved(self) -> list[Error]:
        """Mass and surfactant as at the start, with what popped or a rim collected; the gas obeys its law."""
        simulation = self.simulation
        now = simulation.diagnostics()
        kept = {name: now[name] + now.get(f"border_{name}", 0.0) for name in ("mass", "surfactant")}
        wanted = self.first["mass"] - simulation.spilled
        errors = [Error("mass", abs(kept["mass"] / wanted - 1.0), CONSERVED)]
        if self.first["surfactant"] > 0.0 and simulation.spilled == 0.0:
            errors.append(Error("surfactant", abs(kept["surfactant"] / self.first["surfactant"] - 1.0), CONSERVED))
        if simulation.film.features.closed:
            gas = simulation.state.gas.numpy()
            pressure = self.scene.surroundings.pressure + gas[:, 1]
            errors.append(Error("gas law", float(np.abs(pressure * gas[:, 0] / gas[:, 2] - 1.0).max()), 1e-3))
        return errors


def check_sound(simulation: Simulation) -> None:
    """Raise where a state holds numbers that cannot be.

    Raises:
        Nonsense: a number is not finite, a volume, thickness or mass is not above 0. A rim may have taken a mass.
    """
    state = simulation.state.numpy()
    for name, array in state.items():
        if not np.all(np.isfinite(array)):
            raise Nonsense(f"{name} is not finite")
    if "l.eta" in state and not np.all(state["l.eta"] > 0.0):
        raise Nonsense("l.eta is not above 0")
    if "l.mass" in state and not np.all(state["l.mass"] >= 0.0 if "border" in state else state["l.mass"] > 0.0):
        raise Nonsense("l.mass is not above 0")
    if simulation.film.features.closed and not np.all(state["gas"][:, 0] > 0.0):
        raise Nonsense("a volume is not above 0")


Measure = Callable[[Run], Error]


def pressure(run: Run) -> Error:
    """Gauge pressure against Young-Laplace at the mean radius: rough for a bubble that wobbles."""
    exact = 4.0 * run.scene.material.film_tension / run.radii().mean()
    return Error("pressure", abs(run.simulation.diagnostics()["pressure"] / exact - 1.0), 0.03)


def round_(run: Run) -> Error:
    """Departure from a sphere."""
    r = run.radii()
    return Error("roundness", float(np.ptp(r) / r.mean()), 0.01)


def energy(run: Run) -> Error:
    """Surface and kinetic energy must not grow."""
    parts = ("surface_energy", "kinetic_energy")
    before, now = (sum(d[name] for name in parts) for d in (run.first, run.simulation.diagnostics()))
    return Error("energy gained", max(0.0, now / before - 1.0), 0.01)


def moved(exact: Callable[[float], np.ndarray], what: str) -> Measure:
    """The way of the film's middle against `exact` (time in s -> [3] m)."""

    def measure(run: Run) -> Error:
        way = exact(run.simulation.time)
        return Error(what, float(np.linalg.norm(run.middle() - run.centre - way) / np.linalg.norm(way)), 5e-3)

    return measure


def fall(gravity: float) -> Measure:
    """Free fall: g t^2/2."""
    return moved(lambda t: np.array([0.0, -0.5 * gravity * t**2, 0.0]), "free fall")


def flight(speed: float) -> Measure:
    """Uniform motion along x."""
    return moved(lambda t: np.array([speed * t, 0.0, 0.0]), "way flown")


def spread_mass(run: Run) -> Error:
    """How far the E are from carrying liquid everywhere: the share of E with less than a hundredth of the mean."""
    mass = run.simulation.state.e.mass.numpy()
    return Error("film run dry", float(np.mean(mass <= 0.01 * mass.mean())), 0.0)


def emptied(gravity: float, height: float) -> Measure:
    """Liquid in the border of an upright film that nothing holds up: g t^2/2 over its height."""

    def measure(run: Run) -> Error:
        now = run.simulation.diagnostics()
        fallen = min(0.5 * gravity * run.simulation.time**2 / height, 1.0)
        return Error("liquid not where it falls", abs(now["border_mass"] / run.first["mass"] - fallen), 0.05)

    return measure


def film(
    shape: Shape | Callable[[], Shape],
    *measures: Measure,
    e_count: int = 600,
    l_per_e: int = 4,
    frames: int = 6,
    touch: Callable[[Simulation], None] | None = None,
    **values,
) -> Callable[[], list[Error]]:
    """A run of a film as `Case.run`.

    Args:
        shape: its geometry, or what makes it.
        *measures: what to compare besides what must be conserved.
        e_count: number of E.
        l_per_e: L an E.
        frames: how many.
        touch: changes the particles before the run.
        **values: of Material, Surroundings, Numerics and Scene, by name. Steps are of 1/60 s where nothing is said.
    """
    kinds = {kind: {f.name for f in fields(kind)} for kind in (Material, Surroundings, Numerics)}
    given = {kind: {k: v for k, v in values.items() if k in names} for kind, names in kinds.items()}
    if callable(values.get("thickness")):
        del given[Material]["thickness"]
    taken = set().union(*given.values())

    def run() -> list[Error]:
        scene = Scene(
            "extreme",
            shape() if not isinstance(shape, Shape) else shape,
            e_count,
            l_per_e,
            material=Material(**given[Material]),
            surroundings=Surroundings(**given[Surroundings]),
            numerics=Numerics(**given[Numerics]),
            **{"dt": 1.0 / 60.0, **{k: v for k, v in values.items() if k not in taken}},
        )
        return carried_out(scene, frames, measures, touch)

    return run


def carried_out(scene: Scene, frames: int, measures: tuple[Measure, ...] = (), touch=None) -> list[Error]:
    """Run a scene and return its errors: the measures, then what must be conserved."""
    run = Run(scene)
    if touch:
        touch(run.simulation)
    run.advance(frames)
    return [*(measure(run) for measure in measures), *run.conserved()]


def along(*velocity: float) -> Callable[[np.ndarray], np.ndarray]:
    """The same velocity everywhere, m/s."""
    return lambda x: np.tile(np.array(velocity, dtype=np.float64), (len(x), 1))


def halves(thin: float, thick: float) -> Callable[[np.ndarray], np.ndarray]:
    """Thickness that jumps at x = 0, m."""
    return lambda x: np.where(x[:, 0] > 0.0, thick, thin)


def ringing(**given) -> Callable[[], list[Error]]:
    """A bubble rings in mode 2, against Lamb's frequency."""

    def run() -> list[Error]:
        found = oscillation(**{"e_count": 600, "periods": 2.0, **given})
        return [Error("frequency", abs(found["error"]), 0.02)]

    return run


# Particles put where they should not be


def duplicated(simulation: Simulation) -> None:
    """Put five E each onto its neighbour in the list, and five L likewise."""
    for array in (simulation.state.e.x, simulation.state.l.x):
        x = array.numpy()
        x[10:20:2] = x[11:21:2]
        array.assign(x)
    simulation.rebuild(moved=True)


def collinear(simulation: Simulation) -> None:
    """Put the E within three spacings of the pole onto one line."""
    x = simulation.state.e.x.numpy()
    pole = x[np.argmax(x[:, 1])]
    near = np.linalg.norm(x - pole, axis=1) < 3.0 * simulation.film.spacing
    x[near, 2] = pole[2]
    simulation.state.e.x.assign(x)
    simulation.rebuild(moved=True)


def stray(share: float) -> Callable[[Simulation], None]:
    """Put a share of the L, one at least, ten radii off."""

    def touch(simulation: Simulation) -> None:
        x = simulation.state.l.x.numpy()
        count = max(1, round(share * len(x)))
        x[:count] *= 10.0
        simulation.state.l.x.assign(x)
        simulation.rebuild(moved=True)

    return touch


# Foams


def foam(
    bubbles: tuple[Bubble, ...] | Callable[[], tuple[Bubble, ...]],
    frames: int = 10,
    e_count: int = 600,
    l_per_e: int = 2,
    walls: tuple[Wall, ...] = (),
    events: tuple[Merge | Pop, ...] = (),
    **values,
) -> Callable[[], list[Error]]:
    """A run of a foam as `Case.run`; its measure is the gas of each region that is left."""

    def volumes(run: Run) -> Error:
        before = dict(zip(run.first["regions"], run.first["volumes"], strict=True))
        now = run.simulation.diagnostics()
        changes = [abs(v / before[k] - 1.0) for k, v in zip(now["regions"], now["volumes"], strict=True)]
        return Error("volume", max(changes), 1e-3)

    shape = lambda: Cluster(bubbles() if callable(bubbles) else bubbles, walls, events)  # noqa: E731
    settings = {"cfl": 0.5, "air": "added_mass", "damping": 5.0, "dt": None}
    return film(shape, volumes, e_count=e_count, l_per_e=l_per_e, frames=frames, **{**settings, **values})


def thrown(speed: float) -> tuple[Bubble, ...]:
    """Two bubbles side by side, 1 cm above the plane y = 0, that fly down at `speed` (m/s)."""
    return moved_by(meeting(0.0), (0.0, 0.06, 0.0), (0.0, -speed, 0.0))


def moved_by(bubbles: tuple[Bubble, ...], by, velocity=(0.0, 0.0, 0.0)) -> tuple[Bubble, ...]:
    """The bubbles elsewhere (m), and flying (m/s)."""
    return tuple(
        replace(b, centre=tuple(np.add(b.centre, by)), velocity=tuple(np.add(b.velocity, velocity))) for b in bubbles
    )


def meeting(speed: float, radius: float = 0.05, e_count: int = 600) -> tuple[Bubble, ...]:
    """Two bubbles a spacing apart that meet head-on, each at `speed` (m/s)."""
    away = radius + 0.5 * e_spacing([radius, radius], e_count)
    return tuple(Bubble((s * away, 0.0, 0.0), radius, (-s * speed, 0.0, 0.0)) for s in (1.0, -1.0))


# The matrix

_R = 0.05
_BALL = Sphere(_R)
_FAR = (1000.0, 0.0, 0.0)
_STILL = (pressure, round_)
_FRAME = Rectangle(0.1, 0.1)
_FLOOR = Wall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def _squashed() -> Ellipsoid:
    return Ellipsoid(0.05, 0.01, 0.05)


def dumbbell() -> Shape:
    """Two lobes of radius 6 cm and a waist of half of that."""
    return StarShaped(0.05, lambda d: 0.75 * d[:, 0] ** 2 - 0.5)


def spiky() -> Shape:
    """Waves of mode 12, half a radius high."""
    mode = np.polynomial.legendre.Legendre.basis(12)
    return displaced_sphere(_R, lambda d: 0.5 * mode(d[:, 1]))


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


# Random scenes

SMALL = {"e_count": (60, 900), "l_per_e": (0, 6), "frames": (2, 2), "fps": (24.0, 1e6), "bubbles": (2, 4)}
"""Ranges of the keys that decide how long a run takes; the others are drawn from all that they take."""

LEFT_OUT = ("cluster", "foam_mountain")
"""Scenes that need more E than that."""


def draw(key: Key, low: float, high: float, rng: np.random.Generator) -> Value:
    """A value of a key, log-uniform where its range spans decades."""
    if key.choices:
        return str(rng.choice(key.choices))
    if key.auto and rng.random() < 0.5:
        return None
    if low >= 0.0 and high > 30.0 * max(low, 1e-9 * high):
        if low == 0.0 and not key.above and rng.random() < 0.2:
            return key.check("drawn", 0.0)
        value = math.exp(rng.uniform(math.log(max(low, 1e-9 * high)), math.log(high)))
    else:
        value = rng.uniform(low, high)
    value = min(max(value, low), high)
    return round(value) if key.whole else value


def random_scene(seed: int) -> tuple[str, dict[str, Value]]:
    """Name and overrides of a scene with a third of its keys drawn at random, each from its whole range.

    Three of four are made to go together, see `_reconcile`; the others are mostly refused.
    """
    rng = np.random.default_rng(seed)
    name = str(rng.choice([name for name in scene_names() if name not in LEFT_OUT]))
    parameters = load_scene(name).parameters
    overrides = {}
    for one in parameters:
        key = parameters.keys[one]
        if one in SMALL or rng.random() < 1.0 / 3.0:
            overrides[one] = draw(key, *SMALL.get(one, (key.low, key.high)), rng)
    if rng.random() < 0.75:
        _reconcile(overrides, parameters.values(overrides), rng)
    return name, overrides


def _reconcile(overrides: dict[str, Value], p: Values, rng: np.random.Generator) -> None:
    """Change drawn values that are refused together: enough E, L, tension, a shape that is one, not too many steps."""
    overrides["l_per_e"] = max(1, p.l_per_e)
    overrides["e_count"] = max(p.e_count, 500)
    widest = 0.25 * math.sqrt(overrides["e_count"] / (4 if hasattr(p, "border") else 1))
    overrides["support"] = min(p.support, max(2.0, widest))
    overrides["surfactant"] = min(p.surfactant, rng.uniform(0.0, 0.9) * p.tension / (GAS_CONSTANT * p.temperature))
    if p.dt is not None:
        overrides["dt"] = max(p.dt, 0.1 / p.fps)
    if hasattr(p, "displacement"):
        overrides["displacement"] = min(p.displacement, 0.5 * p.radius)
    if hasattr(p, "separation"):
        overrides["separation"] = min(p.separation, 0.5 * p.width)


def run_random(seed: int) -> Verdict:
    """Run a random scene; see `judge`."""
    name, overrides = random_scene(seed)
    script = load_scene(name)

    def run() -> list[Error]:
        scene = script.build(script.parameters.values(overrides))
        return carried_out(scene, scene.frames)

    return judge(Case("random", f"{name}, seed {seed}", run))
