"""The air far from a sphere: its linear theory ends, which is told, and no energy is made."""

import numpy as np
import pytest

from melp_warp.registry import load_scene
from melp_warp.simulation import Simulation
from melp_warp.stages import air_range


def ringing(**overrides) -> Simulation:
    """An oscillating bubble in air, of E alone."""
    script = load_scene("oscillating_bubble")
    given = {"air": "added_mass", "e_count": 900, "l_per_e": 0, "surfactant": 0.0, **overrides}
    return Simulation(script.build(script.parameters.values(given)))


def energy(simulation: Simulation, monkeypatch) -> float:
    """Surface energy and kinetic energy of the normal motion, film and air, J."""
    probe = simulation.stepper.air_range
    before = probe.found.numpy()
    with monkeypatch.context() as patch:
        patch.setattr(air_range, "SLOPE", -1.0)  # measured whatever the slope
        probe.measure()
    kinetic = probe.found.numpy()[int(air_range.ka.BEFORE)]
    probe.found.assign(before)
    return 2.0 * simulation.scene.material.tension * simulation.diagnostics()["area"] + float(kinetic)


@pytest.mark.parametrize(
    ("mode", "amplitude"),
    [(4, 0.5), (6, 0.3), *(pytest.param(*case, marks=pytest.mark.slow) for case in [(2, 0.5), (3, 0.3)])],
)
def test_the_air_makes_no_energy(mode, amplitude, monkeypatch):
    """Total energy never rises above that of the start by 0.1 % of what can move, the area beyond a sphere's.

    The film starts at rest, so it starts with the most that it ever has.
    """
    simulation = ringing(mode=mode, amplitude=amplitude)
    tension = 2.0 * simulation.scene.material.tension
    gas = simulation.diagnostics()
    start, sphere = tension * gas["area"], tension * (36.0 * np.pi * gas["volume"] ** 2) ** (1.0 / 3.0)
    for _ in range(40):
        simulation.advance_frame()
        assert energy(simulation, monkeypatch) < start + 1e-3 * (start - sphere)


def test_range_is_told():
    """A steep film is noticed, one that rings a little is not."""
    steep, gentle = ringing(mode=4, amplitude=0.5), ringing(mode=2, amplitude=0.05)
    for simulation in (steep, gentle):
        simulation.advance_frame()
    assert "air beyond its range" in steep.notices.of_frame
    assert "air beyond its range" not in gentle.notices.of_frame
