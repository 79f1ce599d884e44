"""Make the pictures of the docs from real runs.

python tools/figures.py                    # all
python tools/figures.py --only drainage
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from melp_warp.cli import main as melp_warp
from melp_warp.preview import Camera, contact_sheet, render, save_image
from melp_warp.usd import list_frames, read_frame

FIGURES = Path(__file__).parent.parent / "docs" / "figures"

SHEETS = {
    "giant_bubble": (["--set", "l_per_e=48", "e_count=2500", "--frames", "240"], (0, 20, 60, 120, 180, 240)),
    "drainage": ([], (0, 5, 10, 20, 40, 150)),
    "equilibrium": (["--fps", "120", "--frames", "60"], (0, 1, 2, 4, 10, 60)),
    "taylor_vortices": ([], (0, 40, 80, 120, 160, 192)),
    "oscillating_bubble": ([], (0, 5, 10, 15, 20, 25)),
    "double_bubble": (["--frames", "60"], (0, 8, 15, 30, 45, 60)),
    "four_bubbles": ([], (0, 15, 40, 70, 90, 120)),
}


def draw(name: str, size: int) -> None:
    """Run one scene and put a sheet of its frames into docs/figures."""
    options, wanted = SHEETS[name]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / name
        if melp_warp(["run", name, "--out", str(out), *options]):
            raise SystemExit(f"{name} failed")
        there = list_frames(out)
        numbers = [n for n in wanted if n in there]
        frames = [read_frame(out, n) for n in numbers]
        camera = Camera.fit(frames)
        images = [render(frame, size, size, camera) for frame in frames]
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
