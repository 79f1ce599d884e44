"""The stages of a step, as a table, and the form of those that a scene brings along (docs/stages.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from melp_warp.errors import require

if TYPE_CHECKING:
    from melp_warp.stepping.stepper import Stepper


class Row(NamedTuple):
    """A stage of the step.

    Attributes:
        name: as in errors and in the log.
        equation: of MELP 2022.
        velocity: what `State.e.u` is once it is done.
        of_l: whether its largest kernels have a thread an L.
        later: whether it comes after E have moved, when their lists may have to be rebuilt.
    """

    name: str
    equation: str
    velocity: str
    of_l: bool = False
    later: bool = False


TABLE = (
    Row("neighbors", "(27), (28)", "that of the step before"),
    Row("l_to_e", "(6), (7)", "along the film from the L, across it kept: at the start of the step", of_l=True),
    Row("membrane", "(12)", "across the film at the end of the step, along it at its start"),
    Row("surfactant", "(14), (15)", "after the share theta of the step (`Tangential.theta`)"),
    Row("e_to_l", "(16)-(18), (8)", "at the end of the step", of_l=True),
    Row("advance_e", "(19), (20)", "at the end of the step, E have moved"),
    Row("geometry", "(9)-(11)", "at the end of the step, normals, areas and volumes are those of it", later=True),
    Row("advance_l", "Algorithm 7", "at the end of the step, L have moved", of_l=True, later=True),
)
"""The stages in their order. A single layer has surfactant before membrane, and none of those of L."""

SIZES = ("e", "l", "r")
"""Lengths that what a stage remembers may have, besides numbers: those of E, L and regions."""


class Stage:
    """A part of the step that a scene brings along; derive from it.

    Within `run` it launches kernels, copies and clears by `melp_warp.device.launch` alone, as all stages do: the step
    is recorded once and replayed. What changes from step to step is read from arrays that `prepare` has set
    (`melp_warp.device.scalars.Setting`).

    Attributes:
        name: of its own.
        after: name of the row of `TABLE` that it follows.
        remembers: what it carries from step to step, name -> (Warp type, length): "e", "l", "r" or a number. It is part
            of the state, so of checkpoints too; 0 at the start, and anew where regions change.
        stepper: all other stages, the film and its state.
    """

    name: str = ""
    after: str = "e_to_l"
    remembers: Mapping[str, tuple[Any, str | int]] = {}

    def __init__(self, stepper: Stepper):
        self.stepper, self.film, self.state = stepper, stepper.film, stepper.state

    def remembered(self, key: str) -> Any:
        """The array of what it remembers."""
        return self.state.remembered[f"{self.name}.{key}"]

    def prepare(self, dt: float) -> None:
        """Set what depends on a step of dt (s) to come: on the host, before the step."""

    def run(self) -> None:
        """Launch its kernels."""

    def check(self) -> None:
        """Raise `SimulationError` if something went wrong (may read back): after each step on the CPU."""

    def report(self) -> dict:
        """What the log says of it under its name, plain numbers (may read back); {} for nothing."""
        return {}


def check_stages(stages: tuple[Any, ...]) -> None:
    """Refuse what is no stage.

    Raises:
        InputError: it is none, or its name is taken.
    """
    names = [getattr(one, "name", one) for one in stages]
    right = all(isinstance(one, type) and issubclass(one, Stage) for one in stages)
    require(right, "stages", names, "classes derived from Stage")
    taken = {row.name for row in TABLE}
    free = all(isinstance(name, str) and name.isidentifier() and name not in taken for name in names)
    require(free and len(set(names)) == len(names), "names of stages", names, "names of their own, each once")
    for one in stages:
        places = [row.name for row in TABLE[1:]]
        require(one.after in places, f"after of stage {one.name}", one.after, f"one of {', '.join(places)}")
        for key, (_, size) in one.remembers.items():
            right = key.isidentifier() and (size in SIZES or (isinstance(size, int) and size > 0))
            require(right, f"{key} of stage {one.name}", size, f"of a length of {', '.join(SIZES)} or a number")
