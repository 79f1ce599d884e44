"""Measure the energy budget of every scene at small size and write the table of docs/energy.md.

python tools/energy.py                       all cases, shown only
python tools/energy.py --write               write the table
python tools/energy.py --only drainage       one scene
python tools/energy.py --frames 2000 --scale 0.5 1 2
"""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path

from melp_warp.stepping.ledger import RAISED
from melp_warp.study.energy_cases import CASES, EnergyCase, Found, run_case

PAGE = Path(__file__).resolve().parents[1] / "docs" / "energy.md"
BEGIN, END = "<!-- tools/energy.py -->", "<!-- end -->"


def row(case: EnergyCase, found: Found) -> str:
    """A row of the table."""
    name, share = found.raised
    raised = f"{name} {100.0 * share:.2g}" if share > RAISED else "-"
    end = f"; stopped: {found.stopped}" if found.stopped else ""
    return (
        f"| {case.label} | {found.e_count} | {found.frames} | {found.time:.3g} | {100.0 * found.share:.2g} |"
        f" {100.0 * found.rest:+.2g} | {raised}{end} |"
    )


def table(rows: list[str]) -> str:
    """The table with its head."""
    head = [
        f"Percent of what moved; `python tools/energy.py --write`, {datetime.date.today():%Y-%m-%d}, one run each:",
        "",
        "| scene | E | frames | s | largest rest | last rest | makes most energy |",
        "|---|---|---|---|---|---|---|",
    ]
    return "\n".join([*head, *rows])


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = list(dict.fromkeys(case.scene for case in CASES))
    parser.add_argument("--only", nargs="+", metavar="SCENE", choices=names, help="these scenes alone")
    parser.add_argument("--frames", type=int, metavar="N", help="frames of each (default: the case's own)")
    parser.add_argument("--scale", type=float, nargs="+", default=[1.0], metavar="S", help="times the E of each case")
    parser.add_argument("--write", action="store_true", help="write the table of docs/energy.md")
    options = parser.parse_args(arguments)
    if options.write and (options.only or options.frames):
        parser.error("--write wants every scene with its own frames: leave --only and --frames out")
    rows = []
    for case in (case for case in CASES if case.scene in (options.only or names)):
        for scale in options.scale:
            rows.append(row(case, run_case(case, scale, options.frames)))
            print(rows[-1], flush=True)
    if options.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        _, _, after = rest.partition(END)
        PAGE.write_text(f"{before}{BEGIN}\n{table(rows)}\n{END}{after}", encoding="utf-8")
        print(f"wrote {PAGE}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
