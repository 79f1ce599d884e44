"""Cases and what becomes of them: sound or not, as accurate as they must be."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from melp_warp.errors import InputError, SimulationError
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation
from melp_warp.study.validation import e_points

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
        """Mass and surfactant as at the start, with what popped or a rim collected; the gas obeys its law.

        Of a film that burst the liquid is counted alone: free rims, drops and a frame hold it, the gas has left.
        """
        simulation = self.simulation
        now = simulation.diagnostics()
        kept = {name: now[name] + now.get(f"border_{name}", 0.0) for name in ("mass", "surfactant")}
        torn = sum(now.get(name, 0.0) for name in ("rim_mass", "drop_mass", "frame_mass"))
        wanted = self.first["mass"] - simulation.spilled
        errors = [Error("mass", abs((kept["mass"] + torn) / wanted - 1.0), CONSERVED)]
        if torn > 0.0:
            return errors
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
