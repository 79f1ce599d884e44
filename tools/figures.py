"""Make the pictures of the docs from real runs, and docs/gallery.md, which shows them with their commands.

python tools/figures.py                    # all
python tools/figures.py --only drainage
"""

from __future__ import annotations

import argparse
import datetime
import json
import re
import tempfile
import time
from pathlib import Path

from melp_warp.cli import main as melp_warp
from melp_warp.preview.draw import contact_sheet, render, save_image
from melp_warp.preview.pictures import Cache
from melp_warp.tables import wrap_markdown

FIGURES = Path(__file__).parent.parent / "docs" / "figures"
GALLERY = FIGURES.parent / "gallery.md"
SIZE = 400
"""Pixels of a picture each way."""

HEAD = """# Gallery

Frames of each scene from real runs, early, middle and late, drawn from what is in the cache.
`python tools/figures.py --only drainage` makes one and its part of this page; without `--only` all are made. Where a
scene is smaller here than by default, its command says so. Times are film time; the minutes, meshes included, are those
of two busy cores.
"""

SHEETS = {
    "giant_bubble": (["--set", "l_per_e=32", "e_count=2000", "--frames", "240"], (0, 20, 60, 120, 180, 240)),
    "drainage": ([], (0, 3, 6, 10, 20, 36)),
    "equilibrium": ([], (0, 1, 2, 4, 10, 36)),
    "taylor_vortices": ([], (0, 40, 80, 120, 160, 192)),
    "leapfrog": (["--set", "e_count=3000", "l_per_e=12"], (0, 40, 80, 110, 150, 192)),
    "turbulent_film": (["--set", "e_count=2500", "l_per_e=12"], (0, 20, 50, 90, 140, 192)),
    "stirred_disc": (["--set", "e_count=1500"], (0, 20, 50, 90, 140, 192)),
    "giant_bubble_vortices": (["--set", "e_count=1500"], (0, 20, 50, 90, 140, 192)),
    "deforming_rectangle_2m": (["--set", "e_count=1800"], (0, 15, 30, 50, 70, 96)),
    "oscillating_bubble": ([], (0, 5, 10, 15, 20, 25)),
    "double_bubble": (["--set", "e_count=1000", "--frames", "60"], (0, 8, 15, 30, 45, 60)),
    "four_bubbles": (["--set", "e_count=1600", "l_per_e=4"], (0, 15, 40, 70, 90, 120)),
    "size_ratio": (["--set", "ratio=0.5", "e_count=1500", "l_per_e=8"], (0, 20, 90)),
    "triple_bubble": (["--set", "e_count=1500", "l_per_e=8"], (0, 15, 45)),
    "quadruple_bubble": (["--set", "e_count=1600", "l_per_e=8"], (10, 25, 45)),
    "cluster": (["--set", "e_count=2600", "l_per_e=4"], (0, 20, 60)),
    "foam_mountain": (["--set", "e_count=2000", "bubbles=8"], (20, 50, 90)),
    "film_burst": ([], (5, 40, 80)),
    "burst_pair": ([], (20, 60, 90)),
    "giant_bubble_burst": (
        ["--set", "e_count=4000", "puncture_time=0.3", "slow_from=0.3", "slow_motion=15", "--frames", "36"],
        (21, 26, 31),
    ),
    "four_bubbles_burst": (
        ["--set", "e_count=2800", "l_per_e=8", "slow_from=1.6", "slow_motion=60", "--frames", "118"],
        (101, 108, 117),
    ),
    "foam_pops": (["--set", "e_count=2500", "l_per_e=4", "--frames", "62"], (20, 45, 62)),
    "inflation": (["--set", "e_count=900", "l_per_e=6"], (0, 60, 125, 180, 240, 300)),
}

SCENE = {"giant_bubble_burst": "giant_bubble", "four_bubbles_burst": "four_bubbles"}
"""Scenes of sheets that have another name."""


def draw(name: str, size: int) -> str:
    """Run one scene and put a sheet of its frames into docs/figures; what the gallery says of it."""
    options, wanted = SHEETS[name]
    scene = SCENE.get(name, name)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / name
        began = time.perf_counter()
        if melp_warp(["run", scene, "--mesh", "--quiet", "--out", str(out), *options]):
            raise SystemExit(f"{name} failed")
        minutes = (time.perf_counter() - began) / 60.0
        cache = Cache(out)
        camera = cache.camera()
        times = {line["frame"]: line["time"] for line in map(json.loads, (out / "run.jsonl").open()) if "time" in line}
        frames = [n for n in wanted if n in cache.frames]
        images = [render(cache.film(n), size, size, camera) for n in frames]
    FIGURES.mkdir(parents=True, exist_ok=True)
    path = FIGURES / f"{name}.png"
    save_image(contact_sheet(images, columns=3), path)
    print(path)
    command = " ".join(["melp-warp", "run", scene, *options])
    shown = f"frames {', '.join(map(str, frames))}, at {', '.join(f'{times[n]:.3g}' for n in frames)} s"
    made = f"{datetime.date.today().isoformat()}, {max(1, round(minutes))} min"
    return f"`{command}`: {shown} ({made}).\n\n![{name}](figures/{name}.png)\n"


def write_gallery(sections: dict[str, str]) -> None:
    """Replace the parts of docs/gallery.md that are new, in the order of the sheets."""
    text = GALLERY.read_text() if GALLERY.exists() else ""
    kept = dict(re.findall(r"^## (\w+)\n\n(.*?)(?=\n## |\Z)", text, re.M | re.S))
    parts = kept | sections
    text = HEAD + "".join(f"\n## {name}\n\n{parts[name]}" for name in SHEETS if name in parts)
    GALLERY.write_text(wrap_markdown(text))


def main() -> None:
    """Draw the sheets asked for; at full size they go into the gallery."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=sorted(SHEETS))
    parser.add_argument("--size", type=int, default=SIZE)
    options = parser.parse_args()
    for name in options.only or SHEETS:
        part = draw(name, options.size)
        if options.size == SIZE:
            write_gallery({name: part})


if __name__ == "__main__":
    main()
