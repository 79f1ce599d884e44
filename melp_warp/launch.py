"""The one place from which kernels are launched."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import warp as wp

from melp_warp.kernels.neighbors import Neighbors

THREADS = int(os.environ.get("MELP_WARP_THREADS", "0")) or os.cpu_count() or 1
"""Threads that share a `launch_rows` on the CPU. Results do not depend on it."""

ROWS_A_THREAD = 4096
"""Fewer L than this are not worth a thread of their own."""

_pool = ThreadPoolExecutor(THREADS)


class Shared:
    """An argument of `launch_rows` that every thread sees whole, whatever its length."""

    def __init__(self, array: wp.array | Neighbors | None):
        self.array = array


def launch_rows(
    kernel, dim: int, inputs: Sequence, outputs: Sequence = (), device=None, least: int = ROWS_A_THREAD
) -> None:
    """Launch a kernel whose thread i touches entry i alone of every array of length `dim`, on all CPU cores.

    Each thread gets its range of those arrays and of the neighbour rows; arrays of other lengths are shared, and so
    are those marked `Shared`. Mark every array that is read at a neighbour's index: its length may be `dim` by chance.
    Nothing is summed across threads, so the result is the same to the bit.

    Args:
        kernel: the kernel.
        dim: number of threads of the kernel.
        inputs: its arguments.
        outputs: the arrays it writes.
        device: where to run.
        least: fewest rows worth a CPU thread.
    """
    parts = min(THREADS, dim // least)
    if parts < 2 or wp.get_device(device).is_cuda:
        launch(kernel, dim, [_whole(a) for a in inputs], outputs, device)
        return
    edges = [dim * k // parts for k in range(parts + 1)]
    kernel.module.load(wp.get_device(device))

    def run(k: int) -> None:
        first, last = edges[k], edges[k + 1]
        cut = [[_cut(a, dim, first, last) for a in arguments] for arguments in (inputs, outputs)]
        launch(kernel, last - first, *cut, device)

    others = [_pool.submit(run, k) for k in range(1, parts)]
    run(0)
    for other in others:
        other.result()


def _whole(argument):
    return argument.array if isinstance(argument, Shared) else argument


def _cut(argument, dim: int, first: int, last: int):
    """The range of an argument that one thread works on."""
    if isinstance(argument, Shared):
        return argument.array
    if isinstance(argument, wp.array) and argument.shape[0] == dim:
        return argument[first:last]
    if hasattr(argument, "stop") and argument.start.shape[0] == dim:
        rows = Neighbors()
        rows.start, rows.stop, rows.index = argument.start[first:last], argument.stop[first:last], argument.index
        return rows
    return argument


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
