"""What a number is: its unit, its meaning and its range, which stand once, with the dataclass field it belongs to."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

import numpy as np

from melp_warp import units
from melp_warp.errors import InputError, require
from melp_warp.keyframes import Keyframes, split

Value = float | int | str | None


@dataclass(frozen=True)
class Key:
    """What a number is and which values it takes.

    Attributes:
        unit: SI unit, "-" for a plain number.
        meaning: one line.
        low: smallest value.
        high: largest value.
        above: whether `low` itself is refused.
        whole: whether only whole numbers are taken.
        choices: the words it takes instead of numbers; empty for a number.
        auto: whether "auto" (None in Python) is taken as well.
        spoken: unit in which people say it, where that is another one: a number without a unit may be meant in it.
        usual: lowest and highest value that raise no doubt.
        varies: whether it may change in time, by keyframes.
    """

    unit: str
    meaning: str
    low: float = -1e9
    high: float = 1e9
    above: bool = False
    whole: bool = False
    choices: tuple[str, ...] = ()
    auto: bool = False
    spoken: str = ""
    usual: tuple[float, float] | None = None
    varies: bool = False

    @property
    def allowed(self) -> str:
        """The values it takes, in words."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        kind = "a whole number" if self.whole else "a number"
        low = f"above {self.low:g} and at most" if self.above else f"from {self.low:g} to"
        unit = "" if self.unit == "-" else f" {self.unit}"
        # .15g keeps large whole limits exact
        more = (" or auto" if self.auto else "") + (" or keyframes, TIME:VALUE,..." if self.varies else "")
        return f"{kind} {low} {self.high:.15g}{unit}{more}"

    @property
    def limits(self) -> str:
        """The same, short enough for a table; without the unit."""
        if self.choices:
            return " | ".join(self.choices)
        low = f"above {self.low:g}, up" if self.above else f"{self.low:g}"
        return f"{low} to {self.high:.15g}" + (", whole" if self.whole else "") + (" | auto" if self.auto else "")

    def parse(self, name: str, text: str) -> Value:
        """Read a value typed by a user, such as "4e-7", "400nm" or "auto".

        Raises:
            InputError: for text that is not a value of this key.
        """
        text = text.strip()
        if self.choices:
            return self.check(name, text)
        if self.auto and text == "auto":
            return None
        if ":" in text:
            return self._keyframes(name, text)
        try:
            number = float(text)
        except ValueError:
            return self.check(name, self._converted(name, text))
        if not self._holds(number) and self._meant(number):
            raise InputError(f"{name} must be {self.allowed}, got {_short(number)}: {self._meant(number)}")
        return self.check(name, number)

    def _keyframes(self, name: str, text: str) -> Keyframes:
        """Keyframes as typed: "0:0,0.5:9.81", with units if wanted."""
        require(self.varies, name, text, f"{self.allowed}: it cannot change in time")
        one = replace(self, varies=False)
        frames = [(_TIME.parse(f"a time of {name}", time), one.parse(name, value)) for time, value in split(name, text)]
        return Keyframes(frames, name)

    def _converted(self, name: str, text: str) -> float:
        """A number with a unit behind it, in this key's unit."""
        parts = units.split(text)
        require(parts is not None, name, text, self.allowed)
        number = units.convert(*parts, self.unit)
        if number is None:
            kind = f"no unit of {self.unit}" if self.unit != "-" else "a unit, and this is a plain number"
            raise InputError(f"{name} must be {self.allowed}, got {text!r}: {parts[1]!r} is {kind}")
        return number

    def check(self, name: str, value: Value) -> Value:
        """Return the value, whole numbers as `int` and others as `float`.

        Raises:
            InputError: for a value that this key does not take.
        """
        if value is None and self.auto:
            return None
        if self.choices:
            require(value in self.choices, name, value, self.allowed)
            return value
        if self.varies and isinstance(value, str) and ":" in value:
            return (
                value
                if isinstance(value, Keyframes) and all(map(self._holds, value.values))
                else self.parse(name, value)
            )
        if not self._holds(value):
            raise InputError(f"{name} must be {self.allowed}, got {_short(value)}")
        return int(value) if self.whole else float(value)

    def _holds(self, value: Value) -> bool:
        """Whether the value is a number in the range."""
        number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        ok = number and bool(np.isfinite(value)) and self.low <= value <= self.high
        return ok and not (self.above and value == self.low) and not (self.whole and value != int(value))

    def doubt(self, name: str, value: Value) -> str:
        """What is odd about a value that is allowed, in a line; "" for nothing."""
        if self.usual is None or not isinstance(value, (int, float)) or self.usual[0] <= value <= self.usual[1]:
            return ""
        low, high = self.usual
        meant = self._meant(value)
        odd = f"{name}={_short(value)}: {value:g} {self.unit} is unusual for the {self.meaning} ({low:g} to {high:g})"
        return odd + (f"; {meant}" if meant else "")

    def _meant(self, number: float) -> str:
        """How to type the number in the unit that people say it in; "" where that is out of the usual as well."""
        meant = units.convert(number, self.spoken, self.unit) if self.spoken else None
        low, high = self.usual or (self.low, self.high)
        if meant is None or not low <= meant <= high or abs(number) < 0.1:
            return ""
        return f"{number:g} {self.spoken} is {number:g}{self.spoken} or {_short(meant)}"


_TIME = Key("s", "time of a keyframe", 0.0, 1e6)


def _short(value: object) -> str:
    """A value as it may have been typed."""
    if isinstance(value, float) and np.isfinite(value) and value == int(value) and abs(value) < 1e15:
        return str(int(value))
    return re.sub(r"(?<=e[+-])0+", "", repr(value)) if isinstance(value, float) else repr(value)


def positive(unit: str, meaning: str, high: float, **more: Any) -> Key:
    """A number above 0."""
    return Key(unit, meaning, 0.0, high, above=True, **more)


def at_least_zero(unit: str, meaning: str, high: float, **more: Any) -> Key:
    """A number of at least 0."""
    return Key(unit, meaning, 0.0, high, **more)


def count(meaning: str, low: int, high: int, **more: Any) -> Key:
    """A whole number."""
    return Key("-", meaning, low, high, whole=True, **more)


def word(meaning: str, choices: tuple[str, ...]) -> Key:
    """One of some words."""
    return Key("-", meaning, choices=choices)


def quantity(key: Key, default: Any = MISSING) -> Any:
    """A dataclass field that is this key."""
    return field(default=default, metadata={"key": key})


def keys_of(cls: type) -> Mapping[str, Key]:
    """The fields of a dataclass that are keys, by name."""
    return {each.name: each.metadata["key"] for each in fields(cls) if "key" in each.metadata}


def check_numbers(made: Any) -> None:
    """Check each field of a dataclass that is a key and holds no vector; whole numbers become `int`, others `float`.

    Raises:
        InputError: for a value that its key does not take.
    """
    for name, key in keys_of(type(made)).items():
        value = getattr(made, name)
        if not isinstance(value, tuple):
            object.__setattr__(made, name, key.check(name, value))
