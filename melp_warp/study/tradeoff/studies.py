"""Which points are run: one knob at a time, a design over all, those of a scene."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, replace

import numpy as np

from melp_warp.cluster import Cluster
from melp_warp.device.float64 import VARIABLE
from melp_warp.errors import InputError, SimulationError
from melp_warp.frame import ParticleFrame
from melp_warp.parameters import Value
from melp_warp.quality import QUALITIES, Quality
from melp_warp.registry import SceneScript
from melp_warp.simulation import Simulation
from melp_warp.study import validation as v
from melp_warp.study.tradeoff.cases import CASES, KNOBS, STANDARD, Case, changes_of
from melp_warp.study.tradeoff.records import SOLVED, Record


def measure(name: str, knob: str, setting: str, quality: Quality, case: Case | None = None, runs: int = 1) -> Record:
    """Run a case at one point.

    Args:
        name: of the case.
        knob: kept in the record, as the next.
        setting: label of the point.
        quality: the point.
        case: the case with other numbers; None for that of `CASES`.
        runs: how often it is run; the cost is the least, for nothing makes a run take less than it needs.

    Returns:
        The record; a run that stops, or that the solver refuses, says so in `stopped`.
    """
    case = case or CASES[name]
    changes = changes_of(quality, case)
    if "precision" in changes:
        return replace(_in_double(name, case, runs), knob=knob, setting=setting, changes=changes)
    try:
        found = [case.run(**{**case.own, **changes}) for _ in range(runs)]
    except (SimulationError, InputError, np.linalg.LinAlgError) as problem:
        return Record(name, knob, setting, changes, stopped=str(problem))
    error, cost = min(found, key=lambda run: run[1]["seconds"])
    return _record(Record(name, knob, setting, changes), error, cost)


def _in_double(name: str, case: Case, runs: int) -> Record:
    """The case as it is, in float64: run by a process of its own, for a process has one precision.

    Raises:
        subprocess.CalledProcessError: it broke; what it said is on the screen.
    """
    code = f"from melp_warp.study import tradeoff; tradeoff.print_record({name!r}, {dict(case.own)!r}, {runs})"
    double = {**os.environ, VARIABLE: "64"}
    done = subprocess.run([sys.executable, "-c", code], env=double, stdout=subprocess.PIPE, text=True, check=True)
    return Record(**json.loads(done.stdout.splitlines()[-1]))


def print_record(name: str, own: Mapping[str, Value], runs: int) -> None:
    """Run a case at numbers of its own and print the record as a line of JSON."""
    print(json.dumps(asdict(measure(name, "", "as it is", STANDARD, replace(CASES[name], own=own), runs))))


def _record(record: Record, error: float, cost: Mapping) -> Record:
    """The record with what was found."""
    pace = cost["seconds"] / cost["simulated"] if "seconds" in cost else math.nan
    kept = {f.name: cost[f.name] for f in fields(Record) if f.name in cost}
    return replace(record, **{**kept, "error": float(error), "cost": pace})


def one_at_a_time(name: str, case: Case | None = None, runs: int = 1) -> Iterable[Record]:
    """The case as it is, then with each of its knobs turned alone."""
    case = case or CASES[name]
    yield measure(name, "", "as it is", STANDARD, case, runs)
    for knob in case.knobs:
        for setting, quality in KNOBS[knob].items():
            if changes_of(quality, case):
                yield measure(name, knob, setting, quality, case, runs)


def designed(case: Case, count: int, seed: int = 0) -> list[Quality]:
    """A Latin hypercube of `count` points over those knobs of a case that cost or buy something.

    Each knob's range is cut into `count` parts, each of which is visited once: E and the step over a factor of 8 and 4
    to both sides, L per E to a quarter and to twice, the tolerance from 1e-4 to 1e-6, all in the logarithm; support 3
    or 4 and flip 0 or 0.95 half of the points each.
    """
    rng = np.random.default_rng(seed)
    share = {knob: (rng.permutation(count) + 0.5) / count for knob in KNOBS}
    points = []
    for i in range(count):
        at = {knob: float(share[knob][i]) for knob in KNOBS}
        keys: dict[str, Value] = {}
        if "tolerance" in case.knobs:
            keys["tolerance"] = SOLVED * 10.0 ** (-2.0 * at["tolerance"])
        if "support" in case.knobs:
            keys["support"] = 3.0 if at["support"] < 0.5 else 4.0
        if "transfer" in case.knobs:
            keys["flip"] = 0.0 if at["transfer"] < 0.5 else 0.95
        points.append(
            Quality(
                e=8.0 ** (at["e"] - 0.5) if "e" in case.knobs else 1.0,
                l=8.0 ** (at["l"]) / 4.0 if "l" in case.knobs else 1.0,
                step=16.0 ** (at["step"] - 0.5) if "step" in case.knobs else 1.0,
                keys=keys,
            )
        )
    return points


def study(name: str, points: int, case: Case | None = None, seed: int = 0, runs: int = 1) -> Iterable[Record]:
    """All records: knobs one at a time; if there are several, a designed set of `points` and the qualities."""
    case = case or CASES[name]
    yield from one_at_a_time(name, case, runs)
    if not case.has_front:
        return
    for i, quality in enumerate(designed(case, points, seed)):
        yield measure(name, "design", str(i), quality, case, runs)
    for quality in QUALITIES:
        yield measure(name, "quality", quality, QUALITIES[quality], case, runs)


# A scene of one's own
def scene_study(script: SceneScript, overrides: Mapping[str, Value], e_count: int, frames: int) -> Iterable[Record]:
    """Run a scene small over the knobs, against a run of it four times finer in spacing squared and in time.

    Args:
        script: the scene.
        overrides: values that replace its own.
        e_count: number of E of the standard run; more where the film needs more.
        frames: frames of each run.

    Returns:
        Records; `error` is that of `field_error`, 0 for the reference, which comes first.

    Raises:
        InputError: the scene refuses the values.
        SimulationError: the reference run stopped.
    """
    own = {**script.parameters.values(overrides).as_dict(), "frames": frames}
    shape = script.build(script.parameters.values(own)).shape
    fewest = shape.fewest_e(own["support"]) if isinstance(shape, Cluster) else 0
    own["e_count"] = max(e_count, 4 * fewest)

    def run(quality: Quality) -> tuple[ParticleFrame, dict]:
        simulation = Simulation(script.build(script.parameters.values({**own, **quality.apply(own)})))
        for _ in range(frames):
            simulation.advance_frame()
        return simulation.particles("e"), v.cost(simulation)

    finer = Quality("the reference", e=4.0, step=0.25, keys={"tolerance": 1e-6})
    reference, cost = run(finer)
    yield _record(Record(script.name, "reference", "finer", finer.apply(own)), 0.0, cost)
    points = [("", "as it is", STANDARD)]
    points += [(knob, setting, quality) for knob in KNOBS for setting, quality in KNOBS[knob].items() if knob != "e"]
    points += [("e", setting, KNOBS["e"][setting]) for setting in ("0.25", "0.5", "2")]
    points += [("quality", name, quality) for name, quality in QUALITIES.items() if name != "standard"]
    for knob, setting, quality in points:
        changes = quality.apply(own)
        if knob and (not changes or (knob == "layers" and "layers" not in changes)):
            continue
        record = Record(script.name, knob, setting, changes)
        try:
            frame, cost = run(quality)
        except (SimulationError, InputError) as problem:
            yield replace(record, stopped=str(problem))
        else:
            yield _record(record, field_error(frame, reference), cost)


def field_error(frame: ParticleFrame, reference: ParticleFrame) -> float:
    """How far two states of a film are apart, as one number.

    Returns:
        The root of the sum of squares of the rms difference of thickness, relative to the mean, and of the rms
        distance of the surfaces, relative to the film's extent; both at the particles of `frame`, from the six
        nearest of `reference` in the same region.
    """
    near = min(6, len(reference.points))
    thickness, away = [], []
    goal = reference.points.astype(np.float64)
    for part in np.array_split(np.arange(len(frame.points)), max(1, len(frame.points) * len(goal) // 4_000_000)):
        x = frame.points[part].astype(np.float64)
        squared = np.sum(x**2, axis=1)[:, None] - 2.0 * x @ goal.T + np.sum(goal**2, axis=1)
        squared[frame.region[part, None] != reference.region] = np.inf
        nearest = np.argpartition(squared, near - 1, axis=1)[:, :near]
        apart = x[:, None] - goal[nearest]
        weight = 1.0 / (np.sum(apart**2, axis=2) + 1e-12 * np.ptp(goal) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        thickness.append(np.sum(weight * reference.thickness[nearest], axis=1))
        away.append(np.sum(weight * np.sum(apart * reference.normals[nearest], axis=2), axis=1))
    uneven = np.sqrt(np.mean((frame.thickness - np.concatenate(thickness)) ** 2)) / reference.thickness.mean()
    moved = np.sqrt(np.mean(np.concatenate(away) ** 2)) / np.ptp(goal, axis=0).max()
    return float(np.hypot(uneven, moved))
