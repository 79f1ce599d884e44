"""Measure the energy budget of every scene at small size and write the tables of docs/energy.md.

python tools/energy.py                       all cases, shown only
python tools/energy.py --write               write the first table
python tools/energy.py --only drainage       one scene
python tools/energy.py --long --scale 1 2    2,000 frames of each with 1 and 2 times its E, the second table
"""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path

from melp_warp.stepping.ledger import RAISED
from melp_warp.study.energy_cases import CASES, LONG, SCALES, EnergyCase, Found, run_case

PAGE = Path(__file__).resolve().parents[1] / "docs" / "energy.md"
BEGIN = {False: "<!-- tools/energy.py -->", True: "<!-- tools/energy.py --long -->"}
END = "<!-- end -->"
HEAD = """\
| scene | E | frames | s | largest rest | last rest | liquid | surfactant | makes most energy | on |
|---|---|---|---|---|---|---|---|---|---|"""


def row(case: EnergyCase, found: Found) -> str:
    """A row of a table."""
    name, share = found.raised
    raised = f"{name} {100.0 * share:.2g}" if share > RAISED else "-"
    rests = f"{100.0 * found.share:.2g} | {100.0 * found.rest:+.2g}"
    if found.none:
        rests, raised = "- | -", f"no budget: {found.none}"
    end = f"; stopped: {found.stopped}" if found.stopped else ""
    return (
        f"| {case.label} | {found.e_count} | {found.frames} | {found.time:.3g} | {rests} |"
        f" {found.liquid:+.0e} | {found.surfactant:+.0e} | {raised}{end} | {datetime.date.today():%m-%d} |"
    )


def merge(table: str, rows: list[str]) -> str:
    """A table with rows in place of those of the same scenes; those of scenes that are no case any more go."""
    order = [case.scaled(scale).label for case in CASES for scale in SCALES]
    found = {line.split(" | ")[0].removeprefix("| "): line for line in (*table.splitlines(), *rows)}
    return "\n".join([HEAD, *(found[label] for label in order if label in found)])


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = list(dict.fromkeys(case.scene for case in CASES))
    parser.add_argument("--only", nargs="+", metavar="SCENE", choices=names, help="these scenes alone")
    parser.add_argument("--long", action="store_true", help=f"{LONG} frames of each, and the second table")
    parser.add_argument(
        "--scale", type=float, nargs="+", default=[1.0], choices=SCALES, metavar="S", help="times the E of each case"
    )
    parser.add_argument("--write", action="store_true", help="write the rows into the table of docs/energy.md")
    options = parser.parse_args(arguments)
    for case in (case for case in CASES if case.scene in (options.only or names)):
        for scale in options.scale:
            scaled = case.scaled(scale)
            line = row(scaled, run_case(scaled, LONG if options.long else None))
            print(line, flush=True)
            if options.write:
                _write(line, options.long)
    return 0


def _write(line: str, long: bool) -> None:
    """Put a row into the page, as soon as it is found: the next ones take minutes."""
    begin = BEGIN[long]
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(begin)
    table, _, after = rest.partition(END)
    PAGE.write_text(f"{before}{begin}\n{merge(table, [line])}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
