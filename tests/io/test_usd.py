"""The USD point cache: what is written, when it is valid, and that it reads back as it was."""

import contextlib
import dataclasses
import os
import re
import resource
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade

from melp_warp.errors import InputError, SimulationError
from melp_warp.frame import ParticleFrame
from melp_warp.optics import display_color
from melp_warp.usd import schema as usd
from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.check import check_cache
from melp_warp.usd.forms import flatten, write_look
from melp_warp.usd.reading import read_frame, read_metadata
from melp_warp.usd.schema import ATTRIBUTES, list_frames

FPS = 24.0
METADATA = {"scene": "test", "seed": 7}
COUNTS = (40, 55, 55, 0, 12)


def make_frame(count, seed=0, time=0.0):
    """A cloud on a sphere that moves with its velocities from time 0."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    velocities = rng.normal(scale=0.1, size=(count, 3))
    return ParticleFrame(
        points=(0.05 * normals + velocities * time).astype(np.float32),
        velocities=velocities.astype(np.float32),
        ids=np.cumsum(rng.integers(1, 2**40, count)),
        widths=rng.uniform(1e-3, 2e-3, count).astype(np.float32),
        normals=normals.astype(np.float32),
        thickness=rng.uniform(5, 1200, count).astype(np.float32),
        region=rng.integers(0, 9, count).astype(np.int32),
        black_film=rng.integers(0, 2, count).astype(np.int32),
    )


def write_run(folder, frames, prims=("Film",), first=0):
    writer = CacheWriter(folder, FPS, METADATA, prims)
    for number, frame in enumerate(frames, first):
        writer.write(number, dict.fromkeys(prims, frame))
    return writer


def assert_same(found, expected):
    assert found.carried == expected.carried == {}
    for field in dataclasses.fields(ParticleFrame)[:-1]:
        a, b = (np.asarray(getattr(frame, field.name)) for frame in (found, expected))
        assert a.dtype == b.dtype, field.name
        assert a.shape == b.shape, field.name
        assert a.tobytes() == b.tobytes(), field.name


@pytest.fixture
def frames():
    return [make_frame(count, seed=number) for number, count in enumerate(COUNTS)]


@pytest.fixture
def cache(tmp_path, frames):
    write_run(tmp_path / "run", frames)
    return tmp_path / "run"


# --- contents ------------------------------------------------------------------------------------------------------


def test_reads_back_bit_for_bit(cache, frames):
    assert list_frames(cache) == [0, 1, 2, 3, 4]
    for number, frame in enumerate(frames):
        assert_same(read_frame(cache, number), frame)


def test_odd_values_survive(tmp_path):
    frame = make_frame(4)
    frame.points[:] = [[-0.0, 1e-38, 1e-45], [3.4e38, -3.4e38, 0], [1, 2, 3], [0.1, 0.2, 0.3]]
    frame.ids[:] = [-(2**63), -1, 0, 2**63 - 1]
    frame.widths[:] = 0.0
    frame.region[:] = [0, 1, 2**31 - 1, 5]
    write_run(tmp_path / "run", [frame])
    assert_same(read_frame(tmp_path / "run", 0), frame)


def test_strided_arrays_are_written_by_value(tmp_path):
    """FromNumpy takes memory as it lies; a view must arrive as its values."""
    frame, wide = make_frame(9), make_frame(18)
    frame.points, frame.thickness = wide.points[::2], wide.thickness[::2]
    frame.velocities = np.asfortranarray(frame.velocities)
    write_run(tmp_path / "run", [frame])
    found = read_frame(tmp_path / "run", 0)
    np.testing.assert_array_equal(found.points, wide.points[::2])
    np.testing.assert_array_equal(found.thickness, wide.thickness[::2])
    np.testing.assert_array_equal(found.velocities, frame.velocities)


def test_a_frame_may_be_changed_after_it_was_written(tmp_path):
    frame = make_frame(9)
    expected = frame.points.copy()
    writer = write_run(tmp_path / "run", [frame])
    frame.points[:] = 5.0
    writer.write(1, {"Film": frame})
    np.testing.assert_array_equal(read_frame(tmp_path / "run", 0).points, expected)
    np.testing.assert_array_equal(read_frame(tmp_path / "run", 1).points, frame.points)


def test_every_attribute_arrives_through_the_clips(cache, frames):
    stage = Usd.Stage.Open(str(cache / "film.usda"))
    prim = stage.GetPrimAtPath("/World/Film")
    for attribute in ATTRIBUTES:
        found = prim.GetAttribute(attribute.name)
        assert str(found.GetTypeName()) == attribute.type_name
        assert found.GetTimeSamples() == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert found.GetResolveInfo(2.0).GetSource() == Usd.ResolveInfoSourceValueClips
        for number, frame in enumerate(frames):
            value = np.array(found.Get(float(number)))
            if attribute.field:
                np.testing.assert_array_equal(value, getattr(frame, attribute.field), err_msg=attribute.name)
            elif attribute.name == "primvars:displayColor":
                np.testing.assert_array_equal(value, display_color(frame.thickness))


def test_primvars_are_known_to_usd(cache):
    stage = Usd.Stage.Open(str(cache / "film.usda"))
    primvars = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/World/Film"))
    assert {
        p.GetPrimvarName(): p.GetInterpolation() for p in primvars.GetPrimvarsWithAuthoredValues()
    } == dict.fromkeys(("thickness", "region", "blackFilm", "displayColor"), "vertex")
    points = UsdGeom.Points.Get(stage, "/World/Film")
    assert points.GetWidthsInterpolation() == "vertex"
    assert points.GetNormalsInterpolation() == "vertex"


def test_extent_bounds_the_spheres(cache, frames):
    stage = Usd.Stage.Open(str(cache / "film.usda"))
    bounds = UsdGeom.BBoxCache(0.0, ["default"])
    for number, frame in enumerate(frames):
        bounds.SetTime(float(number))
        box = bounds.ComputeWorldBound(stage.GetPrimAtPath("/World")).ComputeAlignedRange()
        if not len(frame.points):
            assert box.IsEmpty()
            continue
        radius = frame.widths[:, None] / 2
        np.testing.assert_allclose(box.GetMin(), (frame.points - radius).min(axis=0), rtol=2e-7)
        np.testing.assert_allclose(box.GetMax(), (frame.points + radius).max(axis=0), rtol=2e-7)


def test_velocities_are_per_second(tmp_path):
    """USD's own motion blur moves a point from frame 0 to where it is in frame 1."""
    write_run(tmp_path / "run", [make_frame(30, time=number / FPS) for number in range(2)])
    stage = Usd.Stage.Open(str(tmp_path / "run" / "film.usda"))
    moved = UsdGeom.Points.Get(stage, "/World/Film").ComputePointsAtTime(1.0, 0.0)
    still = UsdGeom.Points.Get(stage, "/World/Film").ComputePointsAtTime(0.0, 0.0)
    expected = read_frame(tmp_path / "run", 1).points
    np.testing.assert_allclose(np.array(moved), expected, rtol=0, atol=1e-8)
    assert np.abs(np.array(still) - expected).max() > 1e-3


def test_units_and_range_of_every_layer(cache):
    paths = [cache / "film.usda", *(usd.frame_path(cache, n) for n in range(5))]
    for number, path in enumerate(paths, -1):
        stage = Usd.Stage.Open(str(path))
        assert UsdGeom.GetStageUpAxis(stage) == "Y"
        assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
        assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == FPS
        assert stage.GetDefaultPrim().GetPath() == "/World"
        assert Usd.ModelAPI(stage.GetDefaultPrim()).GetKind() == "component"
        expected = (0.0, 4.0) if number < 0 else (number, number)
        assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == expected


def test_root_has_no_values_of_its_own(cache):
    root = Sdf.Layer.OpenAsAnonymous(str(cache / "film.usda"))
    for attribute in root.GetPrimAtPath("/World/Film").attributes:
        assert attribute.default is None
        assert root.GetNumTimeSamplesForPath(attribute.path) == 0


def test_preview_material_shows_the_display_color(cache):
    stage = Usd.Stage.Open(str(cache / "film.usda"))
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/World/Film")).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    assert surface.GetShaderId() == "UsdPreviewSurface"
    (source,), _ = surface.GetInput("diffuseColor").GetConnectedSources()
    reader = UsdShade.Shader(source.source.GetPrim())
    assert reader.GetShaderId() == "UsdPrimvarReader_float3"
    assert reader.GetInput("varname").Get() == "displayColor"


def test_metadata(tmp_path):
    metadata = {"scene": "foam", "seed": 2**40, "parameters": {"radius": 0.05, "air": "none", "on": True}}
    writer = CacheWriter(tmp_path / "run", 29.97, metadata, gain=5.0, index=1.4)
    writer.write(3, {"Film": make_frame(3)})
    found = read_metadata(tmp_path / "run")
    versions = found.pop("versions")
    assert set(versions) == {"melpWarp", "warp", "numpy", "usd"}
    assert versions["usd"] == ".".join(map(str, Usd.GetVersion()))
    assert found == metadata | {
        "schemaVersion": usd.SCHEMA_VERSION,
        "thicknessUnit": "nm",
        "refractiveIndex": 1.4,
        "colorGain": 5.0,
        "framesPerSecond": 29.97,
        "startTimeCode": 3.0,
        "endTimeCode": 3.0,
        "prims": ["Film"],
    }
    stage = Usd.Stage.Open(str(tmp_path / "run" / "film.usda"))
    color = np.array(stage.GetAttributeAtPath("/World/Film.primvars:displayColor").Get(3.0))
    np.testing.assert_array_equal(color, display_color(make_frame(3).thickness, 5.0, 1.4))
    assert check_cache(tmp_path / "run") == []


def test_a_second_particle_set(tmp_path):
    shown, mesh = make_frame(20, seed=1), make_frame(8, seed=2)
    writer = CacheWriter(tmp_path / "run", FPS, METADATA, ("Film", "FilmE"))
    writer.write(0, {"FilmE": mesh, "Film": shown})
    assert_same(read_frame(tmp_path / "run", 0), shown)
    assert_same(read_frame(tmp_path / "run", 0, "FilmE"), mesh)
    stage = Usd.Stage.Open(str(tmp_path / "run" / "film.usda"))
    purposes = [UsdGeom.Imageable.Get(stage, f"/World/{name}").ComputePurpose() for name in ("Film", "FilmE")]
    assert purposes == ["default", "guide"]
    assert check_cache(tmp_path / "run") == []


def test_the_root_opens_no_clip(cache):
    """With the manifest, USD need not touch the frames to list attributes and time samples' names."""
    for number in list_frames(cache):
        usd.frame_path(cache, number).write_bytes(b"not a crate file")
    stage = Usd.Stage.Open(str(cache / "film.usda"))
    names = {a.GetName() for a in stage.GetPrimAtPath("/World/Film").GetAttributes() if a.IsAuthored()}
    assert names == {attribute.name for attribute in ATTRIBUTES}


# --- safety --------------------------------------------------------------------------------------------------------


def test_valid_after_every_frame(tmp_path, frames):
    writer = CacheWriter(tmp_path / "run", FPS, METADATA)
    for number, frame in enumerate(frames):
        writer.write(number, {"Film": frame})
        assert check_cache(tmp_path / "run") == []
        assert read_metadata(tmp_path / "run")["endTimeCode"] == number


def test_a_killed_process_leaves_a_valid_cache(tmp_path):
    """SIGKILL while frames are being written: the frames that the root names are whole."""
    program = textwrap.dedent(f"""
        import sys
        sys.path.insert(0, {str(os.path.dirname(__file__))!r})
        from test_usd import *
        writer = CacheWriter(sys.argv[1], FPS, METADATA)
        frame = make_frame(20000)
        for number in range(100000):
            writer.write(number, dict(Film=frame))
            print(number, flush=True)
        """)
    folder = tmp_path / "run"
    process = subprocess.Popen([sys.executable, "-c", program, str(folder)], stdout=subprocess.PIPE, text=True)
    for _ in range(5):
        last = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    problems = [line for line in check_cache(folder) if "left over" not in line]
    assert problems == []
    assert read_metadata(folder)["endTimeCode"] >= last == 4
    assert_same(read_frame(folder, last), make_frame(20000))


def test_what_a_killed_write_leaves_does_no_harm(tmp_path, frames, monkeypatch):
    """Part of a frame under the temporary name: the cache opens, the checker names the file."""
    writer = write_run(tmp_path / "run", frames[:2])

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(os, "replace", stop)
        patch.setattr(Path, "unlink", lambda *_, **__: None)
        writer.write(2, {"Film": frames[2]})
    (left,) = set(os.listdir(tmp_path / "run" / "frames")) - {"film.000000.usdc", "film.000001.usdc"}
    path = tmp_path / "run" / "frames" / left
    path.write_bytes(path.read_bytes()[:100])
    (problem,) = check_cache(tmp_path / "run")
    assert problem.startswith(f"frames/{left}: left over from a write")


def test_open_stages_do_not_make_results_stale(tmp_path, frames):
    """USD shares open layers within a process; checking and flattening see the disk all the same."""
    writer = write_run(tmp_path / "run", frames[:2])
    stages = [Usd.Stage.Open(str(tmp_path / "run" / "film.usda"))]
    writer.write(2, {"Film": frames[2]})
    assert stages[0].GetEndTimeCode() == 1.0
    flat = Sdf.Layer.OpenAsAnonymous(str(flatten(tmp_path / "run", tmp_path / "flat.usdc")))
    assert flat.ListTimeSamplesForPath("/World/Film.points") == [0.0, 1.0, 2.0]
    writer.write(3, {"Film": frames[3]})
    assert check_cache(tmp_path / "run") == []


@pytest.mark.parametrize("failing", ["frame", "root"])
def test_killed_between_frame_and_root(tmp_path, frames, monkeypatch, failing):
    """Stopped just before a rename: no part of the frame counts, everything before does."""
    writer = write_run(tmp_path / "run", frames[:2])
    replace = os.replace

    def stop(source, target):
        if ("frames" in str(target)) == (failing == "frame"):
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr(os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        writer.write(2, {"Film": frames[2]})
    assert check_cache(tmp_path / "run") == []
    assert read_metadata(tmp_path / "run")["endTimeCode"] == 1
    monkeypatch.undo()
    writer.write(2, {"Film": frames[2]})
    assert check_cache(tmp_path / "run") == []
    assert read_metadata(tmp_path / "run")["endTimeCode"] == 2


@contextlib.contextmanager
def file_size_limit(size):
    """The system refuses to write files beyond `size`, as on a full disk (the error is EFBIG, not ENOSPC)."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_full_disk(tmp_path):
    writer = write_run(tmp_path / "run", [make_frame(100)])
    path = usd.frame_path(tmp_path / "run", 1)
    with file_size_limit(50_000), pytest.raises(InputError) as error:
        writer.write(1, {"Film": make_frame(20_000)})
    assert str(error.value) == f"cannot write {path}: File too large; files written before are complete"
    assert check_cache(tmp_path / "run") == []
    assert list_frames(tmp_path / "run") == [0]
    writer.write(1, {"Film": make_frame(100)})
    assert check_cache(tmp_path / "run") == []


def test_disk_full_at_the_flush(tmp_path, monkeypatch):
    """Some systems report a full disk only when the data are flushed."""
    writer = write_run(tmp_path / "run", [make_frame(5)])

    def refuse(handle):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(InputError, match=r"frames/film\.000001\.usdc: No space left on device;"):
        writer.write(1, {"Film": make_frame(5)})
    assert check_cache(tmp_path / "run") == []


@pytest.mark.parametrize("name", ["film.usda", "run.jsonl"])
def test_a_folder_with_a_run_is_refused(tmp_path, name):
    (tmp_path / name).write_text("precious")
    with pytest.raises(InputError, match=rf"already holds a run \({re.escape(name)}\)"):
        CacheWriter(tmp_path, FPS, METADATA)
    assert sorted(os.listdir(tmp_path)) == [name]
    assert (tmp_path / name).read_text() == "precious"


def test_a_second_run_is_refused(cache, frames):
    before = {path: path.read_bytes() for path in cache.rglob("*.usd?")}
    with pytest.raises(InputError, match=r"already holds a run \(film\.usda\)"):
        CacheWriter(cache, FPS, METADATA)
    (cache / "film.usda").unlink()
    with pytest.raises(InputError, match=r"already holds a run \(frames\)"):
        CacheWriter(cache, FPS, METADATA)
    after = {path: path.read_bytes() for path in cache.rglob("*.usd?")}
    assert after == {path: data for path, data in before.items() if path.name != "film.usda"}


def test_folders_that_cannot_be_used(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"output folder .*file is a file"):
        CacheWriter(tmp_path / "file", FPS, METADATA)
    with pytest.raises(InputError, match=r"cannot use output folder .*: Not a directory"):
        CacheWriter(tmp_path / "file" / "run", FPS, METADATA)
    if os.access("/proc/self", os.F_OK):
        with pytest.raises(InputError, match=r"cannot use output folder /proc/self/run: "):
            CacheWriter("/proc/self/run", FPS, METADATA)


# --- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value", "error", "message"),
    [
        ("points", np.zeros((5, 2), np.float32), InputError, r"Film\.points must be an array \[5, 3\] of float32"),
        ("points", np.zeros((5, 3)), InputError, r"Film\.points must be .* float32, got \(\(5, 3\), 'float64'\)"),
        ("points", [[0.0] * 3] * 5, InputError, r"Film\.points must be .*, got 'list'"),
        ("velocities", np.zeros((4, 3), np.float32), InputError, r"Film\.velocities must be an array \[5, 3\]"),
        ("ids", np.arange(5, dtype=np.int32), InputError, r"Film\.ids must be an array \[5\] of int64"),
        ("ids", np.array([1, 2, 2, 3, 4]), InputError, r"Film\.ids must be ascending, each once, got \[2, 2\]"),
        ("ids", np.array([1, 3, 2, 4, 5]), InputError, r"Film\.ids must be ascending, each once, got \[3, 2\]"),
        ("widths", np.ones((5, 1), np.float32), InputError, r"Film\.widths must be an array \[5\]"),
        ("region", np.zeros(5, np.int64), InputError, r"Film\.region must be an array \[5\] of int32"),
        ("points", np.full((5, 3), np.nan, np.float32), SimulationError, r"Film\.points is not finite at .* id 10"),
        ("thickness", np.float32([1, 1, np.inf, 1, 1]), SimulationError, r"Film\.thickness is not finite at .* id 12"),
        ("thickness", np.float32([1, 1, 1, -1, 1]), SimulationError, r"Film\.thickness is negative at .* id 13: -1\.0"),
        ("widths", np.float32([1, 1, 1, 1, -2]), SimulationError, r"Film\.widths is negative at particle id 14: -2\.0"),
    ],
)
def test_bad_arrays_are_refused(tmp_path, field, value, error, message):
    writer = write_run(tmp_path / "run", [make_frame(5)])
    frame = make_frame(5)
    frame.ids = np.arange(10, 15)
    with pytest.raises(error, match=r"frame 1 " + message):
        writer.write(1, {"Film": dataclasses.replace(frame, **{field: value})})
    assert list_frames(tmp_path / "run") == [0]
    assert check_cache(tmp_path / "run") == []


def test_frames_come_in_order(tmp_path):
    writer = write_run(tmp_path / "run", [make_frame(5)], first=3)
    for number in (3, 2, 5, 4.0, -1, 1_000_000):
        with pytest.raises(InputError, match=r"frame_index must be .*, got "):
            writer.write(number, {"Film": make_frame(5)})
    with pytest.raises(InputError, match=r"frames must be one for each of \['Film'\], got \['Film', 'FilmE'\]"):
        writer.write(4, {"Film": make_frame(5), "FilmE": make_frame(5)})
    writer.write(4, {"Film": make_frame(5)})
    assert list_frames(tmp_path / "run") == [3, 4]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fps": 0.0}, "fps must be a number above 0, got 0.0"),
        ({"fps": float("nan")}, "fps must be a number above 0, got nan"),
        ({"metadata": {"seed": 1}}, "metadata.scene must be text, got None"),
        ({"metadata": {"scene": "a"}}, "metadata.seed must be a whole number, got None"),
        ({"metadata": METADATA | {"x": [1]}}, "metadata.x must be text, a bool, a number or a mapping of these"),
        ({"metadata": METADATA | {"x": {"y": 2**64}}}, "metadata.x.y must be within 64 bits"),
        ({"metadata": METADATA | {"a b": 1}}, "metadata key must be a name of letters, digits and _, got 'a b'"),
        ({"metadata": METADATA | {"colorGain": 1}}, "metadata must be without the keys that the writer sets"),
        ({"prims": ("FilmE",)}, 'prims must be "Film" and then other names'),
        ({"prims": ("Film", "Film")}, 'prims must be "Film" and then other names'),
        ({"prims": ("Film", "Looks")}, 'prims must be "Film" and then other names'),
        ({"gain": -1.0}, "gain must be a number above 0, got -1.0"),
        ({"index": 1.0}, "index must be a number above 1, got 1.0"),
    ],
)
def test_bad_arguments_leave_no_folder(tmp_path, arguments, message):
    with pytest.raises(InputError, match=re.escape(message)):
        CacheWriter(**({"directory": tmp_path / "run", "fps": FPS, "metadata": METADATA} | arguments))
    assert not (tmp_path / "run").exists()


# --- reading and other forms ---------------------------------------------------------------------------------------


def test_reading_what_is_not_there(tmp_path, cache):
    assert list_frames(tmp_path / "nothing") == []
    with pytest.raises(InputError, match=r"there is no file .*film\.usda"):
        read_metadata(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"there is no file .*film\.000009\.usdc"):
        read_frame(cache, 9)
    with pytest.raises(InputError, match=r"film\.000001\.usdc: /World/FilmE\.points has no value at time code 1"):
        read_frame(cache, 1, "FilmE")
    path = usd.frame_path(cache, 1)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"film\.000001\.usdc cannot be opened: "):
        read_frame(cache, 1)
    (cache / "film.usda").write_text("#usda 1.0\n")
    with pytest.raises(InputError, match=r"this is not a cache of melp-warp"):
        read_metadata(cache)


@pytest.mark.parametrize("ending", [".usdc", ".usda"])
def test_flattened_file(tmp_path, cache, frames, ending):
    path = flatten(cache, tmp_path / f"flat{ending}")
    root = Sdf.Layer.OpenAsAnonymous(str(path))
    assert not root.GetPrimAtPath("/World").HasInfo("clips")
    assert root.GetExternalReferences() == ()
    assert root.customLayerData == Sdf.Layer.OpenAsAnonymous(str(cache / "film.usda")).customLayerData
    assert str(tmp_path) not in root.documentation
    stage = Usd.Stage.Open(str(path))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0.0, 4.0, FPS)
    for number, frame in enumerate(frames):
        for attribute in ATTRIBUTES:
            if attribute.field:
                value = np.array(stage.GetAttributeAtPath(f"/World/Film.{attribute.name}").Get(float(number)))
                np.testing.assert_array_equal(value, getattr(frame, attribute.field))


def test_flatten_refuses(tmp_path, cache):
    (tmp_path / "old.usdc").write_text("precious")
    for path, message in (("old.usdc", "a new file"), ("x.abc", "a file name ending in .usdc, .usd or .usda")):
        with pytest.raises(InputError, match=f"path must be {message}, got "):
            flatten(cache, tmp_path / path)
    assert (tmp_path / "old.usdc").read_text() == "precious"
    with pytest.raises(InputError, match=r"there is no file"):
        flatten(tmp_path / "nothing", tmp_path / "new.usdc")


def test_look_layer(cache, frames):
    root = (cache / "film.usda").read_bytes()
    path = write_look(cache)
    assert path == cache / "film_look.usda"
    assert (cache / "film.usda").read_bytes() == root
    stage = Usd.Stage.Open(str(path))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0.0, 4.0, FPS)
    np.testing.assert_array_equal(np.array(stage.GetAttributeAtPath("/World/Film.points").Get(1.0)), frames[1].points)
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/World/Film")).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource("mtlx")
    assert surface.GetShaderId() == "ND_open_pbr_surface_surfaceshader"
    values = {i.GetBaseName(): i.Get() for i in surface.GetInputs() if not i.HasConnectedSource()}
    assert values["specular_ior"] == 1.0
    assert values["thin_film_ior"] == np.float32(1.33)
    assert (values["transmission_weight"], values["base_weight"]) == (1.0, 0.0)
    assert values["geometry_thin_walled"] is True
    (source,), _ = surface.GetInput("thin_film_thickness").GetConnectedSources()
    scale = UsdShade.Shader(source.source.GetPrim())
    assert (scale.GetShaderId(), scale.GetInput("in2").Get()) == ("ND_multiply_float", np.float32(0.001))
    (source,), _ = scale.GetInput("in1").GetConnectedSources()
    assert source.source.GetPrim().GetAttribute("inputs:geomprop").Get() == "thickness"
    assert check_cache(cache) == []
