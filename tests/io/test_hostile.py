"""Caches from elsewhere: `check`, `measure`, `preview` and `mesh` end with one line, whatever is in the folder.

No traceback, no hang, no crash, nothing written outside of the folder. What is garbled does not pass `check`.
"""

import json
import os
import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Vt

from melp_warp import cli
from melp_warp.frame import ParticleFrame
from melp_warp.usd import apart
from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.schema import frame_path

FRAMES = 2


def sphere(count, centre, region, first):
    golden = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    y = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    side = np.sqrt(1.0 - y * y)
    normals = np.stack([side * np.cos(golden), y, side * np.sin(golden)], axis=1)
    return 0.05 * normals + centre, normals, np.full(count, region), np.arange(first, first + count)


def two_spheres(count=60):
    parts = [sphere(count, [0.0, 0.0, 0.0], 0, 0), sphere(count, [0.11, 0.0, 0.0], 1, count)]
    points, normals, region, ids = (np.concatenate(column) for column in zip(*parts, strict=True))
    n = len(ids)
    return ParticleFrame(
        points=points.astype(np.float32),
        velocities=np.zeros((n, 3), np.float32),
        ids=ids.astype(np.int64),
        widths=np.full(n, np.sqrt(16.0 * 0.05**2 / count), np.float32),
        normals=normals.astype(np.float32),
        thickness=np.full(n, 400.0, np.float32),
        region=region.astype(np.int32),
        black_film=np.zeros(n, np.int32),
    )


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A cache of two bubbles with a log."""
    folder = tmp_path_factory.mktemp("sound") / "cache"
    writer = CacheWriter(folder, 24.0, {"scene": "test", "seed": 1}, ("Film", "FilmE"), packed=("Film",))
    with (folder / "run.jsonl").open("w") as log:
        for number in range(FRAMES):
            sums = writer.write(number, {"Film": two_spheres(), "FilmE": two_spheres(40)})
            log.write(json.dumps({"frame": number, "sha256": sums}) + "\n")
    return folder


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(apart, "PATIENCE", 8.0)


# --- what is done to it ----------------------------------------------------------------------------------------------


def files_of(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())


def garble(folder, rng):
    """Change the bytes of a file; True, as no such cache may pass, unless it is the log."""
    path = rng.choice(files_of(folder))
    data = before = path.read_bytes()
    kind = rng.randrange(5)
    at = rng.randrange(max(1, len(data) - 8))
    if kind == 0:
        data = data[:at]
    elif kind == 1:
        data = data[:at] + rng.choice([b"\xff", b"\0", b"\x80"]) * 8 + data[at + 8 :]
    elif kind == 2:
        number = rng.choice([2**31 - 1, 2**40, 2**63 - 1, 10**9])
        data = data[:at] + number.to_bytes(8, "little") + data[at + 8 :]
    else:
        changed = bytearray(data)
        for _ in range(rng.choice([1, 8, 64])):
            place, byte = rng.randrange(len(data)), rng.randrange(256)
            changed[place] = byte
        data = bytes(changed)
    path.write_bytes(data)
    return data != before and path.name != "run.jsonl"


NUMBERS = ("1e7", "-1", "1e-7", "999999", "nan", "inf", "1e308", '"text"', "[1, 2]", "0", "")


def text(folder, rng):
    """Put something else in place of a number or a word of the root."""
    path = folder / rng.choice(["film.usda", "film.usda", "film.manifest.usda"])
    source = path.read_text()
    words = list(re.finditer(r"(?<== )[^\n]+", source))
    word = rng.choice(words)
    path.write_text(source[: word.start()] + rng.choice(NUMBERS) + source[word.end() :])


def root(*changes):
    def change(folder, rng):
        path = folder / "film.usda"
        source = path.read_bytes()
        for old, new in changes:
            source = re.sub(old, new, source)
        path.write_bytes(source)

    return change


def layer(change_layer):
    def change(folder, rng):
        path = frame_path(folder, rng.randrange(FRAMES))
        opened = Sdf.Layer.OpenAsAnonymous(str(path))
        time = float(path.stem.split(".")[1])
        change_layer(opened, f"/World/{rng.choice(['Film', 'FilmE'])}", time, rng)
        opened.Export(str(path))

    return change


def spoil_sample(opened, prim, time, rng):
    """An array with a number that cannot be, or too short."""
    names = ["points", "velocities", "ids", "widths", "normals", "primvars:thickness", "primvars:region"]
    names += [f"primvars:{name}{rows}" for name in ("normals", "displayColor") for rows in ("", ":indices")]
    name = rng.choice([name for name in names if opened.GetAttributeAtPath(f"{prim}.{name}")])
    value = opened.QueryTimeSample(f"{prim}.{name}", time)
    array = np.array(value)
    if rng.random() < 0.3:
        array = array[: rng.randrange(len(array))]
    else:
        most = rng.choice([1, len(array)])
        wrong = [np.nan, np.inf, 3e38, -1e30, 0.0] if array.dtype.kind == "f" else [-1, 2**31 - 1, -(2**31), 70_000]
        array[:most] = rng.choice(wrong)
    opened.SetTimeSample(f"{prim}.{name}", time, type(value).FromNumpy(np.ascontiguousarray(array)))


def retype(opened, prim, time, rng):
    name = rng.choice(["points", "widths", "ids", "primvars:region", "primvars:displayColor", "extent"])
    spec = opened.GetAttributeAtPath(f"{prim}.{name}")
    owner = spec.owner
    owner.RemoveProperty(spec)
    kind = rng.choice(["string[]", "asset[]", "token", "matrix4d[]", "double", "bool[]"])
    Sdf.AttributeSpec(owner, name, Sdf.ValueTypeNames.Find(kind))
    values = {
        "string[]": Vt.StringArray(["a", "b"]),
        "asset[]": Sdf.AssetPathArray([Sdf.AssetPath("/dev/zero")]),
        "token": "x",
        "matrix4d[]": Vt.Matrix4dArray(3),
        "double": 1e300,
        "bool[]": Vt.BoolArray([True]),
    }
    opened.SetTimeSample(f"{prim}.{name}", time, values[kind])


def block(opened, prim, time, rng):
    opened.SetTimeSample(f"{prim}.{rng.choice(['points', 'ids', 'extent'])}", time, Sdf.ValueBlock())


def on_one_point(opened, prim, time, rng):
    value = opened.QueryTimeSample(f"{prim}.points", time)
    opened.SetTimeSample(f"{prim}.points", time, Vt.Vec3fArray(len(value)))


def wide(opened, prim, time, rng):
    count = len(opened.QueryTimeSample(f"{prim}.widths", time))
    opened.SetTimeSample(f"{prim}.widths", time, Vt.FloatArray([rng.choice([1e-30, 1e8])] * count))


def many_samples(opened, prim, time, rng):
    for k in range(2000):
        opened.SetTimeSample(f"{prim}.ids", time + k / 4096.0, Vt.Int64Array(1))


def log(*lines):
    def change(folder, rng):
        (folder / "run.jsonl").write_bytes(b"".join(lines))

    return change


def link(name):
    """A link out of the folder where something may be written."""

    def change(folder, rng):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(folder.parent / "outside" / "victim")

    return change


def pipe(name):
    """A pipe, which nobody writes into, in place of a file."""

    def change(folder, rng):
        (folder / name).unlink(missing_ok=True)
        os.mkfifo(folder / name)

    return change


def file_for_folder(folder, rng):
    shutil.rmtree(folder / "frames")
    (folder / "frames").write_text("x")


CHANGES = {
    "one point": layer(on_one_point),
    "widths": layer(wide),
    "many samples": layer(many_samples),
    "value blocks": layer(block),
    "template end": root((rb"templateEndTime = \S+", b"templateEndTime = 1e7")),
    "template end and range": root(
        (rb"templateEndTime = \S+", b"templateEndTime = 999999"), (rb"endTimeCode = \S+", b"endTimeCode = 999999")
    ),
    "stride": root((rb"templateStride = \S+", b"templateStride = 1e-7")),
    "endless range": root((rb"endTimeCode = \S+", b"endTimeCode = inf")),
    "not UTF-8": root((rb'"test"', b'"t\xff\xfest"')),
    "name not UTF-8": root((rb'Points "Film"', b'Points "F\xffilm"')),
    "deep": root((rb'def Xform "World"', b'def "A" { ' * 100_000)),
    "long": root((rb"\Z", b"# " + b"x" * 5_000_000)),
    "sublayer": root((rb"#usda 1.0\n\(", b"#usda 1.0\n(\n    subLayers = [@/dev/zero@]")),
    "payload": root((rb'def Points "Film" ', b'def Points "Film" (payload = @../outside/victim@) ')),
    "metadata is text": root((rb"dictionary melpWarp = \{", b'string melpWarp = "x"\n dictionary other = {')),
    "many prims": root(
        (rb'def Points "Film"', b"".join(b'def Points "P%d" {}\n' % k for k in range(3000)) + b'def Points "Film"')
    ),
    "log of NaN": log(b'{"frame": NaN}\n'),
    "log is deep": log(b"[" * 100_000 + b"\n"),
    "log of another file": log(b'{"frame": 0, "sha256": {"../outside/victim": "0"}}\n'),
    "log not UTF-8": log(b'{"frame": 0, "\xff": 1}\n'),
    "log of other frames": log(b'{"frame": 0}\n{"frame": 0}\n'),
    "log is long": log(b"1" * 5_000_000),
    "pipe for the root": pipe("film.usda"),
    "pipe for a frame": pipe("frames/film.000001.usdc"),
    "pipe for the log": pipe("run.jsonl"),
    "file for a folder": file_for_folder,
}
LINKS = ("preview.png", "preview.png.tmp", ".preview.tmp.png", "found.json", "found.json.tmp", ".found.tmp.json")


def harm(folder, rng, seed):
    """Do something to a cache; whether `check` must find it."""
    names = list(CHANGES)
    if seed < len(names):
        CHANGES[names[seed]](folder, rng)
        return True
    kind = rng.randrange(8)
    if kind < 4:
        return garble(folder, rng)
    if kind == 4:
        text(folder, rng)
    elif kind == 5:
        layer(spoil_sample)(folder, rng)
    elif kind == 6:
        layer(retype)(folder, rng)
    else:
        link(rng.choice(LINKS))(folder, rng)
    return False


# --- what must come of it --------------------------------------------------------------------------------------------


def look_at(folder, seed, capfd):
    """Run `check` and one more command over a folder; the exit code of the first."""
    capfd.readouterr()
    code = cli.main(["check", str(folder)])
    told = capfd.readouterr()
    assert code in (0, 1, 2)
    assert (told.err == "") == (code < 2)
    assert len(told.out.splitlines()) < 2000 and len(told.out) < 1_000_000
    more = [
        ["measure", str(folder), "--json", str(folder / "found.json")],
        ["preview", str(folder), "--size", "16"],
        ["mesh", str(folder), "--triangles", "500", *(["--whole"] if seed % 6 == 5 else [])],
    ][seed % 3]
    code_of_more = cli.main(more)
    assert code_of_more in ((0, 1, 2) if more[0] == "mesh" else (0, 2))
    told = capfd.readouterr()
    assert len(told.err.splitlines()) <= 1 and len(told.out.splitlines()) < 2000
    if more[0] == "mesh" and code == code_of_more == 0:
        assert cli.main(["check", str(folder)]) == 0
    return code


@pytest.mark.parametrize("count", [60, pytest.param(3000, marks=pytest.mark.slow)])
def test_hostile_folders(sound, count, tmp_path, capfd):
    outside = tmp_path / "outside"
    outside.mkdir()
    passed = []
    for seed in range(count):
        folder = tmp_path / "cache"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(sound, folder)
        (outside / "victim").write_text("mine")
        must_fail = harm(folder, random.Random(seed), seed)
        code = look_at(folder, seed, capfd)
        if must_fail and code == 0:
            passed.append(seed)
        assert [path.name for path in outside.iterdir()] == ["victim"], seed
        assert (outside / "victim").read_text() == "mine", seed
        assert sorted(path.name for path in tmp_path.iterdir()) == ["cache", "outside"], seed
    assert passed == []


def test_a_sound_folder_passes(sound, tmp_path, capfd):
    assert look_at(sound, 0, capfd) == look_at(sound, 1, capfd) == 0
    for seed in (2, 5):
        assert look_at(shutil.copytree(sound, tmp_path / str(seed)), seed, capfd) == 0


@pytest.mark.parametrize("command", ["check", "measure", "preview", "mesh"])
def test_no_folder_is_bad_input(command, tmp_path, capfd):
    assert cli.main([command, str(tmp_path / "nope")]) == 2
    assert "DIR must be a folder that a run wrote" in capfd.readouterr().err


@pytest.mark.parametrize("command", ["check", "measure"])
def test_what_usd_hangs_or_dies_on_is_said(command, sound, monkeypatch, capfd):
    """As the other process is stopped after a while, and starts anew for the next question."""
    monkeypatch.setattr(apart, "PATIENCE", 0.0)
    monkeypatch.setattr(apart, "_ask", stopped(apart._ask))
    assert cli.main([command, str(sound)]) == (1 if command == "check" else 2)
    told = capfd.readouterr()
    assert "USD is not done with it after" in told.out + told.err
    monkeypatch.undo()
    assert cli.main([command, str(sound)]) == 0


def stopped(ask):
    """Ask a process that is asleep."""

    def sleeping(question, path):
        apart.stop()
        apart._reader = apart._Reader()
        os.kill(apart._reader.process.pid, 19)
        yield from ask(question, path)

    return sleeping


def test_paths_are_those_of_the_folder_to_work_in(sound, tmp_path, monkeypatch, capfd):
    """Also after it was changed."""
    for name in ("a", "b"):
        shutil.copytree(sound, tmp_path / name / "cache")
        monkeypatch.chdir(tmp_path / name)
        assert cli.main(["check", "cache"]) == 0
        shutil.rmtree(tmp_path / name / "cache")


def test_a_folder_to_work_in_is_not_imported_from(sound, tmp_path, monkeypatch, capfd):
    """A hostile folder may hold Python files named like modules."""
    monkeypatch.chdir(tmp_path)
    for name in ("json", "numpy", "melp_warp"):
        Path(f"{name}.py").write_text("raise SystemExit(9)")
    apart.stop()
    assert cli.main(["check", str(sound)]) == 0
