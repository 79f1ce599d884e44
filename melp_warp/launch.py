"""The one place from which kernels are launched."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp


def launch(kernel, dim: int, inputs: Sequence, outputs: Sequence = (), device=None) -> None:
    """Launch `kernel` over `dim` threads; nothing happens for dim 0."""
    if dim > 0:
        wp.launch(kernel, dim=dim, inputs=list(inputs), outputs=list(outputs), device=device)


class Recorded:
    """A sequence of launches that is captured as a graph at its first run and replayed from then on.

    The arrays it touches and their sizes are baked in: make a new one when they are replaced.
    """

    def __init__(self, body: Callable[[], None], device):
        self._body = body
        self._device = device
        self._graph = None

    def __call__(self) -> None:
        """Run the sequence."""
        if self._graph is None:
            self._body()  # the first run loads every module, which a capture must not do
            with wp.ScopedCapture(device=self._device) as capture:
                self._body()
            self._graph = capture.graph
        else:
            wp.capture_launch(self._graph)
