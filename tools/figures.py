"""Make the pictures of the docs from real runs.

python tools/figures.py                    # all
python tools/figures.py --only drainage
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from melp_warp.cli import main as melp_warp
from melp_warp.preview.draw import contact_sheet, render, save_image
from melp_warp.preview.pictures import Cache

FIGURES = Path(__file__).parent.parent / "docs" / "figures"

SHEETS = {
    "giant_bubble": (["--set", "l_per_e=32", "e_count=2000", "--frames", "240"], (0, 20, 60, 120, 180, 240)),
    "drainage": ([], (0, 3, 6, 10, 20, 36)),
    "equilibrium": ([], (0, 1, 2, 4, 10, 36)),
    "taylor_vortices": ([], (0, 40, 80, 120, 160, 192)),
    "oscillating_bubble": ([], (0, 5, 10, 15, 20, 25)),
    "double_bubble": (["--set", "e_count=1000", "--frames", "60"], (0, 8, 15, 30, 45, 60)),
    "four_bubbles": (["--set", "e_count=1600", "l_per_e=4"], (0, 15, 40, 70, 90, 120)),
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
    "inflation": ([], (0, 60, 125)),
}

SCENE = {"giant_bubble_burst": "giant_bubble", "four_bubbles_burst": "four_bubbles"}
"""Scenes of sheets that have another name."""


def draw(name: str, size: int) -> None:
    """Run one scene and put a sheet of its frames into docs/figures."""
    options, wanted = SHEETS[name]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / name
        if melp_warp(["run", SCENE.get(name, name), "--mesh", "--quiet", "--out", str(out), *options]):
            raise SystemExit(f"{name} failed")
        cache = Cache(out)
        camera = cache.camera()
        images = [render(cache.film(n), size, size, camera) for n in wanted if n in cache.frames]
    FIGURES.mkdir(parents=True, exist_ok=True)
    path = FIGURES / f"{name}.png"
    save_image(contact_sheet(images, columns=3), path)
    print(path)


def main() -> None:
    """Draw the sheets asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=sorted(SHEETS))
    parser.add_argument("--size", type=int, default=400)
    options = parser.parse_args()
    for name in options.only or SHEETS:
        draw(name, options.size)


if __name__ == "__main__":
    main()
