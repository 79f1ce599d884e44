"""Runs of a study: what they cost and how far off they were, which of them are best."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from melp_warp.study import validation as v
from melp_warp.study.tradeoff.cases import CASES

NOISE = 1.3
"""Ratio of costs that the timing of short runs can tell apart."""


EXACT = 1e-5
"""Error up to which a run counts as exact: nothing is left to buy."""


SOLVED = 1e-4
"""Loosest tolerance of a point of the front: above it (14) is left all but unsolved, which is another scheme, explicit,
and no worse only while the steps are short."""


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
