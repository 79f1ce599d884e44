"""Measure speed against accuracy and write docs/accuracy.md with its figures, CSV and JSON.

    python tools/tradeoff.py                            every case, printed only
    python tools/tradeoff.py --only vortex --size 0.5   one, with half the E
    python tools/tradeoff.py --write                    writes the page, ten to twenty minutes on two cores
    python tools/tradeoff.py --write --from FILE.json   the page anew from records that were saved

The cases and knobs are those of `melp_warp.study.tradeoff`; the figures need matplotlib (`pip install -e '.[plot]'`).
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "2")
# between steps the cases look at their film with NumPy, whose BLAS threads would go on spinning through the next step
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import warp as wp

wp.config.log_level = wp.LOG_WARNING

from melp_warp.program.estimate import measure_cost  # noqa: E402
from melp_warp.quality import QUALITIES  # noqa: E402
from melp_warp.registry import load_scene  # noqa: E402
from melp_warp.simulation import Simulation  # noqa: E402
from melp_warp.study import rounding as precision  # noqa: E402
from melp_warp.study import tradeoff as t  # noqa: E402
from melp_warp.study import validation as v  # noqa: E402
from melp_warp.tables import wrap_markdown  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "accuracy.md"
FIGURES = ROOT / "docs" / "figures"

PAPER = (
    # of Table 4: name, scene, E, L per E, seconds an iteration, iterations a frame
    ("MELP Equilibrium", "equilibrium", 1050, 16, 0.33, 1.06),
    ("MELP Flow", "taylor_vortices", 6900, 100, 3.1, 2.25),
)

NOTES = """\
## What it comes to

* **Two errors, of the spacing and of the step, add up or cancel.** Where one is the larger, the other knob buys
  little. A case with one number to get right can be lucky with the signs. So three modes ring at once, the shortest
  eight E long, E at rest lie unevenly, and a film that drains is held against a finer run all the way, not against
  where it ends.
* **Time step.** The midpoint rules, of the normal motion and of the flow along the film, need no more than T/40 of
  what is to be right. Backward Euler for the normal motion, which scenes take for its calm, has twenty times the
  error of what rings.
* **`flow=backward_euler`**, the paper's, has twelve times the error of a wave and four times that of a film that
  drains or evens out, for the same time; in steps a quarter as long, at four times the cost, it has still three times
  that of a wave. What it is for is calm: without drag and viscosity a film sloshes on, and backward Euler damps that.
  Foams keep it. Curved paths of L (`l_order=2`) gain nothing with it and cost a vortex energy; the midpoint rule has
  them anyway.
* **E** buy accuracy wherever the film moves or turns. The pressure of a sphere needs none: it is exact with any
  number of E, however they lie. What rings is of fourth order and soon as right as the step allows: a quarter of the
  E has fifteen times the error, twice the E two thirds.
* **L per E buy picture, not accuracy:** from four on the errors are the same to a few per cent. The cases have four,
  scenes sixteen for the picture.
* **Support 3 has two thirds of the error of 4, the paper's, at three quarters of the cost,** and under a third where
  a bubble rings; 2.5 has four fifths of that of 3, ringing a third, for a tenth less. What support buys is evenness:
  where E are moved by up to 0.15 spacings, eta_E is uneven by 1.3 % at 3 and 0.6 % at 4, and the explicit step ends
  at 1.2 in place of 1.7 spacings a step at the membrane's wave speed. So 3 is the default.
* **Curvature by SPH** is 0.25 % off for the pressure of a sphere of uneven E, which more E do not lower, and has
  fourteen times the error of what rings.
* **Explicit** normal motion stops at the steps of a resting bubble; where it runs it costs the same and has, with the
  paper's fits, over twenty times the error.
* **Tolerance** is relative to the surfactant, not to its variation: at 1e-3 a wave of 1 % is left unsolved, in effect
  explicit. 1e-4 is where the error no longer changes.
* **Relaxed Jacobi** leaves the smooth part of the solution unsolved at 100 sweeps, and its errors differ for that.
  Where 1,000 sweeps solve it, the error is that of conjugate gradients, at more cost.
* **Skin** changes cost alone; from 0.1 to 0.5 hardly that.
* **`flip`** keeps vortices alive: 0.95, which the vortices have, leaves 40 % of what a vortex loses without, for no
  time that could be told, and waves and drainage as they are. PIC destroys a vortex within a turn; FLIP without the
  affine part is worse than APIC with `flip`. The noise of their own that L keep does not show: the grain of eta_L in
  a film that evens out and the error of one that drains are the same to a hundredth with 0, 0.95 and 1.
* **`carrier=circulation`** leaves a vortex 3.9 to 4.2 % of its energy off in place of 8.7 (with `flip` 0.95), and two
  vortices 5 % of their peak in place of 36; waves, drainage and what evens out are the same to 2 %. `mixing=2` changes
  none of them by more than a tenth but for the pair, 0.2 % with circulation, by luck of signs. Both were run on
  2026-11-29 by turns with the cases as they are, on a shared machine: their costs are good to a half
  ([vortices.md](vortices.md) tells them better).
* **Redistribution** takes a seventh of a ringing bubble's time and a quarter of its error; a bubble at rest asks
  nothing of it.
* **float64** changes no error by more than a fortieth, most not in the third digit, at 1.2 to 1.7 times the time and
  1.7 to 1.9 times the memory. It buys sums to the last digit: liquid and surfactant to 1e-16 instead of 1e-8, the
  volume of a bubble at rest to 1e-12 instead of 1e-7. Take it to tell rounding from the scheme, not for a better
  picture.
* **One layer**, explicit, is the most accurate where a thin film evens out against the air's drag, and without XSPH
  for a wave, for four to six times the time; drainage is off by seven to a hundred times as much, and a vortex is
  gone within a turn. See docs/single-layer.md.
* **`draft`, `standard` and `fine` are points of the fronts,** or exact, as all of them are for a bubble at rest. Costs
  repeat to a third: `pair` at `standard` came out at 1.0, 1.0 and 1.4 in three runs of this page. **`paper`** is off by
  SPH and Jacobi where they matter, and by its support; it is there for comparison.

"""

PRECISION = """\
The solver computes in float32, with sums over regions and the gas in float64. With `MELP_WARP_PRECISION=64` in the
environment the same source runs with all numbers of the solver in float64 ([command-line.md](command-line.md)). The
cases as they are, in both: error in float32 and its relative change in float64; cost and memory in float64 relative to
float32; errors of mass and volume in float32, then in float64. What is left of the volume's is the scheme's.

"""


def number(x: float) -> str:
    """Three digits, "-" for none."""
    return f"{x:.3g}" if math.isfinite(x) else "-"


def rows(*lines: Sequence[str]) -> list[str]:
    """A table in Markdown; the first line is its head."""
    head, *body = ["| " + " | ".join(line) + " |" for line in lines]
    return [head, "|" + "---|" * len(lines[0]), *body, ""]


def shown(record: t.Record) -> str:
    """What a run changed."""
    values = (f"{key} {x:.3g}" if isinstance(x, float) else f"{key} {x}" for key, x in record.changes.items())
    return ", ".join(values) or "as it is"


def overview(records: list[t.Record]) -> list[str]:
    """What each case is and where it stands."""
    lines = [("case", "error is", "error as it is", "s a simulated s", "MB", "order in spacing", "in the step")]
    for name, case in t.CASES.items():
        mine = [r for r in records if r.case == name]
        for own in (r for r in mine if r.knob == ""):
            orders = [f"{t.order(mine, knob):.1f}".replace("nan", "-") for knob in ("e", "step")]
            size = number(1e-6 * own.bytes) if own.bytes else "-"
            lines.append((f"{case.title} (`{name}`)", case.measure, number(own.error), number(own.cost), size, *orders))
    return rows(*lines)


def knobs(records: list[t.Record]) -> list[str]:
    """Error and cost of each setting relative to the case as it is."""
    names = [name for name, case in t.CASES.items() if len(case.knobs) > 1 and any(r.case == name for r in records)]
    own = {r.case: r for r in records if r.knob == ""}
    lines = [("knob", "setting", *(f"`{name}`" for name in names))]
    for knob, settings in t.KNOBS.items():
        for setting in settings:
            cells = [cell(records, own, name, knob, setting) for name in names]
            if any(cells):
                lines.append((t.MEANING[knob], setting, *cells))
    return rows(*lines)


def cell(records: list[t.Record], own: dict[str, t.Record], name: str, knob: str, setting: str) -> str:
    """Error and cost relative to the case as it is; "stops" for a run that did not end, empty where there is none."""
    for r in records:
        if (r.case, r.knob, r.setting) == (name, knob, setting):
            if r.stopped:
                return "stops" if r.stopped.startswith("stage") else "refused"
            return f"{r.error / own[name].error:.2f}, {r.cost / own[name].cost:.2f}"
    return ""


def qualities(records: list[t.Record]) -> list[str]:
    """The named qualities against the front of each case."""
    lines = [("case", *QUALITIES)]
    for name in t.CASES:
        mine = [r for r in records if r.case == name]
        points = {r.setting: r for r in mine if r.knob == "quality"}
        if points:
            lines.append((f"`{name}`", *(place(points[q], mine) for q in QUALITIES)))
    return rows(*lines)


def repeatability(records: list[t.Record]) -> str:
    """How far the costs of a run that every case makes twice are apart."""
    pairs = {}
    for r in t.ran(records):
        if not r.changes and r.knob in ("", "quality"):
            pairs.setdefault(r.case, []).append(r.cost)
    apart = [max(costs) / min(costs) for costs in pairs.values() if len(costs) > 1]
    return f"a factor of {max(apart):.2f}" if apart else "an unknown factor"


def place(record: t.Record, mine: list[t.Record]) -> str:
    """Error, cost and distance from the front of one quality."""
    if record.stopped:
        return "refused"
    behind = t.behind(record, mine)
    with_picture = t.behind(record, t.with_as_good_a_picture(record, mine))
    if behind < t.NOISE:
        where = "**on the front**"
    elif record.error < t.EXACT:
        where = f"**exact**, for {behind:.1f} times the cost of the cheapest that is"
    elif with_picture < t.NOISE:
        where = f"**on the front** of its picture ({behind:.1f} without)"
    else:
        where = f"{with_picture:.1f} times the cost of the front of its picture ({behind:.1f} without)"
    return f"{number(record.error)}, {number(record.cost)}: {where}"


def fronts(records: list[t.Record]) -> list[str]:
    """Figure and front of each case."""
    lines = []
    for name, case in t.CASES.items():
        mine = [r for r in records if r.case == name]
        if not mine or not case.has_front:
            continue
        picture = f"accuracy-{name}.png"
        t.plot(mine, FIGURES / picture, case.title, case.measure)
        lines += [f"### {case.title}", "", f"![Error against cost](figures/{picture})", ""]
        best = t.front(mine)
        head = ("error", "s a simulated s", "MB", "mass", "volume", "what")
        lines += rows(
            head,
            *(
                (
                    *(number(x) for x in (r.error, r.cost, 1e-6 * r.bytes, r.mass_error, r.volume_error)),
                    r.setting + ": " + shown(r) if r.knob == "quality" else shown(r),
                )
                for r in best
            ),
        )
    return lines


def refinement(records: list[t.Record]) -> list[str]:
    """Cases that are refined in E and have no step of their own to turn."""
    lines = [("case", "E", "error", "s a simulated s", "volume")]
    for name, case in t.CASES.items():
        refined = "e" in case.knobs and "step" not in case.knobs
        mine = [r for r in records if r.case == name and r.knob in ("", "e") and refined]
        for r in sorted(mine, key=lambda r: r.changes.get("e_count", case.own["e_count"])):
            count = f"{r.changes.get('e_count', case.own['e_count']):,}"
            lines.append((f"`{name}`, {case.measure}", count, number(r.error), number(r.cost), number(r.volume_error)))
    return rows(*lines)


def precisions(records: list[t.Record]) -> list[str]:
    """Each case as it is against the same run in float64."""
    lines = [("case", "error", "in float64", "s a simulated s", "MB", "mass", "volume")]
    for name in t.CASES:
        own, double = ([r for r in records if (r.case, r.knob) == (name, knob)] for knob in ("", "precision"))
        for a, b in zip(own, double, strict=False):
            share = (f"{abs(b.error / a.error - 1.0):.1e}", f"{b.cost / a.cost:.2f}")
            size = f"{b.bytes / a.bytes:.2f}" if a.bytes else "-"
            lines.append((f"`{name}`", number(a.error), *share, size, *(kept(a, b, e) for e in ("mass", "volume"))))
    return rows(*lines)


def kept(single: t.Record, double: t.Record, what: str) -> str:
    """Error of what a run should keep in either precision, "-" where there is nothing to keep."""
    errors = [getattr(r, f"{what}_error") for r in (single, double)]
    return ", ".join(f"{error:.1e}" if error else "0" for error in errors) if any(errors) else "-"


def single_precision() -> list[str]:
    """float32 against float64 at the same particles, and a run whose state is rounded anew at every step."""
    dt, lines = 1.0 / 120.0, [("what", "relative difference from float64")]
    for e_count in (400, 2000):
        simulation = Simulation(v.small_giant(e_count, 8))
        v.steps(simulation, 5, dt)
        lines.append(
            (f"curvature by MLS fits, giant_bubble of {e_count:,} E", number(precision.curvature_error(simulation)))
        )
        lines.append(("mass gathered by E from L, the same", number(precision.transfer_error(simulation))))
    for tolerance in (1e-3, 1e-4, 1e-7):
        simulation = Simulation(v.small_giant(400, 8, tolerance=tolerance))
        v.steps(simulation, 5, dt)
        off, change = precision.solver_error(simulation, dt)
        what = f"solution of (14) at tolerance {tolerance:g} (a step changes it by {number(change)})"
        lines.append((what, number(off)))
    scene = v.small_giant(400, 8)
    for ulps in (1.0, 16.0):
        apart = precision.nudged_difference(scene, 60, dt, ulps)
        lines.append((f"giant_bubble of 400 E after 60 steps, state nudged by {ulps:g} ulp at each", number(apart)))
    finer, own = (Simulation(v.small_giant(n, 8)) for n in (1600, 400))
    for simulation in (finer, own):
        v.steps(simulation, 60, dt)
    apart = t.field_error(own.particles("e"), finer.particles("e"))
    lines.append(("to compare with: the same run with four times the E", number(apart)))
    return rows(*lines)


def table_4() -> list[str]:
    """The paper's comparison cases at its own particle numbers with `--quality paper`."""
    lines = [("Table 4", "particles", "s an iteration", "iterations a frame", "ours: s a step", "steps a frame")]
    for name, scene, e_count, l_per_e, seconds, iterations in PAPER:
        script = load_scene(scene)
        values = QUALITIES["paper"].values(script, {"e_count": e_count, "l_per_e": l_per_e})
        found = measure_cost(script.build(values))
        size = f"{found.e_count:,} E, {found.l_count:,} L"
        ours = (number(found.step_seconds), number(found.steps / found.frames))
        lines.append((f"{name} (our scene `{scene}`)", size, str(seconds), str(iterations), *ours))
    return rows(*lines)


def page(records: list[t.Record], seconds: float) -> str:
    """The text of docs/accuracy.md."""
    return "\n".join(
        [
            "# Speed against accuracy",
            "",
            f"Made by `python tools/tradeoff.py --write` on {datetime.date.today():%Y-%m-%d}; the runs took"
            f" {seconds / 60.0:.0f} minutes (Warp {wp.config.version},"
            f" {platform.machine()} CPU, {os.cpu_count()} cores)."
            f" All {len(records)} runs are in [accuracy.csv](figures/accuracy.csv) and"
            " [accuracy.json](figures/accuracy.json). For a scene of your own: `melp-warp tradeoff SCENE`.",
            "",
            "Each case is run as it is, with every knob turned alone, at the points of a Latin hypercube over E, step,"
            " L, support, tolerance and `flip`, and with each `--quality`. Cost is wall time a simulated second at the"
            f" usual step's; a quality within a factor of {t.NOISE:g} of the front counts as on it. `standard` is the"
            f" case as it is, run once more: the two costs are up to {repeatability(records)} apart here, which"
            " is what a single cost is worth.",
            "",
            "## Cases",
            "",
            *overview(records),
            *NOTES.splitlines(),
            "## What each knob buys, and what it costs",
            "",
            "Error and cost relative to the case as it is: under 1 is better and cheaper.",
            "",
            *knobs(records),
            "## `--quality`",
            "",
            "Error, cost, and how many times cheaper the cheapest run is that is at least as accurate: of all runs, and"
            " of those of its picture, with no fewer L an E and no smaller support. Both buy what no error here"
            " shows: points of the picture, and less grain (giant_bubble with 2,000 E after 1.5 s: 2.0, 1.3 and 0.6 %"
            " of the thickness of E at supports 2.5, 3 and 4). `paper` keeps the steps of a case that sets its own.",
            "",
            *qualities(records),
            "## Refinement of a foam",
            "",
            *refinement(records),
            "## Pareto fronts",
            "",
            "Nothing that was run is both cheaper and more accurate than a row of these tables, but for runs with a"
            f" tolerance above {t.SOLVED:g}, which leave (14) unsolved. Mass is that of the E"
            " against the L, volume that of the surface against the gas law, both relative.",
            "",
            *fronts(records),
            "## Single precision",
            "",
            *PRECISION.splitlines(),
            *precisions(records),
            "What rounding does, seen otherwise: stages evaluated again in NumPy's float64 from the same float32"
            " particles, and a run whose whole state is rounded anew at random at every step, against one left alone"
            " (difference of thickness and surface, relative).",
            "",
            *single_precision(),
            "## The paper's comparison",
            "",
            "Table 4 of MELP 2022, on 64 cores, at its numbers of particles with `--quality paper`; its scenes are not"
            " published in every number, so the iterations a frame are those of ours.",
            "",
            *table_4(),
        ]
    )


def run(names: Sequence[str], size: float, points: int, folder: Path | None) -> list[t.Record]:
    """All records of the cases, printed as they are done and, with a folder, saved after each case."""
    records, start = [], time.perf_counter()
    for name in names:
        began = time.perf_counter()
        mine = list(t.study(name, points, t.CASES[name].scaled(size), runs=4))
        records += mine
        print(f"\n{name}, {time.perf_counter() - began:.0f} s\n\n{t.table(mine)}", flush=True)
        if folder is not None:
            t.save(records, folder, "accuracy", time.perf_counter() - start)
    return records


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=t.CASES, help="run these cases alone")
    parser.add_argument("--size", type=float, default=1.0, help="factor on the E of every case (default: 1)")
    parser.add_argument("--points", type=int, default=16, help="points of the designed set (default: 16)")
    parser.add_argument("--write", action="store_true", help="write docs/accuracy.md and docs/figures")
    parser.add_argument("--from", dest="saved", type=Path, metavar="FILE", help="take saved records, run no case")
    options = parser.parse_args(arguments)
    if options.write and (options.only or options.size != 1.0):
        parser.error("--write wants every case at full size: leave --only and --size out")
    source = options.saved or FIGURES / "accuracy.json"
    if not options.saved:
        run(options.only or list(t.CASES), options.size, options.points, FIGURES if options.write else None)
    if options.write:
        saved = json.loads(source.read_text())
        made = page([t.Record(**{**r, **no_number(r)}) for r in saved["records"]], saved["seconds"])
        PAGE.write_text(wrap_markdown(made))
        print(f"wrote {PAGE}")
    return 0


def no_number(saved: dict) -> dict:
    """JSON has no nan."""
    return {key: math.nan for key, value in saved.items() if value is None}


if __name__ == "__main__":
    raise SystemExit(main())
