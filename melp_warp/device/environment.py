"""What the process is given: the version of Warp, the variables that are ours, and how much Warp says.

Whatever starts Warp imports this first.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import re
import sys
import warnings
from collections.abc import Iterator

import warp as wp

from melp_warp.errors import InputError, require

OLDEST_WARP, NEWEST_WARP = (1, 17), (1, 19)
"""The versions of Warp that melp-warp is tested with. Older ones mix up kernels that are compiled side by side."""


class UntestedWarning(UserWarning):
    """A version that melp-warp has not been tested with."""


def check_warp(version: str) -> None:
    """Refuse a Warp that is too old, and say of one that is newer than all that were tested that it is.

    Raises:
        InputError: it is too old.
    """
    found = tuple(int(part) for part in re.findall(r"\d+", version)[:2])
    oldest, newest = (".".join(map(str, known)) for known in (OLDEST_WARP, NEWEST_WARP))
    if found < OLDEST_WARP:
        raise InputError(f"warp-lang {version} is too old: melp-warp needs {oldest} or newer, pip install -U warp-lang")
    if found > NEWEST_WARP:
        message = f"melp-warp is tested with warp-lang {oldest} to {newest}, this is {version}"
        warnings.warn_explicit(message, UntestedWarning, "melp-warp", 0)


def whole_number(variable: str, default: int, low: int, high: int) -> int:
    """The value of an environment variable.

    Raises:
        InputError: it is no whole number of that range.
    """
    text = os.environ.get(variable, "").strip()
    if not text:
        return default
    ok = re.fullmatch(r"\d{1,9}", text) is not None and low <= int(text) <= high
    require(ok, variable, text, f"a whole number from {low} to {high}")
    return int(text)


def announce(wanted: bool) -> None:
    """Let Warp say what it starts and compiles, or not; it does not unless it is told to."""
    wp.config.log_level = wp.LOG_INFO if wanted else wp.LOG_ERROR


def announces() -> bool:
    """Whether Warp says what it starts and compiles."""
    return wp.config.log_level <= wp.LOG_INFO


def start_warp() -> None:
    """Start Warp; without a word, unless `announce(True)` was called before."""
    with contextlib.nullcontext() if announces() else muted_stderr():
        wp.init()


@contextlib.contextmanager
def muted_stderr() -> Iterator[None]:
    """Drop what native code writes to stderr: Warp warns that there is no CUDA driver even where none is asked for."""
    sys.stderr.flush()
    kept = os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(sink)
        os.close(kept)


_precision = os.environ.get("MELP_WARP_PRECISION") or "32"
require(_precision in ("32", "64"), "MELP_WARP_PRECISION", _precision, "32 or 64")
check_warp(importlib.metadata.version("warp-lang"))
if announces():  # as is usual with Warp
    announce(False)
