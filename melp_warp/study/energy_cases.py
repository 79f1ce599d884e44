"""The energy budget of every scene at small size: for docs/energy.md (tools/energy.py) and the slow tests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from melp_warp.errors import SimulationError
from melp_warp.parameters import Value
from melp_warp.registry import load_scene
from melp_warp.simulation import Simulation
from melp_warp.stepping.ledger import LOSS, TERMS


@dataclass(frozen=True)
class EnergyCase:
    """A scene at small size.

    Attributes:
        scene: its name.
        frames: how many are enough to see where its energy goes.
        keys: keys that are not as the scene has them; `e_count` among them.
        most: largest rest over what moves that it keeps to; infinite where docs/energy.md says why there is none.
    """

    scene: str
    frames: int
    keys: Mapping[str, Value]
    most: float = math.inf

    @property
    def label(self) -> str:
        """The scene with what is not its default."""
        return " ".join([self.scene, *(f"{key}={value}" for key, value in self.keys.items())])


@dataclass(frozen=True)
class Found:
    """What became of a case.

    Attributes:
        e_count: E at the end.
        frames: frames done.
        time: simulated time, s.
        share: largest rest over what moves.
        rest: the last one over what moves.
        raised: name of the loss that makes most energy and how much, over what moves; ("", 0) where none does.
        stopped: why the run ended early; empty where it did not.
    """

    e_count: int
    frames: int
    time: float
    share: float
    rest: float
    raised: tuple[str, float]
    stopped: str


CASES = (
    EnergyCase("oscillating_bubble", 300, {"e_count": 1000}, 0.01),
    EnergyCase("oscillating_bubble", 300, {"e_count": 1000, "air": "added_mass"}, 0.015),
    EnergyCase("giant_bubble", 120, {"e_count": 1000, "l_per_e": 4}, 0.01),
    EnergyCase("giant_bubble", 120, {"e_count": 1000, "l_per_e": 4, "air": "none"}, 0.01),
    EnergyCase("drainage", 150, {"e_count": 400, "l_per_e": 8}, 0.01),
    EnergyCase("equilibrium", 150, {"e_count": 400, "l_per_e": 8}, 0.01),
    EnergyCase("taylor_vortices", 192, {"e_count": 900, "l_per_e": 8}, 0.01),
    EnergyCase("stirred_disc", 48, {"e_count": 900, "l_per_e": 8}, 0.01),
    EnergyCase("giant_bubble_vortices", 48, {"e_count": 1000, "l_per_e": 4}),
    EnergyCase("deforming_rectangle_2m", 48, {"e_count": 900, "l_per_e": 4}),
    EnergyCase("leapfrog", 48, {"e_count": 900, "l_per_e": 8}, 0.01),
    EnergyCase("turbulent_film", 48, {"e_count": 900, "l_per_e": 8}, 0.01),
    EnergyCase("double_bubble", 60, {"e_count": 400, "l_per_e": 4}, 0.01),
    EnergyCase("size_ratio", 60, {"e_count": 450, "l_per_e": 4}, 0.01),
    EnergyCase("triple_bubble", 60, {"e_count": 600, "l_per_e": 4}, 0.01),
    EnergyCase("quadruple_bubble", 60, {"e_count": 800, "l_per_e": 4}, 0.01),
    EnergyCase("four_bubbles", 120, {"e_count": 800, "l_per_e": 4}, 0.02),
    EnergyCase("cluster", 30, {"e_count": 2200, "l_per_e": 2}, 0.01),
    EnergyCase("foam_pops", 40, {"e_count": 1600, "l_per_e": 2}, 0.02),
    EnergyCase("foam_mountain", 30, {"e_count": 1000}, 0.02),
)
"""Every scene; single films besides with what is not their default."""


def run_case(case: EnergyCase, scale: float = 1.0, frames: int | None = None) -> Found:
    """Run a case with `scale` times its E, over its own number of frames where none is given."""
    script = load_scene(case.scene)
    keys = dict(case.keys, e_count=round(scale * case.keys["e_count"]))
    simulation = Simulation(script.build(script.parameters.values(keys)))
    stopped = ""
    try:
        for _ in range(case.frames if frames is None else frames):
            simulation.advance_frame()
    except SimulationError as error:
        stopped = str(error)
    ledger = simulation.ledger
    moved = ledger.moved or 1.0
    # what bubbles that come bring along is measured from a zero that means nothing
    terms = [term for term in TERMS if term.kind == LOSS and term.name != "events"]
    losses = [(term.name, -ledger.flows[term.name] / moved) for term in terms]
    raised = max(losses, key=lambda pair: pair[1])
    return Found(
        simulation.film.n_e,
        simulation.frame,
        ledger.time,
        ledger.share,
        ledger.rest / moved,
        raised if raised[1] > 0.0 else ("", 0.0),
        stopped,
    )
