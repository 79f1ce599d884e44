"""CPU cores that run a graph each and wait for each other do what one would."""

import signal

import numpy as np
import pytest
import warp as wp

from melp_warp.device import launch as launcher
from melp_warp.device.launch import Recorded, clear, copy, launch, repeat
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.stages.neighbors import fixed_rows

N = 1200


@wp.kernel(enable_backward=False)
def mix_rows(rows: Neighbors, source: wp.array(dtype=wp.int32), target: wp.array(dtype=wp.int32)):
    """Shared by cores: reads what another core has written."""
    i = rows.first + wp.tid()
    n = target.shape[0]
    target[i] = source[(7 * i + 300) % n] + 3 * source[n - 1 - i] + 1


@wp.kernel(enable_backward=False)
def total_of(source: wp.array(dtype=wp.int32), left: wp.array(dtype=wp.int32), total: wp.array(dtype=wp.int32)):
    """On one core: reads what all have written, and counts down."""
    s = int(0)
    for i in range(source.shape[0]):
        s = s * 31 + source[i]
    total[0] = 5 * total[0] + s
    left[0] = left[0] - 1


@wp.kernel(enable_backward=False)
def set_left(count: wp.array(dtype=wp.int32), left: wp.array(dtype=wp.int32)):
    """Go round `count` times."""
    left[0] = count[0]


class Work:
    """Loops within a sequence; `inside` says what is in them: kernels that are shared, that are not, or both."""

    def __init__(self, device, inside):
        self.inside, self.device = inside, device
        self.rows = fixed_rows(N, 1, device)
        self.a = wp.array(np.arange(N, dtype=np.int32), device=device)
        self.b, self.c = (wp.zeros(N, dtype=wp.int32, device=device) for _ in range(2))
        self.total, self.left = (wp.zeros(1, dtype=wp.int32, device=device) for _ in range(2))
        self.count = wp.array([9], dtype=wp.int32, device=device)
        self.run = Recorded(self.body, device, N)

    def body(self):
        """Shared, alone, shared, and two loops in a row that are told by the same number when to stop."""
        launch(mix_rows, N, [self.rows, self.a], [self.b], self.device)
        clear(self.c)
        for _ in range(2):
            launch(set_left, 1, [self.count], [self.left], self.device)
            repeat(self.left, self.turn, 9)
        copy(self.c, self.b)
        launch(mix_rows, N, [self.rows, self.c], [self.a], self.device)

    def turn(self):
        if self.inside != "alone":
            launch(mix_rows, N, [self.rows, self.b], [self.c], self.device)
            launch(mix_rows, N, [self.rows, self.c], [self.b], self.device)
        launch(total_of, 1, [self.b], [self.left, self.total], self.device)

    def numbers(self):
        """All that the sequence leaves."""
        return [array.numpy().copy() for array in (self.a, self.b, self.c, self.total)]


@pytest.fixture(autouse=True)
def all_together(monkeypatch):
    """As on a machine that nothing else runs on."""
    monkeypatch.setattr(launcher, "crew", launcher.Crew(adapts=False))


@pytest.mark.parametrize("inside", ["alone", "both"])
def test_lanes_wait_for_each_other(inside, device, monkeypatch):
    """On three cores, 300 times over, the numbers are those of one core and those without a graph."""
    results = []
    for threads, graphs in ((1, False), (1, True), (3, True)):
        monkeypatch.setattr(launcher, "THREADS", threads)
        monkeypatch.setattr(launcher, "GRAPHS", graphs)
        work = Work(device, inside)
        for k in range(300):
            work.count.assign([k % 5])
            work.run()
        results.append(work.numbers())
        assert len(work.run._graphs) == graphs * threads
    for other in results[1:]:
        assert all(np.array_equal(one, two) for one, two in zip(results[0], other, strict=True))
    assert results[0][3][0] != 0


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_waits_for_all_lanes(device, monkeypatch):
    """Pressed when some cores have started and others have not, it comes when all are done, and nothing is lost."""
    monkeypatch.setattr(launcher, "THREADS", 3)
    works = [Work(device, "both") for _ in range(2)]
    for work in works:
        work.run()
    replay, first = wp.capture_launch, works[0].run._graphs[0]

    def press(graph):
        if graph is first:
            signal.raise_signal(signal.SIGINT)
        replay(graph)

    works[1].run()
    with monkeypatch.context() as patch:
        patch.setattr(wp, "capture_launch", press)
        with pytest.raises(KeyboardInterrupt):
            works[0].run()
    for work in works:
        work.run()
    assert all(np.array_equal(one, two) for one, two in zip(*(work.numbers() for work in works), strict=True))


def test_what_is_not_shared_wakes_no_core(device, monkeypatch):
    """A sequence in which one core does everything is one graph."""
    monkeypatch.setattr(launcher, "THREADS", 3)
    work = Work(device, "alone")
    run = Recorded(work.turn, device, N)
    run()
    assert len(run._graphs) == 1


def test_one_alone_by_turns_gives_the_same(device, monkeypatch):
    """Bit for bit, whoever works when; the graph for one is captured when it is first asked for."""
    monkeypatch.setattr(launcher, "THREADS", 3)
    works = [Work(device, "both") for _ in range(2)]
    for k in range(60):
        for work, alone in zip(works, (False, k % 7 < 3), strict=True):
            launcher.crew.together = not alone
            work.count.assign([k % 5])
            work.run()
    assert [len(work.run._alone) for work in works] == [0, 1]
    assert all(np.array_equal(one, two) for one, two in zip(*(work.numbers() for work in works), strict=True))


def test_threads_without_cores_leave_the_work_to_one(monkeypatch):
    """Two that lose half of the time are slower than one; later they try again, and less often each time in vain."""
    monkeypatch.setattr(launcher, "THREADS", 2)
    crew = launcher.Crew(adapts=True)
    for lost, together in ((0.0, True), (0.2, True), (0.5, False), (0.5, False), (0.05, True), (0.6, False)):
        crew.note(lost)
        assert crew.together == together
    assert crew._patience == 4.0 * crew.SHORT
    crew.note(0.0)
    crew.note(0.0)
    assert crew.together and crew._patience == crew.SHORT


def test_it_is_looked_at_from_time_to_time(monkeypatch):
    now, late = [0.0], [0.0]
    monkeypatch.setattr(launcher, "THREADS", 2)
    monkeypatch.setattr(launcher, "perf_counter", lambda: now[0])
    monkeypatch.setattr(launcher, "without_core", lambda: late[0])
    crew = launcher.Crew(adapts=True)
    seen = []
    for k in range(800):  # every 10 ms; others are in the way from 1 to 2 s
        now[0] += 0.01
        late[0] += 0.01 if 100 <= k < 200 else 0.0
        crew.look()
        seen.append(crew.together)
    assert all(seen[:100]) and not any(seen[130:230]) and all(seen[-30:])
    asked = launcher.Crew(adapts=False)
    asked.note(0.0)
    for _ in range(100):
        now[0] += 1.0
        late[0] += 1.0
        asked.look()
    assert asked.together


def test_time_without_a_core_is_counted():
    before = launcher.without_core()
    assert 0.0 <= before <= launcher.without_core()
