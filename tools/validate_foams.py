"""Run the foam validation cases and write docs/validation-foams.md with their figures.

    python tools/validate_foams.py              small sizes, printed only: about two minutes on two cores
    python tools/validate_foams.py --write      full sizes, about fifteen minutes; writes the page and its plot

The cases are the functions of `study.foam_validation`; the plot needs matplotlib (`pip install -e '.[plot]'`).
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "2")

import numpy as np
import warp as wp

wp.config.quiet = True

from melp_warp.study import foam_validation as v  # noqa: E402
from melp_warp.tables import wrap_markdown  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "validation-foams.md"
FIGURE = ROOT / "docs" / "figures" / "foam-angles.png"
PAPER_CURVATURE = "0.8 to 3.4 %"

HEAD = """# Validation of foams

Made by `python tools/validate_foams.py --write` from the runs it describes; the cases are the functions of
`melp_warp/study/foam_validation.py`, [foams.md](foams.md) says what is done and why these numbers come out. All
bubbles have radius 0.05 m or less, films the mass of 400 nm of water and the air's, tension 0.0726 N/m. They start
apart, meet, and are measured at rest by `melp_warp.measure`. "E" is the number of Eulerian particles on the largest
bubble.

"""


def angles(values) -> str:
    """Angles, degrees."""
    return ", ".join(f"{a:.2f}" for a in values)


def percent(x: float) -> str:
    """A relative number."""
    return f"{100.0 * x:+.2g} %"


def verdict(met: bool | None) -> str:
    """Whether a figure reaches what it should."""
    return "-" if met is None else "reached" if met else "NOT reached"


class Page:
    """The rows of the page."""

    def __init__(self):
        self.rows: list[str] = []

    def add(self, what: str, theory: str, paper: str, aim: str, size: str, measured: str, met: bool | None) -> None:
        """One row."""
        self.rows.append(f"| {what} | {theory} | {paper} | {aim} | {size} | {measured} | {verdict(met)} |")
        print(self.rows[-1], flush=True)

    def text(self, seconds: float) -> str:
        """The page."""
        table = [
            "| what | theory | the paper | to reach | E | measured | |",
            "|---|---|---|---|---|---|---|",
            *self.rows,
        ]
        machine = f"{platform.machine()}, {os.cpu_count()} CPU cores, no GPU, Warp {wp.config.version}"
        made = f"Made on {datetime.date.today().isoformat()} in {seconds / 60.0:.0f} minutes ({machine})."
        return HEAD + "\n".join(table) + f"\n\n![Angles against spacing](figures/{FIGURE.name})\n\n{made}\n"


def static(page: Page, full: bool) -> list[dict]:
    """The balancing angle of the exact double bubble."""
    results = [v.balancing_angle(n) for n in ((1000, 3000, 7500, 10000, 20000) if full else (1000, 3000))]
    for r in results:
        page.add(
            "static test, balancing angle",
            "120",
            "-",
            "120 +- 1",
            f"{r['e_per_bubble']:,}",
            f"{r['measured']:.1f}",
            abs(r["error"]) <= 1.0,
        )
    return results


def doubles(page: Page, full: bool) -> list[dict]:
    """Two equal bubbles."""
    results = [v.double_bubble(n) for n in ((1000, 3000, 10000) if full else (1000,))]
    for r in results:
        size, met = f"{r['e_per_bubble']:,}", r["error"] <= 1.2
        page.add(
            "double bubble, dihedral angles",
            "120",
            "118.6, 122.3, 119.1",
            "1.2 degrees",
            size,
            angles(r["measured"]),
            met,
        )
        page.add(
            "its area",
            "27 pi (V/9 pi)^(2/3)",
            "0.0594 m^2",
            "0.5 %",
            size,
            f"{r['area']:.5f} m^2, {percent(r['area_error'])}",
            abs(r["area_error"]) <= 0.005,
        )
    return results


def ratios(page: Page, full: bool) -> None:
    """Bubbles of different sizes."""
    for ratio in (0.4, 0.5, 0.6, 0.7, 0.8, 0.9) if full else (0.6,):
        r = v.double_bubble(10000 if full else 2000, ratio=ratio)
        page.add(
            f"partition curvature, R2 = {ratio} R1",
            "1/R2 - 1/R1 of the settled caps",
            PAPER_CURVATURE,
            "2 %",
            f"{r['e_per_bubble']:,}",
            f"{r['curvature']:+.2f} for {r['expected_curvature']:+.2f} 1/m, {percent(r['curvature_error'])}; "
            f"angles {angles(r['measured'])}",
            abs(r["curvature_error"]) <= 0.02,
        )


def rings(page: Page, full: bool) -> None:
    """Three and four bubbles that all touch."""
    for count, name, paper in ((3, "triple bubble", "<= 0.9 %"), (4, "quadruple bubble", "-")):
        for n in (1000, 2000, 4000) if full else (800,):
            r = v.ring(count, n)
            page.add(
                f"{name}, dihedral angles",
                "120",
                paper,
                "1 %" if count == 3 else "-",
                f"{n:,}",
                f"mean {r['mean']:.2f}, largest error {r['error']:.2f} degrees",
                r["error"] <= 1.2 if count == 3 else None,
            )
            if len(r["edges"]):
                page.add(
                    f"{name}, edge angles",
                    "109.47",
                    "<= 5 %" if count == 4 else "-",
                    "2 %",
                    f"{n:,}",
                    f"mean {r['edges'].mean():.2f}, largest error {percent(r['edge_error'])}",
                    r["edge_error"] <= 0.02,
                )


def conservation(page: Page, full: bool) -> None:
    """Gas, mass and surfactant over a long run, with L that cross."""
    frames = 1200 if full else 60
    scene = v.foam_scene(*v.pair_of(v.RADIUS, v.RADIUS), 500, frames=frames, l_per_e=8, exchange=20.0)
    _, _, watched = v.settle(scene)
    aim = f"gas volume of each region, {frames / 240.0:g} s"
    volume = f"{watched['volume_drift']:.1e}"
    aim += ", logged and found anew at the end"
    page.add(aim, "constant", "-", "0.1 %", "500", volume, watched["volume_drift"] < 1e-3)
    drift = max(watched["mass_drift"], watched["surfactant_drift"])
    page.add("mass, surfactant with exchange", "constant", "-", "1e-5", "500", f"{drift:.1e}", drift < 1e-5)


def steps(page: Page, full: bool) -> None:
    """The largest step in contact."""
    r = v.largest_step(1000)
    for dt, cfl, error in zip(r["series"]["dt"], r["series"]["cfl"], r["series"]["error"], strict=True):
        page.add(
            f"step of 1/{1.0 / dt:.0f} s at rest in contact",
            "-",
            "CFL 0.33",
            "-",
            "1,000",
            f"capillary CFL {cfl:.1f}: " + (f"largest error {error:.1f} degrees" if error == error else "stops"),
            None,
        )


def four(page: Page, full: bool) -> None:
    """The unstable fourfold line."""
    r = v.four_bubbles(600, frames=360 if full else 120)
    said = f"{r['measured']} partitions" + (f", split at {r['when']:.2f} s" if r["when"] == r["when"] else ", no split")
    theory = "splits into two threefold lines"
    page.add("four bubbles in a square", theory, "shown", "splits", "600", said, r["error"] == 0)


def many(page: Page, full: bool) -> None:
    """A foam of many bubbles, run to rest."""
    count = 300 if full else 20
    frames = 240 if full else 20
    r = v.packed(count, frames=frames)
    said = f"{r['measured']} left, {100.0 * r['covered']:.0f} % of the films are partitions; speeds "
    said += f"{1e3 * r['rms_speed']:.1f} mm/s rms, {1e3 * r['speed']:.0f} at most; "
    said += f"volumes within {r['volume_drift']:.0e} on the way"
    name, theory = f"{count} bubbles, {frames / 240.0:.2g} s", "none lost, at rest"
    page.add(name, theory, "9.1 s a step, 64 cores", "-", "240", said, r["measured"] == count)


def draw(statics: list[dict], dynamics: list[dict]) -> None:
    """Angle against spacing."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4))
    for results, label, value in (
        (statics, "static test", lambda r: r["measured"]),
        (dynamics, "at rest after a run", lambda r: r["measured"][2]),
    ):
        spacing = [np.sqrt(4.0 * np.pi / r["e_per_bubble"]) for r in results]
        axes.plot(spacing, [value(r) for r in results], "o-", label=label)
    axes.axhline(120.0, color="gray", lw=0.8)
    axes.set_xlabel("E spacing / radius")
    axes.set_ylabel("outer dihedral angle, degrees")
    axes.legend()
    figure.tight_layout()
    figure.savefig(FIGURE, dpi=110)


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="full sizes; write the page and its plot")
    options = parser.parse_args()
    began, page = time.perf_counter(), Page()
    statics = static(page, options.write)
    dynamics = doubles(page, options.write)
    for case in (ratios, rings, conservation, steps, four, many):
        case(page, options.write)
    if options.write:
        draw(statics, dynamics)
        PAGE.write_text(wrap_markdown(page.text(time.perf_counter() - began)))


if __name__ == "__main__":
    main()
