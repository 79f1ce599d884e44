"""Ctrl-C, SIGTERM and SIGHUP at a better moment."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask a run to end."""

_held = False
_noted: int | None = None


class Interrupted(KeyboardInterrupt):
    """One of `SIGNALS` came.

    Attributes:
        number: which.
    """

    def __init__(self, number: int = signal.SIGINT):
        super().__init__()
        self.number = int(number)


@contextlib.contextmanager
def end_like_ctrl_c() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise `Interrupted` within the block, where they would end the program without a word.

    Signals that are ignored, as by nohup, stay ignored.
    """
    main = threading.current_thread() is threading.main_thread()
    taken = [s for s in SIGNALS if s != signal.SIGINT and main and signal.getsignal(s) == signal.SIG_DFL]
    for number in taken:
        signal.signal(number, _raise)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def finish_first() -> Iterator[None]:
    """Hold signals back until the block is done, the one around it is, or `let_through` is called.

    Python raises `KeyboardInterrupt` wherever it is, and where that is a finalizer or a callback it is lost: what takes
    long holds it back all the time and lets it through where it can stop.

    Other threads never see it. A signal that is ignored, or that a program around Python handles, is left alone.
    """
    global _held, _noted  # noqa: PLW0603
    if _held or threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {s: signal.getsignal(s) for s in SIGNALS if callable(signal.getsignal(s))}
    for number in previous:
        signal.signal(number, _note)
    _held, _noted = True, None
    try:
        yield
    finally:
        _held = False
        for number, handler in previous.items():
            signal.signal(number, handler)
    if _noted is not None:
        signal.raise_signal(_noted)


def let_through() -> None:
    """Raise what a signal that was held back would have raised.

    Raises:
        Interrupted: one was.
    """
    global _noted
    if _noted is not None and threading.current_thread() is threading.main_thread():
        number, _noted = _noted, None
        raise Interrupted(number)


def _note(number: int, _frame: object) -> None:
    global _noted  # noqa: PLW0603
    _noted = number


def _raise(number: int, _frame: object) -> None:
    raise Interrupted(number)
