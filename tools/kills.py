"""Runs that are killed at random moments and resumed, against runs that are left alone: `python tools/kills.py`.

    python tools/kills.py --kills 100 --out FOLDER

Each series starts a run in a process of its own, ends it by SIGKILL (two thirds), SIGTERM or SIGINT after a random
time, resumes it and so on until it is through. Every file of the cache must then be that of a run that was left alone,
byte for byte, and so must the log but for wall times. Some series start with an empty kernel cache: they are killed
while Warp compiles.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

SCENES = {
    "film": """
from melp_warp.material import Surroundings
from melp_warp.parameters import declare
from melp_warp.scene import Scene
from melp_warp.shapes import Sphere

PARAMETERS = declare(radius=0.05, e_count=200, l_per_e=2, frames=6)


def whirl(x):
    return 8.0 * x[:, [2, 0, 1]]


def build(v):
    return Scene("film", Sphere(v.radius), v.e_count, v.l_per_e, frames=v.frames, velocity=whirl,
                 dt=v.dt, surroundings=Surroundings(air="added_mass"))
""",
    "rim": """
import numpy as np

from melp_warp.parameters import declare
from melp_warp.scene import Scene
from melp_warp.shapes import Disc

PARAMETERS = declare(radius=0.05, e_count=200, l_per_e=2, frames=6)


def blow(x):
    return (0.2 + 5.0 * x[:, :1]) * (1.0 - np.sum(x**2, axis=1, keepdims=True) / 0.05**2) * [0.1, 1.0, -0.2]


def build(v):
    shape = Disc(v.radius, flat=False)
    return Scene("rim", shape, v.e_count, v.l_per_e, frames=v.frames, velocity=blow, dt=1.0 / 240.0)
""",
    "foam": """
from melp_warp.cluster import Bubble, Cluster, Merge, Pop
from melp_warp.parameters import declare
from melp_warp.scene import Scene

PARAMETERS = declare(e_count=500, l_per_e=1, frames=4)


def build(v):
    bubbles = (Bubble((-0.0102, 0.0, 0.0), 0.01), Bubble((0.0102, 0.0, 0.0), 0.01), Bubble((0.0, 0.05, 0.0), 0.01),
               Bubble((0.0, -0.05, 0.0), 0.01, born=0.03))
    events = (Pop(0.02, 2, delete=True), Merge(0.045, 0, 1, delete=True))
    return Scene("foam", Cluster(bubbles, events=events), v.e_count, v.l_per_e, frames=v.frames, dt=1.0 / 240.0)
""",
    "burst": """
from melp_warp.bursting import Bursting, Puncture
from melp_warp.parameters import declare
from melp_warp.scene import Scene
from melp_warp.shapes import Sphere

PARAMETERS = declare(radius=0.05, e_count=400, l_per_e=2, frames=6, fps=1000.0)


def build(v):
    bursting = Bursting((Puncture((0.0, v.radius, 0.0), 0.002),))
    return Scene("burst", Sphere(v.radius), v.e_count, v.l_per_e, frames=v.frames, fps=v.fps, bursting=bursting)
""",
}
"""Scene files: a closed film in air, a drum, bubbles that pop, come and merge, a bubble that bursts."""

LEFT_OUT = ("wall_ms",)
"""What a log says of the machine, not of the film."""


def files_of(folder: Path) -> dict[str, bytes]:
    """Every file of a cache by its path in it; checkpoints hold wall times, and are left out."""
    paths = sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix != ".npz" and p.name != "run.jsonl")
    return {str(p.relative_to(folder)): p.read_bytes() for p in paths}


def log_of(folder: Path) -> list[dict]:
    """The lines of a log without wall times."""
    lines = [json.loads(line) for line in (folder / "run.jsonl").read_text(encoding="utf-8").splitlines()]
    return [{key: value for key, value in line.items() if key not in LEFT_OUT} for line in lines]


def difference(folder: Path, alone: Path) -> str:
    """What two runs differ in; empty where in nothing."""
    mine, theirs = files_of(folder), files_of(alone)
    names = [name for name in {**mine, **theirs} if mine.get(name) != theirs.get(name)]
    return ", ".join([*names, *([] if log_of(folder) == log_of(alone) else ["run.jsonl"])])


def start(scene: Path, out: Path, mode: tuple[str, ...], kernels: Path | None) -> subprocess.Popen:
    """A run in a process of its own."""
    command = [sys.executable, "-m", "melp_warp", "run", str(scene), "--quiet", "--out", str(out), *mode]
    environment = dict(os.environ) | ({"WARP_CACHE_PATH": str(kernels)} if kernels else {})
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)


def series(scene: Path, out: Path, rng: random.Random, most: int, longest: float, kernels: Path | None = None) -> int:
    """Kill and resume a run until it is through; how often it was killed.

    Args:
        scene: the scene file.
        out: folder of the run.
        rng: random numbers.
        most: kills after which it is left to end.
        longest: latest moment of a kill, s after the start.
        kernels: folder of Warp's kernels; None for the usual one.
    """
    kills, every = 0, ("--checkpoint", str(rng.choice([1, 2, 3])))
    while True:
        resumes = any(out.glob("checkpoint*.npz")) if out.exists() else False
        process = start(scene, out, (*every, "--resume" if resumes else "--overwrite"), kernels)
        try:
            _, error = process.communicate(timeout=rng.uniform(0.0, longest) if kills < most else None)
        except subprocess.TimeoutExpired:
            number = rng.choice([signal.SIGKILL] * 4 + [signal.SIGTERM, signal.SIGINT])
            process.send_signal(number)
            _, error = process.communicate()
            kills += 1
            if process.returncode == 0 or number == signal.SIGKILL:
                continue
            if process.returncode in (128 + number, -number):  # -number: before there was anybody to handle it
                continue
        if process.returncode == 0:
            return kills
        raise SystemExit(f"{scene.name} in {out}: exit {process.returncode}: {error}")


def main() -> None:
    """Run series after series until there were as many kills as asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, kills, made, began = random.Random(options.seed), 0, 0, time.monotonic()
    options.out.mkdir(parents=True)
    took = {}
    for name, text in SCENES.items():
        (options.out / f"{name}.py").write_text(text)
        for _ in range(2):  # the first compiles, perhaps
            before = time.monotonic()
            process = start(options.out / f"{name}.py", options.out / f"{name}-alone", ("--overwrite",), None)
            if process.wait():
                raise SystemExit(process.stderr.read())
            took[name] = time.monotonic() - before
    compiled = 0
    while kills < options.kills:
        name = list(SCENES)[made % len(SCENES)]
        cold = made % 9 == 4
        kernels = options.out / "kernels" if cold else None
        out = options.out / f"{name}-{made}"
        longest = 30.0 if cold else 1.1 * took[name]
        done = series(options.out / f"{name}.py", out, rng, min(8, options.kills - kills), longest, kernels)
        kills, made, compiled = kills + done, made + 1, compiled + cold * done
        wrong = difference(out, options.out / f"{name}-alone")
        print(f"{name}: killed {done} times, {kills} in all: {wrong or 'the same bytes'}", flush=True)
        if wrong:
            raise SystemExit(1)
        shutil.rmtree(out)
        if cold:
            shutil.rmtree(kernels)
    seconds = time.monotonic() - began
    print(f"{kills} kills in {made} runs, {compiled} of them with no kernels compiled; {seconds:.0f} s; the same bytes")


if __name__ == "__main__":
    main()
