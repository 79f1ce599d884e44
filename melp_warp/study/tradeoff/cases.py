"""Cases with a known answer, and the knobs that are turned."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType

import numpy as np

from melp_warp.numerics import Numerics
from melp_warp.parameters import Value
from melp_warp.quality import Quality
from melp_warp.study import foam_validation
from melp_warp.study import validation as v

STANDARD = Quality()


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
        changes = changes_of(Quality(e=6.0, step=0.25, keys={"tolerance": 1e-6}), case)
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


def changes_of(quality: Quality, case: Case) -> dict[str, Value]:
    """What a point changes in a case.

    A case with a step of its own keeps one, as by cfl its start would set it; the very one where nothing moves.
    """
    changes = quality.apply({**case.own, "precision": 32})
    if case.own["dt"] is None:
        return changes
    kept = {key: value for key, value in changes.items() if key != "cfl" and (key, value) != ("dt", None)}
    return kept if "step" in case.knobs else {key: value for key, value in kept.items() if key != "dt"}
