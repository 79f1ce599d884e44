"""A cache in Blender: what arrives, at which speed, and that a frame renders with its film; needs the module bpy."""

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest

from melp_warp import cli
from melp_warp.optics import color_table, display_color
from melp_warp.program.blender import SCRIPT, TABLES
from melp_warp.usd.packing import shown_thickness
from melp_warp.usd.reading import read_frame, read_mesh

LOOK = """
import json, sys
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[1])
import bpy, film_blender
bpy.ops.wm.read_factory_settings(use_empty=True)
shown = film_blender.open_cache(Path(sys.argv[1]), points=True)
scene, found = bpy.context.scene, {}
found["rate"] = scene.render.fps / scene.render.fps_base
found["range"] = [scene.frame_start, scene.frame_end]
found["camera"] = scene.camera is not None
arrays = {}
for frame in (0, 2):
    scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    for one in shown:
        data = one.evaluated_get(graph).data
        for a in data.attributes:
            width = {"FLOAT": 1, "INT": 1, "FLOAT_VECTOR": 3, "FLOAT_COLOR": 4}.get(a.data_type)
            if width and a.domain == "POINT":
                values = np.zeros(width * len(a.data), np.int32 if a.data_type == "INT" else np.float32)
                a.data.foreach_get({3: "vector", 4: "color"}.get(width, "value"), values)
                arrays[f"{one.name.split('.')[0]}/{frame}/{a.name}"] = values.reshape(-1, width)
np.savez(sys.argv[2], **arrays)
print("FOUND" + json.dumps(found))
film_blender.render(Path(sys.argv[3]), 2, (96, 96), 16)
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blender") / "run"
    small = ["--set", "e_count=300", "l_per_e=2", "approach_speed=0.5", "--frames", "2", "--fps", "50"]
    assert cli.main(["run", "double_bubble", "--mesh", "--quiet", "--out", str(folder), *small]) == 0
    assert cli.main(["blender", str(folder)]) == 0
    return folder


def test_the_script_stands_alone(cache):
    """It imports nothing of ours until it is asked to write itself, and its table is that of the optics."""
    words = (
        "import sys; sys.modules['melp_warp'] = None; import film_blender as f; print(f.rate_of(f.Path('film.usda')))"
    )
    done = subprocess.run([sys.executable, "-c", words], cwd=cache, capture_output=True, text=True, check=True)
    assert float(done.stdout) == 50.0
    assert (cache / SCRIPT).is_file()
    np.testing.assert_allclose(np.load(cache / TABLES)["colors"], color_table(4000.0, 1024, 64), rtol=1e-3, atol=1e-6)


def test_no_script_without_a_cache(tmp_path, capsys):
    assert cli.main(["blender", str(tmp_path)]) == 2
    assert "DIR must be a folder that a run wrote" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.apps
@pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="bpy is not installed")
def test_meshes_and_points_arrive(cache, tmp_path):
    """In a process of its own, as Blender stays in the one that it is loaded into."""
    script, arrays, picture = tmp_path / "look.py", tmp_path / "arrays.npz", tmp_path / "frame.png"
    script.write_text(LOOK)
    command = [sys.executable, str(script), str(cache), str(arrays), str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    line = next(line for line in done.stdout.splitlines() if line.startswith("FOUND"))
    found = json.loads(line.removeprefix("FOUND"))
    assert found == {"rate": 50.0, "range": [0, 2], "camera": True}
    there = np.load(arrays)
    names = {"points": "position", "velocities": "velocity", "thickness": "thickness", "black_film": "blackFilm"}
    for frame in (0, 2):
        for region in (0, 1):
            mesh = read_mesh(cache, frame, region)
            for field, name in names.items():
                value = there[f"Region_{region}/{frame}/{name}"]
                np.testing.assert_array_equal(value, getattr(mesh, field).reshape(value.shape))
        film = read_frame(cache, frame)
        np.testing.assert_array_equal(there[f"Film/{frame}/position"], film.points)
        np.testing.assert_array_equal(there[f"Film/{frame}/thickness"][:, 0], film.thickness)
        colors = display_color(shown_thickness(film.thickness))  # tables of a packed set are taken apart
        np.testing.assert_array_equal(there[f"Film/{frame}/displayColor"][:, :3], colors)
        turned = there[f"Film/{frame}/normals"]
        assert turned.shape == film.normals.shape
        assert np.abs(np.linalg.norm(turned, axis=1) - 1.0).max() < 1e-5
    from PIL import Image

    with Image.open(picture) as image:
        seen = np.asarray(image.convert("RGB"), float)
    assert seen[:8].mean() < 30.0  # the ground
    assert seen[30:66, 30:66].mean() > 2.0 * seen[:8].mean()
    assert np.ptp(seen, axis=2).max() > 40.0  # colours
