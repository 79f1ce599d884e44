"""Packed sets of a cache: what is rounded is off by as much as is said, all else is there to the bit, in any reader."""

import dataclasses
import json

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from melp_warp import cli
from melp_warp.errors import InputError
from melp_warp.frame import ParticleFrame
from melp_warp.optics import display_color
from melp_warp.program.room import Written
from melp_warp.shapes import Sphere
from melp_warp.usd import packing
from melp_warp.usd.apart import read_frame as read_apart
from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.check import check_cache
from melp_warp.usd.forms import flatten
from melp_warp.usd.reading import read_frame
from melp_warp.usd.schema import PACKED_ATTRIBUTES, frame_path, with_rows

EXACT = ("points", "velocities", "ids", "thickness", "region", "black_film")
METADATA = {"scene": "test", "seed": 7}


def on_ellipsoid(count, seed=0):
    """Points of no order on an ellipsoid of half axes 5, 4 and 3 cm, and its normals."""
    rng = np.random.default_rng(seed)
    axes = np.array([0.05, 0.04, 0.03])
    d = rng.normal(size=(2 * count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    stretch = np.linalg.norm(d / axes, axis=1)
    points = axes * d[rng.uniform(size=2 * count) < stretch / stretch.max(initial=1e-9)][:count]
    n = len(points)
    normals = points / axes**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return ParticleFrame(
        points=points.astype(np.float32),
        velocities=rng.normal(scale=0.1, size=(n, 3)).astype(np.float32),
        ids=np.arange(n),
        widths=(np.sqrt(4.0 * 0.0201 / max(n, 1) / np.pi) * rng.uniform(0.8, 1.2, n)).astype(np.float32),
        normals=normals.astype(np.float32),
        thickness=rng.uniform(300.0, 600.0, n).astype(np.float32),
        region=np.zeros(n, np.int32),
        black_film=np.zeros(n, np.int32),
    )


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", a.astype(float), b.astype(float)), -1.0, 1.0)))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Frames, and a cache of them whose first set is packed."""
    frames = [on_ellipsoid(count, seed) for seed, count in enumerate((4000, 3000, 0, 5))]
    folder = tmp_path_factory.mktemp("packed") / "cache"
    writer = CacheWriter(folder, 24.0, METADATA, ("Film", "FilmE"), packed=("Film",))
    for number, frame in enumerate(frames):
        writer.write(number, {"Film": frame, "FilmE": frame})
    return frames, folder


def test_what_is_rounded(made):
    """Widths to 1/32, directions to 8 degrees, 3 in the mean square, colours to 1 nm."""
    frame = made[0][0]
    widths = packing.round_widths(frame.widths)
    assert np.abs(widths / frame.widths - 1.0).max() <= 1.0 / 32.0
    assert len(np.unique(widths)) < 32
    area, kept = (np.sum(w.astype(float) ** 2) for w in (frame.widths, widths))
    assert kept == pytest.approx(area, rel=1e-6)
    even = np.full(9, 0.00123, np.float32)
    np.testing.assert_array_equal(packing.round_widths(even), even)
    assert packing.round_widths(np.zeros(3, np.float32)).tolist() == [0.0, 0.0, 0.0]
    table, rows = packing.pack_normals(frame.normals)
    off = degrees(table[rows], frame.normals)
    assert np.sqrt(np.mean(off**2)) < 3.2
    assert off.max() < 8.0
    assert np.abs(np.linalg.norm(table, axis=1) - 1.0).max() < 1e-6
    table, rows = packing.pack_colors(frame.thickness, 13.0, 1.33)
    near = np.stack([display_color(frame.thickness + d) for d in np.linspace(-1.0, 1.0, 41).astype(np.float32)])
    assert np.abs(near - table[rows]).max(axis=2).min(axis=0).max() < 2e-3


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [0.6, 0.8, 0.0]])
def test_directions_along_axes(normal):
    table, rows = packing.pack_normals(np.array([normal], np.float32))
    assert degrees(table[rows], np.array([normal]))[0] < 8.0


@pytest.mark.parametrize("read", [read_frame, read_apart])
def test_what_is_read(made, read):
    frames, folder = made
    for number, frame in enumerate(frames):
        found = read(folder, number)
        for field in EXACT:
            a, b = getattr(found, field), getattr(frame, field)
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b, err_msg=field)
        np.testing.assert_array_equal(found.widths, packing.round_widths(frame.widths))
        whole = read(folder, number, "FilmE")
        for field in dataclasses.fields(ParticleFrame)[:-1]:
            np.testing.assert_array_equal(getattr(whole, field.name), getattr(frame, field.name), err_msg=field.name)


@pytest.mark.parametrize(("count", "error"), [(4000, 0.7), (16000, 0.2)])
def test_normals_are_those_of_the_surface_through_the_points(count, error):
    """Whatever the ones that are stored; four times the points: a quarter of the error, that of a quadric."""
    frame = on_ellipsoid(count)
    table, rows = packing.pack_normals(frame.normals)
    coarse = dataclasses.replace(frame, normals=table[rows])
    off = degrees(packing.refine_normals(coarse).normals, frame.normals)
    assert np.sqrt(np.mean(off**2)) < error
    assert off.max() < 8.0 * error


def test_a_crowd_is_no_film():
    """A million points in one place have as many neighbours each, and would be fitted for days."""
    n = 1_000_000
    arrays = {
        f.name: np.repeat(getattr(on_ellipsoid(1), f.name), n, axis=0) for f in dataclasses.fields(ParticleFrame)[:-2]
    }
    crowd = ParticleFrame(**arrays)
    assert packing.refine_normals(crowd) is crowd


@pytest.mark.parametrize("factor", [0.0, 2.0, -0.5, 1e9])
def test_normals_that_are_none_are_named(factor):
    frame = on_ellipsoid(50)
    frame.normals[7] *= np.float32(factor)
    with pytest.raises(InputError, match="normals must be of unit length"):
        packing.refine_normals(frame)


def test_sheets_that_lie_side_by_side_are_kept_apart():
    """A bubble within another one, half a spacing off, of the same region and of another one."""
    outer, apart = Sphere(0.05).sample(2000), 0.0005
    inner = outer.points * (1.0 - apart / 0.05)
    n = 2 * len(outer.points)
    for region in (np.zeros(n), np.repeat([0, 1], n // 2)):
        normals = np.concatenate([outer.normals, -outer.normals]).astype(np.float32)
        table, rows = packing.pack_normals(normals)
        frame = dataclasses.replace(
            ParticleFrame.empty(),
            points=np.concatenate([outer.points, inner]).astype(np.float32),
            widths=np.full(n, 0.004, np.float32),
            normals=table[rows],
            region=region.astype(np.int32),
        )
        off = degrees(packing.refine_normals(frame).normals, normals)
        assert off.max() < 1.0


def test_a_stage_has_it_all(made):
    """USD alone: types, values through the clips, colours and normals for each particle."""
    frames, folder = made
    stage = Usd.Stage.Open(str(folder / "film.usda"))
    prim = stage.GetPrimAtPath("/World/Film")
    for attribute in with_rows(PACKED_ATTRIBUTES):
        found = prim.GetAttribute(attribute.name)
        assert str(found.GetTypeName()) == attribute.type_name
        assert found.GetTimeSamples() == [0.0, 1.0, 2.0, 3.0]
        assert found.GetResolveInfo(2.0).GetSource() == Usd.ResolveInfoSourceValueClips
    primvars = UsdGeom.PrimvarsAPI(prim)
    for number, frame in enumerate(frames):
        colors = np.array(primvars.GetPrimvar("displayColor").ComputeFlattened(float(number))).reshape(-1, 3)
        shown = packing.shown_thickness(frame.thickness)
        np.testing.assert_array_equal(colors, display_color(shown))
        normals = np.array(primvars.GetPrimvar("normals").ComputeFlattened(float(number))).reshape(-1, 3)
        assert normals.shape == frame.normals.shape
        assert not len(normals) or degrees(normals, frame.normals).max() < 8.0
        points = UsdGeom.Points(prim).GetPointsAttr().Get(float(number))
        np.testing.assert_array_equal(np.array(points).reshape(-1, 3), frame.points)
    assert UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/World/FilmE")).GetPrimvar("displayColor").IsIndexed() is False


def test_flat_and_referenced(made, tmp_path):
    frames, folder = made
    flat = Usd.Stage.Open(str(flatten(folder, tmp_path / "flat.usdc")))
    other = Usd.Stage.CreateInMemory()
    other.DefinePrim("/Shot").GetReferences().AddReference(str(folder / "film.usda"))
    for stage, path in ((flat, "/World/Film"), (other, "/Shot/Film")):
        color = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(path)).GetPrimvar("displayColor")
        expected = display_color(packing.shown_thickness(frames[1].thickness))
        np.testing.assert_array_equal(np.array(color.ComputeFlattened(1.0)), expected)


def test_it_passes(made):
    assert check_cache(made[1]) == []


def change(path, name, value):
    layer = Sdf.Layer.OpenAsAnonymous(str(path))
    layer.SetTimeSample(f"/World/Film.{name}", 0.0, value)
    layer.Export(str(path))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("primvars:normals:indices", Vt.IntArray([0, 5, 1]), "from 0 to 5, must be from 0 to 2"),
        ("primvars:normals:indices", Vt.IntArray([0, -1, 1]), "from -1 to 1, must be from 0 to 2"),
        ("primvars:displayColor:indices", Vt.IntArray([0, 0]), "2 values for 3 points"),
        ("primvars:normals", Vt.Vec3fArray(3), "not of unit length in 3 entries"),
        ("primvars:normals", Vt.Vec3fArray(), "from 0 to 2, must be from 0 to -1"),
        ("primvars:displayColor", Vt.Vec3fArray([Gf.Vec3f(0.5)] * 3), "off by up to"),
    ],
)
def test_tables_that_do_not_fit(name, value, words, tmp_path):
    frame = on_ellipsoid(400)
    three = dataclasses.replace(frame, **{f.name: getattr(frame, f.name)[:3] for f in dataclasses.fields(frame)[:-2]})
    CacheWriter(tmp_path / "cache", 24.0, METADATA, packed=("Film",)).write(0, {"Film": three})
    assert check_cache(tmp_path / "cache") == []
    change(frame_path(tmp_path / "cache", 0), name, value)
    problems = check_cache(tmp_path / "cache")
    assert any(words in problem for problem in problems), problems


def test_caches_of_before_are_read(tmp_path, made):
    """Of schema version 2, which knew no packed sets."""
    frame = made[0][1]
    CacheWriter(tmp_path / "cache", 24.0, METADATA).write(0, {"Film": frame})
    for path in (tmp_path / "cache" / "film.usda", frame_path(tmp_path / "cache", 0)):
        layer = Sdf.Layer.OpenAsAnonymous(str(path))
        layer.customLayerData = {"melpWarp": {**layer.customLayerData["melpWarp"], "schemaVersion": 2}}
        layer.Export(str(path))
    assert check_cache(tmp_path / "cache") == []
    np.testing.assert_array_equal(read_frame(tmp_path / "cache", 0).normals, frame.normals)


def run(out, *more):
    few = ["--set", "e_count=400", "l_per_e=16", "--frames", "2", "--quiet"]
    assert cli.main(["run", "giant_bubble", "--out", str(out), *few, *more]) == 0
    return sum(path.stat().st_size for path in (out / "frames").iterdir())


def test_runs(tmp_path):
    """L are packed, E are not; --full packs none; what a run goes on with is what it began with."""
    packed, full = run(tmp_path / "packed", "--export", "both"), run(tmp_path / "full", "--export", "both", "--full")
    for (name, size), told in zip(
        {"packed": packed, "full": full}.items(), (Written(1, 1), Written(1, 1, full=True)), strict=True
    ):
        log = (tmp_path / name / "run.jsonl").stat().st_size
        assert size + log == pytest.approx(told.cache_bytes(400, 6400, 3), rel=0.25)
        assert cli.main(["check", str(tmp_path / name)]) == 0
    assert packed < 0.65 * full
    a, b = (read_frame(tmp_path / name, 2) for name in ("packed", "full"))
    np.testing.assert_array_equal(a.points, b.points)
    assert np.sqrt(np.mean(degrees(a.normals, b.normals) ** 2)) < 3.0  # the solver's follow 400 E
    a, b = (read_frame(tmp_path / name, 2, "FilmE") for name in ("packed", "full"))
    np.testing.assert_array_equal(a.normals, b.normals)
    again = ["run", "giant_bubble", "--resume", "--frames", "3", "--quiet", "--out", str(tmp_path / "full")]
    assert cli.main([*again, "--export", "l"]) == 2
    assert cli.main(again) == 0
    assert cli.main(["check", str(tmp_path / "full")]) == 0


def test_measures_of_packed_sets(made, tmp_path, capsys):
    """Volume and area of an ellipsoid from its particles, as well as from a set that is not packed."""
    found = {}
    for which in ("film", "e"):
        path = tmp_path / f"{which}.json"
        assert cli.main(["measure", str(made[1]), "--frame", "0", "--set", which, "--json", str(path)]) == 0
        found[which] = json.loads(path.read_text())["regions"][0]
    assert found["film"]["area"] == pytest.approx(found["e"]["area"], rel=1e-3)
    assert found["film"]["volume"] == pytest.approx(found["e"]["volume"], rel=2e-3)
