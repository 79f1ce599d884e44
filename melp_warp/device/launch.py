"""The one place from which kernels are launched and graphs captured."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from threading import Lock
from time import perf_counter
from weakref import WeakMethod

import warp as wp

from melp_warp.device.environment import whole_number
from melp_warp.device.interrupt import finish_first
from melp_warp.kernels.barrier import meet
from melp_warp.kernels.neighbors import Neighbors


def _cores() -> int:
    """CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_ASKED = whole_number("MELP_WARP_THREADS", 0, 0, 1024)

THREADS = _ASKED or _cores()
"""CPU threads that share a launch. Results do not depend on it."""

ROWS_A_THREAD = 1024
"""Fewest rows of neighbours worth waking a CPU thread for."""

ENTRIES_A_THREAD = 16384
"""The same for entries of an array, where a kernel looks at nothing else."""

ROWS_A_LANE = 256
"""Fewest rows of neighbours worth a lane of a graph, which is awake already."""

ENTRIES_A_LANE = 2048
"""The same for entries of an array."""

GRAPHS = whole_number("MELP_WARP_GRAPHS", 1, 0, 1) == 1
"""Whether sequences are captured at all. Results do not depend on it."""

CPU_BLOCK = 1
"""Threads of a block on the CPU, part of what a module is compiled for."""

_pool = ThreadPoolExecutor(max(THREADS, 8))
_team = Lock()


class Shared:
    """An argument of `launch_rows` that every thread sees whole, whatever its length."""

    def __init__(self, array: wp.array | Neighbors | None):
        self.array = array


class _Lane:
    """One of the CPU cores that a sequence is recorded for, each into a graph of its own.

    A lane has its range of the rows of kernels that cores share; the first one has all others. Before what another
    lane may have yet to do for it a lane waits until all are there.

    Args:
        number: which of them.
        count: how many there are.

    Attributes:
        needed: whether the lane has anything to do.
    """

    def __init__(self, number: int, count: int):
        self.number, self.count = number, count
        self._behind = None  # what the lanes have not waited for yet: "all" of them, the "first", or none
        self.needed = number == 0

    def alone(self, run: Callable[[], None]) -> None:
        """Record what the first lane does for all."""
        if self._behind == "all":
            self.wait()
        if self.number == 0:
            run()
        self._behind = "first"

    def share(self, run: Callable[[int, int], None], dim: int, least: int) -> None:
        """Record this lane's part of run(first, last)."""
        parts = max(1, min(self.count, dim // least))
        if parts == 1:
            self.alone(lambda: run(0, dim))
            return
        self.wait()
        self.needed = True
        if self.number < parts:
            run(dim * self.number // parts, dim * (self.number + 1) // parts)
        self._behind = "all"

    def repeat(self, go: wp.array, body: Callable[[], None]) -> None:
        """Record a sequence that is repeated while `go[0]` is not 0: all lanes look before it changes again."""

        def turn() -> None:
            self._meet()
            body()
            self.wait()

        self.wait()
        wp.capture_while(go, turn)
        self._meet()

    def wait(self) -> None:
        """Record a wait for all lanes, unless nothing happened since the last one."""
        if self._behind:
            self._meet()

    def _meet(self) -> None:
        if self.count > 1:
            self.needed = True
            wp.launch(meet, dim=1, inputs=[_gate(), self.count], device="cpu")
        self._behind = None


@cache
def _gate() -> wp.array:
    """Where lanes meet: one place for all sequences, as one runs at a time."""
    return wp.zeros(32, dtype=wp.uint32, device="cpu")


_lane: _Lane | None = None
"""The lane that is being recorded."""


def launch(kernel, dim: int, inputs: Sequence, outputs: Sequence = (), device=None) -> None:
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
    """
    if not _starts_anywhere(kernel.func):
        _alone(lambda: _launch(kernel, dim, inputs, outputs, device))
        return

    def run(first: int, last: int) -> None:
        parts = [[_from(a, first) for a in arguments] for arguments in (inputs, outputs)]
        _launch(kernel, last - first, *parts, device)

    _share(kernel, dim, ROWS_A_THREAD, ROWS_A_LANE, device, run)


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

    _share(kernel, dim, ENTRIES_A_THREAD, ENTRIES_A_LANE, device, run)


def copy(target: wp.array, source: wp.array, count: int = 0) -> None:
    """Copy the first `count` entries of an array, or all, as a part of a sequence."""
    _alone(lambda: wp.copy(target, source, count=count))


def clear(array: wp.array) -> None:
    """Set an array to zero, as a part of a sequence."""
    _alone(array.zero_)


def _alone(run: Callable[[], None]) -> None:
    """Do what one core does for all."""
    if _lane is None:
        run()
    else:
        _lane.alone(run)


def _launch(kernel, dim: int, inputs: Sequence, outputs: Sequence, device) -> None:
    if dim > 0:
        wp.launch(kernel, dim=dim, inputs=list(inputs), outputs=list(outputs), device=device)


@cache
def _starts_anywhere(function: Callable) -> bool:
    """Whether a kernel takes its row from where its rows start."""
    return ".first + wp.tid()" in inspect.getsource(function)


def _share(kernel, dim: int, least: int, least_lane: int, device, run: Callable[[int, int], None]) -> None:
    """Call run(first, last) for ranges that make up 0 to `dim`, one a core."""
    if _lane is not None:
        _lane.share(run, dim, least_lane)
        return
    threads = THREADS if crew.together else 1
    parts = 1 if wp.get_device(device).is_cuda else max(1, min(threads, dim // least))
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
    if not _decides(go.device):
        for _ in range(most):
            body()
    elif _lane is None:
        wp.capture_while(go, body)
    else:
        _lane.repeat(go, body)


def _decides(device) -> bool:
    """Whether parts of a graph can depend on what is on the device."""
    return not device.is_cuda or wp.is_conditional_graph_supported()


class Crew:
    """Whether the threads work together, or one alone as other processes have the cores.

    Threads that run graphs together wait for each other between kernels, so that one without a core holds up all of
    them: on a busy machine two are several times slower than one. What tells is how long threads were ready to run and
    had no core, which Linux counts; elsewhere they always work together.

    Args:
        adapts: whether they ever stop working together.

    Attributes:
        together: whether they do now.
    """

    LOOK = 0.2
    """Wall time after which it is looked at, s."""

    SHORT, LONG = 1.0, 60.0
    """Half the wall time for which one works alone at first, and all of it after many tries in vain, s."""

    def __init__(self, adapts: bool):
        self.together = True
        self._adapts = adapts and THREADS > 1 and os.path.exists("/proc/self/task")
        self._patience = self.SHORT
        self._since = self._before = None

    def look(self) -> None:
        """Decide from time to time how the next work is done."""
        now = perf_counter() if self._adapts else 0.0
        if self._since is None:
            self._since, self._before = now, without_core() if self._adapts else 0.0
        elif now - self._since >= (self.LOOK if self.together else self._patience):
            late = without_core()
            self.note((late - self._before) / (now - self._since))
            self._since, self._before = now, late

    def note(self, lost: float) -> None:
        """Take down the time that threads had no core, summed over them, in times the wall time.

        It is what all of them lose where they work together; `THREADS` are then about 0.7 times as many as fast as one.
        """
        if not self.together:  # one that has no core of its own needs not ask for two
            self.together = lost < 0.1
        elif lost > 1.0 - 1.0 / (0.7 * THREADS):
            self.together = False
            self._patience = min(2.0 * self._patience, self.LONG)
        else:
            self._patience = self.SHORT


def without_core() -> float:
    """Time that the threads of this process were ready to run and had no core, summed over them, s."""
    waited = 0
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError, IndexError, ValueError), open(f"/proc/self/task/{thread}/schedstat") as file:
            waited += int(file.read().split()[1])
    return 1e-9 * waited


crew = Crew(adapts=_ASKED == 0)
"""The threads of this process."""


class Recorded:
    """A sequence of launches that is captured at its first run and replayed from then on.

    On the CPU it is captured once a core, each of which runs a graph of its own: they start together and meet between
    kernels (`_Lane`), so that a sequence wakes them once. A GPU has one graph.

    The arrays it touches, their sizes and all numbers passed to kernels are baked in: make a new one when arrays are
    replaced, and hand numbers that change over in arrays (`scalars.Setting`). A sequence within another that
    is captured becomes a part of that one's graph. It may contain what this module launches, copies and clears.

    Args:
        body: method of its owner that launches the sequence; it is not kept alive by this.
        device: where to run.
        rows: threads of the largest launch.
    """

    def __init__(self, body: Callable[[], None], device, rows: int):
        self._method = WeakMethod(body)
        self._device = wp.get_device(device)
        self._rows = rows
        self._graphs = []
        self._alone = []

    def _body(self) -> None:
        self._method()()

    def __call__(self) -> None:
        """Run the sequence."""
        if _lane is not None or not GRAPHS:
            self._body()
        elif not self._graphs:
            with _recording(_Lane(0, 1)):
                self._body()  # the first run loads every module, which a capture must not do
            count = 1 if self._device.is_cuda else max(1, min(THREADS, self._rows // ROWS_A_LANE))
            self._graphs = self._capture(count)
        else:
            crew.look()
            _run_together(self._graphs if crew.together or self._device.is_cuda else self._one())

    def _one(self) -> list[wp.Graph]:
        """The sequence as the graph of one thread."""
        if not self._alone:
            self._alone = self._graphs if len(self._graphs) == 1 else self._capture(1)
        return self._alone

    def _capture(self, count: int) -> list[wp.Graph]:
        """The sequence as graphs for a number of threads, those that have anything to do."""
        graphs = []
        if count > 1:
            wp.launch(meet, dim=1, inputs=[_gate(), 1], device=self._device)  # loads its module
        for number in range(count):
            lane = _Lane(number, count)
            with _recording(lane), wp.ScopedCapture(device=self._device) as capture:
                self._body()
            if lane.needed:
                graphs.append(capture.graph)
        return graphs


def _run_together(graphs: Sequence[wp.Graph]) -> None:
    """Run graphs side by side, a CPU core each; they wait for each other, so that nothing may get in between."""
    with _team, finish_first():
        others = [_pool.submit(wp.capture_launch, graph) for graph in graphs[1:]]
        wp.capture_launch(graphs[0])
        for other in others:
            other.result()


@contextmanager
def _recording(lane: _Lane) -> Iterator[None]:
    """Take what is launched for work of this lane."""
    global _lane  # noqa: PLW0603
    _lane, before = lane, _lane
    try:
        yield
    finally:
        _lane = before
