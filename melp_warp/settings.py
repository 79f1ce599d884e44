"""Numbers that change from step to step, where a captured step finds them."""

from __future__ import annotations

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
