"""Numbers that change in time: by keyframes, or by a function of time."""

from __future__ import annotations

import hashlib
import inspect
import itertools
import math
from collections.abc import Callable, Iterable

import numpy as np

from melp_warp.errors import InputError, require

ALLOWED = "TIME:VALUE,TIME:VALUE,... with times in s that rise from 0 or later"


class Keyframes(str):
    """A number at some times; linear in between, and as at the first and the last time before and after them.

    It is its own text, such as "0:0,0.5:9.81": so logs, caches and checkpoints hold it as it is typed.

    Args:
        frames: (time in s, value), times rising from 0 or later.
        name: of the number, for errors.

    Raises:
        InputError: there are none, their times do not rise, or a value is not finite.

    Attributes:
        times: s.
        values: as many.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __new__(cls, frames: Iterable[tuple[float, float]], name: str = "keyframes"):
        """Check and write down."""
        frames = [(float(time), float(value)) for time, value in frames]
        made = super().__new__(cls, ",".join(f"{time!r}:{value!r}" for time, value in frames))
        made.times, made.values = tuple(t for t, _ in frames), tuple(v for _, v in frames)
        rising = all(a < b for a, b in itertools.pairwise(made.times)) and all(map(math.isfinite, made.times))
        right = bool(frames) and rising and made.times[0] >= 0.0 and all(map(math.isfinite, made.values))
        require(right, name, str(made), ALLOWED)
        return made

    def __getnewargs__(self):
        return (tuple(zip(self.times, self.values, strict=True)),)

    def at(self, time: float) -> float:
        """The number at a time (s)."""
        return float(np.interp(time, self.times, self.values))

    def __neg__(self) -> Keyframes:
        """The same with the other sign."""
        return self * -1.0

    def __mul__(self, factor: float) -> Keyframes:
        """The same times a factor."""
        return Keyframes((time, factor * value) for time, value in zip(self.times, self.values, strict=True))

    __rmul__ = __mul__


Number = float | Keyframes | Callable[[float], float]
"""One that may change in time: a function takes the time in s."""


def split(name: str, text: str) -> list[tuple[str, str]]:
    """Times and values of keyframes as typed.

    Raises:
        InputError: names the key `name`.
    """
    parts = [frame.partition(":") for frame in text.split(",")]
    require(all(colon and time.strip() for time, colon, _ in parts), name, text, ALLOWED)
    return [(time, value) for time, _, value in parts]


def stays(number: Number) -> bool:
    """Whether a number is the same at all times."""
    return not isinstance(number, Keyframes) and not callable(number)


def value_at(number: Number, time: float) -> float:
    """A number at a time (s)."""
    if isinstance(number, Keyframes):
        return number.at(time)
    return float(number(time)) if callable(number) else float(number)


def check_number(name: str, number: Number, low: float = -math.inf, high: float = math.inf) -> None:
    """Refuse what is no number, and keyframes out of a range.

    Raises:
        InputError: names it.
    """
    if callable(number):
        return
    values = number.values if isinstance(number, Keyframes) else (number,)
    plain = all(isinstance(value, (int, float, np.number)) and not isinstance(value, bool) for value in values)
    right = plain and all(math.isfinite(value) and low <= value <= high for value in values)
    bounded = f" from {low:g} to {high:g}" if math.isfinite(high) else ""
    require(right, name, number, f"a number{bounded}, Keyframes or a function of time")


def identity(function: Callable) -> str:
    """What tells a function of time from another one: a digest of its source and of the plain values that it closes on.

    Raises:
        InputError: its source is not known.
    """
    try:
        told = inspect.getsource(function)
    except (OSError, TypeError):
        raise InputError(f"a function of time must be one with a source, got {function!r}") from None
    closed = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    told += repr([value for value in closed if isinstance(value, (int, float, str, tuple))])
    return f"function {hashlib.sha256(told.encode()).hexdigest()[:16]}"
