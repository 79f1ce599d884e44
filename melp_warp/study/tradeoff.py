"""Speed against accuracy, measured: cases with a known answer, or a scene of one's own, over the knobs that matter.

Every run is a `Quality` applied to a case's own numbers: one knob at a time, a designed set of several, and the
named qualities. `tools/tradeoff.py` makes docs/accuracy.md from them; `melp-warp tradeoff SCENE` does a user's scene.
"""

from __future__ import annotations

import csv
import functools
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from melp_warp.cluster import Cluster
from melp_warp.device.float64 import VARIABLE
from melp_warp.errors import InputError, SimulationError, require
from melp_warp.frame import ParticleFrame
from melp_warp.numerics import Numerics
from melp_warp.parameters import Value
from melp_warp.quality import QUALITIES, Quality
from melp_warp.registry import SceneScript
from melp_warp.simulation import Simulation
from melp_warp.study import foam_validation
from melp_warp.study import validation as v
from melp_warp.tables import columns

STANDARD = Quality()
NOISE = 1.3
"""Ratio of costs that the timing of short runs can tell apart."""

EXACT = 1e-5
"""Error up to which a run counts as exact: nothing is left to buy."""

SOLVED = 1e-4
"""Loosest tolerance of a point of the front: above it (14) is left all but unsolved, which is another scheme, explicit,
and no worse only while the steps are short."""


def _keys(*choices: Mapping[str, Value]) -> dict[str, Quality]:
    return {", ".join(str(value) for value in keys.values()): Quality(keys=keys) for keys in choices}


_PAPER_FLOW: dict[str, Value] = {"flow": "backward_euler"}

KNOBS: Mapping[str, Mapping[str, Quality]] = MappingProxyType(
    {
        "e": {f"{f:g}": Quality(e=f) for f in (0.25, 0.5, 2.0, 4.0)},
        "l": {f"{f:g}": Quality(l=f) for f in (0.25, 0.5, 2.0)},
        "step": {f"{f:g}": Quality(step=f) for f in (0.25, 0.5, 2.0, 4.0)},
        "support": _keys({"support": 2.5}, {"support": 4.0}),
        "curvature": _keys({"curvature": "sph"}),
        "scheme": _keys({"scheme": "explicit"}, {"scheme": "backward_euler"}, {"scheme": "trapezoid"}),
        "flow": {
            "backward_euler": Quality(keys=_PAPER_FLOW),
            **{f"backward_euler, step {f:g}": Quality(step=f, keys=_PAPER_FLOW) for f in (0.25, 0.5, 2.0)},
            "backward_euler, curved paths": Quality(keys={**_PAPER_FLOW, "l_order": 2}),
        },
        "tolerance": _keys(*({"tolerance": t} for t in (1e-1, 1e-2, 1e-3, 1e-6))),
        "solver": _keys(*({"solver": "jacobi", "max_iterations": most} for most in (100, 1000))),
        "skin": _keys({"skin": 0.1}, {"skin": 0.5}, {"skin": 1.0}),
        "transfer": {
            "PIC": Quality(keys={"affinity": 0.0, "flip": 0.0}),
            **{f"flip {f:g}": Quality(keys={"flip": f}) for f in (0.0, 0.5, 0.9, 1.0)},
            "FLIP": Quality(keys={"affinity": 0.0, "flip": 1.0}),
        },
        "carrier": {
            "apic, mixing 2": Quality(keys={"mixing": 2.0}),
            "circulation": Quality(keys={"carrier": "circulation"}),
            "circulation, mixing 2": Quality(keys={"carrier": "circulation", "mixing": 2.0}),
        },
        "redistribution": _keys({"redistribution": 0.0}, {"redistribution": 0.5}),
        "precision": _keys({"precision": 64}),
        "layers": {
            "1, as many as E": Quality(step=0.125, keys={"layers": 1}),
            "1, four an E": Quality(e=4.0, step=0.125, keys={"layers": 1}),
            "1, four an E, symmetric": Quality(e=4.0, step=0.125, keys={"layers": 1, "gradient": "symmetric"}),
            "1, four an E, xsph 0": Quality(e=4.0, step=0.125, keys={"layers": 1, "xsph": 0.0}),
        },
    }
)
"""Knob -> label -> the point; what is not said is as the case has it."""

MEANING: Mapping[str, str] = MappingProxyType(
    {
        "e": "number of E, relative",
        "l": "L per E, relative",
        "step": "time step, relative",
        "support": "kernel support, E spacings",
        "curvature": "curvature operator",
        "scheme": "time stepping of the normal motion",
        "flow": "time stepping of the flow along the film",
        "tolerance": "tolerance of the solves",
        "solver": "solver of (14), iterations at most",
        "skin": "skin of the lists, E spacings",
        "transfer": "transfer between E and L",
        "carrier": "what L carry vortices by, and mixing",
        "redistribution": "strength of the E redistribution",
        "precision": "bits of a number",
        "layers": "one layer in place of two, explicit, in steps of an eighth; the cases have four L an E",
    }
)


@dataclass(frozen=True)
class Record:
    """One run.

    Attributes:
        case: name of the case.
        knob: knob that was turned, "design" or "quality".
        setting: where to.
        changes: keys that differ from the case's own, with their values.
        error: as the case defines it; nan for a run that stopped.
        cost: wall time a simulated second, s/s.
        steps: steps taken.
        bytes: of all arrays.
        mass_error: of the E against the L, relative.
        volume_error: of the surface against the gas law, relative.
        stopped: why the run stopped, empty where it did not.
    """

    case: str
    knob: str
    setting: str
    changes: dict
    error: float = math.nan
    cost: float = math.nan
    steps: int = 0
    bytes: int = 0
    mass_error: float = math.nan
    volume_error: float = math.nan
    stopped: str = ""


@dataclass(frozen=True)
class Case:
    """A run with a known answer.

    Attributes:
        title: what is run.
        measure: what the error is.
        own: the case's own numbers, as keys of a scene.
        run: from such numbers to the error and `validation.cost`.
        knobs: those that can change its outcome.
    """

    title: str
    measure: str
    own: Mapping[str, Value]
    run: Callable[..., tuple[float, dict]]
    knobs: tuple[str, ...]

    @property
    def has_front(self) -> bool:
        """Whether there are knobs enough for a front."""
        return len(self.knobs) > 2

    def scaled(self, factor: float) -> Case:
        """The case with `factor` times its E."""
        return replace(self, own={**self.own, "e_count": round(factor * self.own["e_count"])})


def _own(e_count: int, l_per_e: int = 0, dt: float | None = None, **numerics: Value) -> dict[str, Value]:
    """Keys as a scene of a single film has them."""
    usual = {name: value for name, value in asdict(Numerics()).items() if name not in ("border", "exchange")}
    return {"e_count": e_count, "l_per_e": l_per_e, "dt": dt, **usual, **numerics}


def _departure(series: Mapping, exact: np.ndarray) -> float:
    """Rms difference of a signal from the exact one, relative to the rms of that."""
    return float(np.linalg.norm(series["signal"] - exact) / np.linalg.norm(exact))


def _rest(e_count: int, l_per_e: int, dt: float, **numerics) -> tuple[float, dict]:
    found = v.resting_bubble(e_count=e_count, l_per_e=l_per_e, dt=dt, count=20, jitter=0.15, **numerics)
    return found["error"], found["cost"]


def _oscillation(e_count: int, l_per_e: int, dt: float, **numerics) -> tuple[float, dict]:
    found = v.chord(e_count=e_count, steps_per_period=1.0 / dt, **numerics)
    return found["error"], found["cost"]


def _marangoni(e_count: int, l_per_e: int, dt: float, **numerics) -> tuple[float, dict]:
    cells = round(math.sqrt(e_count))
    found = v.marangoni_wave(cells, l_per_e, steps_per_period=1.0 / dt, periods=1.0, amplitude=0.04, **numerics)
    series, omega = found["series"], found["exact"] * np.pi / 0.2
    return _departure(series, series["signal"][0] * np.cos(omega * series["time"])), found["cost"]


def _drainage(e_count: int, l_per_e: int, dt: float, **numerics) -> tuple[np.ndarray, dict]:
    found = v.drainage(e_count, l_per_e, duration=2.0, dt=dt, fps=15.0, **numerics)
    return found["series"]["waves"], found["cost"]


def _equilibrium(e_count: int, l_per_e: int, dt: float, **numerics) -> tuple[np.ndarray, dict]:
    found = v.equilibrium(e_count, l_per_e, duration=1.0, dt=dt, **numerics)
    return np.sqrt(found["series"]["variance_e"]), found["cost"]


def _from_finer(name: str, run: Callable[..., tuple[np.ndarray, dict]]) -> Callable[..., tuple[float, dict]]:
    """The error of a case without an exact answer: what it finds against six times its E in steps a quarter as long."""

    @functools.cache
    def finer() -> np.ndarray:
        case = CASES[name]
        changes = _changes(Quality(e=6.0, step=0.25, keys={"tolerance": 1e-6}), case)
        return run(**{**case.own, **changes})[0]

    def against_finer(**keys) -> tuple[float, dict]:
        found, cost = run(**keys)
        return float(np.linalg.norm(found - finer()) / np.linalg.norm(finer())), cost

    return against_finer


def _vortex(e_count: int, l_per_e: int, dt: None, **numerics) -> tuple[float, dict]:
    found = v.taylor_vortex(round(math.sqrt(e_count)), l_per_e, turns=1.0, **numerics)
    return abs(1.0 - found["measured"]), found["cost"]


def _pair(e_count: int, l_per_e: int, dt: None, **numerics) -> tuple[float, dict]:
    found = v.taylor_pair(e_count=e_count, l_per_e=l_per_e, duration=4.0, **numerics)
    return abs(1.0 - found["peak_kept"]), found["cost"]


def _double_bubble(e_count: int, l_per_e: int, dt: None, **_) -> tuple[float, dict]:
    frames = 60
    found = foam_validation.double_bubble(e_count, frames=frames, l_per_e=l_per_e)
    took = {"seconds": found["seconds"], "simulated": frames / 240.0, "steps": found["steps"]}
    return found["error"], {**took, "mass_error": 0.0, "volume_error": found["volume_drift"]}


_FLOW = (
    "e",
    "l",
    "step",
    "flow",
    "support",
    "tolerance",
    "solver",
    "skin",
    "transfer",
    "carrier",
    "precision",
    "layers",
)

CASES: Mapping[str, Case] = MappingProxyType(
    {
        "rest": Case(
            "A bubble at rest, E up to 0.15 spacings from even places, Young-Laplace",
            "gauge pressure against 4 sigma/R, relative",
            _own(1200, dt=1e-3),
            _rest,
            ("e", "support", "curvature", "scheme", "tolerance", "redistribution", "precision"),
        ),
        "oscillation": Case(
            "A bubble ringing in modes 2, 5 and 8, one period of mode 2 in steps of T/60 of mode 8",
            "amplitudes over time against the exact cosines, rms, relative",
            _own(1200, dt=1.0 / 60.0, scheme="trapezoid"),
            _oscillation,
            ("e", "step", "support", "curvature", "scheme", "tolerance", "skin", "redistribution", "precision"),
        ),
        "marangoni": Case(
            "A Marangoni wave of 4 %, one period in steps of T/40",
            "amplitude over time against the exact cosine, rms, relative",
            _own(900, 4, dt=1.0 / 40.0),
            _marangoni,
            _FLOW,
        ),
        "drainage": Case(
            "A film that drains, 2 s in steps of 1/60 s",
            "where its liquid lies over time against a run of 6 times the E in steps of a quarter, relative",
            _own(400, 4, dt=1.0 / 60.0),
            _from_finer("drainage", _drainage),
            _FLOW,
        ),
        "equilibrium": Case(
            "An uneven disc that evens out (the paper's comparison), 1 s in steps of 1/60 s",
            "deviation of the thickness over time against a run of 6 times the E in steps of a quarter, relative",
            _own(400, 4, dt=1.0 / 60.0),
            _from_finer("equilibrium", _equilibrium),
            _FLOW,
        ),
        "vortex": Case(
            "A Taylor vortex, one turnover, cfl 0.99",
            "kinetic energy lost or gained, share",
            _own(900, 4, flip=0.95),
            _vortex,
            _FLOW,
        ),
        "pair": Case(
            "Two Taylor vortices 0.81 m apart, 4 s, cfl 0.99",
            "peak vorticity lost or gained, share",
            _own(1600, 4, flip=0.95),
            _pair,
            ("support", "transfer", "carrier", "precision"),
        ),
        "double_bubble": Case(
            "Two bubbles that meet, 0.25 s; E on each",
            "largest departure of a dihedral angle from 120 degrees, degrees",
            _own(1000),
            _double_bubble,
            ("e", "precision"),
        ),
    }
)


def _changes(quality: Quality, case: Case) -> dict[str, Value]:
    """What a point changes in a case.

    A case with a step of its own keeps one, as by cfl its start would set it; the very one where nothing moves.
    """
    changes = quality.apply({**case.own, "precision": 32})
    if case.own["dt"] is None:
        return changes
    kept = {key: value for key, value in changes.items() if key != "cfl" and (key, value) != ("dt", None)}
    return kept if "step" in case.knobs else {key: value for key, value in kept.items() if key != "dt"}


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
    changes = _changes(quality, case)
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
    code = f"from melp_warp import tradeoff; tradeoff.print_record({name!r}, {dict(case.own)!r}, {runs})"
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
            if _changes(quality, case):
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


def ran(records: Iterable[Record]) -> list[Record]:
    """Those that came to an end with a number and a time."""
    return [r for r in records if math.isfinite(r.error) and math.isfinite(r.cost)]


def _solved(records: Iterable[Record]) -> list[Record]:
    return [r for r in ran(records) if r.changes.get("tolerance", 0.0) <= SOLVED]


def front(records: Sequence[Record]) -> list[Record]:
    """The Pareto front, cheapest first: nothing else that was solved is both as cheap and as accurate."""
    best, found = math.inf, []
    for record in sorted(_solved(records), key=lambda r: (r.cost, r.error)):
        if max(record.error, EXACT) < best:
            best = max(record.error, EXACT)
            found.append(record)
    return found


def behind(record: Record, records: Sequence[Record]) -> float:
    """How many times cheaper the cheapest solved run is that is at least as accurate, or exact: 1 on the front."""
    enough = max(record.error, EXACT)
    return record.cost / min(r.cost for r in [*_solved(records), record] if r.error <= enough)


def with_as_good_a_picture(record: Record, records: Sequence[Record]) -> list[Record]:
    """Records of the same case with no fewer L per E and no smaller support: what a picture gains by both is no error.

    L are its points. Less support leaves more grain in the thickness of a film whose E lie unevenly.
    """
    own = CASES[record.case].own

    def what_shows(r: Record) -> list[float]:
        return [r.changes.get(key, own[key]) for key in ("l_per_e", "support")]

    return [r for r in records if all(x >= y for x, y in zip(what_shows(r), what_shows(record), strict=True))]


def order(records: Sequence[Record], knob: str) -> float:
    """Fitted order of convergence in the spacing (`knob` e) or in the time step (step); nan for under three runs."""
    runs = [r for r in ran(records) if r.knob == knob or r.knob == ""]
    if len(runs) < 3:
        return math.nan
    factors = [float(r.setting) if r.knob else 1.0 for r in runs]
    sizes = [f**-0.5 for f in factors] if knob == "e" else factors
    return v.order_of(sizes, [max(r.error, 1e-12) for r in runs])


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


# What is written


def table(records: Sequence[Record]) -> str:
    """The records as lines of text, cheapest first; a star for those on the front, an exclamation mark for stopped."""
    best = {id(r) for r in front([r for r in records if r.knob != "reference"])}
    rows = [("", "knob", "setting", "error", "s a simulated s", "steps", "MB")]
    for r in sorted(records, key=lambda r: (not math.isfinite(r.cost), r.cost)):
        if r.stopped:
            rows.append(("!", r.knob, r.setting, r.stopped[:60], "", "", ""))
            continue
        star = "*" if id(r) in best else ""
        numbers = (f"{r.error:.3g}", f"{r.cost:.3g}", str(r.steps), f"{1e-6 * r.bytes:.3g}")
        rows.append((star, r.knob or "-", r.setting, *numbers))
    return columns(rows)


def save(records: Sequence[Record], folder: Path, stem: str, seconds: float) -> list[Path]:
    """Write the records as `stem`.csv and `stem`.json, which also has the `seconds` all runs took; the files."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [asdict(r) for r in records]
    paths = [folder / f"{stem}.csv", folder / f"{stem}.json"]
    with paths[0].open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Record)], lineterminator="\n")
        writer.writeheader()
        writer.writerows({**row, "changes": json.dumps(row["changes"])} for row in rows)
    finite = [{k: None if isinstance(x, float) and not math.isfinite(x) else x for k, x in r.items()} for r in rows]
    paths[1].write_text(json.dumps({"seconds": seconds, "records": finite}, indent=1, allow_nan=False) + "\n")
    return paths


def plot(records: Sequence[Record], path: Path, title: str, measure: str) -> Path:
    """Draw error against cost with the front, the knobs and the named qualities.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ModuleNotFoundError:
        raise InputError("a plot needs matplotlib: pip install 'melp-warp[plot]'") from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = [r for r in ran(records) if r.error > 0.0]
    require(bool(shown), "records", records, "runs with an error above 0")
    fig, ax = plt.subplots(figsize=(7.2, 4.0), layout="constrained")
    for knob in dict.fromkeys(r.knob for r in shown):
        mine = [r for r in shown if r.knob == knob]
        place = ([r.cost for r in mine], [r.error for r in mine])
        if knob == "quality":
            ax.plot(*place, "k*", ms=11)
            for r in mine:
                ax.annotate(r.setting, (r.cost, r.error), xytext=(5, 5), textcoords="offset points")
        else:
            ax.plot(*place, "x" if knob == "design" else "o", ms=5, label=knob or "as it is")
    best = front(shown)
    ax.step([r.cost for r in best], [r.error for r in best], where="post", color="0.5", lw=1.0, label="front")
    ax.set(xscale="log", yscale="log", xlabel="wall time a simulated second, s", ylabel="error", title=title)
    ax.text(0.01, 0.01, measure, transform=ax.transAxes, fontsize=7)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    path.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(path, dpi=70)
    plt.close(fig)
    return path
