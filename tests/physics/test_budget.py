"""The energy budget: exact exchanges, schemes' losses by formula, drag's work; and that it changes nothing."""

import json

import numpy as np
import pytest

from melp_warp import validation as v
from melp_warp.cli import main
from melp_warp.material import Material, Surroundings
from melp_warp.scene import Scene
from melp_warp.shapes import Rectangle, displaced_sphere
from melp_warp.simulation import Simulation

R = 0.05


def ring(scheme, steps_per_period, periods, **scene):
    """A bubble of 600 E that rings in a vacuum, and its ledger a period later."""
    period = 2.0 * np.pi / v.oscillation_frequency(2, R, v.CLEAN, "none")
    legendre = np.polynomial.legendre.Legendre.basis(2)
    dt = period / steps_per_period
    numerics = v.Numerics(scheme=scheme, redistribution=0.0)
    shape = displaced_sphere(R, lambda d: 0.05 * legendre(d[:, 1]))
    made = Scene("ring", shape, 600, material=v.CLEAN, numerics=numerics, dt=dt, fps=0.5 / dt, **scene)
    simulation = Simulation(made)
    for _ in range(round(0.5 * periods * steps_per_period)):
        simulation.advance_frame()
    return simulation


def wave(frames=12, amplitude=0.1, **options):
    """A standing Marangoni wave on a flat film, a quarter of a period or so."""
    material = Material()
    k = np.pi / 0.2
    dt = 2.0 * np.pi / (v.elastic_speed(material) * k) / 40.0

    def profile(x):
        return 1.0 + amplitude * np.cos(k * (x[:, 0] + 0.1))

    scene = Scene(
        "wave",
        Rectangle(0.2, 0.1),
        288,
        6,
        material=material,
        thickness=lambda x: material.thickness * profile(x),
        concentration=lambda x: material.surfactant * profile(x),
        dt=dt,
        fps=1.0 / dt,
        **options,
    )
    simulation = Simulation(scene)
    for _ in range(frames):
        simulation.advance_frame()
    return simulation


def test_the_midpoint_rule_keeps_the_energy_of_a_ringing_bubble():
    """Kinetic and free energy change into one another: the schemes take nothing, the rest is that of 600 cells."""
    ledger = ring("trapezoid", 40.0, 1.0).ledger
    assert ledger.moved > 2e-6
    assert abs(ledger.flows["membrane"]) < 1e-3 * ledger.moved
    assert ledger.share < 0.01


def test_backward_eulers_loss_is_that_of_a_linear_oscillator():
    """A period of n steps leaves (1 + (2 pi/n)^2)^-n of the energy; the formula books what is gone.

    The energy at the start is the largest kinetic energy of the midpoint rule. The last step of a frame is not booked.
    """
    n = 160.0
    energy = ring("trapezoid", 40.0, 0.5).ledger.moved
    ledger = ring("backward_euler", n, 1.0).ledger
    assert ledger.flows["membrane"] / energy == pytest.approx(1.0 - (1.0 + (2.0 * np.pi / n) ** 2) ** -n, rel=0.05)
    assert ledger.share < 0.01


def test_a_marangoni_wave_keeps_kinetic_and_free_energy():
    """sigma A alone is no energy here: the free energy with the surfactant's entropy is what motion is paid from."""
    ledger = wave().ledger
    assert ledger.stores["kinetic"] > 0.5 * ledger.moved
    assert ledger.share < 0.01


def test_what_drag_takes_is_booked():
    """A damped wave: what kinetic and free energy lose together is the work of the drag."""
    ledger = wave(surroundings=Surroundings(drag=1e-3)).ledger
    assert ledger.flows["drag"] > 0.05 * ledger.moved
    assert ledger.share < 0.01


def test_the_budget_changes_no_bit():
    """With it and without it the states are the same, and without it nothing is made."""
    with_it, without = (wave(frames=3, budget=budget) for budget in (True, False))
    a, b = with_it.state.numpy(), without.state.numpy()
    assert all(np.array_equal(a[key], b[key]) for key in b)
    assert set(a) - set(b) == {"memory.part", "memory.lying", "memory.book"}
    assert without.stepper.budget is None and without.ledger is None
    assert "budget" not in without.diagnostics()
    bubbles = [ring("trapezoid", 40.0, 0.1, budget=budget).state.numpy() for budget in (True, False)]
    assert all(np.array_equal(bubbles[0][key], bubbles[1][key]) for key in bubbles[1])


RUN = ["run", "oscillating_bubble", "--set", "e_count=300", "redistribution=0", "--frames", "3", "--quiet"]


def test_report_prints_a_table(tmp_path, capsys):
    """Table and picture of a run; one that kept no budget is refused with a line."""
    assert main([*RUN, "--out", str(tmp_path / "a")]) == 0
    last = json.loads((tmp_path / "a" / "run.jsonl").read_text().splitlines()[-1])["budget"]
    assert last["moved"] > 0.0
    capsys.readouterr()
    code = main(["report", str(tmp_path / "a")])
    said = capsys.readouterr()
    assert "kinetic" in said.out and "unexplained" in said.out
    if code == 0:
        assert (tmp_path / "a" / "budget.png").is_file()
    else:
        assert code == 2 and "matplotlib" in said.err
    assert main([*RUN, "--no-budget", "--out", str(tmp_path / "b")]) == 0
    assert "budget" not in json.loads((tmp_path / "b" / "run.jsonl").read_text().splitlines()[-1])
    assert main(["report", str(tmp_path / "b")]) == 2


def test_the_lines_of_the_log_add_up():
    """Stores less those at the start, and what the flows took, leave the rest that is written."""
    simulation = wave(frames=3, surroundings=Surroundings(drag=1e-3))
    line = simulation.diagnostics()["budget"]
    left = sum(line["stores"].values()) - sum(line["start"].values()) - sum(line["work"].values())
    left += sum(line["dissipation"].values()) + sum(line["losses"].values())
    assert left == pytest.approx(line["rest"], abs=1e-9 * line["moved"])


def test_drawing_without_matplotlib_is_refused_in_a_line(tmp_path, capsys, monkeypatch):
    """The table is printed all the same; no traceback, exit code 2."""
    assert main([*RUN, "--out", str(tmp_path / "a")]) == 0
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["report", str(tmp_path / "a")]) == 2
    said = capsys.readouterr()
    assert "kinetic" in said.out and said.err.count("\n") == 1 and "melp-warp[plot]" in said.err


def test_a_large_rest_fails_a_strict_run(tmp_path, monkeypatch):
    """What is beyond the bound is noted, and --strict ends with 1."""
    monkeypatch.setattr("melp_warp.budget.UNEXPLAINED", 1e-9)
    assert main([*RUN, "--strict", "--out", str(tmp_path / "a")]) == 1
    assert "energy budget" in json.loads((tmp_path / "a" / "run.jsonl").read_text().splitlines()[-1])["notices"]
