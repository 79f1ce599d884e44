"""What a run must tell about the worth of its results: said once, logged every frame, repeated in the last line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass


@dataclass
class _Span:
    """Frames that a notice held in: how many, the first, and the worst with its value."""

    frames: int
    first: int
    worst: int
    value: float


class Notices:
    """Doubts about the results of a run that goes on, by name: an unresolved length, a solve that stopped early.

    Whoever finds a doubt notes it in every frame that it holds in:

        notices.note("air beyond its range", 1.4, "the slope is 1.4 where the model holds to 0.5")

    The name says what is wrong in a few words and stays the same for the whole run. The value is a number that is the
    larger the worse; with several notes of a name in a frame the worst stays. The text explains it once, with the
    value as it is then, units, and what is needed instead.

    Stages have a method `remark(notices)`, which `Stepper.remark` calls when a frame is done: there they read back, and
    clear, what they summed up on the device over the frame's steps. What concerns a run as a whole is noted in
    `Simulation._remark`. Nothing is noted inside a step. Notes of a frame that is done again are forgotten.

    A run prints the text of each name once (not with --quiet), writes {name: value} as "notices" of each frame into
    run.jsonl, and repeats all names in its last line; with --strict it then ends with exit code 1.

    Attributes:
        of_frame: name -> worst value in the last frame.
        first: number that a run gives to its frame 0.
    """

    def __init__(self):
        self.of_frame: dict[str, float] = {}
        self._texts: dict[str, str] = {}
        self._spans: dict[str, _Span] = {}
        self._fresh: list[str] = []
        self._frames = 0
        self.first = 0

    def __bool__(self) -> bool:
        return bool(self._spans)

    def begin(self) -> None:
        """Forget what was noted since the last good frame."""
        self.of_frame, self._texts = {}, {}

    def note(self, name: str, value: float, text: str) -> None:
        """Note a doubt in the frame that has just been done."""
        if name not in self.of_frame or not self.of_frame[name] >= value:
            self.of_frame[name], self._texts[name] = value, text

    def end(self, frame: int) -> None:
        """Take what was noted for that of a good frame."""
        self._frames += 1
        for name in self.of_frame:
            self._count(name, self.first + frame)

    def _count(self, name: str, frame: int) -> None:
        value, span = self.of_frame[name], self._spans.get(name)
        if span is None:
            span = self._spans[name] = _Span(0, frame, frame, value)
            self._fresh.append(f"{name}, frame {frame}: {self._texts[name]}")
        span.frames += 1
        if value > span.value:
            span.worst, span.value = frame, value

    def add(self, frame: int, name: str, value: float, text: str) -> None:
        """Note a doubt in a good frame once it is over, as when it is written."""
        self.note(name, value, text)
        self._count(name, self.first + frame)

    def fresh(self) -> list[str]:
        """Lines to print: the notices that came up for the first time since this was last asked."""
        lines, self._fresh = self._fresh, []
        return lines

    def save(self) -> dict:
        """What is known of the run so far, in plain numbers."""
        return {"frames": self._frames, "spans": {name: asdict(span) for name, span in self._spans.items()}}

    def load(self, saved: Mapping) -> None:
        """Go on from what was known; what was said is not said again."""
        self.begin()
        self._fresh, self._frames = [], saved["frames"]
        self._spans = {name: _Span(**span) for name, span in saved["spans"].items()}

    def summary(self) -> str:
        """All of the run in one line; empty where there are none."""
        return "; ".join(
            f"{name} in {span.frames} of {self._frames} frames, first in {span.first},"
            f" worst in {span.worst} ({span.value:.3g})"
            for name, span in self._spans.items()
        )
