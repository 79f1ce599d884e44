"""The one place from which kernels are launched and graphs captured."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from weakref import WeakMethod

import warp as wp

from melp_warp.kernels.neighbors import Neighbors

THREADS = int(os.environ.get("MELP_WARP_THREADS", "0")) or os.cpu_count() or 1
"""CPU threads that share a launch. Results do not depend on it."""

ROWS_A_THREAD = 1024
"""Fewest rows of neighbours worth a CPU thread."""

ENTRIES_A_THREAD = 16384
"""Fewest entries of an array worth a CPU thread where a kernel looks at nothing else."""

ALONE_ROWS = 12000
"""Rows of neighbours from which a sequence gains more from cores than from being captured."""

GRAPHS = os.environ.get("MELP_WARP_GRAPHS", "1") != "0"
"""Whether sequences are captured at all. Results do not depend on it."""

CPU_BLOCK = 1
"""Threads of a block on the CPU, part of what a module is compiled for."""

_pool = ThreadPoolExecutor(THREADS)
_shared = True


class Shared:
    """An argument of `launch_rows` that every thread sees whole, whatever its length."""

    def __init__(self, array: wp.array | Neighbors | None):
        self.array = array


def launch(kernel, dim: int, inputs: Sequence, outputs: Sequence = (), device=None, least: int = ROWS_A_THREAD) -> None:
    """Launch `kernel` over `dim` threads; nothing happens for dim 0.

    On the CPU all cores share a kernel whose row is `rows.first + wp.tid()`, `rows` any of its neighbours: each is
    given a range of the rows. Such a kernel reads what it likes and writes row i of its outputs, so the result is the
    same to the bit.

    Args:
        kernel: the kernel.
        dim: number of threads of the kernel.
        inputs: its arguments.
        outputs: the arrays it writes.
        device: where to run.
        least: fewest rows worth a CPU thread.
    """
    if not _starts_anywhere(kernel.func):
        _launch(kernel, dim, inputs, outputs, device)
        return

    def run(first: int, last: int) -> None:
        parts = [[_from(a, first) for a in arguments] for arguments in (inputs, outputs)]
        _launch(kernel, last - first, *parts, device)

    _share(kernel, dim, least, device, run)


def launch_rows(kernel, dim: int, inputs: Sequence, outputs: Sequence = (), device=None) -> None:
    """As `launch`, and share a kernel whose thread i touches entry i alone of every array of length `dim`.

    Each core gets its range of those arrays and of the neighbour rows; arrays of other lengths are shared, and so are
    those marked `Shared`: mark what is read at another index, its length may be `dim` by chance.
    """
    if _starts_anywhere(kernel.func):
        launch(kernel, dim, inputs, outputs, device)
        return

    def run(first: int, last: int) -> None:
        cut = [[_cut(a, dim, first, last) for a in arguments] for arguments in (inputs, outputs)]
        _launch(kernel, last - first, *cut, device)

    _share(kernel, dim, ENTRIES_A_THREAD, device, run)


def _launch(kernel, dim: int, inputs: Sequence, outputs: Sequence, device) -> None:
    if dim > 0:
        wp.launch(kernel, dim=dim, inputs=list(inputs), outputs=list(outputs), device=device)


@cache
def _starts_anywhere(function: Callable) -> bool:
    """Whether a kernel takes its row from where its rows start."""
    return ".first + wp.tid()" in inspect.getsource(function)


def _share(kernel, dim: int, least: int, device, run: Callable[[int, int], None]) -> None:
    """Call run(first, last) for ranges that make up 0 to `dim`, one a core."""
    alone = not _shared or wp.get_device(device).is_cuda
    parts = 1 if alone else max(1, min(THREADS, dim // least))
    edges = [dim * k // parts for k in range(parts + 1)]
    if parts > 1:
        kernel.module.load(wp.get_device(device), CPU_BLOCK)  # not by every thread at once
    others = [_pool.submit(run, edges[k], edges[k + 1]) for k in range(1, parts)]
    run(0, edges[1])
    for other in others:
        other.result()


def _from(argument, first: int):
    """An argument for rows from `first` on."""
    if isinstance(argument, Shared):
        argument = argument.array
    if first > 0 and hasattr(argument, "first"):
        return _neighbors(argument.start, argument.stop, argument.index, first)
    return argument


def _cut(argument, dim: int, first: int, last: int):
    """The range of an argument that one thread works on."""
    if isinstance(argument, Shared):
        return argument.array
    if isinstance(argument, wp.array) and argument.shape[0] == dim:
        return argument[first:last]
    if hasattr(argument, "first") and argument.start.shape[0] == dim:
        return _neighbors(argument.start[first:last], argument.stop[first:last], argument.index, 0)
    return argument


def _neighbors(start: wp.array, stop: wp.array, index: wp.array, first: int) -> Neighbors:
    rows = Neighbors()
    rows.start, rows.stop, rows.index, rows.first = start, stop, index, first
    return rows


def compile_kernels(names: Iterable[str], device) -> None:
    """Compile kernel files side by side, as far as the cache lacks them, and not one by one at their first launch.

    Args:
        names: modules of `melp_warp.kernels`.
        device: where they are to run.
    """
    modules = [wp.get_module(import_module(f"melp_warp.kernels.{name}").__name__) for name in names]
    wp.force_load(device, modules, max_workers=THREADS)


def sort_pairs(key: wp.array, value: wp.array, count: int) -> None:
    """Sort the first `count` of 2 `count` keys (int32) and their values, which may allocate: no graph can hold it."""
    wp.utils.radix_sort_pairs(key, value, count)


def repeat(go: wp.array, body: Callable[[], None], most: int) -> None:
    """Launch a sequence again and again while `go[0]` is not 0, without the host looking where it is captured.

    Args:
        go: [1] int32, which the sequence itself sets to 0.
        body: launches the sequence; running it with `go[0]` at 0 must change nothing.
        most: times that it is run on a GPU whose driver has no conditional parts of graphs.
    """
    if _decides(go.device):
        wp.capture_while(go, body)
    else:
        for _ in range(most):
            body()


def _decides(device) -> bool:
    """Whether parts of a graph can depend on what is on the device."""
    return not device.is_cuda or wp.is_conditional_graph_supported()


class Recorded:
    """A sequence of launches that is captured as a graph at its first run and replayed from then on.

    The arrays it touches, their sizes and all numbers passed to kernels are baked in: make a new one when arrays are
    replaced, and hand numbers that change over in arrays (`melp_warp.settings.Setting`). A sequence within another that
    is captured becomes a part of that one's graph. A graph runs on one CPU core: from `least` rows on the sequence is
    run launch by launch instead, by all of them.

    Args:
        body: method of its owner that launches the sequence; it is not kept alive by this.
        device: where to run.
        rows: threads of the largest launch.
        least: fewest rows that all cores together are better for.
    """

    def __init__(self, body: Callable[[], None], device, rows: int = 0, least: int = ALONE_ROWS):
        self._method = WeakMethod(body)
        self._device = wp.get_device(device)
        self._shared = not self._device.is_cuda and THREADS > 1 and rows >= least
        self._graph = None

    def _body(self) -> None:
        self._method()()

    def __call__(self) -> None:
        """Run the sequence."""
        if self._shared or not _shared or not GRAPHS:
            self._body()
        elif self._graph is None:
            with _one_thread():
                self._body()  # the first run loads every module, which a capture must not do
                with wp.ScopedCapture(device=self._device) as capture:
                    self._body()
            self._graph = capture.graph
        else:
            wp.capture_launch(self._graph)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Launch from this thread alone: none other may launch during a capture."""
    global _shared  # noqa: PLW0603
    _shared, before = False, _shared
    try:
        yield
    finally:
        _shared = before
