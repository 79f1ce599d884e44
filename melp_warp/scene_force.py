"""A force from outside that a scene brings along: a Warp function, checked and told from others."""

from __future__ import annotations

import ast
import hashlib
from dataclasses import dataclass
from typing import Any

from melp_warp.errors import InputError, require
from melp_warp.keyframes import Number, check_number, identity

ARGUMENTS = ("vec3", "float", "vec3", "float")
SIGNATURE = "(x: wp.vec3, t: float, u: wp.vec3, eta: float, ...numbers: float) -> acceleration, rate"


@dataclass(frozen=True, init=False)
class Force:
    """An acceleration of the film, from a Warp function of place, time, velocity and thickness.

        @wp.func
        def wind(x: wp.vec3, t: float, u: wp.vec3, eta: float, speed: float):
            rate = 20.0
            return rate * (wp.vec3(speed, 0.0, 0.0) - u), rate

        Force(wind, speed=0.5)

    The function is given where an E is (m, in the scene's own coordinates), the time in the middle of the step (s), the
    velocity of the liquid (m/s) and the film's thickness (m), and then its numbers. It returns the acceleration (m/s^2)
    and the rate at which that falls as the velocity grows (1/s, 0 for none). With the rate, a force that would need
    small steps is solved for together with all others.

    Args:
        function: decorated with `wp.func`.
        **numbers: for each further argument of the function a number, `Keyframes` or a function of time.

    Raises:
        InputError: it is no Warp function, its arguments are others, or a number is missing, unknown or none.

    Attributes:
        numbers: in the order of the function's arguments.
    """

    function: Any
    numbers: dict[str, Number]

    def __init__(self, function: Any, /, **numbers: Number):
        import warp as wp

        name = getattr(function, "key", None) or getattr(function, "__name__", repr(function))
        require(
            isinstance(function, wp.Function) and not function.is_builtin(), "force", name, "a function of @wp.func"
        )
        _check_arguments(name, function)
        wanted = list(function.input_types)[len(ARGUMENTS) :]
        given = f"numbers {', '.join(numbers) or 'none'}"
        require(set(wanted) == set(numbers), f"force {name}", given, f"one with {', '.join(wanted) or 'no number'}")
        for key, number in numbers.items():
            check_number(f"{key} of force {name}", number)
        object.__setattr__(self, "function", function)
        object.__setattr__(self, "numbers", {key: numbers[key] for key in wanted})

    @classmethod
    def of(cls, one: Any) -> Force:
        """A force, or a Warp function without numbers, as a force."""
        return one if isinstance(one, Force) else cls(one)

    @property
    def name(self) -> str:
        """That of its function."""
        return self.function.key

    @property
    def digest(self) -> str:
        """What tells its function from others: its code, and all code and numbers that it refers to."""
        told = hashlib.sha256()
        for text in sorted(_told(self.function, set())):
            told.update(text.encode())
        return told.hexdigest()[:16]

    def describe(self) -> dict[str, object]:
        """What a checkpoint says of it: plain values."""
        said = {key: identity(number) if callable(number) else number for key, number in self.numbers.items()}
        return {"function": f"{self.name} {self.digest}", **said}


def _check_arguments(name: str, function: Any) -> None:
    """Refuse a function that takes or returns something else."""
    import warp as wp

    double = {wp.float64: "float", wp.vec3d: "vec3"}
    single = {float: "float", vars(wp)["float32"]: "float", vars(wp)["vec3f"]: "vec3"}
    kinds = double if wp.vec3 is wp.vec3d else single
    found = [kinds.get(kind, getattr(kind, "__name__", str(kind))) for kind in function.input_types.values()]
    right = tuple(found[:4]) == ARGUMENTS and all(kind == "float" for kind in found[4:])
    told = f"({', '.join(found)})"
    if kinds is double:
        told += "; with MELP_WARP_PRECISION=64 it must be in a scene file, or be written with wp.float64 and wp.vec3d"
    if not right:
        raise InputError(f"force {name} must be {SIGNATURE}, got {told}")
    returned = [node.value for node in ast.walk(function.adj.tree) if isinstance(node, ast.Return)]
    pairs = all(not isinstance(value, ast.Tuple) or len(value.elts) == 2 for value in returned)
    plain = any(isinstance(value, (ast.Constant, ast.Name, ast.BinOp)) or value is None for value in returned)
    require(
        bool(returned) and pairs and not plain, f"force {name}", "another return", "one that returns acceleration, rate"
    )


def _told(function: Any, seen: set) -> list[str]:
    """The code of a Warp function and of those that it calls, and the constants in them."""
    if function in seen or function.is_builtin():
        return []
    seen.add(function)
    constants, _, functions = function.adj.get_references()
    told = [ast.unparse(function.adj.tree), *(f"{function.key} {name} {value!r}" for name, value in constants.items())]
    return told + [text for other in functions for text in _told(other, seen)]
