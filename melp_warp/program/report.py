"""`melp-warp report`: the energy budget of a run (docs/energy.md), and the grain of its frames (docs/vortices.md)."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path

from melp_warp.errors import InputError, require
from melp_warp.stepping.ledger import KINDS, LOSS, RAISED, STORE, TERMS, Term


def read_budget(folder: Path) -> list[dict]:
    """The budgets of a run's frames, in their order.

    Raises:
        InputError: the folder has no log, or one without a budget.
    """
    path = folder / "run.jsonl"
    require(path.is_file(), "DIR", str(folder), "a folder that a run wrote")
    try:
        frames = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    except ValueError as error:
        raise InputError(f"{path} must hold a line of JSON a frame: {error}") from None
    lines = [frame["budget"] for frame in frames if "start" in frame.get("budget", {})]
    require(bool(lines), "DIR", str(folder), "a run of at least one frame that kept an energy budget")
    return lines


LOOKED_AT = 11
"""Frames of a cache of which the grain is measured, evenly spread from the first to the last."""


def read_grain(folder: Path) -> list[tuple[int, float]]:
    """Frames of a cache of L and the grain of each (docs/vortices.md); none where it has no L.

    Raises:
        InputError: a file of the cache cannot be read.
    """
    from melp_warp.measure.grain import grain
    from melp_warp.usd.apart import read_frame, read_root
    from melp_warp.usd.schema import list_frames

    frames = list_frames(folder)
    if not frames or not read_root(folder)["with_l"]:
        return []
    chosen = sorted({frames[round(k * (len(frames) - 1) / (LOOKED_AT - 1))] for k in range(LOOKED_AT)})
    found = ((number, read_frame(folder, number)) for number in chosen)
    return [(number, grain(f.points, f.normals, f.thickness, f.region)) for number, f in found]


def print_grain(found: Sequence[tuple[int, float]]) -> None:
    """Print the grain of frames."""
    if found:
        print("grain: " + ", ".join(f"{100.0 * amount:.1f} % in frame {number}" for number, amount in found))


def _amount(line: dict, term: Term, of: str = "") -> float:
    """What a line of the log has of a term, J; 0 where the run was made before there was such a term."""
    return line[of or term.kind].get(term.name, 0.0)


def print_budget(lines: Sequence[dict]) -> None:
    """Print what each term stores more, did or took since the start; what makes energy is marked."""
    from rich.console import Console
    from rich.table import Table

    last = lines[-1]
    moved = last["moved"] or 1.0
    table = Table(title=f"Energy up to {last['time']:.4g} s; {last['moved']:.4g} J moved")
    for column in ("kind", "term", "J", "% of what moved", "what"):
        table.add_column(column, justify="right" if column in ("J", "% of what moved") else "left")
    for kind in KINDS:
        for term in (t for t in TERMS if t.kind == kind):
            change = _amount(last, term) - (_amount(last, term, "start") if kind == STORE else 0.0)
            if change:
                mark = " makes energy" if kind == LOSS and change < -RAISED * moved else ""
                table.add_row(kind, term.name, f"{change:.4g}", f"{100 * change / moved:.3f}", term.meaning + mark)
    table.add_row("rest", "", f"{last['rest']:.4g}", f"{100 * last['rest'] / moved:.3f}", "unexplained")
    console = Console(width=130)
    console.print(table)
    console.print(f"The rest was never above {100 * last['share']:.3g} % of what moved.")
    balance = last["balance"]
    console.print(
        f"liquid {balance['liquid']:+.2e}, surfactant {balance['surfactant']:+.2e} (relative); "
        f"momentum beyond outside forces {[float(f'{p:.3g}') for p in balance['momentum']]} kg m/s"
    )


def draw_budget(lines: Sequence[dict], path: Path) -> Path:
    """Draw the terms over time to a PNG file; the file.

    Raises:
        InputError: matplotlib is missing, or the file cannot be written.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("drawing the budget needs matplotlib: pip install 'melp-warp[plot]'")
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    moved = lines[-1]["moved"] or 1.0
    time = [line["time"] for line in lines]
    figure, axes = pyplot.subplots(figsize=(8, 5))
    for term in TERMS:
        start = _amount(lines[0], term, "start") if term.kind == STORE else 0.0
        values = [(_amount(line, term) - start) / moved for line in lines]
        if max(map(abs, values)) > RAISED:
            axes.plot(time, values, label=term.name, linestyle="-" if term.kind == STORE else "--")
    axes.plot(time, [line["rest"] / moved for line in lines], "k", linewidth=2, label="rest")
    axes.set(xlabel="time, s", ylabel="energy over what moved")
    axes.legend(fontsize="small")
    try:
        figure.savefig(path, dpi=120, bbox_inches="tight")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error
    finally:
        pyplot.close(figure)
    return path
