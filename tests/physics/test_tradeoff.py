"""Speed against accuracy: fronts, orders and designed sets, runs over the knobs, and single precision."""

import csv
import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

from melp_warp import cli
from melp_warp.frame import ParticleFrame
from melp_warp.quality import Quality
from melp_warp.shapes import Sphere
from melp_warp.simulation import Simulation
from melp_warp.study import rounding as precision
from melp_warp.study import tradeoff
from melp_warp.study import validation as v
from melp_warp.study.tradeoff import CASES, KNOBS, Record


def record(cost, error, knob="design", setting="x"):
    return Record("case", knob, setting, {}, error=error, cost=cost)


POINTS = [record(1.0, 9.0), record(2.0, 4.0), record(3.0, 5.0), record(8.0, 1.0), record(9.0, 1.0)]


def test_front_holds_what_nothing_else_beats():
    """Cost 3 and error 5 is beaten by (2, 4), cost 9 and error 1 by (8, 1); stopped runs are no points."""
    points = [*POINTS[::-1], record(math.nan, math.nan), record(0.1, math.nan)]
    assert [(r.cost, r.error) for r in tradeoff.front(points)] == [(1.0, 9.0), (2.0, 4.0), (8.0, 1.0)]


def test_front_leaves_out_what_was_not_solved():
    loose = Record("case", "tolerance", "0.1", {"tolerance": 0.1}, error=0.1, cost=0.1)
    assert tradeoff.front([*POINTS, loose]) == tradeoff.front(POINTS)
    assert tradeoff.behind(POINTS[0], [*POINTS, loose]) == 1.0


def test_behind_is_the_cost_over_the_fronts():
    assert [tradeoff.behind(r, POINTS) for r in POINTS] == [1.0, 1.0, 1.5, 1.0, 9.0 / 8.0]


@pytest.mark.parametrize(("knob", "power"), [("e", -1.0), ("step", 2.0)])
def test_order_is_found(knob, power):
    """error ~ dx^2 is error ~ 1/(number of E); error ~ dt^2."""
    runs = [record(1.0, f**power, "" if f == 1.0 else knob, f"{f:g}") for f in (0.25, 0.5, 1.0, 2.0)]
    assert tradeoff.order(runs, knob) == pytest.approx(2.0)
    assert math.isnan(tradeoff.order(runs[:2], knob))


def test_designed_set_visits_every_part_of_every_range_once():
    points = tradeoff.designed(CASES["vortex"], 8, seed=3)
    for values, low, high in (
        ([math.log(p.e) for p in points], -0.5 * math.log(8.0), 0.5 * math.log(8.0)),
        ([math.log(p.step) for p in points], -math.log(4.0), math.log(4.0)),
        ([math.log10(p.keys["tolerance"] / tradeoff.SOLVED) for p in points], -2.0, 0.0),
    ):
        part = np.floor(8.0 * (np.array(values) - low) / (high - low))
        assert sorted(part) == list(range(8))
    assert sorted(p.keys["support"] for p in points) == [3.0] * 4 + [4.0] * 4
    assert tradeoff.designed(CASES["rest"], 4)[0].keys.keys() == {"tolerance", "support"}
    assert all(p.l == 1.0 for p in tradeoff.designed(CASES["rest"], 4))


@pytest.mark.parametrize("name", CASES)
def test_knobs_of_a_case_are_knobs(name):
    assert set(CASES[name].knobs) <= set(KNOBS)


@pytest.mark.slow
def test_a_case_at_two_points_and_one_that_is_refused(device):
    """Four times the E bring the error of three waves down; too few are told, not raised."""
    case = CASES["oscillation"].scaled(0.25)
    own, finer = (tradeoff.measure("oscillation", "e", "", Quality(e=f), case) for f in (1.0, 4.0))
    assert finer.error < 0.2 * own.error
    assert finer.changes == {"e_count": 1200}
    assert (own.steps, own.stopped) == (251, "")
    assert own.cost > 0.0
    assert finer.bytes > 3 * own.bytes
    assert 0.0 < own.volume_error < 1e-5
    refused = tradeoff.measure("oscillation", "e", "", Quality(e=0.2), case)
    assert "e_count" in refused.stopped
    assert math.isnan(refused.error)


def test_a_picture_is_bought_by_l_and_support():
    """A run with fewer L or less support gives another picture; the case's own numbers count where none is said."""
    fewer, narrow, more, own = (
        Record("vortex", "", "", changes, error=0.1, cost=1.0)
        for changes in ({"l_per_e": 2}, {"support": 2.5}, {"l_per_e": 8, "support": 4.0}, {})
    )
    records = [fewer, narrow, more, own]
    assert tradeoff.with_as_good_a_picture(own, records) == [more, own]
    assert tradeoff.with_as_good_a_picture(fewer, records) == [fewer, more, own]
    assert tradeoff.with_as_good_a_picture(more, records) == [more]


def test_the_step_of_a_case_is_its_own(device):
    """A quality that leaves the step to cfl changes other things of a case with a step, and not that."""
    paper = Quality(keys={"dt": None, "cfl": 0.5, "support": 4.0})
    assert tradeoff.measure("rest", "", "", paper, CASES["rest"].scaled(0.4)).changes == {"support": 4.0}


def frame_of(points, normals, thickness):
    n = len(points)
    zero = np.zeros(n)
    return ParticleFrame(points, 0.0 * points, np.arange(n), zero, normals, thickness, zero, zero)


def test_field_error_of_known_fields():
    """A sphere against itself, 2 % thicker everywhere, and 1 % larger: of the extent 2 R that is 0.5 %."""
    d = Sphere(1.0).sample(2000).points
    thickness = np.full(2000, 400.0)
    reference = frame_of(d, d, thickness)
    assert tradeoff.field_error(reference, reference) < 1e-6
    assert tradeoff.field_error(frame_of(d, d, 1.02 * thickness), reference) == pytest.approx(0.02, rel=1e-3)
    # six neighbours on a sphere lie some d^2/2R below a point above them
    assert tradeoff.field_error(frame_of(1.01 * d, d, thickness), reference) == pytest.approx(0.005, rel=0.1)


def test_records_are_written(tmp_path):
    records = [record(1.0, 2.0), Record("case", "scheme", "explicit", {"scheme": "explicit"}, stopped="stage membrane")]
    tradeoff.save(records, tmp_path, "found", 3.0)
    rows = list(csv.DictReader((tmp_path / "found.csv").open()))
    assert [row["stopped"] for row in rows] == ["", "stage membrane"]
    assert json.loads(rows[1]["changes"]) == {"scheme": "explicit"}
    saved = json.loads((tmp_path / "found.json").read_text())
    assert saved["seconds"] == 3.0
    assert [r["error"] for r in saved["records"]] == [2.0, None]


def test_command_measures_a_scene(tmp_path, monkeypatch, capsys):
    """Reference first, everything else against it: more E are nearer to it, and the folder holds the records."""
    monkeypatch.setattr(tradeoff.studies, "KNOBS", {"e": KNOBS["e"], "curvature": KNOBS["curvature"]})
    monkeypatch.setattr(tradeoff.studies, "QUALITIES", {"draft": Quality(e=0.5)})
    out = tmp_path / "trade"
    options = ["--e", "300", "--frames", "12", "--out", str(out), "--set", "l_per_e=4"]
    assert cli.main(["tradeoff", "drainage", *options]) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0].split() == ["knob", "setting", "error", "s", "a", "simulated", "s", "steps", "MB"]
    records = json.loads((out / "tradeoff.json").read_text())["records"]
    assert records[0]["knob"] == "reference"
    error = {(r["knob"], r["setting"]): r["error"] for r in records}
    assert error["e", "2"] < error["", "as it is"] < error["e", "0.5"]
    assert cli.main(["tradeoff", "drainage", "--out", str(out)]) == 2
    assert "--out must be a new or empty folder" in capsys.readouterr().err


@pytest.mark.parametrize(("option", "value"), [("--e", "0"), ("--frames", "0")])
def test_command_refuses(option, value, capsys):
    assert cli.main(["tradeoff", "drainage", option, value]) == 2
    assert option in capsys.readouterr().err


def test_stages_are_as_exact_as_float32_allows(device):
    """Curvature, mass gathered from L and the solution of (14) against float64 at the same particles.

    float32 has 6e-8; sums over some fifty neighbours and a fit's solve may lose a digit.
    """
    simulation = Simulation(v.small_giant(300, 4, tolerance=1e-7))
    v.steps(simulation, 2, 1.0 / 120.0)
    found = precision.curvature_error(simulation), precision.transfer_error(simulation)
    solved, change = precision.solver_error(simulation, 1.0 / 120.0)
    print(f"curvature {found[0]:.1e}, mass {found[1]:.1e}, (14) {solved:.1e} of a change of {change:.1e}")
    assert 0.0 < max(found) < 2e-6
    assert solved < 2e-6
    assert change > 1e-4


@pytest.mark.slow
def test_rounding_is_far_below_resolution(device):
    """A run nudged by an ulp at every step stays near to one left alone; nudged a hundred thousand times more not."""
    scene = v.small_giant(300, 4)
    near, far = (precision.nudged_difference(scene, 3, 1.0 / 120.0, ulps) for ulps in (1.0, 1e5))
    assert 0.0 < near < 1e-4
    assert far > 30.0 * near


@pytest.fixture(scope="module")
def tool():
    """tools/tradeoff.py as a module."""
    path = Path(__file__).parents[2] / "tools" / "tradeoff.py"
    spec = importlib.util.spec_from_file_location("tradeoff_tool", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_page_tells_what_was_found(tool):
    """Cells are relative to the case as it is; qualities say whether they lie on the front."""
    own = Record("vortex", "", "as it is", {}, error=0.4, cost=2.0, bytes=10**6)
    records = [
        own,
        Record("vortex", "e", "2", {"e_count": 1800}, error=0.2, cost=5.0),
        Record("vortex", "scheme", "explicit", {}, stopped="stage membrane: E particle 3 is not finite"),
        Record("vortex", "quality", "draft", {"support": 3.0}, error=0.5, cost=1.0),
        Record("vortex", "quality", "standard", {}, error=0.4, cost=2.1),
        Record("vortex", "quality", "fine", {}, error=0.3, cost=20.0),
        Record("vortex", "quality", "paper", {}, stopped="e_count must be larger"),
    ]
    assert tool.cell(records, {"vortex": own}, "vortex", "e", "2") == "0.50, 2.50"
    assert tool.cell(records, {"vortex": own}, "vortex", "scheme", "explicit") == "stops"
    assert tool.cell(records, {"vortex": own}, "vortex", "skin", "1") == ""
    row = tool.qualities(records)[2].split(" | ")
    assert "**on the front**" in row[1] and "**on the front**" in row[2]
    assert "4.0 times the cost of the front of its picture" in row[3]
    assert row[4].startswith("refused")
    assert "0.4 | 2 | 1 | - | -" in tool.overview(records)[2]


def test_page_compares_precisions(tool):
    """Change of the error, shares of time and memory, what is kept in each; a foam's refinement leaves them out."""
    kept = {"mass_error": 0.0, "volume_error": 0.0}
    own = Record("double_bubble", "", "as it is", {}, error=2.0, cost=4.0, bytes=100, **kept | {"volume_error": 1e-8})
    double = Record("double_bubble", "precision", "64", {"precision": 64}, error=2.002, cost=5.0, bytes=150, **kept)
    assert tool.precisions([own, double])[2] == "| `double_bubble` | 2 | 1.0e-03 | 1.25 | 1.50 | - | 1.0e-08, 0 |"
    assert [line for line in tool.refinement([own, double]) if "double_bubble" in line] == tool.refinement([own])[2:3]
    assert "| bits of a number | 64 | 1.00, 1.25 |" in tool.knobs([own, double])


@pytest.mark.slow
def test_tool_runs_a_case_small(tool, capsys):
    assert tool.main(["--only", "rest", "--size", "0.5", "--points", "2"]) == 0
    told = capsys.readouterr().out
    assert "curvature" in told
    assert "design" in told
