"""Each socket is used from a file outside the package: it runs, goes on, is exported, and costs nothing if absent."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from melp_warp import AirModel, Simulation, cli, load_scene, read_frame
from melp_warp.stepping.parts import kernel_files
from melp_warp.usd.check import check_cache

FOLDER = Path(__file__).parent
SOCKETS = ("force", "carried", "stage", "particle_set", "air_model")
PLAIN = {"forces": (), "carried": (), "stages": (), "sets": (), "air_model": AirModel()}
ACT = ("force", "air_model")


def run(out, name, *more):
    return cli.main(["run", str(FOLDER / f"{name}.py"), "--out", str(out), "--quiet", "--export", "both", *more])


@pytest.mark.parametrize("name", [*SOCKETS, "writer"])
def test_a_file_is_short(name):
    assert len((FOLDER / f"{name}.py").read_text().splitlines()) <= 60


@pytest.mark.parametrize("name", SOCKETS)
def test_it_runs_goes_on_and_is_exported(device, tmp_path, name):
    """A run that is stopped and resumed writes what one in a go does, to the byte, and the cache is sound."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert run(whole, name, "--frames", "3") == 0
    assert run(parts, name, "--frames", "1") == 0
    assert run(parts, name, "--frames", "3", "--resume") == 0
    for frame in range(4):
        files = [folder / "frames" / f"film.{frame:06d}.usdc" for folder in (whole, parts)]
        assert files[0].read_bytes() == files[1].read_bytes(), frame
    assert check_cache(whole) == [] and check_cache(parts) == []
    lines = [json.loads((folder / "run.jsonl").read_text().splitlines()[-1]) for folder in (whole, parts)]
    assert lines[0].get(name) == lines[1].get(name)


@pytest.mark.parametrize("name", SOCKETS)
def test_without_it_nothing_is_there(device, name):
    """No array, no stage, no kernel; and what does not act on the film leaves its bits."""
    scene = load_scene(str(FOLDER / f"{name}.py")).scene()
    with_it, without = Simulation(scene), Simulation(replace(scene, **PLAIN))
    for simulation in (with_it, without):
        simulation.advance_frame()
    state, stepper = without.state, without.stepper
    assert (state.carried, state.sets, state.remembered, stepper.extras) == ({}, {}, {}, [])
    assert stepper.forces.hold is None and stepper.carriage is None
    assert "carried" not in kernel_files(without.film.features)
    assert set(without.stepper.wall) <= set(with_it.stepper.wall)
    if name not in ACT:
        for key, array in state.numpy().items():
            assert np.array_equal(array, with_it.state.numpy()[key]), key


def test_what_they_do(device, tmp_path):
    """The wind blows, dye stays, the stage counts, dust sinks: all by the numbers."""
    for name in SOCKETS:
        assert run(tmp_path / name, name, "--frames", "3") == 0
    lines = {name: json.loads((tmp_path / name / "run.jsonl").read_text().splitlines()[-1]) for name in SOCKETS}
    assert lines["force"]["momentum"][0] > 0.2 * 0.5 * lines["force"]["mass"]
    assert lines["force"]["budget"]["work"]["push"] > 0.0
    first = json.loads((tmp_path / "carried" / "run.jsonl").read_text().splitlines()[0])
    assert lines["carried"]["carried"]["dye"] == pytest.approx(first["carried"]["dye"], rel=1e-6)
    assert read_frame(tmp_path / "carried", 3).carried["dye"].max() > 0.0
    assert lines["stage"]["fall"]["longest"] == pytest.approx(3 / 60, rel=0.1)
    start, end = (read_frame(tmp_path / "particle_set", frame, "Dust") for frame in (0, 3))
    assert end.points - start.points == pytest.approx(np.tile([0.0, -0.3 * 3 / 60, 0.0], (40, 1)), abs=1e-6)
    assert end.widths == pytest.approx(1e-3)


def ringing(scene, frames):
    """Period of the mode P2, s: that of the sine which fits its speed best."""
    simulation, times, speeds = Simulation(scene), [], []
    for _ in range(frames):
        simulation.advance_frame()
        n = simulation.state.e.normal.numpy()
        shape = simulation.stepper.geometry.area.numpy() * (3.0 * n[:, 1] ** 2 - 1.0)
        times.append(simulation.time)
        speeds.append(shape @ (simulation.state.e.u.numpy() * n).sum(axis=1))
    periods = np.linspace(0.02, 0.06, 801)
    phases = [2.0 * np.pi * np.array(times) / period for period in periods]
    rests = [np.linalg.lstsq(np.stack([np.cos(p), np.sin(p)], 1), np.array(speeds), rcond=None)[1][0] for p in phases]
    return periods[int(np.argmin(rests))]


def test_an_air_model(device):
    """The bubble rings with the mass that the model gives: 2 pi sqrt((m + A) R^2/(8 sigma)), within 0.4 %.

    The air of the package, of both sides, makes it 27 % slower.
    """
    scene = load_scene(str(FOLDER / "air_model.py")).scene()
    radius, material, density = 0.03, scene.material, scene.surroundings.air_density
    for model, air in ((scene.air_model, density * radius / 2.0), (AirModel(), density * radius * 5.0 / 6.0)):
        exact = 2.0 * np.pi * radius * np.sqrt((material.areal_mass + air) / (8.0 * material.film_tension))
        assert ringing(replace(scene, air_model=model), 40) == pytest.approx(exact, rel=4e-3)


def test_a_writer(device, tmp_path):
    """Frames besides the cache, over a stop too; see tests/io/test_writers.py for more."""
    named = f"{FOLDER / 'writer.py'}:Text"
    assert run(tmp_path / "out", "carried", "--frames", "1", "--writer", named) == 0
    assert run(tmp_path / "out", "carried", "--frames", "3", "--resume") == 0
    found = [np.loadtxt(path) for path in sorted((tmp_path / "out" / "writers" / "Text").glob("*.txt"))]
    assert len(found) == 4
    points = read_frame(tmp_path / "out", 3, "FilmE").points
    assert found[3][:, :3] == pytest.approx(points, abs=1e-7)
