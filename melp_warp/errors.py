"""Errors a user can mend: each is one line that names the field, the value and what is allowed."""


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
