"""The form of a stage of the step: the package's own and those that a scene brings along (docs/stages.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from melp_warp.errors import require

if TYPE_CHECKING:
    from melp_warp.device.linear import ConjugateGradient, RationalLaplacian
    from melp_warp.features import Features
    from melp_warp.stages.notices import Notices
    from melp_warp.stepping.stepper import Stepper

SIZES = ("e", "l", "r")
"""Lengths that what a stage remembers may have, besides numbers: those of E, L and regions."""


class Solve(NamedTuple):
    """A kind of linear solve in a stage.

    Attributes:
        solvers: those that must end within their tolerance.
        report: gives iterations and residual of the last one (reads back); None for none.
    """

    solvers: tuple[ConjugateGradient | RationalLaplacian, ...]
    report: Callable[[], tuple[int, float]] | None = None


class Stage:
    """A part of the step. A scene's own derives from it, as those of the package do (`melp_warp.stepping.step`).

    Within `run` it launches kernels, copies and clears by `melp_warp.device.launch` alone: the step is recorded once
    and replayed. What changes from step to step is read from arrays that `prepare` has set
    (`melp_warp.device.scalars.Setting`).

    Attributes:
        name: as in errors and in the log.
        equation: of MELP 2022, for those that have one.
        velocity: what `State.e.u` is once it is done; "" for what it was before.
        after: of a scene's own, the name of the stage that it follows.
        needs: parts of the stepper without which it cannot run: a film that has them not goes without the stage; a
            scene's own is refused there.
        writes: the arrays of the state that it changes, "e.u". Where it leaves a number in the positions and velocities
            of the first one's particles that is not finite, the run stops and names it.
        kernels: files of `melp_warp.kernels` whose kernels it launches itself.
        of_l: whether its largest kernels have a thread an L.
        recorded: whether it is part of the step's graphs; others run on the host, before them.
        later: whether it comes after E have moved, when their lists may have to be rebuilt.
        remembers: what a scene's own carries from step to step, name -> (Warp type, length): "e", "l", "r" or a number.
            It is part of the state, so of checkpoints too; 0 at the start, and anew where regions change. What the
            package's carry is in `melp_warp.stages.state.Memory`.
        stepper: all other stages and parts, the film and its state.
    """

    name: str = ""
    equation: str = ""
    velocity: str = ""
    after: str = "e_to_l"
    needs: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    kernels: tuple[str, ...] = ()
    of_l: bool = False
    recorded: bool = True
    later: bool = False
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

    def run_guarded(self) -> None:
        """The same, and have a look at what it has written: what is recorded of it."""
        self.run()
        self.stepper.guard(self)

    def check(self) -> None:
        """Raise `SimulationError` if something went wrong (may read back): after each step on the CPU."""

    def solves(self) -> dict[str, Solve]:
        """Its linear solves by kind, as the log names them."""
        return {}

    def remark(self, notices: Notices) -> None:
        """Note what must be known of the frame's steps (may read back)."""

    def report(self) -> dict:
        """What the log says of it, plain numbers (may read back), a scene's own under its name; {} for nothing."""
        return {}


def kernels_of(kind: Any, features: Features) -> tuple[str, ...]:
    """Files of `melp_warp.kernels` that a part or a stage of a film launches from; a part's may depend on the film."""
    return kind.kernels(features) if callable(kind.kernels) else kind.kernels


def check_stages(stages: tuple[Any, ...]) -> None:
    """Refuse what is no stage.

    Raises:
        InputError: it is none, or its name is taken.
    """
    if not stages:
        return
    from melp_warp.stepping.parts import CARRIERS  # which imports scenes

    own = {stage.name: stage for carrier in CARRIERS.values() for stage in carrier.stages}
    names = [getattr(one, "name", one) for one in stages]
    right = all(isinstance(one, type) and issubclass(one, Stage) for one in stages)
    require(right, "stages", names, "classes derived from Stage")
    free = all(isinstance(name, str) and name.isidentifier() and name not in own for name in names)
    require(free and len(set(names)) == len(names), "names of stages", names, "names of their own, each once")
    places = [name for name, stage in own.items() if stage.recorded]
    for one in stages:
        require(one.after in places, f"after of stage {one.name}", one.after, f"one of {', '.join(places)}")
        for key, (_, size) in one.remembers.items():
            right = key.isidentifier() and (size in SIZES or (isinstance(size, int) and size > 0))
            require(right, f"{key} of stage {one.name}", size, f"of a length of {', '.join(SIZES)} or a number")
