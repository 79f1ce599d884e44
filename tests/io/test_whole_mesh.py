"""One mesh for a whole foam: partitions once, borders shared, the liquid of both sheets, areas of exact foams."""

from dataclasses import fields, replace

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdGeom

from melp_warp import cli
from melp_warp.errors import InputError
from melp_warp.mesh.surfaces import make_meshes
from melp_warp.mesh.whole import join_meshes, make_whole
from melp_warp.registry import load_scene
from melp_warp.shapes import Disc, Sphere
from melp_warp.simulation import Simulation
from melp_warp.study.mesh_validation import SCENES, frame_of, liquid_in, volume_of, whole_areas, whole_liquid
from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.check import check_cache
from melp_warp.usd.check_surfaces import check_whole
from melp_warp.usd.reading import read_frame, read_metadata, read_whole
from melp_warp.usd.schema import WHOLE, list_frames
from tests.foams import Double, cluster
from tests.helpers import fitted_order


def joined(e, rims=()):
    """The one mesh of E as a solver leaves them."""
    meshes, problems = make_meshes(e, None, rims)
    whole, more = join_meshes(meshes, e, None)
    assert problems + more == []
    return whole


def uses(whole):
    """How many faces each edge has: [m, 2] ends and [m] faces."""
    sides = np.concatenate([whole.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    return np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)


def border_length(whole):
    edges, times = uses(whole)
    ends = whole.points.astype(float)[edges[times == 3]]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum())


# --- topology ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bubbles", "count"), [(2, 200), (3, 300), (4, 200), (4, 500)])
def test_edges_have_two_faces_and_three_on_borders(bubbles, count, device):
    """The skin of every bubble is a sphere of its own; each partition is there once."""
    whole = joined(cluster(bubbles, count))
    assert check_whole(whole) == []
    times = uses(whole)[1]
    assert set(times.tolist()) == {2, 3}
    pairs = set(whole_areas(whole))
    inner = {(k, s) for k in range(bubbles) for s in range(k + 1, bubbles)}
    assert pairs == {(k, -1) for k in range(bubbles)} | inner


@pytest.mark.parametrize(("bubbles", "nodes"), [(2, 0), (3, 2), (4, 5)])
def test_borders_meet_four_at_a_time(bubbles, nodes, device):
    """Plateau: two bubbles have a ring, three two vertices with four borders each, four have five of them."""
    edges, times = uses(joined(cluster(bubbles, 300)))
    degree = np.bincount(edges[times == 3].ravel())
    assert set(degree[degree > 0].tolist()) <= {2, 4}
    assert (degree == 4).sum() == nodes


def test_a_single_bubble_and_a_film_on_a_frame(device):
    """Nothing is shared: the mesh of the only region as it is, used once along its rim."""
    for shape, rims in ((Sphere(0.1), ()), (Disc(0.1), Disc(0.1).edges())):
        e = frame_of(shape.sample(400))
        alone = make_meshes(e, None, rims)[0][0]
        whole = joined(e, rims)
        np.testing.assert_array_equal(whole.points, alone.points)
        np.testing.assert_array_equal(whole.faces, alone.faces)
        assert check_whole(whole, len(rims)) == []
        assert (uses(whole)[1] == 1).any() == bool(rims)


def test_the_checker_sees_every_fault(device):
    whole = joined(cluster(2, 300))
    whole.faces = whole.faces[1:]
    whole.inside, whole.outside = whole.inside[1:], whole.outside[1:]
    for name in ("normals", "thickness", "black_film"):
        setattr(whole, name, getattr(whole, name)[3:])
    assert any("region" in problem for problem in check_whole(whole))


# --- geometry ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_areas_of_double_bubbles_converge(device):
    """Caps, partition and border against the exact ones, for equal bubbles and for unequal ones."""
    for double in (Double(), Double(1.0, 0.6)):
        counts, errors = (250, 500, 1000), []
        for count in counts:
            whole = joined(double.frame(count, noise=0.0))
            areas = whole_areas(whole)
            part = double.partition_area()
            exact = {(k, -1): area - part for k, area in enumerate(double.areas())} | {(0, 1): part}
            ring = 2.0 * np.pi * double.contact
            errors.append(
                [
                    *(abs(areas[pair] / exact[pair] - 1.0) for pair in exact),
                    abs(sum(areas.values()) / sum(exact.values()) - 1.0),
                    abs(border_length(whole) / ring - 1.0),
                ]
            )
        errors = np.array(errors)
        print(errors)
        assert errors[-1].max() < 0.04
        assert errors[-1, 3] < 2e-3
        spacing = 1.0 / np.sqrt(counts)
        assert fitted_order(spacing, errors.max(axis=1)) > 0.9


def test_volumes_within_skins(device):
    """Of unequal bubbles, whose partition bulges."""
    double, error = Double(1.0, 0.6), []
    for count in (250, 1000):
        whole = joined(double.frame(count, noise=0.0))
        found = [volume_of(whole.skin(region)) for region in (0, 1)]
        error.append(abs(np.array(found) / double.volumes() - 1.0))
    print(error)
    assert (error[1] < [0.01, 0.025]).all()
    assert (error[1] < 0.55 * error[0]).all()


# --- what it carries -----------------------------------------------------------------------------------------------


def test_a_partition_is_as_thick_as_both_sheets(device):
    e = cluster(3, 300)
    e.thickness[:] = np.array([300.0, 400.0, 500.0])[e.region]
    e.velocities[:] = e.points
    whole = joined(e)
    mean = whole.thickness.reshape(-1, 3).mean(axis=1)
    for pair in whole_areas(whole):
        wanted = sum((300.0, 400.0, 500.0)[k] for k in pair if k >= 0)
        assert np.median(mean[(whole.inside == pair[0]) & (whole.outside == pair[1])]) == pytest.approx(
            wanted, rel=0.05
        )
    assert whole_liquid(whole) == pytest.approx(liquid_in(e), rel=1e-5)
    np.testing.assert_allclose(whole.velocities, whole.points, atol=0.15)
    assert np.linalg.norm(whole.normals, axis=1) == pytest.approx(1.0, abs=1e-5)


def test_no_face_is_flipped(device):
    for n, count in ((3, 250), (4, 300)):
        whole = joined(cluster(n, count))
        x = whole.points.astype(float)[whole.faces]
        face = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        assert (np.einsum("ij,ikj->ik", face, whole.normals.reshape(-1, 3, 3)) > 0.0).all()


def test_points_of_no_region_are_refused(device):
    e = cluster(2, 200)
    with pytest.raises(InputError, match="triangles"):
        join_meshes(make_meshes(e)[0], e, 0)


# --- runs and caches -----------------------------------------------------------------------------------------------

SMALL = [
    "--set",
    "e_count=800",
    "l_per_e=2",
    "approach_speed=0.5",
    "--fps",
    "24",
    "--frames",
    "4",
    "--export",
    "both",
    "--full",
]


def test_a_run_writes_what_the_command_writes_afterwards(tmp_path, capsys):
    assert cli.main(["run", "double_bubble", "--quiet", "--whole", "--out", str(tmp_path / "with"), *SMALL]) == 0
    assert cli.main(["run", "double_bubble", "--quiet", "--mesh", "--out", str(tmp_path / "after"), *SMALL]) == 0
    assert cli.main(["mesh", str(tmp_path / "after"), "--whole"]) == 0
    for cache in ("with", "after"):
        assert check_cache(tmp_path / cache) == []
        assert read_metadata(tmp_path / cache)["prims"] == ["Film", "FilmE", WHOLE]
    shared = 0
    for frame in list_frames(tmp_path / "with"):
        one, two = (read_whole(tmp_path / cache, frame) for cache in ("with", "after"))
        for field in fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(two, field.name))
        assert whole_liquid(one) == pytest.approx(liquid_in(read_frame(tmp_path / "with", frame)), rel=1e-5)
        shared += (one.outside >= 0).sum()
    assert shared > 0  # they meet
    assert cli.main(["preview", str(tmp_path / "with"), "--size", "160", "--out", str(tmp_path / "seen.png")]) == 0
    picture = np.asarray(Image.open(tmp_path / "seen.png")).astype(float)
    assert picture.max() > 150.0
    assert cli.main(["mesh", str(tmp_path / "after")]) == 0
    assert read_metadata(tmp_path / "after")["prims"][2:] == ["FilmSurface/Region_0", "FilmSurface/Region_1"]


def test_usd_reads_it(tmp_path):
    """One prim, seen by default, with values at corners where films differ, and the regions of each face."""
    e = cluster(2, 200)
    whole = joined(e)
    writer = CacheWriter(tmp_path / "cache", 24.0, {"scene": "test", "seed": 1}, ("Film", WHOLE))
    writer.write(0, {"Film": e, WHOLE: whole})
    stage = Usd.Stage.Open(str(tmp_path / "cache" / "film.usda"))
    mesh = UsdGeom.Mesh.Get(stage, f"/World/{WHOLE}")
    assert mesh.ComputePurpose() == "default"
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetNormalsInterpolation() == "faceVarying"
    assert len(mesh.GetNormalsAttr().Get(0.0)) == 3 * len(whole.faces)
    for name, interpolation in {"thickness": "faceVarying", "inside": "uniform", "outside": "uniform"}.items():
        primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar(name)
        assert primvar.GetInterpolation() == interpolation
        np.testing.assert_array_equal(np.array(primvar.Get(0.0)), getattr(whole, name))
    with pytest.raises(InputError, match="inside"):
        writer.write(1, {"Film": e, WHOLE: replace(whole, inside=whole.inside[1:])})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["four_bubbles", "cluster", "foam_mountain", "size_ratio", "triple_bubble"])
def test_foams_that_change_are_sound(name, tmp_path):
    """Bubbles meet, pop, merge and come; every fifth frame."""
    script = load_scene(name)
    simulation = Simulation(script.build(script.parameters.values(SCENES[name])))
    while True:
        if simulation.frame % 5 == 0:
            e, many = (simulation.particles(which) if which == "e" or simulation.has_l else None for which in "el")
            whole, problems = make_whole(e, many)
            assert problems == [], simulation.frame
            assert whole_liquid(whole) == pytest.approx(liquid_in(many or e), rel=1e-5)
        if simulation.frame == simulation.scene.frames:
            break
        simulation.advance_frame()
