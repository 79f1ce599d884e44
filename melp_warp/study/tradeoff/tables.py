"""Tables, files and figures of a study."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

from melp_warp.errors import InputError, require
from melp_warp.study.tradeoff.records import Record, front, ran
from melp_warp.tables import columns


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
