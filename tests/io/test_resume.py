"""Runs that end before their time go on as if nothing had been."""

import importlib.util
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from melp_warp import cli
from melp_warp.device.interrupt import end_like_ctrl_c, finish_first, let_through
from melp_warp.errors import InputError
from melp_warp.files import append
from melp_warp.program import output, resume
from melp_warp.program.plan import Every
from melp_warp.simulation import Simulation
from melp_warp.usd.check import check_cache
from melp_warp.usd.schema import list_frames

SPEC = importlib.util.spec_from_file_location("kills", Path(__file__).resolve().parents[2] / "tools" / "kills.py")
kills = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(kills)

FRAMES = 6


class Killed(BaseException):
    """Stands in for the end of the process: nothing catches it."""


@pytest.fixture(scope="module", params=kills.SCENES)
def alone(request, tmp_path_factory, device):
    """A scene file, the folder of a run of it that was left alone, and how often that put something in place."""
    folder = tmp_path_factory.mktemp("alone")
    script = folder / f"{request.param}.py"
    script.write_text(kills.SCENES[request.param])
    with pytest.MonkeyPatch.context() as patch:
        made = die_at(patch, 0)
        assert run(script, folder / "out", "--checkpoint", 2) == 0
    return script, folder / "out", len(made)


@pytest.fixture(scope="module")
def film(tmp_path_factory, device):
    """The same of a closed film."""
    folder = tmp_path_factory.mktemp("film")
    script = folder / "film.py"
    script.write_text(kills.SCENES["film"])
    assert run(script, folder / "out") == 0
    return script, folder / "out"


def run(script, out, *options):
    return cli.main(["run", str(script), "--quiet", "--out", str(out), *map(str, options)])


def die_at(monkeypatch, count):
    """Let the process end when it puts its `count`-th file in place or logs its line, with half of it written."""
    replace, left, made = os.replace, [count], []

    def reached():
        made.append(1)
        left[0] -= 1
        return left[0] == 0

    def replacing(source, target, **options):
        if reached():
            shutil.copy(source, Path(target).parent / f".left.tmp{Path(target).suffix}")
            raise Killed
        replace(source, target, **options)

    def appending(path, data):
        if reached():
            append(path, data[: len(data) // 2])
            raise Killed
        append(path, data)

    monkeypatch.setattr(os, "replace", replacing)
    monkeypatch.setattr(output, "append", appending)
    return made


@pytest.mark.parametrize("count", [1, pytest.param(8, marks=pytest.mark.slow)])
def test_killed_runs_go_on_to_the_same_bytes(alone, count, tmp_path, monkeypatch):
    """While files are written: in the first frame, at a checkpoint, anywhere, more than once."""
    script, whole, total = alone
    rng = random.Random(3)
    for number, at in enumerate(rng.sample(range(4, total), count)):
        out = tmp_path / str(number)
        for points in (at, rng.randrange(3, total)):
            mode = ["--resume"] if any(out.glob("checkpoint*.npz")) else ["--overwrite"]
            with monkeypatch.context() as patch:
                die_at(patch, points)
                try:
                    assert run(script, out, "--checkpoint", 2, *mode) == 0
                except Killed:
                    continue
                break
        else:
            assert run(script, out, "--checkpoint", 2, "--resume") == 0
        assert kills.difference(out, whole) == "", f"killed at {at} of {total}"
    assert check_cache(out) == []


@pytest.mark.slow
def test_killed_processes_go_on_to_the_same_bytes(alone, tmp_path):
    """The real thing: python tools/kills.py does a hundred."""
    script, whole, _ = alone
    assert kills.series(script, tmp_path / "out", random.Random(1), most=4, longest=8.0) > 0
    assert kills.difference(tmp_path / "out", whole) == ""


def test_meshes_and_numbers_of_frames_go_on(film, tmp_path, monkeypatch):
    script, _ = film
    options = ["--mesh", "--start", 1001, "--export", "both"]
    assert run(script, tmp_path / "whole", *options) == 0
    with monkeypatch.context() as patch, pytest.raises(Killed):
        die_at(patch, 14)
        run(script, tmp_path / "out", *options, "--checkpoint", 2)
    assert run(script, tmp_path / "out", "--resume") == 0
    assert kills.difference(tmp_path / "out", tmp_path / "whole") == ""
    assert list_frames(tmp_path / "out") == list(range(1001, 1008))


def test_a_run_that_ended_is_extended(film, tmp_path):
    script, whole = film
    out = tmp_path / "out"
    assert run(script, out, "--frames", 2) == 0
    assert run(script, out, "--frames", FRAMES, "--resume") == 0
    assert kills.files_of(out) == kills.files_of(whole)
    assert run(script, out, "--resume") == 0  # there is nothing left to do
    assert kills.files_of(out) == kills.files_of(whole)


def one_line(capsys, *words):
    error = capsys.readouterr().err
    assert error.startswith("melp-warp: error: ")
    assert error.count("\n") == 1
    for word in words:
        assert word in error


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "e_count=220"], ["e_count is 200 there, 220 here", "--branch"]),
        (["--frames", 3], ["frames must be at least 6"]),
        (["--export", "both"], ["--export must be None, as it was"]),
        (["--start", 7], ["--start must be 0, as it was"]),
        (["--no-budget"], ["--no-budget must be True, as it was"]),
    ],
)
def test_what_differs_is_said(film, options, words, capsys):
    script, out = film
    before = kills.files_of(out)
    assert run(script, out, "--resume", *options) == 2
    one_line(capsys, *words)
    assert kills.files_of(out) == before


def test_another_scene_of_the_same_name_is_refused(film, tmp_path, capsys):
    script, out = film
    other = tmp_path / "film.py"
    other.write_text(script.read_text().replace('air="added_mass"', 'air="added_mass", drag=0.01'))
    assert run(other, out, "--resume") == 2
    one_line(capsys, "is of another scene", "surroundings.drag is", "there, 0.01 here")


def test_a_branch_starts_from_a_checkpoint_with_other_numbers(film, tmp_path, capsys):
    script, out = film
    before = kills.files_of(out)
    branch = tmp_path / "branch"
    assert run(script, branch, "--branch", out, "--frames", 8, "--dt", 0.004) == 0
    assert list_frames(branch) == [6, 7, 8]
    assert check_cache(branch) == []
    assert kills.files_of(out) == before
    log = kills.log_of(branch)
    assert log[0]["time"] == kills.log_of(out)[-1]["time"]
    assert log[-1]["substeps"] == 5
    assert run(script, tmp_path / "other", "--branch", out, "--set", "e_count=220") == 2
    one_line(capsys, "cannot change during a run", "e_count is 200 there, 220 here")
    assert not (tmp_path / "other").exists()


def test_a_branch_may_burst_in_slow_motion_and_goes_on_itself(tmp_path, capsys):
    """Punctured after the checkpoint, slowed down from it on; ended early and resumed it comes to the same bytes."""
    out, branch, again = (tmp_path / name for name in ("out", "branch", "again"))
    small = ["--set", "e_count=200", "l_per_e=2"]
    assert run("oscillating_bubble", out, "--frames", 2, *small) == 0
    line = kills.log_of(out)[-1]
    tempo = ["--set", f"slow_from={line['time']}", "slow_motion=20", "--puncture", f"0,0.03,0,{line['time']}"]
    assert run("oscillating_bubble", branch, "--branch", out, "--frames", 8, *tempo) == 0
    assert check_cache(branch) == []
    log = kills.log_of(branch)
    assert max(one["rims"] for one in log) == 1
    assert log[1]["time"] - log[0]["time"] == pytest.approx(0.05 * line["time"] / 2.0, rel=1e-3)
    assert run("oscillating_bubble", again, "--branch", out, "--frames", 6, *tempo) == 0
    assert run("oscillating_bubble", again, "--resume", "--frames", 8) == 0
    last = "frames/film.000008.usdc"
    assert kills.files_of(again)[last] == kills.files_of(branch)[last]
    late = ["--set", "slow_from=0.0001", "slow_motion=2"]
    assert run("oscillating_bubble", tmp_path / "late", "--branch", out, "--frames", 4, *late) == 2
    one_line(capsys, "slow_from must be at least")


def test_a_folder_without_a_checkpoint(film, tmp_path, capsys):
    assert run(film[0], tmp_path / "none", "--resume") == 2
    one_line(capsys, "holds no checkpoint to go on from")


def test_two_checkpoints_are_kept(film, tmp_path, capsys):
    """Where the newest is damaged the run goes on from the one before; where both are it says so."""
    script, whole = film
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    newest = out / "checkpoint.npz"
    data = bytearray(newest.read_bytes())
    data[len(data) // 2] ^= 1
    newest.write_bytes(data)
    assert run(script, out, "--resume") == 0
    assert kills.difference(out, whole) == ""
    for path in out.glob("*.npz"):
        path.write_bytes(path.read_bytes()[:1000])
    assert run(script, out, "--resume") == 2
    one_line(capsys, "checkpoint.npz cannot be read", "checkpoint.old.npz cannot be read")


def test_frames_that_are_missing_are_said(film, tmp_path, capsys):
    script, whole = film
    shutil.copytree(whole, tmp_path / "out")
    (tmp_path / "out" / "frames" / "film.000003.usdc").unlink()
    assert run(script, tmp_path / "out", "--resume") == 2
    one_line(capsys, "all frames up to 6, the checkpoint's")


def test_overwrite_removes_a_run_and_nothing_else(film, tmp_path, capsys):
    script, whole = film
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    assert run(script, out) == 2
    one_line(capsys, "a new or empty folder")
    (out / "notes.txt").write_text("mine")
    assert run(script, out, "--overwrite") == 2
    one_line(capsys, "a folder that holds a run and nothing else", "notes.txt")
    (out / "notes.txt").unlink()
    for left in (".film.000003.ab_c1def.tmp.usdc", ".film.000003.lko5_w4g.tmp.zOSPg5"):  # ours, and USD's own
        (out / "frames" / left).write_text("")
    assert run(script, out, "--overwrite", "--frames", 2) == 0
    assert len(list((out / "frames").iterdir())) == 3
    assert list_frames(out) == [0, 1, 2]
    assert check_cache(out) == []


def test_a_failed_first_frame_does_not_block_the_folder(film, tmp_path, monkeypatch):
    script, _ = film
    out = tmp_path / "out"
    with monkeypatch.context() as patch, pytest.raises(Killed):
        die_at(patch, 2)
        run(script, out)
    assert run(script, out, "--frames", 1) == 0
    assert check_cache(out) == []


def test_a_deleted_folder_stops_the_run(film, tmp_path, monkeypatch, capsys):
    advance = Simulation.advance_frame

    def deleting(self):
        if self.frame == 2:
            shutil.rmtree(tmp_path / "out")
        advance(self)

    monkeypatch.setattr(Simulation, "advance_frame", deleting)
    assert run(film[0], tmp_path / "out") == 2
    one_line(capsys, "No such file or directory")
    assert not (tmp_path / "out").exists()


def test_a_full_disk_leaves_no_half_line_and_no_temporary(film, tmp_path, monkeypatch, capsys):
    """What the log takes of a line is taken back; once there is room again the run goes on to the same bytes."""
    script, whole = film
    out = tmp_path / "out"
    lines = []

    class Full:
        """A log on a disk that has room for half of the fourth line."""

        def __init__(self, file):
            self.file = file

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.file.close()

        def __getattr__(self, name):
            return getattr(self.file, name)

        def write(self, data):
            lines.append(1)
            if len(lines) == 4:
                return self.file.write(data[: len(data) // 2])
            if len(lines) > 4:
                raise OSError(28, "No space left on device")
            return self.file.write(data)

    opened = Path.open
    with monkeypatch.context() as patch:
        patch.setattr(
            Path,
            "open",
            lambda path, *a, **k: Full(opened(path, *a, **k)) if path.name == "run.jsonl" else opened(path, *a, **k),
        )
        assert run(script, out) == 2
    one_line(capsys, "cannot write", "run.jsonl", "No space left on device")
    assert len((out / "run.jsonl").read_text().splitlines()) == 3
    assert (out / "run.jsonl").read_text().endswith("\n")
    assert not [p for p in out.rglob("*") if ".tmp" in p.name]
    assert run(script, out, "--resume") == 0
    assert kills.difference(out, whole) == ""


# --- signals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)])
def test_signals_end_like_ctrl_c(number, tmp_path):
    """A process that gets one leaves a sound cache and a checkpoint, says so and exits with 128 + its number."""
    out = tmp_path / "out"
    (tmp_path / "film.py").write_text(kills.SCENES["film"])
    process = kills.start(tmp_path / "film.py", out, ("--frames", "100000", "--checkpoint", "0"), None)
    deadline = time.monotonic() + 120.0
    while len(list_frames(out)) < 3 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(number)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    frames = list_frames(out)
    assert error.splitlines()[-1] == (
        f"melp-warp: interrupted: {out} holds {len(frames)} frames, 0 to {frames[-1]}; --resume goes on"
    )
    assert not [p for p in out.rglob("*") if ".tmp" in p.name]
    assert check_cache(out) == []
    assert resume.find_start(out).frame == frames[-1]


def test_an_ignored_signal_stays_ignored():
    """As in a script that starts a run with `&`, or by nohup."""
    code = """
import os, signal
from melp_warp.device.interrupt import end_like_ctrl_c, finish_first, let_through
for number in (signal.SIGINT, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
with end_like_ctrl_c(), finish_first():
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGHUP)
    let_through()
print("here")
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert found.stdout == "here\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_held_signals_come_through(number):
    before = signal.signal(number, signal.SIG_DFL)  # a shell may have had them ignored
    try:
        with end_like_ctrl_c():
            with pytest.raises(KeyboardInterrupt) as caught, finish_first():
                signal.raise_signal(number)
                let_through()
            assert caught.value.number == number
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)


@pytest.mark.parametrize(
    ("text", "seconds", "frames"), [("20", 0.0, 20), ("30s", 30.0, 0), ("1.5min", 90.0, 0), ("0", 0, 0)]
)
def test_when_checkpoints_are_due(text, seconds, frames):
    every = Every.parse(text)
    assert (every.seconds, every.frames) == (seconds, frames)
    assert every.due(1e9, 1_000_000) == (text != "0")
    assert not every.due(0.9 * seconds, frames - 1)


@pytest.mark.parametrize("text", ["", "-1", "1.5", "5 min", "5h", "nan", "1e3"])
def test_when_no_checkpoint_is_due(text, film, tmp_path, capsys):
    assert run(film[0], tmp_path / "out", f"--checkpoint={text}") == 2
    one_line(capsys, '--checkpoint must be a number of frames or a time as "30s" or "5min"')


def test_what_a_checkpoint_says_of_its_run_is_checked(film, tmp_path):
    header = json.loads((film[1] / "run.jsonl").read_text().splitlines()[-1])
    good = {
        "scene": "film",
        "parameters": {},
        "options": {name: {str: ""}.get(kind, False) for name, kind in resume.OPTIONS.items()}
        | {"export": None, "triangles": None, "first": 0},
        "frame": 6,
        "line": header,
        "empty_from": None,
    }
    assert resume.Start.of(tmp_path / "c.npz", good).written
    for change in (
        {"frame": "6"},
        {"options": {}},
        {"line": 3},
        {"extra": 1},
        {"frame": -1},
        {"line": {"a": math.nan}},
    ):
        with pytest.raises(InputError, match="npz"):
            resume.Start.of(tmp_path / "c.npz", good | change)
    with pytest.raises(InputError, match="was not written by a run"):
        resume.Start.of(tmp_path / "c.npz", 7)
