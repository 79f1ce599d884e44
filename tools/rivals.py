"""What a user would pick instead: the same gather in SciPy, Numba and Taichi, and the explicit single-layer step."""

from __future__ import annotations

import importlib
import statistics
import time
from collections.abc import Callable

import numpy as np
import warp as wp

from melp_warp.device.launch import launch
from melp_warp.errors import SimulationError
from melp_warp.kernels.native import weigh_row
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation
from melp_warp.study.validation import unevenness

EXPLICIT_TIME = 28e-3
"""Simulated time to which the explicit and the implicit step are run, s."""

EVEN_TIME, FLOW_TIME = 0.3, 0.1
"""Simulated times to which an uneven disc is let even out, and the same with the particles of the paper's flow, s."""

MELP = {"e_count": 1050, "l_per_e": 16}
SINGLE = {"e_count": 4200, "layers": 1}
FINER = {"e_count": 2100, "l_per_e": 8, "dt": 1e-3, "tolerance": 1e-6}
"""The disc of MELP 2022, Table 4, in two layers and in one; and in two in steps a thirtieth as long."""

BARE = {"e_count": 1050, "layers": 1, "drag": 0.0}
"""The disc without the air's drag, which the paper's film does not have."""

WEAKER = 0.1
"""What the paper multiplies the tension of its single layer by."""

MOST_STEPS = 5000
"""Steps after which a run whose step follows from speeds alone is given up."""

TAME = 2.0
"""A run is unstable when its largest speed exceeds that of the implicit one by this factor."""


@wp.kernel(enable_backward=False)
def gather_bare(
    x: wp.array(dtype=wp.vec3),
    source: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    total: wp.array(dtype=float),
):
    """One weighted sum over the list, weights recomputed: the least that an SPH pass does."""
    i = rows.first + wp.tid()
    p = x[i]
    s = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        s += kernel_w(wp.length(source[rows.index[k]] - p), r)
    total[i] = s


@wp.kernel(enable_backward=False)
def gather_row(
    x: wp.array(dtype=wp.vec3), rows: Neighbors, r: float, weight: wp.array(dtype=float), total: wp.array(dtype=float)
):
    """The same sum by the C++ loop that the step uses, weights kept."""
    i = rows.first + wp.tid()
    total[i] = weigh_row(i, x[i], x, rows, r, x.shape[0], weight)[3]


def median_ms(work: Callable[[], object], repeats: int = 5) -> float:
    """Median wall time of `work`, the first call left out, ms."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - began))
    return statistics.median(times[1:])


def compact(rows: Neighbors) -> tuple[np.ndarray, np.ndarray]:
    """The list without the room between its rows: offsets [n + 1] and indices [pairs]."""
    start, stop, index = rows.start.numpy(), rows.stop.numpy(), rows.index.numpy()
    count = stop - start
    offset = np.concatenate([[0], np.cumsum(count)])
    place = np.arange(offset[-1]) + np.repeat(start - offset[:-1], count)
    return offset.astype(np.int32), index[place]


def weights(d: np.ndarray, r: float) -> np.ndarray:
    """`kernels.sph.kernel_w` in NumPy."""
    s = 3.0 * d / r
    powers = [np.maximum(c - s, 0.0) ** 5 for c in (3.0, 2.0, 1.0)]
    return 0.004661441847 * 9.0 / r**2 * (powers[0] - 6.0 * powers[1] + 15.0 * powers[2])


def gathers(sim: Simulation) -> list[dict]:
    """The gather over the E:E list of a film by every means at hand, and what it takes to find the list."""
    film, lists, x = sim.film, sim.stepper.lists, sim.state.e.x
    rows, n = lists.ee.rows, film.n_e
    total, weight = film.zeros(n), film.zeros(rows.index.shape[0])
    offset, index = compact(rows)
    points = x.numpy()[:n].copy()
    made = [
        ("list", median_ms(lists.rebuild_e)),
        ("gather, Warp", median_ms(lambda: launch(gather_bare, n, [x, x, rows, film.r], [total], sim.device))),
        ("gather, C++ row", median_ms(lambda: launch(gather_row, n, [x, rows, film.r], [weight, total], sim.device))),
    ]
    expected = total.numpy()
    for name, rival in (("scipy", scipy_gather), ("numba", numba_gather), ("taichi", taichi_gather)):
        try:
            importlib.import_module(name)
        except ImportError:
            continue
        for label, work, result in rival(points, offset, index, film.r, lists.reach):
            made.append((label, median_ms(work)))
            if result is not None and not np.allclose(result(), expected, rtol=1e-3):
                raise ArithmeticError(f"{label} does not give the same sums")
    return [{"what": label, "ms": ms, "ns_per_pair": 1e6 * ms / len(index)} for label, ms in made]


def scipy_gather(points, offset, index, r, reach):
    """(label, work, result) of a tree's neighbour search and of a sparse matrix of weights times a vector."""
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

    row = np.repeat(np.arange(len(points)), np.diff(offset))
    values = weights(np.linalg.norm(points[index] - points[row], axis=1), r).astype(np.float32)
    matrix = csr_matrix((values, index, offset), shape=(len(points), len(points)))
    ones = np.ones(len(points), dtype=np.float32)
    return [
        ("list, SciPy cKDTree", lambda: cKDTree(points).query_ball_point(points, reach, workers=-1), None),
        ("product with ready weights, SciPy CSR", lambda: matrix @ ones, lambda: matrix @ ones),
    ]


def numba_gather(points, offset, index, r, reach):
    """(label, work, result) of the loop in Numba, all cores."""
    import numba

    three, two, one, nil, six, fifteen = (np.float32(v) for v in (3, 2, 1, 0, 6, 15))
    unit = np.float32(0.004661441847 * 9.0)

    @numba.njit(parallel=True, fastmath=True)
    def gather(points, offset, index, r, total):
        for i in numba.prange(len(total)):
            s = nil
            for k in range(offset[i], offset[i + 1]):
                j = index[k]
                dx = points[j, 0] - points[i, 0]
                dy = points[j, 1] - points[i, 1]
                dz = points[j, 2] - points[i, 2]
                q = three / r * np.sqrt(dx * dx + dy * dy + dz * dz)
                a, b, c = max(three - q, nil), max(two - q, nil), max(one - q, nil)
                s += a * a * a * a * a - six * b * b * b * b * b + fifteen * c * c * c * c * c
            total[i] = unit / (r * r) * s

    total, r32 = np.zeros(len(points), dtype=np.float32), np.float32(r)
    return [("gather, Numba", lambda: gather(points, offset, index, r32, total), lambda: total)]


def taichi_gather(points, offset, index, r, reach):
    """(label, work, result) of the loop in Taichi, all cores."""
    import taichi as ti

    ti.init(arch=ti.cpu, log_level=ti.ERROR, fast_math=True)
    vec = ti.types.ndarray(dtype=ti.math.vec3, ndim=1)
    ints, floats = ti.types.ndarray(dtype=ti.i32, ndim=1), ti.types.ndarray(dtype=ti.f32, ndim=1)

    def gather(points, offset, index, r, total):
        for i in total:
            s = 0.0
            for k in range(offset[i], offset[i + 1]):
                q = 3.0 / r * (points[index[k]] - points[i]).norm()
                a, b, c = ti.max(3.0 - q, 0.0), ti.max(2.0 - q, 0.0), ti.max(1.0 - q, 0.0)
                s += a * a * a * a * a - 6.0 * b * b * b * b * b + 15.0 * c * c * c * c * c
            total[i] = 0.004661441847 * 9.0 / (r * r) * s

    # types, not the text that annotations are in this file
    gather.__annotations__ = {"points": vec, "offset": ints, "index": ints, "r": ti.f32, "total": floats}
    kernel = ti.kernel(gather)
    total = np.zeros(len(points), dtype=np.float32)
    return [("gather, Taichi", lambda: kernel(points, offset, index, r, total), lambda: total)]


def run_to(scene: Scene, device: str, dt: float) -> tuple[Simulation, float]:
    """A scene at EXPLICIT_TIME in steps of dt, and the wall time of the steps, s."""
    sim = Simulation(scene, device)
    sim.step(dt)  # loads what a step needs
    began = time.perf_counter()
    for _ in range(round(EXPLICIT_TIME / dt) - 1):
        sim.step(dt)
    wp.synchronize_device(sim.device)
    return sim, time.perf_counter() - began


def explicit(make: Callable[[Numerics], Scene], device: str, dt: float) -> list[dict]:
    """The implicit midpoint step and the explicit one, its dt halved from `dt` until it is stable, to the same time."""
    sim, seconds = run_to(make(Numerics(scheme="trapezoid")), device, dt)
    speed = sim.diagnostics()["max_speed"]
    made = [{"what": "implicit", "dt": dt, "seconds": seconds, "max_speed": speed}]
    for halvings in range(12):
        small = dt / 2**halvings
        sim, seconds = run_to(make(Numerics(scheme="explicit")), device, small)
        reached = sim.diagnostics()["max_speed"]
        if np.isfinite(reached) and reached < TAME * speed:
            return [*made, {"what": "explicit", "dt": small, "seconds": seconds, "max_speed": reached}]
    raise ArithmeticError(f"the explicit step is unstable down to {small:g} s")


def even_out(scene: Scene, device: str, duration: float, by_speed: bool = False) -> dict:
    """Run a scene to `duration` (s): what it took, and how uneven the film is then against the start.

    Args:
        scene: what to run.
        device: where.
        duration: simulated time, s.
        by_speed: whether the step is that of the fastest particle alone, as Wang et al. 2021 count it, no wave's.
    """
    sim = Simulation(scene, device)
    start = unevenness(sim)
    try:
        if by_speed:
            step_by_speed(sim, duration)
        while sim.time < duration - 1e-9:
            sim.advance_frame()
        end = unevenness(sim)
    except SimulationError:
        end = float("inf")
    seconds = sim.step_seconds[1:] or sim.step_seconds  # the first loads what a step needs
    return {
        "particles": sim.film.n_e + sim.film.n_l,
        "cfl": scene.numerics.cfl,
        "ms": 1e3 * statistics.fmean(seconds),
        "steps": len(sim.step_seconds),
        "seconds": len(sim.step_seconds) * statistics.fmean(seconds),
        "start": start,
        "end": end,
        "reached": sim.time,
        "stable": end < start,
    }


def step_by_speed(sim: Simulation, duration: float) -> None:
    """Take steps in which the fastest particle moves `cfl` spacings, as two layers take them, up to `duration` (s).

    Raises:
        SimulationError: the state broke, or more than MOST_STEPS are wanted.
    """
    reach = sim.scene.numerics.cfl * sim.film.spacing
    dt = reach / sim.stepper.carrier.wave_speed
    while sim.time < duration - 1e-9:
        sim.step(min(dt, duration - sim.time))
        sim.stepper.check()
        if len(sim.step_seconds) > MOST_STEPS:
            raise SimulationError(f"steps of {dt:.3g} s")
        dt = min(2.0 * dt, reach / max(sim.diagnostics()["max_speed"], 1e-9), 1.0 / sim.scene.fps)


def layers(make: Callable[..., Scene], device: str) -> list[dict]:
    """Table 4 of MELP 2022: two layers against one, with the real tension and with a tenth of it.

    Args:
        make: from keys of `equilibrium` to the scene.
        device: where to run.
    """
    paper_flow = {"e_count": 6900, "l_per_e": 16}
    runs = [("MELP", EVEN_TIME, MELP), ("MELP, finer", EVEN_TIME, FINER)]
    runs += [("single layer", EVEN_TIME, {**SINGLE, "cfl": cfl}) for cfl in (0.99, 0.33, 0.1, 0.033)]
    runs += [("MELP", FLOW_TIME, paper_flow), ("single layer", FLOW_TIME, {"e_count": 40000, "layers": 1})]
    made = []
    for what, duration, keys in runs:
        tension = make(**keys).material.tension
        surfactant = make(**keys).material.surfactant
        weak = {**keys, "tension": WEAKER * tension, "surfactant": WEAKER * surfactant}
        real = even_out(make(**keys), device, duration)
        made.append(
            {"what": what, "to": duration, **real, "weaker": even_out(make(**weak), device, duration)["seconds"]}
        )
    return made


def bare(make: Callable[..., Scene], device: str) -> list[dict]:
    """A single layer without drag: what keeps it stable, and what does not."""
    runs = [
        ("difference", "waves", 0.33, 0.0),
        ("difference", "waves", 0.033, 0.0),
        ("difference", "waves", 0.99, 0.99),
        ("difference", "speeds", 0.99, 0.99),
        ("difference", "speeds", 0.033, 0.99),
        ("symmetric", "waves", 0.33, 0.0),
        ("symmetric", "waves", 0.99, 0.99),
    ]
    return [
        {"force": force, "xsph": xsph, "by": by}
        | even_out(make(**BARE, gradient=force, cfl=cfl, xsph=xsph), device, EVEN_TIME, by == "speeds")
        for force, by, cfl, xsph in runs
    ]
