"""What the checks of a cache share: how they name files, faults and what was expected."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from melp_warp.usd.schema import (
    FRAMES,
    METADATA_KEY,
    frame_path,
)

MOST_NAMED = 10
"""Problems of one kind that are told one by one; of more the number is told."""


def guarded(name: str, check: Callable[..., list[str]], *arguments) -> list[str]:
    """The problems that a check finds; what a file from elsewhere makes of it besides is one, too."""
    try:
        return check(*arguments)
    except Exception as error:
        return [f"{name}: cannot be checked: {in_words(error)}"]


def in_words(error: Exception) -> str:
    """An error in a line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def listed(frames: Sequence[int]) -> str:
    """Frame numbers in few words."""
    return f"{frames[0]} to {frames[-1]} ({len(frames)})" if len(frames) else "none"


def few(faults: Sequence, words: Callable[..., str] = str) -> list[str]:
    """The first faults of a kind in words, and how many there are besides."""
    named = [words(fault) for fault in faults[: MOST_NAMED + 1]]
    more = len(faults) - len(named)
    return named if more <= 0 else [*named[:-1], f"{named[-1]} (and {more} more)"]


def frame_name(frame: int) -> str:
    """The file of a frame, as problems name it."""
    return f"{FRAMES}/{frame_path('', frame).name}"


def expect(where: str, found: object, wanted: object) -> list[str]:
    """A problem where something is not what it must be."""
    return [] if found == wanted else [f"{where}: is {found!r:.200}, must be {wanted!r}"]


def metadata_of(layer) -> dict:
    """What a layer says of the run, {} where that is no dictionary."""
    data = layer.customLayerData.get(METADATA_KEY, {})
    return data if isinstance(data, dict) else {}
