"""Films that burst, from the command line to the files: rims and drops in the cache, slow motion, resumed runs."""

import json
import shutil

import numpy as np
import pytest

from melp_warp import cli
from melp_warp.frame import ParticleFrame
from melp_warp.measure.fits import nearest_distance
from melp_warp.mesh.outline import mesh_torn, outlines
from melp_warp.registry import load_scene
from melp_warp.usd.check import check_cache
from melp_warp.usd.reading import read_curves, read_frame, read_mesh, read_metadata
from melp_warp.usd.schema import DROPS, FREE_RIMS, RIM_CURVES, list_frames

CORNERS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]])
SMALL = ["--set", "e_count=400", "l_per_e=4", "breakup=5", "--quiet", "--no-budget"]


def run(out, *options, scene="film_burst"):
    return cli.main(["run", scene, "--out", str(out), *SMALL, *options])


def lines(folder):
    return [json.loads(line) for line in (folder / "run.jsonl").read_text().splitlines()]


def edge_of(faces):
    """Points at which a side of one face alone begins."""
    sides = {(int(f[k]), int(f[k - 2])) for f in faces for k in range(3)}
    return sorted({a for a, b in sides if (b, a) not in sides})


@pytest.fixture(scope="module")
def burst(tmp_path_factory):
    """A film with a hole in its middle and another one off it, half a millisecond later."""
    folder = tmp_path_factory.mktemp("burst") / "cache"
    assert run(folder, "--puncture", "0.02,0.02,0,0.0005", "--frames", "40", "--mesh") == 0
    return folder


def test_the_cache_has_rims_and_drops(burst):
    """Where they are, how thick, how fast; sums agree with the log."""
    faults = check_cache(burst)
    assert all(fault.split(", first")[0].endswith("faces look inwards") for fault in faults)
    assert len(faults) <= 4  # of 41 frames: where rims have just met a mesh may fold
    log = lines(burst)
    assert log[0]["rims"] == 0 and log[1]["rims"] == 1
    assert max(line["rims"] for line in log) == 2
    assert log[-1]["drops"] > 50
    before = log[0]["mass"] + log[0]["rim_mass"]
    for frame in (5, 20, 40):
        rims, drops, line = read_frame(burst, frame, FREE_RIMS), read_frame(burst, frame, DROPS), log[frame]
        whole = line["mass"] + line["rim_mass"] + line["drop_mass"] + line["frame_mass"]
        assert whole == pytest.approx(before, rel=1e-5)
        assert len(drops.points) == line["drops"]
        assert (998.0 * np.pi / 6.0 * drops.widths.astype(float) ** 3).sum() == pytest.approx(
            line["drop_mass"], rel=5e-3
        )
        x = rims.points.astype(float)
        apart = np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1)
        assert np.median(apart) < 0.2 * 0.005
        assert len(read_frame(burst, frame).points) == line["l_count"]
        assert len(np.unique(rims.region)) == line["rims"]


def test_the_film_ends_at_its_rims(burst):
    """No L lies in a hole, and the mesh has an edge there."""
    frame = 12
    rims, film = read_frame(burst, frame, FREE_RIMS).points, read_frame(burst, frame).points
    radius = np.linalg.norm(rims[:, :2], axis=1)
    assert np.linalg.norm(film[:, :2], axis=1).min() > 0.97 * radius.min()
    assert lines(burst)[frame]["mesh_problems"] == []


def test_a_film_in_pieces_is_meshed_piece_by_piece():
    """Two squares with a gap between them: all E are in the one mesh, whose liquid is theirs."""
    side = (np.arange(12) + 0.5) / 12 * 0.1
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    flat_grid, away = np.pad(grid, ((0, 0), (0, 1))), np.array([0.2, 0.0, 0.0])
    x = np.concatenate([flat_grid, flat_grid + away])
    n, width = len(x), np.sqrt(4.0 / np.pi) * 0.1 / 12
    flat = {"points": x.astype(np.float32), "velocities": np.zeros((n, 3), np.float32), "ids": np.arange(n)}
    flat |= {"widths": np.full(n, width, np.float32), "normals": np.tile(np.float32([0, 0, 1]), (n, 1))}
    flat |= {"thickness": np.full(n, 400.0, np.float32), "region": np.zeros(n, np.int32)}
    e = ParticleFrame(**flat, black_film=np.zeros(n, np.int32))
    turn = np.concatenate(
        [np.linspace(a, b, 40, endpoint=False) for a, b in zip(CORNERS, np.roll(CORNERS, -1, 0), strict=True)]
    )
    loops = np.concatenate([turn, turn + away])
    k = len(loops)
    beads = {"points": loops.astype(np.float32), "velocities": np.zeros((k, 3), np.float32), "ids": np.arange(k)}
    beads |= {"widths": np.full(k, 1e-4, np.float32), "normals": np.tile(np.float32([0, 0, 1]), (k, 1))}
    beads |= {"thickness": np.full(k, 1e5, np.float32), "region": np.repeat(np.int32([0, 1]), k // 2)}
    meshes, problems = mesh_torn(e, None, [], ParticleFrame(**beads, black_film=np.zeros(k, np.int32)))
    assert problems == []
    a, b, c = (meshes[0].points.astype(float)[meshes[0].faces[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert area.sum() == pytest.approx(0.02, rel=0.01)
    assert (area * meshes[0].thickness[meshes[0].faces].mean(axis=1)).sum() == pytest.approx(0.02 * 400.0, rel=0.01)
    assert meshes[0].points[:, 0].max() > 0.25 and meshes[0].points[:, 0].min() < 0.05


def test_slow_motion(burst):
    """Frames are 500 times shorter; a second of velocities is one of what is shown."""
    log = lines(burst)
    assert log[30]["time"] == pytest.approx(30 / 60.0 / 500.0, rel=1e-9)
    assert read_metadata(burst)["slowMotion"] == {"factor": 500.0, "from": 0.0}
    rims = [read_frame(burst, frame, FREE_RIMS) for frame in (10, 11)]
    radius = [np.linalg.norm(one.points, axis=1).mean() for one in rims]
    speed = np.linalg.norm(rims[0].velocities, axis=1).mean()
    assert (radius[1] - radius[0]) * 60.0 == pytest.approx(speed, rel=0.03)


def test_time_runs_on_after_slow_motion():
    scene = load_scene("giant_bubble").scene(slow_motion=10.0, slow_from=0.1, slow_until=0.2)
    times = np.array([scene.film_time(frame) for frame in range(100)])
    steps = np.diff(times) * 60.0
    assert times[6] == pytest.approx(0.1) and times[-1] == pytest.approx(99 / 60.0 - 0.9)
    np.testing.assert_allclose(steps[:6], 1.0)
    np.testing.assert_allclose(steps[6:66], 0.1)
    np.testing.assert_allclose(steps[66:], 1.0)
    assert [scene.tempo(frame) for frame in (0, 30, 90)] == [1.0, 0.1, 1.0]


def test_a_run_goes_on_in_the_middle_of_a_burst(tmp_path):
    """Same bytes as of a run that was not stopped."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    second = ("--puncture", "0.02,0.02,0,0.0005")
    assert run(whole, *second, "--frames", "24") == 0
    assert run(parts, *second, "--frames", "9") == 0
    assert run(parts, "--resume", "--frames", "24") == 0
    for frame in list_frames(whole):
        name = f"frames/film.{frame:06d}.usdc"
        assert (whole / name).read_bytes() == (parts / name).read_bytes(), name


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--puncture", "1,2"), "--puncture must be x,y,z,t or x,y,z,t,radius, in m and s, got '1,2'"),
        (("--puncture", ""), "--puncture must be x,y,z,t"),
        (("--puncture", "0,0,0,0;0,0,0,1"), "--puncture must be x,y,z,t"),
        (("--puncture", "0,0,0,-1"), "time of a puncture must be at least 0 s, the start"),
        (("--puncture", "0,0,0,0,0"), "radius of a puncture must be above 0 m"),
        (("--puncture", "0,0,0,inf"), "puncture must be finite numbers"),
        (("--puncture", "0,0,0,0,1"), "radius of a puncture must be at most"),
    ],
)
def test_bad_punctures_end_in_one_line(options, told, tmp_path, capsys):
    assert run(tmp_path / "out", *options, "--frames", "1") == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1


def test_a_puncture_off_the_film_is_said(tmp_path, capsys):
    assert run(tmp_path / "out", "--puncture", "0,0,1,0", "--frames", "1", "--strict") == 1
    small = ["--set", "e_count=240", "l_per_e=1", "--frames", "1", "--strict"]
    foam = ["run", "double_bubble", "--out", str(tmp_path / "foam"), "--puncture", "0,0,9,0", *small]
    assert cli.main(foam) == 1
    assert "m off the film: nothing happens" in capsys.readouterr().err


def test_meshes_of_a_foam_that_bursts_are_sound(tmp_path):
    """In every frame while a bubble of four is torn; it has fewer faces each time, and in the end none.

    Its mesh ends at the rim: of the edge's points that are near it 85 % lie on it, others would fold a face.
    """
    times = ["merge_time=auto", "pop_time=0.05", "slow_from=0.05", "slow_motion=60"]
    small = ["e_count=480", "l_per_e=2", *times, "--frames", "28", "--mesh"]
    assert cli.main(["run", "four_bubbles", "--quiet", "--out", str(tmp_path / "out"), "--set", *small]) == 0
    assert check_cache(tmp_path / "out") == []
    faces = [len(read_mesh(tmp_path / "out", frame, 1).faces) for frame in range(4, 29)]
    assert faces[0] > faces[10] > 0 and faces[-1] == 0
    gaps = []
    for frame in range(4, 14):
        mesh, rim = read_mesh(tmp_path / "out", frame, 1), read_frame(tmp_path / "out", frame, FREE_RIMS).points
        width = np.sqrt(2.0) * read_frame(tmp_path / "out", frame).widths.mean()  # of an E
        gap = nearest_distance(mesh.points[edge_of(mesh.faces)], rim.astype(np.float64)) / width
        gaps.append(gap[gap < 1.4])
    gaps = np.concatenate(gaps)
    assert len(gaps) > 60 and (gaps < 0.2).mean() > 0.85


def test_the_outline_of_a_film_with_holes(burst):
    """The wire and a closed curve around each hole; where a rim has come to the wire, one curve of both."""
    wire = load_scene("film_burst").scene().shape.edges()
    early, e = read_frame(burst, 5, FREE_RIMS), read_frame(burst, 5)
    assert len(outlines(wire, early, e)) == 2
    assert len(outlines(wire, None, e)) == 1
    late, e = read_frame(burst, 40, FREE_RIMS), read_frame(burst, 40)
    curves = outlines(wire, late, e)
    assert len(curves) >= 1
    for curve in curves:
        gap = np.linalg.norm(np.roll(curve, -1, axis=0) - curve, axis=1)
        assert gap.max() < 0.03


def test_the_rims_are_curves_as_well(burst):
    """Closed curves through the beads, as thick; USD reads them through the clips, and their number changes."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(burst / "film.usda"))
    prim = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/World/{RIM_CURVES}"))
    assert (prim.GetTypeAttr().Get(), prim.GetWrapAttr().Get()) == ("linear", "nonperiodic")
    assert prim.GetWidthsInterpolation() == "vertex"
    assert UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/{FREE_RIMS}")).GetPurposeAttr().Get() == "guide"
    log, seen = lines(burst), set()
    for frame in (0, 1, 5, 20, 40):
        curves, beads = read_curves(burst, frame), read_frame(burst, frame, FREE_RIMS)
        seen.add(len(curves.counts))
        assert len(curves.counts) == log[frame]["rims"]
        np.testing.assert_array_equal(np.array(prim.GetPointsAttr().Get(frame)).reshape(-1, 3), curves.points)
        np.testing.assert_array_equal(np.array(prim.GetCurveVertexCountsAttr().Get(frame), dtype=int), curves.counts)
        starts = np.cumsum(curves.counts) - curves.counts
        closed = [
            np.allclose(curves.points[s], curves.points[s + n - 1]) for s, n in zip(starts, curves.counts, strict=True)
        ]
        kept = np.ones(len(curves.points), dtype=bool)
        kept[(starts + curves.counts - 1)[closed]] = False
        np.testing.assert_array_equal(curves.points[kept], beads.points)
        np.testing.assert_array_equal(curves.widths[kept], beads.widths)
        assert all(closed) or frame > 5  # later they end at the frame
    assert len(seen) > 1


def test_curves_that_do_not_fit_their_points_are_told(burst, tmp_path):
    from pxr import Sdf, Vt

    folder = tmp_path / "cache"
    shutil.copytree(burst, folder)
    path = str(folder / "frames" / "film.000005.usdc")
    layer = Sdf.Layer.FindOrOpen(path)
    layer.SetTimeSample(f"/World/{RIM_CURVES}.curveVertexCounts", 5.0, Vt.IntArray([3]))
    layer.Save()
    told = [fault for fault in check_cache(folder) if RIM_CURVES in fault]
    assert any("curveVertexCounts: must be two or more each" in fault for fault in told)
