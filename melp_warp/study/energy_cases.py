"""The energy budget of every scene at small size: for docs/energy.md (tools/energy.py) and the slow tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from melp_warp.errors import SimulationError
from melp_warp.features import without_budget
from melp_warp.parameters import Value
from melp_warp.registry import load_scene
from melp_warp.simulation import Simulation
from melp_warp.stepping.ledger import LOSS, TERMS, UNEXPLAINED, Ledger


@dataclass(frozen=True)
class EnergyCase:
    """A scene at small size.

    Attributes:
        scene: its name.
        frames: how many are enough to see where its energy goes.
        keys: keys that are not as the scene has them; `e_count` among them.
        most: largest rest over what moves that it keeps to.
    """

    scene: str
    frames: int
    keys: Mapping[str, Value]
    most: float = UNEXPLAINED

    @property
    def label(self) -> str:
        """The scene with what is not its default."""
        return " ".join([self.scene, *(f"{key}={value}" for key, value in self.keys.items())])

    def scaled(self, scale: float) -> EnergyCase:
        """The same with `scale` times its E."""
        return replace(self, keys={**self.keys, "e_count": round(scale * self.keys["e_count"])})


@dataclass(frozen=True)
class Found:
    """What became of a case.

    Attributes:
        e_count: E at the end.
        frames: frames done.
        time: simulated time, s; where a budget was kept, up to when.
        liquid: what there is more of it in the end, with what left the film, relative.
        surfactant: the same.
        none: why no budget was kept; then what follows it is 0. Empty where one was.
        share: largest rest over what moves.
        rest: the last one over what moves.
        raised: name of the loss that makes most energy and how much, over what moves; ("", 0) where none does.
        stopped: why the run ended early; empty where it did not.
    """

    e_count: int
    frames: int
    time: float
    liquid: float
    surfactant: float
    none: str = ""
    share: float = 0.0
    rest: float = 0.0
    raised: tuple[str, float] = ("", 0.0)
    stopped: str = ""


HELD = ("mass", "border_mass", "spilled", "rim_mass", "drop_mass", "frame_mass")
"""What of the log holds liquid: the film, its border, what ran over it, free rims, drops, what they left at a frame."""


CASES = (
    EnergyCase("oscillating_bubble", 300, {"e_count": 1000}),
    EnergyCase("oscillating_bubble", 300, {"e_count": 1000, "air": "added_mass"}),
    EnergyCase("giant_bubble", 120, {"e_count": 600, "l_per_e": 4}),
    EnergyCase("giant_bubble", 120, {"e_count": 600, "l_per_e": 4, "air": "none"}),
    EnergyCase("drainage", 150, {"e_count": 300, "l_per_e": 4}),
    EnergyCase("equilibrium", 150, {"e_count": 300, "l_per_e": 4}),
    EnergyCase("taylor_vortices", 192, {"e_count": 400, "l_per_e": 4}),
    EnergyCase("stirred_disc", 48, {"e_count": 300, "l_per_e": 4}),
    EnergyCase("giant_bubble_vortices", 48, {"e_count": 1000, "l_per_e": 4}),
    EnergyCase("deforming_rectangle_2m", 48, {"e_count": 900, "l_per_e": 4}),
    EnergyCase("leapfrog", 48, {"e_count": 400, "l_per_e": 4}),
    EnergyCase("turbulent_film", 48, {"e_count": 600, "l_per_e": 4}),
    EnergyCase("double_bubble", 60, {"e_count": 800, "l_per_e": 2}),
    EnergyCase("size_ratio", 60, {"e_count": 450, "l_per_e": 4}),
    EnergyCase("triple_bubble", 60, {"e_count": 450, "l_per_e": 4}),
    EnergyCase("quadruple_bubble", 60, {"e_count": 600, "l_per_e": 2}),
    EnergyCase("four_bubbles", 120, {"e_count": 600, "l_per_e": 2}),
    EnergyCase("cluster", 30, {"e_count": 2200, "l_per_e": 1}),
    EnergyCase("foam_pops", 40, {"e_count": 1600, "l_per_e": 1}),
    EnergyCase("foam_mountain", 30, {"e_count": 1000}),
    EnergyCase("inflation", 300, {"e_count": 300, "l_per_e": 2}),
    EnergyCase("film_burst", 100, {"e_count": 400, "l_per_e": 4}),
    EnergyCase("burst_pair", 130, {"e_count": 400, "l_per_e": 4}),
)
"""Every scene; single films besides with what is not their default."""


SCALES, LONG = (1.0, 2.0, 4.0), 2000
"""Times their E at which cases run for long, and the frames of that."""


class Amounts:
    """Liquid and surfactant of a run, but for what bubbles bring along that come and the surfactant of films that go.

    Attributes:
        liquid, surfactant: what there is more of them than at the start, relative.
    """

    def __init__(self, simulation: Simulation):
        self._simulation = simulation
        self.liquid = self.surfactant = 0.0
        self._seen = self._look()

    def _look(self) -> tuple[list[int], float, float]:
        line = self._simulation.diagnostics()
        liquid = sum(line.get(name, 0.0) for name in HELD)
        return list(self._simulation.state.course.labels), liquid, line["surfactant"] + line.get("border_surfactant", 0)

    def follow(self) -> None:
        """Compare with a frame ago."""
        (labels, liquid, surfactant), (before, held, solute) = self._look(), self._seen
        if set(labels) <= set(before):
            self.liquid += liquid / held - 1.0
        if labels == before and not self._simulation.state.course.holed and solute > 0.0:
            self.surfactant += surfactant / solute - 1.0
        self._seen = labels, liquid, surfactant


def run_case(case: EnergyCase, frames: int | None = None) -> Found:
    """Run a case over its own number of frames where none is given.

    A frame with a number that is not finite, or a gas off its law by a thousandth, stops it.
    """
    script = load_scene(case.scene)
    simulation = Simulation(script.build(script.parameters.values(case.keys)))
    amounts, stopped = Amounts(simulation), ""
    try:
        for _ in range(case.frames if frames is None else frames):
            simulation.advance_frame()
            amounts.follow()
    except SimulationError as error:
        stopped = str(error)
    found = Found(
        simulation.film.n_e,
        simulation.frame,
        simulation.time,
        amounts.liquid,
        amounts.surfactant,
        without_budget(simulation.scene),
        stopped=stopped,
    )
    return found if simulation.ledger is None else replace(found, **_of_ledger(simulation.ledger))


def _of_ledger(ledger: Ledger) -> dict:
    """What a budget says."""
    moved = ledger.moved or 1.0
    # what bubbles that come bring along is measured from a zero that means nothing
    terms = [term for term in TERMS if term.kind == LOSS and term.name != "events"]
    name, share = max(((term.name, -ledger.flows[term.name] / moved) for term in terms), key=lambda pair: pair[1])
    return {
        "time": ledger.time,
        "share": ledger.share,
        "rest": ledger.rest / moved,
        "raised": (name, share) if share > 0.0 else ("", 0.0),
    }
