"""Benchmarks: time a step, stage by stage, against one bare neighbour gather over the same pairs.

    python tools/bench.py                        # the three sizes of the table, CPU
    python tools/bench.py --device cuda:0 --case paper
    python tools/bench.py --json new.json --compare old.json --page docs/benchmarks.md

Shared machines drift: trust the ratios, which are taken in one run.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from pathlib import Path

import numpy as np
import warp as wp

from melp_warp import __version__
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w
from melp_warp.launch import THREADS, launch
from melp_warp.material import Material
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import StarShaped
from melp_warp.simulation import Simulation
from melp_warp.stepper import STAGES

TARGETS_MS = {"equilibrium": 8.0, "sphere": 38.0, "flow": 60.0}
PUBLISHED_MS = {"equilibrium": 760.0, "sphere": 3820.0, "flow": 6950.0}
"""The authors' released C++ program on two cores of the same kind of machine, ms a step."""


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


def scene_of(name: str, settings: list[str]) -> Scene:
    """A shipped scene with other numbers."""
    script = load_scene(name)
    return script.build(script.parameters.values(script.parameters.parse(settings)))


def oscillating_sphere(e_count: int) -> Scene:
    """A lone E-only bubble in motion."""
    shape = StarShaped(0.05, lambda d: 0.02 * (1.5 * d[:, 1] ** 2 - 0.5))
    return Scene("sphere", shape, e_count=e_count, material=Material(surfactant=0.0), dt=2e-4)


CASES = {
    "equilibrium": lambda: scene_of("equilibrium", []),
    "sphere": lambda: oscillating_sphere(20480),
    "flow": lambda: scene_of("equilibrium", ["e_count=6900"]),
    "bubble": lambda: scene_of("giant_bubble", ["e_count=6900"]),
    "paper": lambda: scene_of("equilibrium", ["e_count=6900", "l_per_e=100"]),
}
DEFAULT_CASES = ("equilibrium", "sphere", "flow", "bubble")


def pairs_of(sim: Simulation) -> tuple[int, int]:
    """E:E and L:E pairs in the lists, skin included."""
    lists = sim.stepper.lists
    return lists.ee.pairs, lists.le.pairs if lists.le else 0


def time_gather(sim: Simulation, repeats: int) -> float:
    """Median time of one bare gather over all E:E and L:E pairs, ms."""
    lists, state, film = sim.stepper.lists, sim.state, sim.film
    jobs = [(lists.ee, state.e.x, film.n_e)]
    if state.l is not None:
        jobs.append((lists.le, state.l.x, film.n_l))
    sums = [film.zeros(n) for _, _, n in jobs]
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        for (one, x, n), total in zip(jobs, sums, strict=True):
            launch(gather_bare, n, [x, state.e.x, one.rows, film.r], [total], sim.device)
        wp.synchronize_device(sim.device)
        times.append(1e3 * (time.perf_counter() - began))
    return statistics.median(times[1:])


def run_case(name: str, device: str, steps: int) -> dict:
    """Time one case; every figure is a median over steps."""
    began = time.perf_counter()
    sim = Simulation(CASES[name](), device)
    setup = time.perf_counter() - began
    dt = min(sim.largest_step(), 1.0 / sim.scene.fps)
    for _ in range(3):
        sim.step(dt)
    sim.stepper.check()
    totals, stages = [], {stage: [] for stage in STAGES}
    for _ in range(steps):
        before = dict(sim.stepper.wall)
        began = time.perf_counter()
        sim.step(min(dt, sim.largest_step()))
        wp.synchronize_device(sim.device)
        totals.append(1e3 * (time.perf_counter() - began))
        for stage in STAGES:
            stages[stage].append(1e3 * (sim.stepper.wall[stage] - before[stage]))
    sim.stepper.check()
    ee, le = pairs_of(sim)
    gather = time_gather(sim, 5)
    step = statistics.median(totals)
    return {
        "case": name,
        "e_count": sim.film.n_e,
        "l_count": sim.film.n_l,
        "boundary": sim.film.n_b,
        "ee_pairs": ee,
        "le_pairs": le,
        "setup_s": setup,
        "step_ms": step,
        "stage_ms": {stage: statistics.median(v) for stage, v in stages.items() if any(v)},
        "gather_ms": gather,
        "gathers": step / gather,
        "ns_per_pair": 1e6 * step / (ee + le),
        "solvers": sim.diagnostics()["solvers"],
        "list_builds": sim.stepper.lists.builds,
        "target_ms": TARGETS_MS.get(name),
        "published_ms": PUBLISHED_MS.get(name),
    }


def machine(device: str) -> dict:
    """What the figures were taken on."""
    found = wp.get_device(device)
    return {
        "device": found.name if found.is_cuda else f"CPU, {platform.machine()}",
        "cores": os.cpu_count(),
        "threads": THREADS,
        "warp": wp.__version__,
        "numpy": np.__version__,
        "melp_warp": __version__,
    }


def table(results: list[dict], old: dict[str, dict]) -> str:
    """The cases as a Markdown table."""
    head = [
        "case",
        "E",
        "L",
        "pairs",
        "ms a step",
        "target",
        "published C++",
        "times faster",
        "bare gathers",
        "ns a pair",
    ]
    head += ["against before"] if old else []
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for r in results:
        target, published = r["target_ms"], r["published_ms"]
        row = [
            r["case"],
            f"{r['e_count']:,}",
            f"{r['l_count']:,}",
            f"{r['ee_pairs'] + r['le_pairs']:,}",
            f"{r['step_ms']:.1f}",
            f"{target:.0f}" if target else "-",
            f"{published:.0f}" if published else "-",
            f"{published / r['step_ms']:.0f}" if published else "-",
            f"{r['gathers']:.1f}",
            f"{r['ns_per_pair']:.0f}",
        ]
        if old:
            row.append(f"{r['step_ms'] / old[r['case']]['step_ms']:.2f}" if r["case"] in old else "-")
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


def stage_table(results: list[dict]) -> str:
    """Share of the stages as a Markdown table, ms."""
    names = [stage for stage in STAGES if any(stage in r["stage_ms"] for r in results)]
    lines = ["| case | " + " | ".join(names) + " |", "|" + "---|" * (len(names) + 1)]
    for r in results:
        cells = [f"{r['stage_ms'][n]:.1f}" if n in r["stage_ms"] else "-" for n in names]
        lines.append(f"| {r['case']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(path: Path, info: dict, results: list[dict], old: dict[str, dict]) -> None:
    """Put the figures between the markers of a page; the text around them stays."""
    begin, end = "<!-- figures -->", "<!-- end of figures -->"
    what = ", ".join(f"{k} {v}" for k, v in info.items())
    figures = (
        f"{begin}\n\n{what}\n\n{table(results, old)}\n\nMedian ms of each stage:\n\n{stage_table(results)}\n\n{end}"
    )
    text = path.read_text() if path.exists() else f"# Benchmarks\n\n{begin}\n{end}\n"
    first, last = text.index(begin), text.index(end) + len(end)
    path.write_text(text[:first] + figures + text[last:])


def main() -> None:
    """Run the cases and print, store and compare their figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--case", action="append", choices=sorted(CASES), help="may be given several times")
    parser.add_argument("--steps", type=int, default=15)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--compare", type=Path, help="JSON of an earlier run")
    parser.add_argument("--page", type=Path, help="Markdown page whose figures are replaced")
    options = parser.parse_args()
    wp.config.quiet = True
    results = []
    for name in options.case or DEFAULT_CASES:
        results.append(run_case(name, options.device, options.steps))
        print(table(results[-1:], {}).splitlines()[-1], flush=True)
    old = {}
    if options.compare:
        old = {r["case"]: r for r in json.loads(options.compare.read_text())["results"]}
    info = machine(options.device)
    print(f"\n{table(results, old)}\n\n{stage_table(results)}")
    if options.json:
        options.json.write_text(json.dumps({"machine": info, "results": results}, indent=1) + "\n")
    if options.page:
        write_page(options.page, info, results, old)


if __name__ == "__main__":
    main()
