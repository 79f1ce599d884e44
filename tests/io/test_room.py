"""What cannot fit is refused before anything is made."""

import time

import pytest

from melp_warp import cli
from melp_warp.errors import InputError
from melp_warp.program.estimate import array_bytes, measure_cost
from melp_warp.program.room import LEAST_E, LEAST_L, Written, parse_size, size_text
from melp_warp.registry import load_scene
from melp_warp.simulation import Simulation

FEW = ["--set", "e_count=300", "l_per_e=2", "--frames", "3", "--quiet"]


def one_line(capsys, *words):
    error = capsys.readouterr().err
    assert error.startswith("melp-warp: error: ")
    assert error.count("\n") == 1
    for word in words:
        assert word in error


@pytest.mark.parametrize(("text", "size"), [("500", 500.0), ("4kB", 4e3), ("1.5 GB", 1.5e9), ("2T", 2e12)])
def test_sizes(text, size):
    assert parse_size("--max-disk", text) == size


@pytest.mark.parametrize("text", ["", "0", "-1GB", "1e9", "4 GiB", "much", "1,5GB"])
def test_what_is_no_size(text, tmp_path, capsys):
    with pytest.raises(InputError, match="--max-disk must be a size"):
        parse_size("--max-disk", text)
    assert cli.main(["run", "giant_bubble", "--out", str(tmp_path / "out"), f"--max-memory={text}", *FEW]) == 2
    one_line(capsys, "--max-memory must be a size above 0 such as 500MB or 1.5GB")


@pytest.mark.parametrize("estimate", [[], ["--estimate"]])
def test_what_no_machine_holds_is_refused_at_once(estimate, tmp_path, capsys):
    """It was still placing particles after 90 s."""
    began = time.perf_counter()
    huge = ["--quiet", "--set", "e_count=10000000", "l_per_e=1000"]
    assert cli.main(["run", "giant_bubble", "--out", str(tmp_path / "out"), *huge, *estimate]) == 2
    assert time.perf_counter() - began < 30.0
    one_line(capsys, "10,000,000 E and 10,000,000,000 L", "few enough for the memory of cpu")
    assert not (tmp_path / "out").exists()


def test_limits_of_a_run(tmp_path, capsys):
    out = tmp_path / "out"
    run = ["run", "giant_bubble", "--out", str(out), *FEW]
    need = 300 * LEAST_E + 600 * LEAST_L
    assert cli.main([*run, "--max-memory", str(need - 1)]) == 2
    one_line(capsys, "300 E and 600 L", "few enough for --max-memory, 1.08 MB")
    assert cli.main([*run, "--max-disk", "100kB"]) == 2
    one_line(capsys, "about 623 kB with checkpoints", "few enough for --max-disk, 100 kB")
    assert not out.exists()
    assert cli.main([*run, "--max-memory", str(need), "--max-disk", "650kB"]) == 0


@pytest.mark.parametrize("name", ["giant_bubble", "oscillating_bubble", "drainage", "double_bubble"])
def test_arrays_take_no_less(name, device):
    """What is refused cannot run: the arrays of a scene take what is told or more."""
    script = load_scene(name)
    keys = {"e_count": 300} | ({"l_per_e": 16} if script.parameters.defaults["l_per_e"] else {})
    simulation = Simulation(script.build(script.parameters.values(keys)))
    film = simulation.film
    assert array_bytes(simulation) > LEAST_E * film.n_e + LEAST_L * film.n_l


def test_meshes_on_the_disk(tmp_path):
    """What is told of a cache with meshes is no less than half of what it takes, and no more than twice."""
    out = tmp_path / "out"
    assert cli.main(["run", "giant_bubble", "--out", str(out), "--mesh", "--triangles", "4000", *FEW]) == 0
    taken = sum(path.stat().st_size for path in (out / "frames").iterdir()) - 4 * 4000
    told = Written(mesh=True, triangles=4000).cache_bytes(0, 600, 4)
    assert size_text(told) == "741 kB"
    assert 0.5 < told / taken < 2.0


def test_many_l_do_not_put_the_estimate_below_what_e_resolve(monkeypatch, device):
    """With many L an E the film that was measured had too few E, and e_count was blamed."""
    monkeypatch.setattr("melp_warp.program.estimate.PARTICLES", 1000)
    script = load_scene("giant_bubble")
    found = measure_cost(script.build(script.parameters.values({"e_count": 800, "l_per_e": 40})))
    assert found.measured == 0.5
    assert found.load > 0.0
