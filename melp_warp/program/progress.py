"""What a run says while it goes on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from melp_warp.program.output import kept_frames
from melp_warp.program.plan import Plan

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation
    from melp_warp.stages.notices import Notices


class ProgressLine:
    """A bar on stderr with frame, simulated time, time step, steps a second and time left."""

    def __init__(self, plan: Plan):
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TextColumn("{task.fields[state]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=Console(stderr=True, quiet=plan.quiet),
            disable=plan.quiet,
        )
        self._name = plan.name
        self._task = self._bar.add_task(f"{plan.name}: preparing", total=plan.scene.frames, state="")

    def __enter__(self) -> ProgressLine:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # an error is told in one line: no bar before it
        failed = kind is not None and issubclass(kind, Exception)
        self._bar.live.transient = failed
        self._bar.live.stop()
        if not failed and not self._bar.console.is_interactive:
            self._bar.console.print()  # without a terminal the bar is written once, and its line left open

    def say(self, notices: Notices) -> None:
        """Print the notices that are new, above the bar."""
        for line in notices.fresh():
            self._bar.console.print(f"melp-warp: notice: {line}", markup=False, highlight=False, soft_wrap=True)

    def advance(self, simulation: Simulation, diagnostics: Mapping, seconds: float) -> None:
        """A frame is done, which took `seconds` of wall time."""
        rate = diagnostics["substeps"] / max(seconds, 1e-9)
        state = f"t {simulation.time:.4g} s, dt {diagnostics['dt']:.3g} s, {rate:.3g} steps/s,{_busy()}"
        self._bar.update(self._task, completed=simulation.frame, description=self._name, state=state)


def _busy() -> str:
    """What to say of the speed while one thread works for all."""
    from melp_warp.device.launch import crew

    return "" if crew.together else " one thread (other programs have the cores),"


def noticed_in(simulation: Simulation | None) -> str:
    """The notices of a run that did not end, as the end of a line."""
    return f"; noticed: {simulation.notices.summary()}" if simulation and simulation.notices else ""


def say_finished(folder: Path, images: list[Path], simulation: Simulation, empty_from: int | None) -> None:
    """Say what there is once a run is done."""
    from melp_warp.usd.schema import ROOT

    print(f"{kept_frames(folder)}: {folder / ROOT}")
    if empty_from is not None:
        print(f"The last film is gone: from frame {empty_from} on there are no particles")
    for image in images:
        print(f"drawn: {image}")
    print(f"Open the .usda in usdview, Houdini or Omniverse, or draw a frame: melp-warp preview {folder}")
    if simulation.unaccounted:
        print(simulation.unaccounted)
    if simulation.notices:
        print(f"Noticed: {simulation.notices.summary()}")
