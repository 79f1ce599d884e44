"""Every scene, small, from the command line to a checked cache, with the real solver."""

import json
import math
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from melp_warp import cli
from melp_warp.usd.check import check_cache
from melp_warp.usd.reading import read_frame
from melp_warp.usd.schema import ATTRIBUTES, list_frames

SMALL = {
    "cluster": ["e_count=2400", "l_per_e=1"],
    "double_bubble": ["e_count=240", "l_per_e=4"],
    "foam_mountain": ["e_count=1000", "bubbles=5"],
    "foam_pops": ["e_count=1600", "l_per_e=1", "pop_time=0.02", "pop_interval=0.001", "pops=2"],
    "four_bubbles": ["e_count=480", "l_per_e=2", "merge_time=0.03"],
    "quadruple_bubble": ["e_count=480", "l_per_e=2"],
    "size_ratio": ["e_count=480", "l_per_e=2"],
    "triple_bubble": ["e_count=360", "l_per_e=2"],
    "drainage": ["e_count=300", "l_per_e=4"],
    "equilibrium": ["e_count=300", "l_per_e=4"],
    "giant_bubble": ["e_count=400", "l_per_e=4"],
    "inflation": ["e_count=300", "l_per_e=2"],
    "film_burst": ["e_count=400", "l_per_e=4", "slow_motion=200"],
    "burst_pair": ["e_count=400", "l_per_e=4", "slow_motion=200"],
    "oscillating_bubble": ["e_count=400"],
    "taylor_vortices": ["e_count=400", "l_per_e=4"],
    "leapfrog": ["e_count=400", "l_per_e=4"],
    "turbulent_film": ["e_count=400", "l_per_e=4", "whirls=2"],
    "stirred_disc": ["e_count=300", "l_per_e=4"],
    "deforming_rectangle_2m": ["e_count=400", "l_per_e=4"],
    "giant_bubble_vortices": ["e_count=500", "l_per_e=4"],
}
NUMBERS = "time dt substeps e_count l_count area mass surfactant kinetic_energy surface_energy max_speed".split()
LIQUID = ("mass", "rim_mass", "drop_mass", "frame_mass")
FIELDS = [attribute.field for attribute in ATTRIBUTES if attribute.field]


def run(name, out, *options, frames=3):
    return cli.main(
        ["run", name, "--frames", str(frames), "--quiet", "--out", str(out), "--set", *SMALL[name], *map(str, options)]
    )


def lines(folder):
    return [json.loads(line) for line in (folder / "run.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("name", SMALL)
def test_every_scene_runs_to_a_sound_cache(name, tmp_path):
    out = tmp_path / name
    assert run(name, out) == 0
    assert check_cache(out) == []
    assert list_frames(out) == [0, 1, 2, 3]
    log = lines(out)
    for key in NUMBERS:
        assert all(isinstance(line[key], (int, float)) and math.isfinite(line[key]) for line in log), key
    assert len(log[-1]["momentum"]) == 3
    assert log[-1]["wall_ms"]
    liquid = [sum(line.get(kind, 0.0) for kind in LIQUID) for line in log]
    assert liquid[-1] == pytest.approx(liquid[0], rel=1e-5)
    assert log[-1]["max_speed"] > 0.0
    first, last = read_frame(out, 0), read_frame(out, 3)
    kept = np.searchsorted(first.ids, last.ids)  # particles are lost only with a film that breaks
    np.testing.assert_array_equal(first.ids[kept], last.ids)
    assert len(last.ids) == len(first.ids) or name in ("four_bubbles", "foam_pops", "film_burst", "burst_pair")
    moved = np.abs(last.points - first.points[kept]).max()
    gone = len(last.ids) < len(first.ids)
    assert gone or moved > 0.0 or np.abs(last.thickness - first.thickness[kept]).max() > 0.0


POPPING = """
from melp_warp.cluster import Bubble, Cluster, Pop
from melp_warp.parameters import FOAM, declare

PARAMETERS = declare(**FOAM, radius=0.05, pop_time=0.04, e_count=200, l_per_e=4, frames=5)


def build(p):
    return p.scene("popping", Cluster((Bubble((0.0, 0.0, 0.0), p.radius),), events=(Pop(p.pop_time, 0, delete=True),)))
"""


def test_a_run_whose_last_bubble_pops_ends_as_any_other(tmp_path, capsys):
    """Frames 3 to 5 hold no particles; the last lines say so, the cache is sound and every frame can be drawn."""
    script, out = tmp_path / "popping.py", tmp_path / "out"
    script.write_text(POPPING)
    assert cli.main(["run", str(script), "--out", str(out), "--export", "both"]) == 0
    assert "The last film is gone: from frame 3 on there are no particles" in capsys.readouterr().out
    assert check_cache(out) == []
    assert [len(read_frame(out, frame, "Film").points) > 0 for frame in list_frames(out)] == 3 * [True] + 3 * [False]
    log = lines(out)
    assert log[-1]["spilled"] == pytest.approx(log[0]["mass"], rel=1e-6)
    for frame in (2, 5):
        picture = tmp_path / f"{frame}.png"
        assert cli.main(["preview", str(out), "--frame", str(frame), "--size", "64", "--out", str(picture)]) == 0
        assert picture.stat().st_size > 0


def test_same_seed_same_result_bit_for_bit(tmp_path):
    for folder, seed in (("one", 4), ("two", 4), ("other", 5)):
        assert run("giant_bubble", tmp_path / folder, "--seed", seed, "--export", "both") == 0
    one, two, other = ([read_frame(tmp_path / f, 3, p) for p in ("Film", "FilmE")] for f in ("one", "two", "other"))
    for prim in (0, 1):
        for field in FIELDS:
            assert getattr(one[prim], field).tobytes() == getattr(two[prim], field).tobytes(), field
    assert one[0].points.tobytes() != other[0].points.tobytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["giant_bubble", "--device", "tpu"], ["device", "cpu", "'tpu'"]),
        (["giant_bubble", "--set", "e_count=5"], ["e_count", "5"]),
        (["drainage", "--set", "e_count=3"], ["e_count", "3"]),
    ],
)
def test_what_the_solver_refuses(arguments, words, tmp_path, capsys):
    assert cli.main(["run", *arguments, "--out", str(tmp_path / "cache")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("melp-warp: error: ")
    assert error.count("\n") == 1
    for word in words:
        assert word in error
    assert not (tmp_path / "cache").exists()


def stopped(capsys, out, *words):
    """The run ended with one line that holds the words; its frames, numbered from 0, and the checkpoint are sound."""
    error = capsys.readouterr().err
    assert error.startswith("melp-warp: error: stage ")
    assert error.count("\n") == 1
    for word in (*words, "checkpoint.npz"):
        assert word in error
    assert check_cache(out) == []
    with np.load(out / "checkpoint.npz") as checkpoint:
        assert int(checkpoint["frame"]) == list_frames(out)[-1]
        assert all(np.isfinite(checkpoint[name]).all() for name in checkpoint.files)


def test_a_step_that_is_not_finite_keeps_the_last_good_frame(tmp_path, monkeypatch, capsys):
    from melp_warp.simulation import Simulation

    advance = Simulation.advance_frame

    def poisoned(self):
        if self.frame == 2:
            u = self.state.l.u.numpy()
            u[7] = np.nan
            self.state.l.u.assign(u)
        advance(self)

    monkeypatch.setattr(Simulation, "advance_frame", poisoned)
    out = tmp_path / "cache"
    assert run("giant_bubble", out, frames=9) == 1
    stopped(capsys, out, "particle", "not finite", "3 frames, 0 to 2")


def test_an_unstable_scheme_stops_with_its_stage(tmp_path, capsys):
    out = tmp_path / "cache"
    assert run("giant_bubble", out, "scheme=explicit") == 1
    stopped(capsys, out, "stage membrane", "1 frame, 0 to 0")


def listen():
    """Have Ctrl-C heard, whatever the shell that the tests run in ignores."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_ctrl_c_as_a_user_presses_it(tmp_path):
    out = tmp_path / "cache"
    command = [sys.executable, "-m", "melp_warp", "run", "giant_bubble", "--frames", "100000", "--out", str(out)]
    process = subprocess.Popen(
        [*command, "--set", *SMALL["giant_bubble"]],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=listen,  # noqa: PLW1509
    )
    deadline = time.monotonic() + 60.0
    while len(list_frames(out)) < 3 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 130
    frames = list_frames(out)
    assert f"holds {len(frames)} frames, 0 to {frames[-1]}" in error
    assert [line["frame"] for line in lines(out)] == frames
    assert check_cache(out) == []


@pytest.mark.slow
@pytest.mark.parametrize(("separation", "parts"), [(0.81, True), (0.7, False)])
def test_taylor_vortices_part_beyond_the_critical_distance(separation, parts, tmp_path):
    """In two-dimensional Euler flow cores 0.81 m apart are 2.9 m apart after 8 s; those 0.78 m apart or less merge."""
    out = tmp_path / "cache"
    assert cli.main(["run", "taylor_vortices", "--quiet", "--out", str(out), "--set", f"separation={separation}"]) == 0
    assert check_cache(out) == []
    points = read_frame(out, 0).points
    cores = [np.linalg.norm(points - [side * separation, 0.0, 0.0], axis=1) < 0.15 for side in (-0.5, 0.5)]
    last = read_frame(out, list_frames(out)[-1]).points
    distance = np.linalg.norm(np.median(last[cores[0]], axis=0) - np.median(last[cores[1]], axis=0))
    assert distance > 1.6 if parts else distance < 0.6
