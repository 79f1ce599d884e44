"""Qualities: what they change, that they run on every scene, and estimates of what a run costs."""

import gc

import numpy as np
import pytest
import warp as wp

from melp_warp import cli
from melp_warp.errors import InputError
from melp_warp.program.estimate import array_bytes, measure_cost
from melp_warp.program.room import Written
from melp_warp.quality import QUALITIES, Quality, find_quality
from melp_warp.registry import load_scene, scene_names
from melp_warp.simulation import Simulation
from melp_warp.stepping.sampling import make_film
from melp_warp.usd.reading import read_metadata


@pytest.fixture(autouse=True)
def few_steps(monkeypatch):
    """Estimates take as few steps as they can."""
    monkeypatch.setattr("melp_warp.program.estimate.SECONDS", 0.0)


def values(name, quality, **given):
    return QUALITIES[quality].values(load_scene(name), given)


@pytest.mark.parametrize("name", scene_names())
def test_standard_is_the_scene_itself(name):
    script = load_scene(name)
    assert values(name, "standard").as_dict() == script.parameters.values().as_dict()


@pytest.mark.parametrize("name", scene_names())
@pytest.mark.parametrize("quality", ["draft", "paper"])
def test_every_scene_takes_the_coarsest_qualities(name, quality, device):
    """The scene can be set up with the fewest E and with the widest support; few L."""
    script = load_scene(name)
    p = values(name, quality)
    film, _ = make_film(script.build(script.parameters.values({**p.as_dict(), "l_per_e": min(1, p.l_per_e)})), device)
    assert film.numerics.support == p.support


@pytest.mark.parametrize("name", scene_names())
def test_draft_is_coarser_and_fine_is_finer(name):
    draft, standard, fine = (values(name, q) for q in ("draft", "standard", "fine"))
    assert draft.e_count <= standard.e_count < fine.e_count
    assert draft.l_per_e <= standard.l_per_e <= fine.l_per_e
    assert draft.cfl > standard.cfl > fine.cfl


@pytest.mark.parametrize("name", ["giant_bubble", "double_bubble"])
def test_paper_has_the_papers_settings(name):
    """Support 4 and SPH operators (21), relaxed Jacobi (Appendix B), 16 L an E, CFL 0.99, of foams 0.33 (6.3)."""
    p = values(name, "paper")
    assert (p.support, p.solver, p.l_per_e, p.dt) == (4.0, "jacobi", 16, None)
    cfl, curvature = {"giant_bubble": (0.99, "sph"), "double_bubble": (0.33, None)}[name]
    assert p.cfl == cfl
    assert p.as_dict().get("curvature") == curvature


def test_factors_are_relative_to_the_scene():
    defaults = load_scene("giant_bubble").parameters.defaults
    changed = Quality(e=0.5, l=0.25, step=2.0, keys={"skin": 0.3}).apply(defaults)
    same_factor_of_time = pytest.approx(1.98 * 0.5**0.5)
    assert changed == {
        "e_count": 1000,
        "l_per_e": 4,
        "dt": pytest.approx(1 / 60),
        "cfl": same_factor_of_time,
        "skin": 0.3,
    }
    assert Quality(l=0.0).apply(defaults) == {"l_per_e": 1}
    assert Quality(l=4.0).apply(load_scene("oscillating_bubble").parameters.defaults) == {}


def test_keys_that_are_given_override_the_quality(tmp_path):
    out = tmp_path / "run"
    options = ["--quality", "draft", "--frames", "0", "--quiet", "--out", str(out), "--set", "l_per_e=3"]
    assert cli.main(["run", "equilibrium", *options]) == 0
    parameters = read_metadata(out)["parameters"]
    assert parameters["l_per_e"] == 3
    assert parameters["e_count"] == values("equilibrium", "draft").e_count < 1050


def test_unknown_quality(capsys):
    assert cli.main(["run", "equilibrium", "--quality", "best"]) == 2
    error = capsys.readouterr().err
    assert "--quality must be one of draft, standard, fine, paper, got 'best'" in error
    with pytest.raises(InputError):
        find_quality("")


def test_scenes_lists_what_a_quality_changes(capsys):
    assert cli.main(["scenes", "equilibrium"]) == 0
    listed = capsys.readouterr().out.split("What --quality changes:")[1].splitlines()
    rows = {line.split()[0]: line.split()[1:] for line in listed if line}
    assert rows["key"] == list(QUALITIES)
    assert rows["e_count"] == [str(values("equilibrium", q).e_count) for q in QUALITIES]


def small(name="giant_bubble", **given):
    script = load_scene(name)
    return script.build(script.parameters.values({"e_count": 250, "l_per_e": 4, "frames": 3, **given}))


def test_array_bytes_counts_every_array_once(device):
    """All Warp arrays that making a simulation leaves behind, found by the garbage collector instead."""
    gc.collect()
    before = {id(a) for a in gc.get_objects() if isinstance(a, wp.array)}
    simulation = Simulation(small())
    gc.collect()
    made = [a for a in gc.get_objects() if isinstance(a, wp.array) and id(a) not in before]
    known = sum({a.ptr: a.capacity for a in made if a.ptr}.values())
    assert array_bytes(simulation) == pytest.approx(known, rel=0.02)


def test_estimate_against_a_run(tmp_path, device):
    """Steps are those that the run takes, disk within a quarter of the folder that it writes."""
    scene = small(dt=1.0 / 180.0)
    found = measure_cost(scene)
    assert (found.e_count, found.l_count, found.measured) == (250, 1000, 1.0)
    assert (found.steps, found.dt) == (9, pytest.approx(1.0 / 180.0))
    assert found.memory == array_bytes(Simulation(scene))
    out = tmp_path / "run"
    settings = ["e_count=250", "l_per_e=4", f"dt={1.0 / 180.0}", "frames=3", "seed=1"]
    assert cli.main(["run", "giant_bubble", "--quiet", "--out", str(out), "--set", *settings]) == 0
    written = sum(f.stat().st_size for f in (out / "frames").iterdir()) + (out / "run.jsonl").stat().st_size
    assert found.disk == Written().cache_bytes(250, 1000, 4)
    assert written == pytest.approx(found.disk, rel=0.25)
    kept = sum(f.stat().st_size for f in out.glob("checkpoint*.npz"))
    assert found.beside == Written().other_bytes(250, 1000)
    assert kept == pytest.approx(2.0 / 3.0 * found.beside, rel=0.5)


def test_estimate_of_a_scene_that_is_measured_smaller(monkeypatch, device):
    """Memory in proportion is within 15 % of what the arrays of the whole scene take."""
    scene = small(e_count=600)
    monkeypatch.setattr("melp_warp.program.estimate.PARTICLES", 1500)
    monkeypatch.setattr("melp_warp.program.estimate.FEWEST_E", 1)
    found = measure_cost(scene)
    assert found.measured == 0.5
    assert found.e_count == 600
    assert found.memory == pytest.approx(array_bytes(Simulation(scene)), rel=0.15)


@pytest.mark.parametrize("name", ["equilibrium", "double_bubble"])
def test_estimate_writes_nothing(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    few = ["--set", "e_count=300", "l_per_e=1", "--frames", "2"]
    assert cli.main(["run", name, "--estimate", *few]) == 0
    assert list(tmp_path.iterdir()) == []
    told = capsys.readouterr().out
    rows = {line.split("  ")[0].strip(): line for line in told.splitlines()}
    assert set(rows) == {"particles", "memory", "a step", "steps", "whole run", "load", "on disk"}
    assert np.all([any(c.isdigit() for c in line) for line in rows.values()])
