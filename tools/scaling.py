"""Cost a step against E, L, bubbles and cores, memory a particle, start-up, and what a cut over GPUs would send."""

from __future__ import annotations

import gc
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import warp as wp

from melp_warp.kernels.neighbors import Neighbors
from melp_warp.scene import Scene
from melp_warp.shapes import Sphere
from melp_warp.simulation import Simulation

STEPS = 8


def device_bytes() -> int:
    """Bytes of all Warp arrays that own their memory."""
    gc.collect()
    # asked by type: isinstance would follow weak references to what is gone
    arrays = [a for a in gc.get_objects() if issubclass(type(a), wp.array)]
    arrays = [a for a in arrays if getattr(a, "_ref", a) is None and a.ptr]
    return sum(a.capacity for a in arrays)


def measure(scene: Scene, device: str, steps: int = STEPS) -> dict:
    """Median wall time of a step, ms, and memory, bytes."""
    before = device_bytes()
    sim = Simulation(scene, device)
    dt = sim.largest_step()
    times = []
    for k in range(steps + 2):
        began = time.perf_counter()
        sim.step(dt)
        wp.synchronize_device(sim.device)
        if k >= 2:
            times.append(1e3 * (time.perf_counter() - began))
    sim.stepper.check()
    return {
        "e_count": sim.film.n_e,
        "l_count": sim.film.n_l,
        "regions": sim.film.regions,
        "step_ms": statistics.median(times),
        "bytes": device_bytes() - before,
    }


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Fitted p of cost = c size^p."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def series(name: str, key: str, scenes: Sequence[Callable[[], Scene]], device: str) -> dict:
    """Runs that differ in one size, and the exponent of the cost in it."""
    runs = [measure(make(), device) for make in scenes]
    return {
        "name": name,
        "key": key,
        "runs": runs,
        "exponent": exponent(*([r[k] for r in runs] for k in (key, "step_ms"))),
    }


def cores(bench: Path, case: str, frames: int) -> list[dict]:
    """A case with 1, 2, 4, ... threads, a process each: step, ms."""
    made, threads = [], 1
    while threads <= (os.cpu_count() or 1):
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "run.json"
            command = [sys.executable, str(bench), "--case", case, "--frames", str(frames), "--only", "cases"]
            environment = os.environ | {"MELP_WARP_THREADS": str(threads)}
            subprocess.run([*command, "--json", str(out)], env=environment, check=True, stdout=subprocess.DEVNULL)
            made.append({"threads": threads, "step_ms": json.loads(out.read_text())["results"][0]["step_ms"]})
        threads *= 2
    return made


def start() -> list[dict]:
    """Wall time of `melp-warp run giant_bubble --frames 1` with an empty kernel cache and with a full one, s."""
    folder = Path(tempfile.mkdtemp())
    made = []
    for what in ("empty", "full"):
        environment = os.environ | {"WARP_CACHE_PATH": str(folder / "cache")}
        command = [sys.executable, "-m", "melp_warp", "run", "giant_bubble", "--frames", "1", "--quiet"]
        began = time.perf_counter()
        subprocess.run([*command, "--out", str(folder / what)], env=environment, check=True, stdout=subprocess.DEVNULL)
        made.append({"cache": what, "seconds": time.perf_counter() - began})
    shutil.rmtree(folder)
    return made


def memory(flat: dict, sphere: dict) -> dict:
    """Bytes an E (E-only films) and an L (slope over films of one size of E)."""
    e = np.polyfit([r["e_count"] for r in sphere["runs"]], [r["bytes"] for r in sphere["runs"]], 1)[0]
    l = np.polyfit([r["l_count"] for r in flat["runs"]], [r["bytes"] for r in flat["runs"]], 1)[0]  # noqa: E741
    return {"e_bytes": float(e), "l_bytes": float(l)}


def halo(e_count: int, parts: Sequence[int], device: str) -> list[dict]:
    """Share of E of a sphere in equal slabs that are held twice: those that a list reaches across a cut."""
    sim = Simulation(Scene("cut", Sphere(0.1), e_count), device)
    rows: Neighbors = sim.stepper.lists.ee.rows
    start, stop, index = rows.start.numpy(), rows.stop.numpy(), rows.index.numpy()
    i = np.repeat(np.arange(e_count), stop - start)
    j = index[np.arange(len(i)) + np.repeat(start - np.concatenate([[0], np.cumsum(stop - start)[:-1]]), stop - start)]
    height = sim.state.e.x.numpy()[:e_count, 1]
    made = []
    for count in parts:
        part = np.searchsorted(np.quantile(height, np.arange(1, count) / count), height)
        across = part[i] != part[j]
        wanted = np.unique(np.stack([part[i[across]], j[across]]), axis=1).shape[1]
        made.append({"e_count": e_count, "parts": count, "halo": wanted / e_count})
    return made
