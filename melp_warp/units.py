"""Units that a user may type behind a number: `400nm`, `5 cm`, `72.8mN/m`, `1g/cm^3`, `25degC`, `18%`."""

from __future__ import annotations

import math
import re
from fractions import Fraction
from typing import NamedTuple

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\d.].*)", re.S)
_FACTOR = re.compile(r"(1|%|[A-Za-z]+)\^?(-?\d)?")


class Unit(NamedTuple):
    """A unit of measure.

    Attributes:
        factor: base units that one of it is.
        powers: exponents of the base units: m, kg, s, K, mol, a degree of angle, a spacing of E.
        zero: kelvins at its 0, for a scale of temperature.
    """

    factor: Fraction
    powers: tuple[int, ...]
    zero: Fraction = Fraction(0)


def _unit(factor: str = "1", m=0, kg=0, s=0, k=0, mol=0, degree=0, spacing=0) -> Unit:
    return Unit(Fraction(factor), (m, kg, s, k, mol, degree, spacing))


_PREFIXES = {"n": "1e-9", "u": "1e-6", "m": "1e-3", "c": "1e-2", "h": "1e2", "k": "1e3"}
_PREFIXED = {
    "m": _unit(m=1),
    "g": _unit("1e-3", kg=1),
    "s": _unit(s=1),
    "Hz": _unit(s=-1),
    "N": _unit(kg=1, m=1, s=-2),
    "Pa": _unit(kg=1, m=-1, s=-2),
    "bar": _unit("1e5", kg=1, m=-1, s=-2),
    "mol": _unit(mol=1),
    "K": _unit(k=1),
    "St": _unit("1e-4", m=2, s=-1),
}
_UNITS = {
    "1": _unit(),
    "%": _unit("0.01"),
    "min": _unit("60", s=1),
    "fps": _unit(s=-1),
    "atm": _unit("101325", kg=1, m=-1, s=-2),
    "degC": Unit(Fraction(1), _unit(k=1).powers, Fraction("273.15")),
    "degrees": _unit(degree=1),
    "deg": _unit(degree=1),
    "rad": Unit(Fraction(180.0 / math.pi), _unit(degree=1).powers),
    "spacings": _unit(spacing=1),
    **_PREFIXED,
    **{
        prefix + name: base._replace(factor=Fraction(size) * base.factor)
        for prefix, size in _PREFIXES.items()
        for name, base in _PREFIXED.items()
    },
}
_SAME = {
    "\u00b5": "u",
    "\u03bc": "u",
    "°C": "degC",
    "°": "deg",
    "²": "^2",
    "³": "^3",
    "micron": "um",
    "·": " ",
    "*": " ",
}
"""Other ways to write them."""


def split(text: str) -> tuple[float, str] | None:
    """A number and the unit typed behind it; None where the text is not both."""
    match = _NUMBER.fullmatch(text)
    return (float(match[1]), match[2]) if match else None


def convert(number: float, unit: str, wanted: str) -> float | None:
    """A number in one unit as one in another, rounded once: 400 "nm" is 4e-7 "m".

    Returns:
        The number; None where a unit is unknown or the two measure different things.
    """
    given, target = _find(unit), _find("1" if wanted == "-" else wanted)
    if given is None or target is None or given.powers != target.powers or not abs(number) < 1e200:
        return None
    return float((Fraction(repr(number)) * given.factor + given.zero) / target.factor)


def _find(text: str) -> Unit | None:
    """The unit that a text names, such as "mN/m", "m^2/s" or "Pa s/m"; what follows a slash divides."""
    for other, ours in _SAME.items():
        text = text.replace(other, ours)
    words = re.sub(r"\s*/\s*", " /", re.sub(r"^/", "1/", text.strip())).split()
    factors = [_power(word.removeprefix("/"), -1 if word.startswith("/") else 1) for word in words]
    if not factors or None in factors:
        return None
    if len(factors) == 1:
        return factors[0]
    powers = tuple(map(sum, zip(*(one.powers for one in factors), strict=True)))
    return Unit(math.prod(one.factor for one in factors), powers)


def _power(word: str, sign: int) -> Unit | None:
    """One factor of a unit, such as "cm^3", or what it divides by."""
    match = _FACTOR.fullmatch(word)
    if match is None or match[1] not in _UNITS:
        return None
    one, power = _UNITS[match[1]], sign * int(match[2] or 1)
    return Unit(one.factor**power, tuple(power * each for each in one.powers), one.zero)
