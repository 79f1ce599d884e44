"""Scenes at their extremes, and particles that are moved about in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from melp_warp.cluster import Bubble, Cluster, Merge, Pop, Wall, e_spacing
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Shape, StarShaped, displaced_sphere
from melp_warp.simulation import Simulation
from melp_warp.study.limits.judging import Error, Measure, Run
from melp_warp.study.validation import oscillation

RADIUS = 0.05
"""Of bubbles, m."""


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


def dumbbell() -> Shape:
    """Two lobes of radius 6 cm and a waist of half of that."""
    return StarShaped(0.05, lambda d: 0.75 * d[:, 0] ** 2 - 0.5)


def spiky() -> Shape:
    """Waves of mode 12, half a radius high."""
    mode = np.polynomial.legendre.Legendre.basis(12)
    return displaced_sphere(RADIUS, lambda d: 0.5 * mode(d[:, 1]))
