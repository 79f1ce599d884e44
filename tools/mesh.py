"""Measure surface meshes and write the figures into docs/mesh.md.

python tools/mesh.py --write          spheres of 200 to 200,000 E and every frame of every scene, small
python tools/mesh.py --largest 2000   up to 2,000 E, shown only
"""

from __future__ import annotations

import argparse
from pathlib import Path

from melp_warp.study.mesh_validation import SCENES, SceneRecord, SphereRecord, measure_sphere, prove_scene

PAGE = Path(__file__).resolve().parents[1] / "docs" / "mesh.md"
BEGIN, END = "<!-- tools/mesh.py -->", "<!-- end -->"
COUNTS = (200, 500, 1000, 2000, 5000, 20_000, 200_000)
SCENE_TEXT = """\
Every frame of every scene with some 200 E a bubble, as few as foams take; bubbles pop, merge and come in some of them
(`pytest -m slow tests/io/test_mesh.py` does the same). Liquid: the largest relative error of a region in any frame."""
FEWER_L = 200_000
"""E from which there are 4 L an E in place of 16."""


def row(record: SphereRecord) -> str:
    """A row of the table."""
    errors = " | ".join(f"{error:.1e}" for error in (record.area, record.volume, record.liquid))
    closed = "; ".join(record.problems) or "yes"
    return f"| {record.e_count:,} | {record.faces:,} | {closed} | {errors} | {record.seconds:.2g} |"


def measure(counts: list[int]) -> list[str]:
    """The lines of the table."""
    measure_sphere(200)  # compiles
    lines = [
        "| E | triangles | closed, nothing inside out | area | volume | liquid | s |",
        "|---|---|---|---|---|---|---|",
    ]
    for count in counts:
        lines.append(row(measure_sphere(count, 4 if count >= FEWER_L else 16)))
        print(lines[-1])
    return lines


def scene_row(record: SceneRecord) -> str:
    """A row of the table of scenes."""
    closed = "; ".join(record.problems[:3]) or "yes"
    numbers = f"{record.frames} | {record.meshes:,} | {record.faces:,}"
    return f"| `{record.name}` | {numbers} | {closed} | {record.liquid:.1e} | {100.0 * record.share:.1f} % |"


def prove(frames: int | None) -> list[str]:
    """The lines of the table of scenes."""
    lines = [
        "| scene | frames | meshes | most triangles | closed, nothing inside out | liquid | share of the time |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in SCENES:
        lines.append(scene_row(prove_scene(name, frames)))
        print(lines[-1])
    return lines


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--largest", type=int, default=COUNTS[-1], metavar="N", help="E of the largest sphere")
    parser.add_argument("--frames", type=int, metavar="N", help="frames of each scene (default: all)")
    parser.add_argument("--write", action="store_true", help="write docs/mesh.md")
    options = parser.parse_args()
    lines = measure([count for count in COUNTS if count <= options.largest])
    lines += ["", SCENE_TEXT, "", *prove(options.frames)]
    if options.write:
        before, rest = PAGE.read_text().split(BEGIN)
        PAGE.write_text("\n".join([before + BEGIN, "", *lines, "", END + rest.split(END)[1]]))
        print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
