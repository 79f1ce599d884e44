"""The measuring tool on exact foams, as they are and with what a solver does to them; and its command."""

import dataclasses
import json

import numpy as np
import pytest

from melp_warp import cli
from melp_warp.errors import InputError
from melp_warp.measure.fits import close_pairs, fit_sphere
from melp_warp.measure.results import measure
from melp_warp.usd.cache import CacheWriter
from tests.foams import Double, cluster, frame_of, single

TETRAHEDRON = np.degrees(np.arccos(-1.0 / 3.0))
EQUAL, UNEQUAL, SHARP = Double(), Double(1.0, 0.6), Double(outside=110.0)


@pytest.fixture(scope="module")
def measured():
    """Measurements by what was measured, each taken once."""
    store = {}

    def get(foam, count, **options):
        key = (repr(foam), count, *options.items())
        if key not in store:
            frame = cluster(foam, count, **options) if isinstance(foam, int) else foam.frame(count, **options)
            store[key] = measure(frame)
        return store[key]

    return get


def pair_error(found):
    """Largest error of a dihedral angle at a line outside, degrees; no angle may be missing."""
    return max(abs(angle - 120.0) for pair in found.pairs for angle in pair.angles)


def line_error(found):
    return max(abs(angle - 120.0) for line in found.triples for angle in line.angles)


def vertex_error(found):
    return max(abs(angle - TETRAHEDRON) for vertex in found.vertices for angle in vertex.angles)


# --- one and two bubbles ---------------------------------------------------------------------------------------------


def test_a_single_bubble():
    found = measure(single(0.02, 1000))
    (bubble,) = found.regions
    assert (found.pairs, found.triples, found.vertices, found.fitted_area, found.least_area) == ((), (), (), None, None)
    assert bubble.count == bubble.cap.count == 1000
    assert bubble.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.02**3, rel=3e-3)
    assert bubble.area == bubble.cap_area == pytest.approx(4.0 * np.pi * 0.02**2, rel=1e-5)
    assert bubble.cap.radius == pytest.approx(0.02, rel=1e-3)
    assert bubble.pressure == pytest.approx(200.0, rel=1e-3)
    assert bubble.cap.center == pytest.approx(np.zeros(3), abs=2e-5)
    assert bubble.centroid == pytest.approx(np.zeros(3), abs=1e-4)
    assert bubble.cap.residual / found.spacing == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("foam", [EQUAL, UNEQUAL], ids=["equal", "unequal"])
@pytest.mark.parametrize("gap", [0.02, 0.3])
def test_angles_and_partition_of_a_double_bubble(foam, gap, measured):
    found = measured(foam, 4000, gap=gap)
    (pair,) = found.pairs
    assert pair_error(found) < 0.3
    assert pair.partition.curvature == pytest.approx(-foam.curvature, rel=0.01, abs=0.01)
    assert pair.expected == pytest.approx(-foam.curvature, rel=0.01, abs=0.002)
    assert pair.contact_radius == pytest.approx(foam.contact, rel=2e-3)
    assert pair.partition.gap / found.spacing == pytest.approx(gap, abs=0.01)
    assert pair.partition.residual / found.spacing < 0.025
    for region, radius in zip(found.regions, (foam.first, foam.second), strict=True):
        assert region.cap.radius == pytest.approx(radius, rel=2e-3)
        assert region.pressure == pytest.approx(4.0 / radius, rel=2e-3)
    assert found.regions[1].cap.center == pytest.approx([foam.apart, 0.0, 0.0], abs=2e-3)
    assert (found.triples, found.vertices) == ((), ())


@pytest.mark.parametrize("foam", [EQUAL, UNEQUAL], ids=["equal", "unequal"])
def test_volumes_and_areas_of_a_double_bubble(foam, measured):
    found = measured(foam, 4000, rounding=0.0)
    (pair,) = found.pairs
    for region, volume, area in zip(found.regions, foam.volumes(), foam.areas(), strict=True):
        assert region.volume == pytest.approx(volume, rel=3e-3)
        assert region.area == pytest.approx(area, rel=3e-3)
    total = sum(foam.areas()) - foam.partition_area()
    assert found.film_area == pytest.approx(total, rel=3e-3)
    assert found.fitted_area == pytest.approx(total, rel=3e-3)
    assert pair.area == pytest.approx(foam.partition_area(), rel=0.01)


def test_rounded_corners_shorten_the_films_and_not_the_fitted_ones(measured):
    found = measured(EQUAL, 4000)
    exact = sum(EQUAL.areas()) - EQUAL.partition_area()
    # three films lose 1.5 spacings less the arc's half each, once a side
    lost = 3.0 * 1.5 * (1.0 - np.pi / 6.0 * np.sqrt(3.0)) * found.spacing * 2.0 * np.pi * EQUAL.contact
    assert found.film_area == pytest.approx(exact - lost, rel=3e-3)
    assert found.fitted_area == pytest.approx(exact, rel=3e-3)
    assert found.least_area == pytest.approx(exact, rel=3e-3)
    for region in found.regions:
        assert region.volume == pytest.approx(EQUAL.volumes()[0], rel=3e-3)


@pytest.mark.parametrize("foam", [EQUAL, UNEQUAL], ids=["equal", "unequal"])
def test_errors_shrink_with_the_spacing(foam):
    coarse, fine = (
        np.sqrt(np.mean([pair_error(measure(foam.frame(count, seed=seed))) ** 2 for seed in range(4)]))
        for count in (500, 2000)
    )
    assert fine < 0.6 * coarse


def test_a_wrong_angle_is_measured_as_such(measured):
    (pair,) = measured(SHARP, 4000).pairs
    assert pair.angles == pytest.approx((125.0, 125.0, 110.0), abs=0.5)


def test_least_area_is_for_equal_volumes_only(measured):
    assert measured(EQUAL, 4000).least_area is not None
    assert measured(UNEQUAL, 4000).least_area is None


def test_films_with_few_particles_have_no_fit():
    found = measure(Double(1.0, 0.45).frame(250))
    (pair,) = found.pairs
    assert found.regions[0].cap.count > 100
    assert pair.partition.count == 12
    assert (found.regions[1].cap, found.regions[1].pressure, pair.expected, pair.contact_radius) == (None,) * 4
    assert pair.angles == (pytest.approx(120.0, abs=5.0), None, None)
    found = measure(Double(1.0, 0.45).frame(150))
    assert (found.pairs[0].partition, found.pairs[0].angles, found.fitted_area) == (None, None, None)
    assert "  -  " in found.table()
    json.dumps(found.to_json(), allow_nan=False)


# --- three and four bubbles ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "lines", "vertices"), [(2, 0, 0), (3, 1, 2), (4, 4, 5)])
@pytest.mark.parametrize(("gap", "rounding"), [(0.02, 1.5), (0.3, 2.5)])
def test_equal_bubbles(n, lines, vertices, gap, rounding, measured):
    found = measured(n, 4000, gap=gap, rounding=rounding)
    assert len(found.regions) == n
    assert len(found.pairs) == n * (n - 1) // 2
    assert (len(found.triples), len(found.vertices)) == (lines, vertices)
    assert all(len(vertex.angles) == 6 for vertex in found.vertices)
    assert pair_error(found) < 0.3
    if lines:
        assert line_error(found) < 0.5
        assert vertex_error(found) < 0.3
    for pair in found.pairs:
        assert pair.partition.curvature == pytest.approx(0.0, abs=0.02)
        assert pair.contact_radius == pytest.approx(np.sqrt(0.75), rel=2e-3)


def test_vertices_lie_where_they_must(measured):
    found = measured(4, 4000, gap=0.02, rounding=1.5)
    inner = [vertex for vertex in found.vertices if -1 not in vertex.regions]
    assert [vertex.regions for vertex in inner] == [(0, 1, 2, 3)]
    assert inner[0].point == pytest.approx(np.zeros(3), abs=3e-3)
    for vertex in measured(3, 4000, gap=0.02, rounding=1.5).vertices:
        assert np.linalg.norm(vertex.point) == pytest.approx(np.sqrt(2.0 / 3.0), rel=2e-3)


def test_errors_of_four_bubbles_shrink_with_the_spacing(measured):
    coarse, fine = measured(4, 1000, gap=0.02, rounding=1.5), measured(4, 4000, gap=0.02, rounding=1.5)
    for error in (pair_error, line_error, vertex_error):
        assert error(fine) < 0.5 * error(coarse)


def test_bubbles_apart_are_no_pair():
    one, two = single(1.0, 500), single(1.0, 500, seed=2)
    both = frame_of(
        np.concatenate([one.points, two.points + np.float32([2.3, 0.0, 0.0])]),
        np.concatenate([one.normals, two.normals]),
        np.concatenate([one.widths, two.widths]) ** 2 * np.pi / 4.0,
        np.repeat([0, 7], 500),
    )
    found = measure(both)
    assert [region.region for region in found.regions] == [0, 7]
    assert (found.pairs, found.fitted_area, found.least_area) == ((), None, None)


# --- what is measured ------------------------------------------------------------------------------------------------


def sheet(n=20, bend=0.0):
    """A square of n x n particles; bent to a part of a tube with `bend`."""
    u, v = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-0.5, 0.5, n),) * 2))
    if not bend:
        return frame_of(np.stack([u, v, 0 * u], 1), np.tile([0.0, 0.0, 1.0], (n * n, 1)), np.full(n * n, 0.0025), 0 * u)
    normals = np.stack([np.sin(bend * u), 0 * u, np.cos(bend * u)], 1)
    points = normals / bend + np.stack([0 * u, v, 0 * u], 1)
    return frame_of(points, normals, np.full(n * n, 0.0025), 0 * u)


def test_an_open_film_has_no_volume():
    found = measure(sheet())
    assert found.regions[0].volume is None
    assert found.regions[0].cap.curvature == 0.0
    assert found.regions[0].cap.radius is None
    assert found.regions[0].pressure == 0.0
    assert "-" in found.table()
    assert measure(sheet(bend=2.0 * np.pi * 0.95)).regions[0].volume is None  # a tube, whose normals add up to nearly 0


def test_the_spacing_can_be_given(measured):
    frame = EQUAL.frame(1000)
    assert measure(frame).spacing == pytest.approx(np.sqrt(EQUAL.areas()[0] / 1000), rel=0.02)
    assert measure(frame, 0.2).spacing == 0.2
    assert measure(frame, 0.2).pairs[0].partition.count < measure(frame).pairs[0].partition.count


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"widths": np.zeros(500, np.float32)}, "widths must be above 0 m"),
        ({"normals": np.zeros((500, 3), np.float32)}, "normals must be of unit length"),
        ({"region": np.full(500, -1, np.int32)}, "region must be 0 or above"),
    ],
)
def test_particles_that_cannot_be_measured(change, words):
    with pytest.raises(InputError, match=words):
        measure(dataclasses.replace(single(1.0, 500), **change))


def test_an_empty_frame_and_a_wrong_spacing():
    frame = single(1.0, 500)
    with pytest.raises(InputError, match="frame must be one with particles"):
        measure(frame_of(*(np.zeros((0, 3)),) * 2, np.zeros(0), np.zeros(0)))
    for spacing in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="spacing must be above 0 m"):
            measure(frame, spacing)


def test_close_pairs_are_all_pairs():
    x = np.random.default_rng(3).uniform(0.0, 1.0, (300, 3)) * [1.0, 0.2, 0.02]
    near = np.linalg.norm(x[:, None] - x, axis=2) <= 0.13
    np.fill_diagonal(near, False)
    found = [pair for i, j in close_pairs(x, 0.13) for pair in zip(i.tolist(), j.tolist(), strict=True)]
    assert len(found) == len(set(found))
    assert set(found) == set(zip(*(at.tolist() for at in np.nonzero(near)), strict=True))


@pytest.mark.parametrize("radius", [1.0, 30.0, np.inf])
def test_a_fit_is_exact_for_exact_points(radius):
    u, v = np.random.default_rng(5).uniform(-0.4, 0.4, (2, 200))
    k = 1.0 / radius
    drop = k * (u**2 + v**2) / (1.0 + np.sqrt(1.0 - k**2 * (u**2 + v**2)))
    normals = np.stack([k * u, v * k, 1.0 - k * drop], 1)
    side = np.repeat([1.0, -1.0], 100)
    sphere = fit_sphere(np.stack([u, v, 7.0 - drop], 1) + 0.01 * side[:, None] * normals, normals, np.ones(200), side)
    assert sphere.curvature == pytest.approx(k, abs=1e-9)
    assert sphere.gap == pytest.approx(0.02, abs=1e-9)
    assert sphere.residual < 1e-9
    assert sphere.distance(np.array([[0.0, 0.0, 7.5]]))[0] == pytest.approx(0.5, abs=1e-9)


# --- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Frame 0: one bubble; frame 1: a double bubble. FilmE has half as many particles."""
    folder = tmp_path_factory.mktemp("measure") / "run"
    writer = CacheWriter(folder, 24.0, {"scene": "test", "seed": 1}, prims=("Film", "FilmE"))
    writer.write(0, {"Film": single(0.01, 1000), "FilmE": single(0.01, 500)})
    writer.write(1, {"Film": EQUAL.frame(1000), "FilmE": EQUAL.frame(500)})
    return folder


def numbers(*arguments, path):
    assert cli.main(["measure", *map(str, arguments), "--json", str(path)]) == 0
    return json.loads(path.read_text())


def test_the_command_prints_a_table_and_writes_json(cache, tmp_path, capsys):
    found = numbers(cache, path=tmp_path / "m.json")
    table = capsys.readouterr().out
    assert "1/R 1/m" in table and "least area of two equal bubbles" in table
    assert found["pairs"][0]["regions"] == [0, 1]
    assert found["pairs"][0]["angles"] == pytest.approx([120.0] * 3, abs=1.0)
    assert found["regions"][0]["cap"]["radius"] == pytest.approx(1.0, rel=0.01)
    assert len(found["regions"][0]["cap"]["center"]) == 3
    assert [region["count"] for region in found["regions"]] == np.bincount(EQUAL.frame(500).region).tolist()


def test_the_command_takes_a_frame_a_set_and_a_spacing(cache, tmp_path):
    path = tmp_path / "m.json"
    first = numbers(cache, "--frame", 0, path=path)
    assert (first["regions"][0]["count"], first["pairs"]) == (500, [])
    film = numbers(cache, "--frame", 0, "--set", "film", path=path)
    assert film["regions"][0]["count"] == 1000
    assert film["spacing"] == pytest.approx(first["spacing"], rel=1e-6)  # that of the E
    assert numbers(cache, "--spacing", 0.2, path=path)["spacing"] == 0.2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--frame", "7"], "--frame must be from 0 to 1, got 7"),
        (["--frame", "last"], "--frame: invalid int value: 'last'"),
        (["--set", "l"], "--set: invalid choice: 'l'"),
        (["--spacing", "0"], "spacing must be above 0 m, got 0.0"),
        (["--json", "no/such/folder/m.json"], "no/such/folder/m.json: No such file or directory"),
        (["--json", "/dev/m.json"], "file must be in a folder of a disk, got '/dev/m.json'"),
    ],
)
def test_wrong_options(arguments, words, cache, capsys):
    assert cli.main(["measure", str(cache), *arguments]) == 2
    told = capsys.readouterr()
    assert told.err.startswith("melp-warp: error: ") and told.err.count("\n") == 1
    assert words in told.err
    assert told.out == ""


def test_wrong_folders(tmp_path, capsys):
    for folder in (tmp_path, tmp_path / "none"):
        assert cli.main(["measure", str(folder)]) == 2
        assert "DIR must be a folder that a run wrote" in capsys.readouterr().err
    writer = CacheWriter(tmp_path / "run", 24.0, {"scene": "test", "seed": 1})
    writer.write(0, {"Film": single(1.0, 200)})
    assert cli.main(["measure", str(tmp_path / "run"), "--set", "e"]) == 2
    assert "--set must be film, as the cache has no /World/FilmE, got 'e'" in capsys.readouterr().err
    assert cli.main(["measure", str(tmp_path / "run")]) == 0
