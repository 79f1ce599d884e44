"""What a run would cost: memory, time and disk, from a few measured steps of it."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from melp_warp.program.room import Written, size_text
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation
from melp_warp.tables import columns

PARTICLES = 100_000
"""Scenes of more particles than this are measured at this size, and the costs taken in proportion."""

FEWEST_E = 400
"""E that are measured at least, however many L each has."""

WARM_UP, FEWEST = 3, 4
"""Steps that are not timed, for kernels are loaded and recorded in them; fewest steps that are."""

SECONDS = 2.0
"""Wall time after which no further step is taken."""


@dataclass(frozen=True)
class Estimate:
    """The cost of a run.

    Attributes:
        e_count: E, all those of the run.
        l_count: L.
        memory: bytes of all arrays.
        step_seconds: wall time of a step, s.
        dt: size of the last step that was taken, s; the whole run is taken to go on with it.
        steps: number of steps.
        disk: bytes of the cache and its log.
        beside: bytes of checkpoints and pictures.
        frames: number of frames after the first.
        measured: share of the particles that the steps were measured with; the rest is in proportion.
        load: processes that ran or wanted to in the last minute, this one among them.
    """

    e_count: int
    l_count: int
    memory: float
    step_seconds: float
    dt: float
    steps: int
    disk: float
    beside: float
    frames: int
    measured: float
    load: float

    @property
    def seconds(self) -> float:
        """Wall time of all steps, s."""
        return self.steps * self.step_seconds

    def table(self) -> str:
        """The estimate as lines of text."""
        scaled = "" if self.measured == 1.0 else f" (measured with {100.0 * self.measured:.2g} % of them)"
        return columns(
            [
                ("particles", f"{self.e_count:,} E, {self.l_count:,} L{scaled}"),
                ("memory", f"{size_text(self.memory)} in arrays"),
                ("a step", f"{1e3 * self.step_seconds:.3g} ms, of {self.dt:.3g} s"),
                ("steps", f"{self.steps:,} for {self.frames:,} frames"),
                ("whole run", f"{_duration(self.seconds)}, without writing and drawing"),
                ("load", f"{self.load:.2g} processes on {os.cpu_count()} cores meanwhile, and taken to stay"),
                ("on disk", f"{size_text(self.disk)}, and {size_text(self.beside)} for checkpoints and pictures"),
            ]
        )


def _duration(seconds: float) -> str:
    """Seconds in words."""
    for unit, length in (("s", 60.0), ("min", 60.0)):
        if seconds < 2.0 * length:
            return f"{seconds:.3g} {unit}"
        seconds /= length
    return f"{seconds:.3g} h"


def array_bytes(root: object) -> int:
    """Bytes of all Warp arrays that an object of this package holds, shared memory counted once."""
    spans = sorted((a.ptr, a.ptr + a.capacity) for a in _arrays(root) if a.ptr and a.capacity)
    total, reached = 0, 0
    for first, last in spans:
        total += max(0, last - max(first, reached))
        reached = max(reached, last)
    return total


def _arrays(root: object) -> Iterator[wp.array]:
    """The arrays below an object, through attributes, lists and dictionaries."""
    seen, left = set(), [root]
    while left:
        item = left.pop()
        if id(item) in seen:
            continue
        seen.add(id(item))
        if isinstance(item, wp.array):
            yield item
        elif isinstance(item, dict):
            left.extend(item.values())
        elif isinstance(item, (list, tuple)):
            left.extend(item)
        elif type(item).__module__.startswith("melp_warp") or hasattr(item, "_cls"):  # ours, or a Warp struct
            left.extend(vars(item).values())


def measure_cost(scene: Scene, device: str = "cpu", written: Written | None = None) -> Estimate:
    """Take a few steps of a scene and tell what all of it would cost.

    Scenes of more than `PARTICLES` particles are measured with fewer: memory, time a step and, where the scene sets
    no `dt`, the number of steps are then scaled. So are those of a foam some of whose bubbles come later, as if all
    came and none popped.

    Args:
        scene: what to simulate.
        device: Warp's name of the device.
        written: what the run writes; None for its L alone.

    Returns:
        The estimate. The step is that of the start: a flow that grows faster needs more steps.

    Raises:
        InputError: the scene or the device cannot be used.
        SimulationError: a step failed.
    """
    written = written or Written()
    fraction = min(1.0, max(PARTICLES / (scene.e_count * (1 + scene.l_per_e)), FEWEST_E / scene.e_count))
    simulation = Simulation(replace(scene, e_count=max(1, round(fraction * scene.e_count))), device)
    dt, step_seconds = _take_steps(simulation)
    share = fraction / scene.growth
    e_count, l_count = (round(n / share) for n in (simulation.film.n_e, simulation.film.n_l))
    if scene.dt is None and dt < 0.99 / scene.fps:
        dt *= math.sqrt(fraction)  # cfl counts in spacings
    return Estimate(
        e_count=e_count,
        l_count=l_count,
        memory=array_bytes(simulation) / share,
        step_seconds=step_seconds / share,
        dt=dt,
        steps=math.ceil(scene.film_time(scene.frames) / dt - 1e-6),
        disk=written.cache_bytes(e_count, l_count, scene.frames + 1),
        beside=written.other_bytes(e_count, l_count),
        frames=scene.frames,
        measured=share,
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan"),
    )


def _take_steps(simulation: Simulation) -> tuple[float, float]:
    """Take steps as a run does: the size of the last one, and the wall time of a usual one, s."""
    timed, taken, began = [], 0, time.perf_counter()
    while len(timed) < FEWEST or time.perf_counter() - began < SECONDS:
        start = time.perf_counter()
        frames = math.floor(simulation.time * simulation.scene.fps + 1e-6)
        dt = simulation.step_towards((frames + 1) / simulation.scene.fps)
        wp.synchronize_device(simulation.device)
        taken += 1
        if taken > WARM_UP:
            timed.append(time.perf_counter() - start)
        simulation.stepper.check()
    return dt, float(np.median(timed))
