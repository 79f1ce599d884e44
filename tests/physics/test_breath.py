"""Gas that comes and goes: Young-Laplace while a bubble is blown up, the law of an opening that is held open."""

import math

import numpy as np
import pytest

from melp_warp.errors import InputError
from melp_warp.material import Material, Surroundings
from melp_warp.scene import Scene
from melp_warp.shapes import Rectangle, Sphere
from melp_warp.simulation import Simulation
from melp_warp.stepping.breath import CONTRACTION

RADIUS = 0.04
SOAP = Material(thickness=1e-6)


def departure(simulation):
    """Radius (m), and pressure over 4 sigma/R less 1."""
    gas = simulation.state.gas.numpy()[0]
    radius = float(np.cbrt(3.0 * gas[0] / (4.0 * math.pi)))
    simulation.stepper.fields.update()
    sigma = SOAP.tension - SOAP.rt * SOAP.surfactant * float(simulation.stepper.fields.gamma.numpy().mean())
    return radius, gas[1] * radius / (4.0 * sigma) - 1.0


@pytest.mark.parametrize("air", [pytest.param("none", marks=pytest.mark.slow), "added_mass"])
def test_a_bubble_is_blown_up_to_twice_its_radius(air):
    """4 sigma/R on the way to 0.5 %, even E, all liquid there, spacing as of the film's size."""
    gas = ((2.0, 8.0),)
    scene = Scene("film", Sphere(RADIUS), 600, 2, SOAP, Surroundings(air=air), gas=gas, fps=15, frames=32, dt=1 / 240)
    simulation = Simulation(scene)
    before, start = simulation.diagnostics(), simulation.film.spacing
    for _ in range(32):
        simulation.advance_frame()
        radius, error = departure(simulation)
        assert abs(error) < 0.005
    assert radius == pytest.approx(2.0 * RADIUS, rel=1e-3)
    after = simulation.diagnostics()
    assert after["mass"] == pytest.approx(before["mass"], rel=1e-6)
    assert after["surfactant"] == pytest.approx(before["surfactant"], rel=1e-6)
    density = simulation.stepper.geometry.density.numpy()
    assert math.sqrt(density.max() / density.min()) < 1.3
    assert simulation.film.spacing == pytest.approx(2.0 * start, rel=0.05)
    assert after["thickness_mean"] == pytest.approx(0.25 * before["thickness_mean"], rel=0.01)


def test_the_error_of_the_pressure_is_of_first_order_in_the_step():
    errors = []
    for steps in (60, 120, 240):
        scene = Scene("film", Sphere(RADIUS), 300, 0, SOAP, gas=((2.0, 8.0),), fps=30, dt=1.0 / steps)
        simulation = Simulation(scene)
        for _ in range(15):
            simulation.advance_frame()
        errors.append(departure(simulation)[1])
    assert 1.7 < errors[0] / errors[1] < 2.3
    assert 1.7 < errors[1] / errors[2] < 2.3


def test_gas_leaves_through_an_opening():
    """R^(7/2) falls linearly in time, with the slope (7/2) C A sqrt(8 sigma/rho_air)/(4 pi): 3 %."""
    area = 3e-5
    simulation, places = Simulation(Scene("film", Sphere(RADIUS), 600, 2, SOAP, opening=area, fps=30)), []
    for _ in range(30):
        simulation.advance_frame()
        places.append((simulation.time, departure(simulation)[0] ** 3.5))
    times, power = np.array(places).T
    density = simulation.scene.surroundings.air_density
    wanted = 3.5 * CONTRACTION * area * math.sqrt(8.0 * SOAP.film_tension / density) / (4.0 * math.pi)
    assert np.polyfit(times, power, 1)[0] == pytest.approx(-wanted, rel=0.03)
    assert power[-1] < 0.9 * power[0]


def test_a_run_goes_on_while_it_is_blown_up(tmp_path):
    """Same bits from a checkpoint."""
    scene = Scene("film", Sphere(RADIUS), 300, 2, SOAP, gas=((0.3, 3.0),), fps=30, frames=10)
    run = Simulation(scene)
    for _ in range(5):
        run.advance_frame()
    run.save_checkpoint(tmp_path / "half.npz")
    other = Simulation(scene, checkpoint=tmp_path / "half.npz")
    for _ in range(4):
        run.advance_frame()
        other.advance_frame()
    for name, array in run.state.numpy().items():
        np.testing.assert_array_equal(array, other.state.numpy()[name], err_msg=name)


def test_gas_that_cannot_be_is_refused():
    for gas in (((0.0, -1.0),), ((1.0, 2.0), (0.5, 1.0)), ((-1.0, 2.0),)):
        with pytest.raises(InputError, match="gas must be times that rise"):
            Scene("film", Sphere(RADIUS), 300, gas=gas)
    with pytest.raises(InputError, match="gas must be none but for a closed single film"):
        Scene("film", Rectangle(0.1, 0.1), 300, 2, gas=((1.0, 2.0),))
    with pytest.raises(InputError, match="opening must be 0 where gas is given"):
        Scene("film", Sphere(RADIUS), 300, gas=((1.0, 2.0),), opening=1e-5)
