"""Benchmarks: frames as a user runs them, stage by stage, and one bare gather over the same pairs; rivals; scaling.

    python tools/bench.py                                    # everything but --large, CPU
    python tools/bench.py --device cuda:0 --large            # with 4.8 million L and with 300 bubbles
    python tools/bench.py --case bubble --only cases         # one case
    python tools/bench.py --json new.json --pages docs

Shared machines drift: only ratios of times taken in one run are printed, none with a time of another day. SciPy, Numba
and Taichi take part where they are installed (`pip install -e '.[bench]'`).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import time
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import warp as wp
from rivals import EVEN_TIME, EXPLICIT_TIME, FLOW_TIME, bare, explicit, gather_bare, gathers, layers
from scaling import cores, halo, memory, series, start

from melp_warp import __version__
from melp_warp.cluster import Bubble, Cluster, e_spacing
from melp_warp.device.launch import THREADS, launch
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import StarShaped
from melp_warp.simulation import Simulation
from melp_warp.stepping.step import TABLE

STAGES = [stage.name for stage in TABLE]


def scene_of(name: str, **keys) -> Scene:
    """A shipped scene with other numbers."""
    script = load_scene(name)
    return script.build(script.parameters.values(keys))


def oscillating_sphere(e_count: int, numerics: Numerics | None = None) -> Scene:
    """A lone E-only bubble in motion."""
    shape = StarShaped(0.05, lambda d: 0.02 * (1.5 * d[:, 1] ** 2 - 0.5))
    material = Material(surfactant=0.0)
    return Scene("sphere", shape, e_count=e_count, material=material, dt=2e-4, numerics=numerics or Numerics())


def bubbles(count: int, e_count: int) -> Scene:
    """Equal E-only bubbles on a cubic grid, a spacing apart: each presses on its neighbours."""
    side = math.ceil(count ** (1.0 / 3.0) - 1e-9)
    places = list(product(range(side), repeat=3))[:count]
    pitch = 0.1 + e_spacing([0.05] * count, e_count)
    shape = Cluster(tuple(Bubble(tuple(pitch * c for c in place), 0.05) for place in places))
    surroundings = Surroundings(damping=20.0, air="added_mass")
    return Scene("bubbles", shape, e_count=e_count, dt=1e-3, surroundings=surroundings)


CASES = {
    "giant_bubble": lambda: scene_of("giant_bubble"),
    "oscillating_bubble": lambda: scene_of("oscillating_bubble"),
    "drainage": lambda: scene_of("drainage"),
    "equilibrium": lambda: scene_of("equilibrium"),
    "triple_bubble": lambda: scene_of("triple_bubble"),
    "sphere": lambda: oscillating_sphere(20480),
    "flow": lambda: scene_of("equilibrium", e_count=6900),
    "bubble": lambda: scene_of("giant_bubble", e_count=6900),
    "paper": lambda: scene_of("equilibrium", e_count=6900, l_per_e=100),
    "large": lambda: scene_of("equilibrium", e_count=82000, l_per_e=59),
    "bubbles": lambda: bubbles(300, 192000),
}
"""Default scenes first; then larger ones: E alone, a flat disc, a moving bubble with L, the paper's L, and so on."""

LARGE_CASES = ("large", "bubbles")
WARM_UP = 2
"""Frames that are told apart: the first ones load and record kernels and grow the step from that of a start at rest."""

PARTS = ("cases", "rivals", "scaling", "start")


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


def run_case(name: str, device: str, frames: int) -> dict:
    """Time frames of one case as a user runs them; every figure but those of the start is a median over frames."""
    began = time.perf_counter()
    sim = Simulation(CASES[name](), device)
    setup = time.perf_counter() - began
    first = [time_frame(sim)["frame_ms"] for _ in range(WARM_UP)]
    made = [time_frame(sim) for _ in range(frames)]
    ee, le = pairs_of(sim)
    gather = time_gather(sim, 5)
    step = statistics.median(m["step_ms"] for m in made)
    return {
        "case": name,
        "e_count": sim.film.n_e,
        "l_count": sim.film.n_l,
        "boundary": sim.film.n_b,
        "ee_pairs": ee,
        "le_pairs": le,
        "setup_s": setup,
        "first_frames_ms": first,
        "frame_ms": statistics.median(m["frame_ms"] for m in made),
        "steps_a_frame": statistics.median(m["steps"] for m in made),
        "step_ms": step,
        "stage_ms": stages_of(made),
        "gather_ms": gather,
        "gathers": step / gather,
        "ns_per_pair": 1e6 * step / (ee + le),
        "solvers": sim.diagnostics()["solvers"],
        "list_builds": sim.stepper.lists.builds,
    }


def time_frame(sim: Simulation) -> dict:
    """Wall time of a frame, of a step of it, and of the stages of a step, ms."""
    before, began = len(sim.step_seconds), time.perf_counter()
    sim.advance_frame()
    wp.synchronize_device(sim.device)
    wall, steps = 1e3 * (time.perf_counter() - began), len(sim.step_seconds) - before
    stages = {stage: 1e3 * sim.stepper.wall.get(stage, 0.0) / steps for stage in STAGES}
    return {"frame_ms": wall, "steps": steps, "step_ms": wall / steps, "stages": stages}


def stages_of(made: list[dict]) -> dict[str, float]:
    """Median time of each stage that there is, ms a step."""
    times = {stage: [m["stages"][stage] for m in made] for stage in STAGES}
    return {stage: statistics.median(v) for stage, v in times.items() if any(v)}


def machine(device: str) -> dict:
    """What the figures were taken on."""
    found = wp.get_device(device)
    return {
        "device": found.name if found.is_cuda else f"CPU, {platform.machine()}",
        "cores": os.cpu_count(),
        "threads": THREADS,
        "load at the start": round(os.getloadavg()[0], 1),
        "warp": wp.__version__,
        "numpy": np.__version__,
        "melp_warp": __version__,
    }


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def table(results: list[dict]) -> str:
    """The cases as a Markdown table."""
    head = ["case", "E", "L", "pairs", "start, s", "first frames, ms", "steps a frame", "ms a frame", "ms a step"]
    head += ["bare gathers", "ns a pair"]
    rows = []
    for r in results:
        row = [r["case"], f"{r['e_count']:,}", f"{r['l_count']:,}", f"{r['ee_pairs'] + r['le_pairs']:,}"]
        row += [f"{r['setup_s']:.1f}", ", ".join(f"{ms:.0f}" for ms in r["first_frames_ms"])]
        row += [f"{r['steps_a_frame']:g}", f"{r['frame_ms']:.1f}", f"{r['step_ms']:.1f}"]
        rows.append([*row, f"{r['gathers']:.1f}", f"{r['ns_per_pair']:.0f}"])
    return markdown(head, rows)


def stage_table(results: list[dict]) -> str:
    """Time of the stages as a Markdown table, ms."""
    names = [stage for stage in STAGES if any(stage in r["stage_ms"] for r in results)]
    rows = [[r["case"], *(f"{r['stage_ms'][n]:.1f}" if n in r["stage_ms"] else "-" for n in names)] for r in results]
    return markdown(["case", *names], rows)


def rival_tables(rivals: dict) -> str:
    """The gather by other means, and the explicit step."""
    own = next(g["ms"] for g in rivals["gathers"] if g["what"] == "gather, C++ row")
    gathers = [
        [g["what"], f"{g['ms']:.2f}", f"{g['ns_per_pair']:.2f}", f"{g['ms'] / own:.1f}"] for g in rivals["gathers"]
    ]
    implicit = rivals["explicit"][0]["seconds"]
    steps = [
        [s["what"], f"{s['dt']:.3g}", f"{s['seconds']:.2f}", f"{s['seconds'] / implicit:.1f}", f"{s['max_speed']:.3f}"]
        for s in rivals["explicit"]
    ]
    return (
        "One sum over the E:E list of the sphere:\n\n"
        f"{markdown(['what', 'ms', 'ns a pair', 'times ours'], gathers)}\n\n"
        f"A lone bubble of 2,000 E, no L, to {1e3 * EXPLICIT_TIME:g} ms of simulated time:\n\n"
        f"{markdown(['step', 'dt, s', 's', 'times ours', 'largest speed, m/s'], steps)}\n\n"
        f"{layer_tables(rivals['layers'], rivals['bare'])}"
    )


def layer_tables(runs: list[dict], drag_free: list[dict]) -> str:
    """Two layers against one after Table 4 of MELP 2022, and what a single one is stable by."""
    rows = []
    for r in runs:
        rows.append([r["what"], f"{r['to']:g}", f"{r['particles']:,}", f"{r['cfl']:g}", f"{r['ms']:.1f}"])
        rows[-1] += [str(r["steps"]), f"{r['seconds']:.2f}", f"{100 * r['end']:.2f} %", yes(r["stable"])]
        rows[-1].append(f"{r['weaker']:.2f}")
    head = ["method", "to, s", "particles", "CFL", "ms a step", "steps", "s", "uneven at the end", "stable"]
    head.append("s, tension 0.1 x")
    why = []
    for r in drag_free:
        why.append([r["force"], f"{r['xsph']:g}", r["by"], f"{r['cfl']:g}", str(r["steps"])])
        end = f"{100 * r['end']:.1f} %" if math.isfinite(r["end"]) else f"stops at {r['reached']:.2g} s"
        why[-1] += [end, yes(r["stable"])]
    return (
        f"The disc of `equilibrium`, {100 * runs[0]['start']:.1f} % uneven at the start, in two layers and in one\n"
        f"(`layers=1`), to {EVEN_TIME:g} s and, with the particles of the paper's flow, to {FLOW_TIME:g} s:\n\n"
        f"{markdown(head, rows)}\n\n"
        f"A single layer of {drag_free[0]['particles']:,} particles on that disc without the air's drag, to "
        f"{EVEN_TIME:g} s; it is stable\nif it gets there, less uneven than it was:\n\n"
        + markdown(["Marangoni force", "xsph", "CFL counts", "CFL", "steps", "uneven at the end", "stable"], why)
    )


def yes(true: bool) -> str:
    """In a word."""
    return "yes" if true else "no"


def start_table(made: list[dict]) -> str:
    """Seconds from the command to the first frame of the default scene."""
    return "First frame of `giant_bubble`, from the command on:\n\n" + markdown(
        ["kernel cache", "s"], [[s["cache"], f"{s['seconds']:.1f}"] for s in made]
    )


def scaling_tables(made: dict) -> str:
    """Cost against size, memory, cores and what a cut sends, as Markdown."""
    rows = []
    for s in made["series"]:
        sizes = ", ".join(f"{r[s['key']]:,}" for r in s["runs"])
        times = ", ".join(f"{r['step_ms']:.1f}" for r in s["runs"])
        rows.append([s["name"], sizes, times, f"{s['exponent']:.2f}"])
    one = made["cores"][0]["step_ms"]
    threads = [[str(c["threads"]), f"{c['step_ms']:.1f}", f"{one / c['step_ms']:.2f}"] for c in made["cores"]]
    m = made["memory"]
    cut = [[str(h["parts"]), f"{h['e_count']:,}", f"{100 * h['halo']:.1f} %"] for h in made["halo"]]
    return "\n\n".join(
        [
            markdown(["against", "sizes", "ms a step", "exponent"], rows),
            f"Memory: {m['e_bytes']:,.0f} bytes an E, {m['l_bytes']:,.0f} bytes an L.",
            "Threads, case bubble:\n\n" + markdown(["threads", "ms a step", "times faster"], threads),
            "A sphere cut into slabs, E that a slab needs from others:\n\n"
            + markdown(["slabs", "E", "share of all E"], cut),
            fifty_million(m),
        ]
    )


def fifty_million(memory: dict) -> str:
    """What a scene of fifty million particles holds and moves, from the measured bytes a particle."""
    rows = []
    for per_e in (16, 64):
        e = 50e6 / (1 + per_e)
        size = e * memory["e_bytes"] + (50e6 - e) * memory["l_bytes"]
        rows.append([str(per_e), f"{e / 1e6:.1f}", f"{(50e6 - e) / 1e6:.1f}", f"{size / 1e9:.0f}"])
        rows[-1] += [str(math.ceil(size / (0.9 * room))) for room in (80e9, 141e9)]
    head = ["L an E", "E, millions", "L, millions", "GB", "GPUs of 80 GB", "GPUs of 141 GB"]
    return "Fifty million particles, by the bytes above:\n\n" + markdown(head, rows)


def put(path: Path, figures: str) -> None:
    """Put the figures between the markers of a page; the text around them stays."""
    begin, end = "<!-- figures -->", "<!-- end of figures -->"
    text = path.read_text()
    path.write_text(text[: text.index(begin)] + f"{begin}\n\n{figures}\n\n" + text[text.index(end) :])


def write_pages(folder: Path, made: dict) -> None:
    """Renew the figures of benchmarks.md and scaling.md that were taken."""
    what = ", ".join(f"{k} {v}" for k, v in made["machine"].items())
    results = made["results"]
    figures = [what, table(results), f"Median ms a step of each stage:\n\n{stage_table(results)}"]
    figures += [rival_tables(made["rivals"]), start_table(made["start"])]
    put(folder / "benchmarks.md", "\n\n".join(figures))
    put(folder / "scaling.md", f"{what}\n\n{scaling_tables(made['scaling'])}")


def run_rivals(device: str) -> dict:
    """The gather by other means on a film of 20,480 E, the explicit step on one of 2,000, and the single layer."""
    sim, disc = Simulation(oscillating_sphere(20480), device), partial(scene_of, "equilibrium")
    return {
        "gathers": gathers(sim),
        "explicit": explicit(lambda numerics: oscillating_sphere(2000, numerics), device, 3.5e-4),
        "layers": layers(disc, device),
        "bare": bare(disc, device),
    }


def run_scaling(device: str, frames: int) -> dict:
    """Cost against E, L, bubbles and cores."""
    of_e = [lambda n=n: oscillating_sphere(n) for n in (1280, 5120, 20480)]
    of_l = [lambda n=n: scene_of("equilibrium", e_count=2000, l_per_e=n) for n in (4, 16, 64)]
    of_bubbles = [lambda n=n: bubbles(n, 400 * n) for n in (2, 8, 27)]
    sphere = series("E, a sphere", "e_count", of_e, device)
    flat = series("L, a flat film of 2,000 E", "l_count", of_l, device)
    regions = series("bubbles of 400 E", "regions", of_bubbles, device)
    return {
        "series": [sphere, flat, regions],
        "memory": memory(flat, sphere),
        "cores": cores(Path(__file__), "bubble", frames),
        "halo": halo(20480, (2, 4, 8), device),
    }


def main() -> None:
    """Run the parts asked for and print, store and compare their figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--case", action="append", choices=sorted(CASES), help="may be given several times")
    parser.add_argument("--large", action="store_true", help="also 82,000 E with 4.8 million L, and 300 bubbles")
    parser.add_argument("--only", choices=PARTS, help="one part instead of all")
    parser.add_argument("--frames", type=int, default=12, help="frames that are timed of each case (default: 12)")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pages", type=Path, help="folder of benchmarks.md and scaling.md, whose figures are replaced")
    options = parser.parse_args()
    if options.pages and options.only:
        parser.error("--pages needs all parts: leave --only out")
    wp.config.log_level = wp.LOG_WARNING
    wanted = (options.only,) if options.only else PARTS
    made = {"machine": machine(options.device)}
    if "cases" in wanted:
        names = options.case or [name for name in CASES if options.large or name not in LARGE_CASES]
        made["results"] = [run_case(name, options.device, options.frames) for name in names]
        print(f"{table(made['results'])}\n\n{stage_table(made['results'])}\n", flush=True)
    if "rivals" in wanted:
        made["rivals"] = run_rivals(options.device)
        print(rival_tables(made["rivals"]) + "\n", flush=True)
    if "scaling" in wanted:
        made["scaling"] = run_scaling(options.device, options.frames)
        print(scaling_tables(made["scaling"]) + "\n", flush=True)
    if "start" in wanted:
        made["start"] = start()
        print(start_table(made["start"]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(made, indent=1) + "\n")
    if options.pages:
        write_pages(options.pages, made)


if __name__ == "__main__":
    main()
