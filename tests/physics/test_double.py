"""The solver in float64 against itself in float32, and how its source is made double."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from melp_warp.device import float64 as double
from melp_warp.errors import InputError
from melp_warp.simulation import Simulation
from melp_warp.study import tradeoff
from melp_warp.study.tradeoff import CASES, KNOBS
from melp_warp.usd.check import check_cache
from tests import precision_runs as runs

EPS = float(np.finfo(np.float32).eps)
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What a process in float64 wrote: results, a checkpoint, a cache."""
    path = tmp_path_factory.mktemp("double")
    command = [sys.executable, "-m", "tests.precision_runs", str(path)]
    subprocess.run(command, cwd=ROOT, env={**os.environ, double.VARIABLE: "64"}, check=True)
    return path


@pytest.fixture(scope="module")
def pair(folder, device):
    """All results in float32 and in float64."""
    return runs.all_runs(), dict(np.load(folder / "found.npz"))


@pytest.mark.slow
@pytest.mark.parametrize("name", runs.RUNS)
def test_precisions_agree_to_rounding(pair, name):
    """Positions round to eps of the film's size; the forces take them twice over the spacing, so velocities lose more.

    A ringing bubble of radius R loses the most: its curvature's rounding is eps R/dx^2, of 2/R some 30 eps.
    """
    single, exact = ({key: found[f"{name}.{key}"] for key in ("x", "u", "moved", "pressure")} for found in pair)
    assert (single["x"].dtype, exact["x"].dtype) == (np.float32, np.float64)
    off = {key: np.abs(single[key] - exact[key]).max() / np.abs(exact[key]).max() for key in ("x", "u")}
    print(f"{name}: x {off['x'] / EPS:.1f} eps, u {off['u'] / EPS:.0f} eps")
    assert 0.0 < off["x"] < 10.0 * EPS
    assert 0.0 < off["u"] < 1000.0 * EPS
    assert single["moved"] == pytest.approx(exact["moved"], abs=10.0 * EPS * np.ptp(exact["x"]))
    assert single["pressure"] == pytest.approx(exact["pressure"], rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", runs.RUNS)
def test_transfers_conserve_to_the_rounding_of_either(pair, name):
    """Mass, surfactant and momentum that E have from L: to eps in float32, nine digits better in float64."""
    kept = ("mass", "surfactant", "momentum")
    single, exact = ([float(found[f"{name}.{key}"]) for key in kept] for found in pair)
    print(f"{name}: {single} in float32, {exact} in float64")
    assert 1e-10 < max(single) < 4.0 * EPS
    assert max(exact) < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in runs.RUNS if name != "drainage"])
def test_gas_law_is_of_float64_in_both(pair, name):
    assert max(float(found[f"{name}.gas"]) for found in pair) < 1e-14


@pytest.mark.slow
def test_surface_holds_the_volume_of_the_gas_law(pair):
    """Found anew from a bubble at rest it is off by the rounding of positions; in float64 by the scheme alone."""
    single, exact = (float(found["rest.volume"]) for found in pair)
    assert single < EPS
    assert exact < 0.01 * single


@pytest.mark.slow
def test_stages_are_those_of_an_independent_float64(pair):
    """Curvature and gathered mass against `study.rounding`, which is NumPy: the C++ rows are double throughout."""
    for key in ("curvature", "gathered"):
        single, exact = (float(found[key]) for found in pair)
        assert 0.1 * EPS < single < 20.0 * EPS
        assert exact < 1e-14


@pytest.mark.slow
def test_checkpoint_is_read_in_the_other_precision(folder, device):
    simulation = Simulation(runs.scene("giant_bubble"))
    simulation.load_checkpoint(folder / "checkpoint.npz")
    with np.load(folder / "checkpoint.npz") as stored:
        assert stored["e.x"].dtype == np.float64
        assert np.array_equal(simulation.state.e.x.numpy(), stored["e.x"].astype(np.float32))


@pytest.mark.slow
def test_cache_is_float32_and_says_where_it_is_from(folder):
    assert not check_cache(folder / "cache")
    assert "+float64" in (folder / "cache" / "film.usda").read_text()


@pytest.mark.slow
def test_knob_runs_a_case_in_float64():
    """The same error but for rounding, 6e-8 R of some 1e-2 R in each of some hundred steps; twice the bytes."""
    case, points = CASES["oscillation"].scaled(0.25), (tradeoff.STANDARD, KNOBS["precision"]["64"])
    single, exact = (tradeoff.measure("oscillation", "", "", q, case) for q in points)
    assert exact.changes == {"precision": 64}
    assert exact.error == pytest.approx(single.error, abs=1e-4)
    assert exact.error != single.error
    assert 1.5 < exact.bytes / single.bytes < 2.0


@pytest.mark.parametrize(
    ("single", "expected"),
    [
        ("x = wp.zeros(3, dtype=wp.vec3), wp.float32, wp.mat33, wp.vec2f, wp.vec3d, wp.int32", None),
        ("y = 0.5 * float(a)  # of the host", "y = 0.5 * float(a)  # of the host"),
        ("HALF = wp.constant(0.5)", "HALF = wp.constant(double_constant(0.5))"),
        ("g = wp.HashGrid(\n8, 8, 8,\n)", "g = wp.HashGrid(\n8, 8, 8, dtype=wp.float64,\n)"),
        (
            "a, b = wp.ones(1, dtype=float), np.ones(1, dtype=float)",
            "a, b = wp.ones(1, dtype=wp.float64), np.ones(1, dtype=float)",
        ),
        ("@wp.func\ndef f(a: wp.array(dtype=float)): ...", "@wp.func\ndef f(a: wp.array(dtype=wp.float64)): ..."),
        (
            "@wp.func\ndef f(a: float) -> float:\n    é = 2; return 0.5 * a + wp.randf(s)",
            "@wp.func\ndef f(a: wp.float64) -> wp.float64:\n"
            "    é = 2; return wp.float64(0.5) * a + wp.float64(wp.randf(s))",
        ),
        ("@wp.struct\nclass C:\n    a: float", "@wp.struct\nclass C:\n    a: wp.float64"),
        ("@dataclass\nclass C:\n    a: float = 1.0", "@dataclass\nclass C:\n    a: float = 1.0"),
        (
            '@wp.func_native(f"""{ROW}\n""")\ndef f(): ...',
            '@wp.func_native(double_snippet(f"""{ROW}\n"""))\ndef f(): ...',
        ),
    ],
)
def test_source_is_rewritten_in_place(single, expected):
    doubled = "x = wp.zeros(3, dtype=wp.vec3d), wp.float64, wp.mat33d, wp.vec2d, wp.vec3d, wp.int32"
    assert double.rewrite(single) == (expected or doubled)


def test_snippets_are_rewritten():
    code = "const float* q; float a = 1.5f * sqrtf(x) + 2.0e-3f + 6.f;"
    assert double.double_snippet(code) == "const double* q; double a = 1.5 * sqrt(x) + 2.0e-3 + 6.;"
    with pytest.raises(ValueError, match="cannot be made double"):
        double.double_snippet("wp::float32 a;")


def test_kernels_take_no_constants_of_warp():
    """Those are float32 in either precision, and do not multiply with float64."""
    found = [path.name for path in Path(runs.kernels.__path__[0]).glob("*.py") if "wp.pi" in path.read_text().lower()]
    assert not found


def test_other_precisions_are_refused(monkeypatch):
    monkeypatch.setenv(double.VARIABLE, "16")
    with pytest.raises(InputError, match="MELP_WARP_PRECISION must be 32 or 64, got '16'"):
        double.install()
