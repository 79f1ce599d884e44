"""Ctrl-C at a better moment."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator

_held = False
_pressed = False


@contextlib.contextmanager
def finish_first() -> Iterator[None]:
    """Hold Ctrl-C back until the block is done, the one around it is, or `let_through` is called.

    Python raises `KeyboardInterrupt` wherever it is, and where that is a finalizer or a callback it is lost: what takes
    long holds it back all the time and lets it through where it can stop.

    Other threads never see it, and where a program around Python handles it, it is left to that.
    """
    global _held, _pressed  # noqa: PLW0603
    main = threading.current_thread() is threading.main_thread()
    if _held or not main or signal.getsignal(signal.SIGINT) is None:
        yield
        return
    previous = signal.signal(signal.SIGINT, _note)
    _held, _pressed = True, False
    try:
        yield
    finally:
        _held = False
        signal.signal(signal.SIGINT, previous)
    if _pressed:
        signal.raise_signal(signal.SIGINT)


def let_through() -> None:
    """Raise `KeyboardInterrupt` if Ctrl-C was pressed and held back.

    Raises:
        KeyboardInterrupt: it was.
    """
    global _pressed  # noqa: PLW0603
    if _pressed and threading.current_thread() is threading.main_thread():
        _pressed = False
        raise KeyboardInterrupt


def _note(*_: object) -> None:
    global _pressed  # noqa: PLW0603
    _pressed = True
