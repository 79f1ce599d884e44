"""Numbers that pass between host and device from step to step, without either waiting for the other."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import warp as wp


class Setting:
    """A number that kernels read from the device and the host sets between steps.

    A graph keeps the numbers that it was captured with; what an array holds it reads anew at every replay.

    Args:
        device: where the number is read.
        dtype: its type there.

    Attributes:
        array: [1] the number, 0 at first.
    """

    def __init__(self, device, dtype=wp.float32):
        self.array = wp.zeros(1, dtype=dtype, device=device)
        self._value = 0

    def at(self, value: float) -> wp.array:
        """Set the number, written only where it changes; its array."""
        if value != self._value:
            self.array.fill_(value)
            self._value = value
        return self.array


class Reading:
    """A small array as it was after a step, for the host to look at.

    On a GPU the host sees how things were a step before the last one: it never waits for the step in progress.

    Args:
        array: what to read.
    """

    def __init__(self, array: wp.array):
        self._array = array
        self._taken = deque(maxlen=2 if array.device.is_cuda else 1)

    def take(self, note: Any) -> None:
        """Copy the array once the steps launched so far are done; `note` is kept with it."""
        host, done = self._room()
        wp.copy(host, self._array)
        if done is not None:
            self._array.device.stream.record_event(done)
        self._taken.append((host, done, note))

    def _room(self) -> tuple[wp.array, wp.Event | None]:
        if len(self._taken) == self._taken.maxlen:
            return self._taken.popleft()[:2]
        gpu = self._array.device.is_cuda
        host = wp.empty(self._array.shape, dtype=self._array.dtype, device="cpu", pinned=gpu)
        return host, wp.Event(self._array.device) if gpu else None

    def get(self) -> tuple[np.ndarray, Any] | None:
        """The array and its note; None where none was taken."""
        if not self._taken:
            return None
        host, done, note = self._taken[0]
        if done is not None:
            wp.synchronize_event(done)
        return host.numpy(), note

    def contents(self) -> list[tuple[np.ndarray, Any]]:
        """Copies of what was taken last, each with its note, the oldest first (waits for it)."""
        for _, done, _ in self._taken:
            if done is not None:
                wp.synchronize_event(done)
        return [(host.numpy().copy(), note) for host, _, note in self._taken]

    def refill(self, contents: list[tuple[np.ndarray, Any]]) -> None:
        """Go on as if this had been taken."""
        self._taken.clear()
        for values, note in contents[-self._taken.maxlen :]:
            host, done = self._room()
            host.assign(values)
            if done is not None:
                self._array.device.stream.record_event(done)
            self._taken.append((host, done, note))
