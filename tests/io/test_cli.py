"""The command line and the frame loop, with a stand-in for the solver that is quick and fails on demand."""

import json
import os
import signal
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import melp_warp
from melp_warp import cli
from melp_warp.errors import InputError, SimulationError
from melp_warp.frame import ParticleFrame
from melp_warp.preview.pictures import spread
from melp_warp.program import afterwards, runner
from melp_warp.stages.notices import Notices
from melp_warp.usd.check import check_cache
from melp_warp.usd.reading import read_frame, read_metadata
from melp_warp.usd.schema import list_frames

FEW = ["--set", "e_count=60", "l_per_e=2"]


class StandIn:
    """The solver's interface; particles stay where the shape puts them."""

    fail_at = interrupt_at = None
    doubts = types.MappingProxyType({})  # frame -> value of the notice "the rim leaks"

    def __init__(self, scene, device="cpu"):
        if device != "cpu":
            raise InputError(f"--device must be one of cpu, got {device!r}")
        self.scene, self.frame, self.has_l = scene, 0, scene.l_per_e > 0
        self.notices, self.unaccounted = Notices(), ""
        self.notices.end(0)

    @property
    def time(self):
        return self.frame / self.scene.fps

    def advance_frame(self):
        if self.frame + 1 == self.fail_at:
            raise SimulationError("surfactant: not finite at E particle 17")
        if self.frame + 1 == self.interrupt_at:
            raise KeyboardInterrupt
        self.frame += 1
        self.notices.begin()
        if self.frame in self.doubts:
            value = self.doubts[self.frame]
            self.notices.note("the rim leaks", value, f"{value} kg/s, none is right")
        self.notices.end(self.frame)

    def particles(self, which):
        samples = self.scene.shape.sample(self.scene.e_count * (self.scene.l_per_e if which == "l" else 1))
        n = len(samples.points)
        return ParticleFrame(
            samples.points.astype(np.float32),
            np.zeros((n, 3), np.float32),
            np.arange(n, dtype=np.int64),
            np.sqrt(4.0 / np.pi * samples.area).astype(np.float32),
            samples.normals.astype(np.float32),
            np.full(n, self.scene.material.thickness * 1e9, np.float32),
            np.zeros(n, np.int32),
            np.zeros(n, np.int32),
        )

    def diagnostics(self):
        result = {"time": self.time, "dt": 0.01, "substeps": 2, "volume": float("nan"), "momentum": np.zeros(3)}
        return {**result, "notices": dict(self.notices.of_frame)}

    def save_checkpoint(self, path, run=None):
        np.savez(path, frame=self.frame)

    def back(self):
        pass

    def conclude(self):
        pass


@pytest.fixture(autouse=True)
def solver(monkeypatch):
    """Put a fresh stand-in in the solver's place."""
    made = type("Solver", (StandIn,), {})
    monkeypatch.setattr(runner, "_simulation", lambda plan: made(plan.scene, plan.device))
    return made


def run(*arguments):
    return cli.main(["run", *map(str, arguments)])


def one_line(capsys, *words):
    """The error that was printed: one line that starts as all do and holds the words."""
    error = capsys.readouterr().err
    assert error.startswith("melp-warp: error: "), error
    assert error.count("\n") == 1 and error.endswith("\n")
    for word in words:
        assert word in error
    return error


def lines(folder):
    return [json.loads(line) for line in (folder / "run.jsonl").read_text().splitlines()]


# --- a run -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["giant_bubble", "oscillating_bubble", "drainage", "equilibrium", "taylor_vortices"])
def test_run_writes_a_sound_cache_and_a_line_a_frame(name, tmp_path, capsys):
    out = tmp_path / "cache"
    assert run(name, "--frames", 3, "--fps", 25, "--seed", 7, "--out", out, *FEW) == 0
    assert check_cache(out) == []
    assert list_frames(out) == [0, 1, 2, 3]
    log = lines(out)
    assert [line["frame"] for line in log] == [0, 1, 2, 3]
    assert log[3]["time"] == pytest.approx(3 / 25)
    assert log[0]["volume"] is None
    assert log[0]["momentum"] == [0.0, 0.0, 0.0]
    metadata = read_metadata(out)
    assert (metadata["scene"], metadata["seed"], metadata["parameters"]["e_count"]) == (name, 7, 60)
    assert metadata["framesPerSecond"] == 25
    told = capsys.readouterr()
    assert str(out / "film.usda") in told.out
    assert f"melp-warp preview {out}" in told.out


def test_default_folder_is_named_after_the_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("equilibrium", "--frames", 0, "--quiet", *FEW) == 0
    assert list_frames("out/equilibrium") == [0]


def test_quiet_prints_nothing(tmp_path, capfd):
    assert run("equilibrium", "--frames", 2, "--quiet", "--out", tmp_path / "q", *FEW) == 0
    assert capfd.readouterr() == ("", "")


def test_progress_goes_to_stderr(tmp_path, capfd):
    assert run("equilibrium", "--frames", 2, "--out", tmp_path / "q", *FEW) == 0
    told = capfd.readouterr()
    assert "2/2" in told.err
    assert "steps/s" in told.err
    assert "steps/s" not in told.out
    (bar,) = told.err.splitlines()  # without a terminal one line, which ends
    assert told.err == f"{bar}\n"


@pytest.mark.parametrize(
    ("export", "counts"),
    [
        (None, {"Film": 120}),
        ("l", {"Film": 120}),
        ("e", {"Film": 60, "FilmE": 60}),
        ("both", {"Film": 120, "FilmE": 60}),
    ],
)
def test_export(export, counts, tmp_path):
    out = tmp_path / "cache"
    options = ["--export", export] if export else []
    assert run("giant_bubble", "--frames", 1, "--quiet", "--out", out, *options, *FEW) == 0
    assert read_metadata(out)["prims"] == list(counts)
    for prim, count in counts.items():
        assert len(read_frame(out, 1, prim).ids) == count
    assert check_cache(out) == []


def test_export_of_a_scene_without_l(tmp_path, capsys):
    common = ["oscillating_bubble", "--frames", 0, "--quiet", "--set", "e_count=60"]
    assert run(*common, "--out", tmp_path / "default") == 0
    assert len(read_frame(tmp_path / "default", 0).ids) == 60
    assert run(*common, "--out", tmp_path / "l", "--export", "l") == 2
    one_line(capsys, "--export must be e or both", "no L", "'l'")
    assert not (tmp_path / "l").exists()


def test_what_is_odd_is_said_before_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner, "run", lambda plan: 0)
    assert run("giant_bubble", "--set", "radius=10", "displacement=1") == 0
    assert capsys.readouterr().err.startswith("melp-warp: warning: radius=10: 10 m is unusual for the radius")
    assert run("giant_bubble", "--quiet", "--set", "radius=10", "displacement=1") == 0
    assert run("giant_bubble", "--dt", "2ms", "--set", "radius=10cm", "thickness=400nm") == 0
    assert capsys.readouterr().err == ""


def test_options_reach_the_scene(tmp_path, solver, monkeypatch):
    seen = []
    monkeypatch.setattr(runner, "run", lambda plan: seen.append(plan) or 0)
    assert run("giant_bubble", "--dt", "1e-3", "--set", "radius=0.2", "thickness=500e-9", "--set", "xsph=0.5") == 0
    assert run("giant_bubble", "--cfl", "0.5", "--device", "cuda:0", "--export", "both", "--preview") == 0
    first, second = seen
    assert (first.scene.dt, first.scene.shape.radius, first.scene.numerics.xsph) == (1e-3, 0.2, 0.5)
    assert (first.scene.material.thickness, first.export, first.out) == (500e-9, None, Path("out/giant_bubble"))
    assert (second.scene.dt, second.scene.numerics.cfl) == (None, 0.5)
    assert (second.device, second.export, second.preview) == ("cuda:0", "both", True)


def test_preview_draws_the_last_frame_and_a_contact_sheet(tmp_path, monkeypatch):
    monkeypatch.setattr(afterwards, "PREVIEW_SIZE", 48)
    monkeypatch.setattr(afterwards, "CONTACT_SIZE", 24)
    out = tmp_path / "cache"
    assert run("giant_bubble", "--frames", 12, "--preview", "--quiet", "--out", out, *FEW) == 0
    from PIL import Image

    with Image.open(out / "preview.png") as image:
        assert image.size == (48, 48)
        assert np.ptp(np.asarray(image)) > 20
    with Image.open(out / "contact.png") as image:
        assert image.size[0] == image.size[1] > 3 * 24
    assert check_cache(out) == []


def test_picked_frames_span_the_run():
    assert spread([0], 9) == [0]
    assert spread([0, 1, 2], 9) == [0, 1, 2]
    assert spread(list(range(301)), 9) == [0, 38, 75, 112, 150, 188, 225, 262, 300]


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["COMMAND"]),
        (["fly"], ["'fly'", "'run'", "'scenes'"]),
        (["run"], ["NAME|PATH.py"]),
        (["run", "giant_buble"], ["unknown scene 'giant_buble'", "did you mean giant_bubble", "drainage"]),
        (["run", "missing.py"], ["unknown scene 'missing.py'", "no such file"]),
        (["run", "drainage", "--device", "tpu"], ["device", "cpu", "'tpu'"]),
        (["run", "drainage", "--set", "radios=1"], ["unknown key 'radios'", "melp-warp scenes NAME"]),
        (["run", "drainage", "--set", "radius=1"], ["unknown key 'radius'"]),
        (["run", "drainage", "--set", "width"], ["--set must be key=value", "'width'"]),
        (["run", "drainage", "--set", "width=wide"], ["width must be a number from 0.0001 to 100 m", "'wide'"]),
        (["run", "drainage", "--set", "width=nan"], ["width must be", "nan"]),
        (["run", "giant_bubble", "--set", "radius=0"], ["radius must be", "from 0.0001", "got 0"]),
        (["run", "giant_bubble", "--set", "radius=-0.1"], ["radius must be", "from 0.0001", "-0.1"]),
        (["run", "giant_bubble", "--set", "thickness=-1e-9"], ["thickness must be", "from 1e-09", "got -1e-9"]),
        (["run", "giant_bubble", "--set", "thickness=0"], ["thickness must be", "from 1e-09", "got 0"]),
        (["run", "giant_bubble", "--set", "e_count=-3"], ["e_count must be a whole number from 1", "-3"]),
        (["run", "giant_bubble", "--set", "e_count=1.5"], ["e_count must be a whole number", "1.5"]),
        (["run", "giant_bubble", "--set", "displacement=9"], ["displacement must be", "every radius is above 0"]),
        (["run", "taylor_vortices", "--set", "separation=5"], ["separation must be below width = 4 m", "5.0"]),
        (["run", "giant_bubble", "--set", "surfactant=1e-4"], ["surfactant must be", "below tension/(R T)"]),
        (["run", "giant_bubble", "--frames", "many"], ["frames must be a whole number", "'many'"]),
        (["run", "giant_bubble", "--frames", "-1"], ["frames must be a whole number from 0 to 999999, got -1"]),
        (["run", "giant_bubble", "--frames", "-5"], ["frames must be a whole number from 0 to 999999, got -5"]),
        (
            ["run", "giant_bubble", "--frames", "1000000"],
            ["frames must be a whole number from 0 to 999999, got 1000000"],
        ),
        (["run", "giant_bubble", "--out", ""], ["--out", "it must not be empty"]),
        (["run", "giant_bubble", "--out", "/proc/foo"], ["--out must be a folder of a disk, got '/proc/foo'"]),
        (["run", "giant_bubble", "--fps", "0"], ["fps must be", "above 0"]),
        (["run", "giant_bubble", "--dt", "inf"], ["dt must be", "inf"]),
        (["run", "giant_bubble", "--cfl", "-1"], ["cfl must be", "0.01", "-1"]),
        (["run", "giant_bubble", "--dt", "1", "--cfl", "1"], ["--cfl", "not allowed with", "--dt"]),
        (["run", "giant_bubble", "--seed", "1", "--set", "seed=2"], ["seed must be given once"]),
        (["run", "giant_bubble", "--export", "all"], ["--export", "'all'", "'both'"]),
        (["run", "giant_bubble", "--bogus"], ["--bogus"]),
        (["scenes", "nowhere"], ["unknown scene 'nowhere'"]),
        (["preview", "nowhere"], ["DIR must be a folder that a run wrote", "'nowhere'"]),
        (["preview", "nowhere", "--frame", "x"], ["--frame", "'x'"]),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 2
    one_line(capsys, *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("held", ["film.usda", "run.jsonl", "frames", "notes.txt"])
def test_an_occupied_folder_is_left_alone(held, tmp_path, capsys):
    (tmp_path / held).write_text("mine")
    assert run("equilibrium", "--out", tmp_path, *FEW) == 2
    one_line(capsys, "--out must be a new or empty folder", str(tmp_path), held)
    assert [path.name for path in tmp_path.iterdir()] == [held]
    assert (tmp_path / held).read_text() == "mine"


def test_a_run_does_not_overwrite_a_run(tmp_path, capsys):
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 1, "--quiet", "--out", out, *FEW) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert run("equilibrium", "--frames", 2, "--quiet", "--out", out, *FEW) == 2
    one_line(capsys, str(out))
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_what_a_system_folder_is_refused_before(monkeypatch, capsys):
    """Before Warp is started, which took 13 s."""
    monkeypatch.setattr(runner, "begin_warp", lambda: pytest.fail("Warp was started"))
    assert run("giant_bubble", "--out", "/proc/foo") == 2
    one_line(capsys, "a folder of a disk")


def test_many_keys_do_not_bury_the_hint(capsys):
    """It was followed by 45 names."""
    assert run("giant_bubble", "--set", "radios=1") == 2
    error = capsys.readouterr().err
    assert "did you mean radius?" in error
    assert len(error) < 120


def test_an_empty_folder_is_taken(tmp_path):
    assert run("equilibrium", "--frames", 0, "--quiet", "--out", tmp_path, *FEW) == 0


def test_out_below_a_file(tmp_path, capsys):
    (tmp_path / "file").write_text("x")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert run("equilibrium", "--out", out, *FEW) == 2
        one_line(capsys, "--out must be", "is a file")


def test_out_that_cannot_be_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert run("equilibrium", "--out", tmp_path / "new", *FEW) == 2
    one_line(capsys, "--out must be writable", str(tmp_path))


def fill_disk(monkeypatch, files):
    """Let `files` more files be put in place, then refuse."""
    replace, left = os.replace, [files]

    def limited(*arguments, **options):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(28, "No space left on device")
        return replace(*arguments, **options)

    monkeypatch.setattr(os, "replace", limited)


def test_a_full_disk_keeps_the_frames_before(tmp_path, monkeypatch, capsys):
    fill_disk(monkeypatch, 1 + 2 * 3 + 1)  # the manifest, two files a frame, the first checkpoint
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", out, *FEW) == 2
    one_line(capsys, "No space left on device")
    assert list_frames(out) == [0, 1, 2]
    assert [line["frame"] for line in lines(out)] == [0, 1, 2]
    assert check_cache(out) == []


def test_a_full_disk_while_logging(tmp_path, monkeypatch, capsys):
    out, opened = tmp_path / "cache", Path.open

    def refuse(self, *arguments, **options):
        if self.name == "run.jsonl":
            raise OSError(28, "No space left on device")
        return opened(self, *arguments, **options)

    monkeypatch.setattr(Path, "open", refuse)
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", out, *FEW) == 2
    one_line(capsys, "cannot write", "run.jsonl", "No space left on device")


def test_a_failing_step_keeps_the_last_good_frame(tmp_path, solver, capsys):
    solver.fail_at = 3
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", out, *FEW) == 1
    one_line(capsys, "surfactant: not finite at E particle 17", "3 frames, 0 to 2", "checkpoint.npz")
    assert list_frames(out) == [0, 1, 2]
    assert check_cache(out) == []
    with np.load(out / "checkpoint.npz") as checkpoint:
        assert checkpoint["frame"] == 2


def test_a_notice_is_said_once_logged_and_repeated(tmp_path, solver, capsys):
    solver.doubts = {2: 0.5, 3: 0.75, 5: 0.25}
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 5, "--out", out, *FEW) == 0
    said = capsys.readouterr()
    assert said.err.count("melp-warp: notice: the rim leaks, frame 2: 0.5 kg/s, none is right") == 1
    assert said.err.count("notice:") == 1
    last = said.out.splitlines()[-1]
    assert last == "Noticed: the rim leaks in 3 of 6 frames, first in 2, worst in 3 (0.75)"
    logged = [json.loads(line)["notices"] for line in (out / "run.jsonl").read_text().splitlines()]
    assert logged == [{}, {}, {"the rim leaks": 0.5}, {"the rim leaks": 0.75}, {}, {"the rim leaks": 0.25}]


@pytest.mark.parametrize("doubts, code", [({}, 0), ({3: 1.0}, 1)])
def test_strict_fails_where_there_are_notices(doubts, code, tmp_path, solver, capfd):
    solver.doubts = doubts
    assert run("equilibrium", "--frames", 4, "--quiet", "--strict", "--out", tmp_path / "cache", *FEW) == code
    assert capfd.readouterr() == ("", "")
    assert list_frames(tmp_path / "cache") == [0, 1, 2, 3, 4]


def test_an_error_repeats_the_notices(tmp_path, solver, capsys):
    solver.doubts, solver.fail_at = {1: 2.0}, 3
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", tmp_path / "cache", *FEW) == 1
    one_line(capsys, "E particle 17", "noticed: the rim leaks in 1 of 3 frames")


def test_notices_keep_the_worst_of_a_frame_and_forget_one_done_again():
    notices = Notices()
    notices.note("late", 1.0, "1 s")
    notices.begin()
    notices.note("deep", 2.0, "2 m")
    notices.note("deep", 3.0, "3 m")
    notices.note("deep", 1.0, "1 m")
    notices.end(4)
    assert notices.of_frame == {"deep": 3.0}
    assert notices.fresh() == ["deep, frame 4: 3 m"] and notices.fresh() == []
    assert notices.summary() == "deep in 1 of 1 frames, first in 4, worst in 4 (3)"


def test_a_failing_step_on_a_full_disk(tmp_path, solver, monkeypatch, capsys):
    def refuse(self, path, run=None):
        raise OSError(28, "No space left on device")

    solver.fail_at, solver.save_checkpoint = 1, refuse
    assert run("equilibrium", "--quiet", "--out", tmp_path / "cache", *FEW) == 1
    one_line(capsys, "E particle 17", "1 frame, 0 to 0", "checkpoint.npz could not be written: No space left")


def test_a_frame_that_is_not_finite_is_not_written(tmp_path, solver, monkeypatch, capsys):
    def particles(self, which):
        frame = StandIn.particles(self, which)
        if self.frame == 2:
            frame.velocities[5] = np.nan
        return frame

    monkeypatch.setattr(solver, "particles", particles)
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", out, *FEW) == 1
    one_line(capsys, "Film.velocities is not finite at particle id 5", "2 frames, 0 to 1")
    assert check_cache(out) == []


# --- Ctrl-C ----------------------------------------------------------------------------------------------------------


def test_ctrl_c_leaves_a_valid_cache(tmp_path, solver, capsys):
    solver.interrupt_at = 4
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", out, *FEW) == 130
    assert capsys.readouterr().err == f"melp-warp: interrupted: {out} holds 4 frames, 0 to 3; --resume goes on\n"
    assert [line["frame"] for line in lines(out)] == list_frames(out) == [0, 1, 2, 3]
    assert check_cache(out) == []


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_while_a_frame_is_written_finishes_it(tmp_path, monkeypatch, capsys):
    replace, calls = os.replace, []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 5:
            os.kill(os.getpid(), signal.SIGINT)
        return replace(*arguments, **options)

    monkeypatch.setattr(os, "replace", interrupted)
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", out, *FEW) == 130
    assert "2 frames, 0 to 1" in capsys.readouterr().err
    assert [line["frame"] for line in lines(out)] == list_frames(out) == [0, 1]
    assert check_cache(out) == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_in_a_finalizer_is_not_lost(tmp_path, solver, capsys):
    """Python drops what is raised there: a run went on as if nothing had been pressed."""

    class Dropped:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def advance_frame(self):
        if self.frame == 2:
            Dropped()
        StandIn.advance_frame(self)

    solver.advance_frame = advance_frame
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 9, "--quiet", "--out", out, *FEW) == 130
    assert "4 frames, 0 to 3" in capsys.readouterr().err
    assert check_cache(out) == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_before_the_first_frame(tmp_path, monkeypatch, capsys):
    def interrupted(plan):
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "_simulation", interrupted)
    assert run("equilibrium", "--quiet", "--out", tmp_path / "cache", *FEW) == 130
    assert "no frame was written" in capsys.readouterr().err
    assert not (tmp_path / "cache").exists()


# --- scenes, check, preview ------------------------------------------------------------------------------------------


def test_scenes_lists_all(capsys):
    assert cli.main(["scenes"]) == 0
    listed = capsys.readouterr().out.splitlines()
    films = ["drainage", "equilibrium", "giant_bubble", "oscillating_bubble", "taylor_vortices"]
    films += ["deforming_rectangle_2m", "giant_bubble_vortices", "leapfrog", "stirred_disc", "turbulent_film"]
    films += ["burst_pair", "film_burst", "inflation"]
    foams = ["cluster", "double_bubble", "foam_mountain", "foam_pops", "four_bubbles", "quadruple_bubble"]
    foams += ["size_ratio", "triple_bubble"]
    assert [line.split()[0] for line in listed] == sorted(films + foams)


def test_scenes_name_is_a_table_of_keys(capsys):
    assert cli.main(["scenes", "drainage"]) == 0
    table = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert table["thickness"].split()[1:3] == ["4e-07", "m"]
    assert "reference thickness" in table["thickness"]
    assert "0.0001 to 100" in table["width"]
    assert "above 0" in table["density"]
    assert table["air"].endswith("none | added_mass")
    assert table["dt"].split()[1] == "auto"


def test_check_tells_a_sound_cache_from_a_broken_one(tmp_path, capsys):
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 2, "--quiet", "--out", out, *FEW) == 0
    assert cli.main(["check", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: no problem found\n"
    path = out / "frames" / "film.000001.usdc"
    path.write_bytes(path.read_bytes()[:100])
    assert cli.main(["check", str(out)]) == 1
    assert "film.000001.usdc" in capsys.readouterr().out


def test_preview_command(tmp_path, capsys):
    out, image = tmp_path / "cache", tmp_path / "one.png"
    assert run("oscillating_bubble", "--frames", 2, "--quiet", "--out", out, "--set", "e_count=60") == 0
    assert cli.main(["preview", str(out), "--frame", "1", "--out", str(image), "--size", "32"]) == 0
    assert capsys.readouterr().out == f"{image}\n"
    from PIL import Image

    with Image.open(image) as picture:
        assert picture.size == (32, 32)
    assert cli.main(["preview", str(out), "--frame", "7"]) == 2
    one_line(capsys, "--frame must be from 0 to 2, got 7")
    assert cli.main(["preview", str(out), "--size", "4"]) == 2
    one_line(capsys, "--size must be from 8 to 8192 pixels, got 4")
    assert cli.main(["preview", str(out), "--size", "32", "--out", str(tmp_path / "no" / "x.png")]) == 2
    one_line(capsys, "No such file or directory")


def test_preview_of_several_frames(tmp_path, capsys):
    out = tmp_path / "cache"
    assert run("giant_bubble", "--frames", 4, "--quiet", "--out", out, "--set", "e_count=60", "l_per_e=8") == 0
    preview = ["preview", str(out), "--size", "40x24"]
    assert cli.main([*preview, "--frames", ":3:2", "--out", str(tmp_path / "f.##.jpg"), "--orbit", "90"]) == 0
    names = [tmp_path / f"f.{n:02d}.jpg" for n in (0, 2)]
    assert capsys.readouterr().out.split() == [str(name) for name in names]
    from PIL import Image

    assert [Image.open(name).format for name in names] == ["JPEG", "JPEG"]
    first, second = (np.asarray(Image.open(name), int) for name in names)
    assert first.shape == (24, 40, 3)
    assert np.abs(first - second).max() > 20  # from another side
    movie = tmp_path / "film.gif"
    assert cli.main([*preview, "--movie", str(movie), "--background", "light", "--orbit", "90"]) == 0
    with Image.open(movie) as picture:
        assert (picture.n_frames, picture.size) == (5, (40, 24))
    assert cli.main([*preview, "--particles", "--out", str(tmp_path / "p.png")]) == 0


def test_preview_makes_a_video(tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out, movie = tmp_path / "cache", tmp_path / "film.mp4"
    assert run("giant_bubble", "--frames", 4, "--quiet", "--out", out, *FEW) == 0
    assert cli.main(["preview", str(out), "--size", "64x48", "--movie", str(movie), "--fps", "12"]) == 0
    assert imageio_ffmpeg.count_frames_and_secs(str(movie)) == (5, pytest.approx(5 / 12, abs=0.02))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--frames", "0:9"], "--frames must be from 0 to 2, got 9"),
        (["--frames", "0:1"], "--out must be a name with #"),
        (["--frames", "2:0"], "FIRST:LAST[:STEP]"),
        (["--frames", "x"], "argument --frames: must be A:B"),
        (["--frame", "1", "--frames", "0:1"], "--frames must be left out with --frame"),
        (["--size", "4x"], "--size must be from 8 to 8192"),
        (["--size", "axb"], "argument --size: must be N or WxH"),
        (["--from", "1,2"], "argument --from: must be three numbers"),
        (["--out", "film.tga"], "picture must be a file ending in .png"),
        (["--movie", "film.avi"], "--movie must be a file ending in .gif"),
        (["--movie", "film.gif", "--out", "x.png"], "--out must be left out with --movie"),
        (["--movie", "film.gif", "--fps", "0"], "--fps must be above 0"),
        (["--environment", "moon"], "environment must be"),
        (["--background", "puce"], "background must be"),
        (["--fov", "180"], "fov must be"),
        (["--orbit", "nan"], "--orbit must be"),
    ],
)
def test_bad_options_of_preview(options, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("giant_bubble", "--frames", 2, "--quiet", "--out", "cache", *FEW) == 0
    assert cli.main(["preview", "cache", *options]) == 2
    one_line(capsys, words)
    assert sorted(os.listdir()) == ["cache"]


def test_preview_says_nothing_else(tmp_path):
    out = tmp_path / "cache"
    assert run("equilibrium", "--frames", 0, "--quiet", "--out", out, *FEW) == 0
    done = process("-m", "melp_warp", "preview", out, "--size", "32")
    assert (done.stdout, done.stderr) == (f"{out}/preview.png\n", "")


# --- as processes ----------------------------------------------------------------------------------------------------


def process(*command, **options):
    return subprocess.run([sys.executable, *map(str, command)], capture_output=True, text=True, check=False, **options)


def test_version():
    done = process("-m", "melp_warp", "--version")
    assert (done.returncode, done.stdout) == (0, f"melp-warp {melp_warp.__version__}\n")


def test_listing_scenes_imports_nothing_heavy():
    code = "import sys; from melp_warp.cli import main; main(['scenes', 'drainage'])"
    done = process("-c", f"{code}; print([m for m in ('warp', 'pxr', 'PIL', 'rich') if m in sys.modules])")
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_closed_pipe_is_no_traceback():
    command = f"{sys.executable} -m melp_warp scenes drainage | head -n 1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout.startswith("drainage:")
    assert done.stderr == ""


def scripts():
    import melp_warp.scenes

    return sorted(path for path in Path(melp_warp.scenes.__path__[0]).glob("*.py") if path.stem != "__init__")


def test_scene_files_are_short():
    assert len(scripts()) == 21
    for path in scripts():
        assert len(path.read_text().splitlines()) < 100, path.name


@pytest.mark.parametrize("path", scripts(), ids=lambda path: path.stem)
def test_scene_files_run_as_scripts(path, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(runner, "run", lambda plan: seen.append(plan) or 0)
    monkeypatch.setattr(sys, "argv", [str(path), "--frames", "2", "--set", "e_count=50"])
    assert cli.run_file(str(path)) == 0
    assert (seen[0].name, seen[0].scene.frames, seen[0].scene.e_count) == (path.stem, 2, 50)
    assert "run_file(__file__)" in path.read_text()


def test_a_script_takes_the_same_options(tmp_path):
    done = process(scripts()[0], "--set", "thickness=-1", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("melp-warp: error: thickness must be")


def test_a_script_in_a_checkout_that_is_not_installed_says_so(tmp_path):
    done = process("-S", scripts()[0], cwd=tmp_path, env={**os.environ, "PYTHONPATH": numpy_alone(tmp_path)})
    assert done.returncode == 1
    assert "pip install -e ." in done.stderr
    assert "Traceback" not in done.stderr


def numpy_alone(folder):
    """A folder that holds NumPy and nothing else, to put on the path."""
    packages = folder / "packages"
    packages.mkdir()
    for name in ("numpy", "numpy.libs"):
        source = Path(np.__path__[0]).parent / name
        if source.exists():
            (packages / name).symlink_to(source)
    return str(packages)
