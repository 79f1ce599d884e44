"""Errors a user can mend: each is one line that names the field, the value and what is allowed."""

from __future__ import annotations

import traceback

SCENE_FILE = "melp_warp_scene_"
"""What the names of modules start with that are made of a scene file."""


class InputError(ValueError):
    """Input that cannot be used. The command line prints the message and exits with code 2."""


class SimulationError(RuntimeError):
    """A run that cannot go on (non-finite state, collapsed gas, lists that overflow).

    The message names the stage and, where one is to blame, the particle.
    """


class CrowdedError(SimulationError):
    """A neighbour list overflowed: what was done since the last good state can be done again with more room."""


class LeapError(SimulationError):
    """Particles moved too far in a step: what was done since the last good state can be done again in smaller ones."""


def require(condition: bool, field: str, value: object, allowed: str) -> None:
    """Raise `InputError("FIELD must be ALLOWED, got VALUE")` unless `condition` holds."""
    if not condition:
        raise InputError(f"{field} must be {allowed}, got {value!r}")


def in_a_line(error: BaseException) -> str:
    """An error's kind and the first line of its message."""
    return f"{type(error).__name__}: {(str(error).splitlines() or ['no message'])[0]}"


def from_scene(error: BaseException) -> str | None:
    """Where in a scene the code was that raised an error, or called what did; None where no scene took part."""
    found = None
    for frame, line in traceback.walk_tb(error.__traceback__):
        if frame.f_globals.get("__name__", "").startswith((SCENE_FILE, "melp_warp.scenes.")):
            found = f"{frame.f_code.co_filename}, line {line}, in {frame.f_code.co_name}"
    return found
