"""Measure vortices against Euler's equations and write the figures into docs/vortices.md.

python tools/validate_vortices.py --write               all, about half an hour on two cores
python tools/validate_vortices.py --only zonal baroclinic   some, shown only
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from melp_warp.study import validation as v
from melp_warp.study import vortex_validation as vv

PAGE = Path(__file__).resolve().parents[1] / "docs" / "vortices.md"
BEGIN, END = "<!-- tools/validate_vortices.py -->", "<!-- end -->"


@dataclass(frozen=True)
class Case:
    """A row of the table for each of `runs`.

    Attributes:
        what: what is measured.
        exact: what theory gives.
        function: from `melp_warp.study.validation` or `melp_warp.study.vortex_validation`.
        runs: its arguments.
        show: what it returns, in words.
    """

    what: str
    exact: str
    function: Callable[..., dict]
    runs: list[dict]
    show: Callable[[dict], str]


def kept(r: dict) -> str:
    """Energy and enstrophy, in words."""
    return f"energy {r['energy_kept']:.3f}" + (
        f", enstrophy {r['enstrophy_kept']:.3f}" if "enstrophy_kept" in r else ""
    )


CASES = {
    "leapfrog": Case(
        "leapfrog: in line, two cores until, energy at 8 s, peak at the start and at 5 s, places off to 4 s",
        "2.3, 4.26, 5.83, 6.98 s; 7.3 s; 1; 31.8 1/s",
        vv.leapfrog,
        [{"carrier": "apic"}, {"e_count": 4608}, {}, {"e_count": 18432, "l_per_e": 8}],
        lambda r: (
            ", ".join(f"{t:.2f}" for t in r["passes"])
            + f" s; {r['apart_until']:.1f} s; {r['energy_kept']:.3f}; {r['peak_start']:.1f}, {r['peak_at_5']:.1f} 1/s;"
            f" {r['places_off']:.2f} m"
        ),
    ),
    "pair": Case(
        "two Taylor vortices 0.81 m apart, after 8 s (0.78 m: they merge)",
        "2.35 m",
        v.taylor_pair,
        [
            {"noise": 0.0, **given}
            for given in (
                {"carrier": "apic", "flip": 0.95},
                {},
                {"cfl": 0.5, "l_per_e": 4},
                {"e_count": 10000, "l_per_e": 8},
                {"e_count": 10000, "l_per_e": 4, "cfl": 0.5},
                {"separation": 0.78},
                {"separation": 0.78, "cfl": 0.5, "l_per_e": 4},
            )
        ],
        lambda r: f"{r['measured']:.2f} m" + (f", merged at {r['merged']:.1f} s" if r["merged"] == r["merged"] else ""),
    ),
    "vortex": Case(
        "one Taylor vortex of 5 spacings, 3 turnovers: energy, angular momentum, peak",
        "1, 1, 1",
        v.taylor_vortex,
        [{"carrier": "apic", "flip": 0.95}, {"cells": 24, "l_per_e": 8}, {}, {"cells": 64, "l_per_e": 8}],
        lambda r: f"{r['measured']:.3f}, {r['angular_kept']:.4f}, {r['peak_kept']:.3f}",
    ),
    "zonal": Case(
        "zonal flow on a bubble, 5 turnovers: departure of the vorticity",
        "0",
        vv.zonal,
        [{"e_count": 1500, "carrier": "apic"}, {"e_count": 500}, {"e_count": 1500}, {"e_count": 4500}],
        lambda r: f"{100.0 * r['error']:.2f} %; {kept(r)}",
    ),
    "haurwitz": Case(
        "Rossby-Haurwitz wave of degree 4 on a bubble, 5 turnovers: its drift",
        "alpha (1 - 2/(n (n + 1)))",
        vv.haurwitz,
        [{"e_count": 1500, "carrier": "apic"}, {"e_count": 500}, {"e_count": 1500}, {"e_count": 4500}],
        lambda r: f"{100.0 * r['error']:+.2f} %, amplitude {r['amplitude_kept']:.3f}; {kept(r)}",
    ),
    "sphere_pair": Case(
        "a vortex pair on a bubble, one turn: its rate; distance; speed of the bubble over that of the flow",
        "Gamma/(4 pi R^2 sin(gamma/2)); 1; 0",
        vv.sphere_pair,
        [{"e_count": 1000}, {"e_count": 2000}, {"e_count": 4000}],
        lambda r: f"{100.0 * r['error']:+.2f} %; {r['apart']:.3f}; {r['flown']:.3f}",
    ),
    "turbulence": Case(
        "turbulent_film, 20 turnovers: energy, enstrophy",
        "1, falls",
        vv.turbulence,
        [{"e_count": 6000, "carrier": "apic", "l_per_e": 8}, {"e_count": 6000, "l_per_e": 8}],
        lambda r: f"{r['measured']:.3f}" + (f", {r['enstrophy_kept']:.3f}" if "enstrophy_kept" in r else ""),
    ),
    "lamb_oseen": Case(
        "viscous vortex: growth of a^2",
        "4 nu",
        vv.lamb_oseen,
        [{"cells": 20}, {"cells": 30}, {"cells": 40}],
        lambda r: f"{100.0 * r['error']:+.2f} %",
    ),
    "baroclinic": Case(
        "uneven film that surfactant holds up: d omega/dt",
        "g (d eta/dx)/eta",
        vv.baroclinic,
        [{"cells": 15}, {"cells": 30}, {"cells": 60}],
        lambda r: f"{100.0 * r['error']:+.2f} %",
    ),
}


def size(result: dict) -> str:
    """How large a run was and what carried it."""
    e_count = result.get("e_count") or result["cells"] ** 2
    flip = f", flip {result['flip']:g}" if "flip" in result else ""
    cfl = f", cfl {result['cfl']:g}" if "cfl" in result else ""
    apart = f", {result['separation']:g} m" if result.get("separation", 0.81) != 0.81 else ""
    return f"{result.get('carrier', vv.CARRIER)}{flip}, {e_count:,} E{cfl}{apart}"


def measure(names: list[str]) -> list[str]:
    """The lines of the table."""
    lines = ["| what | exact | run | measured |", "|---|---|---|---|"]
    for name in names:
        case = CASES[name]
        for run in case.runs:
            result = case.function(**run)
            lines.append(f"| {case.what} | {case.exact} | {size(result)} | {case.show(result)} |")
            print(lines[-1], flush=True)
    return lines


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=CASES, metavar="CASE", help="these cases: " + ", ".join(CASES))
    parser.add_argument("--write", action="store_true", help="write docs/vortices.md")
    options = parser.parse_args()
    lines = measure(options.only or list(CASES))
    if options.write:
        before, rest = PAGE.read_text().split(BEGIN)
        PAGE.write_text("\n".join([before + BEGIN, "", *lines, "", END + rest.split(END)[1]]))
        print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
