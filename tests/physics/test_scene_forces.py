"""Forces that scenes bring along, and numbers that change in time, against what theory gives."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from melp_warp import Disc, Force, InputError, Keyframes, Scene, Simulation, Sphere, Surroundings, load_scene
from melp_warp.device.float64 import VARIABLE
from melp_warp.kernels.forces import hold_of
from melp_warp.numerics import Numerics
from melp_warp.stages.forces import fuse
from tests.kernels.test_cuda import ARCHITECTURES

WIND, RATE = 0.5, 20.0
FACTOR = wp.constant(2.0)


@wp.func
def wind(x: wp.vec3, t: float, u: wp.vec3, eta: float, speed: float, rate: float):
    """A wind along x that takes the film along."""
    return rate * (wp.vec3(speed, 0.0, 0.0) - u), rate


@wp.func
def swing(x: wp.vec3, t: float, u: wp.vec3, eta: float):
    """An acceleration that grows with time, along y."""
    return wp.vec3(0.0, FACTOR * t, 0.0), 0.0


@wp.func
def spring(x: wp.vec3, t: float, u: wp.vec3, eta: float):
    """Towards the plane x = 1 of the scene's coordinates."""
    return wp.vec3(10.0 * (1.0 - x[0]), 0.0, 0.0), 0.0


def blown(rate=RATE, speed=WIND, **numbers):
    """A bubble in the wind."""
    scene = Scene("blown", Sphere(0.03), **{"e_count": 200, "l_per_e": 0, "fps": 60.0, **numbers})
    return replace(scene, forces=[Force(wind, speed=speed, rate=rate)])


def after(scene, frames):
    simulation = Simulation(scene)
    for _ in range(frames):
        simulation.advance_frame()
    return simulation


def relative_momentum(simulation):
    told = simulation.diagnostics()
    return np.array(told["momentum"]) / told["mass"]


CARRIERS = {
    "E alone": {},
    "two layers": {"l_per_e": 4},
    "single layer": {"numerics": Numerics(layers=1)},
    "trapezoid": {"numerics": Numerics(scheme="trapezoid")},
}


@pytest.mark.parametrize("name", CARRIERS)
@pytest.mark.parametrize("rate", [RATE, 1e4])
def test_a_bubble_takes_up_the_wind(device, name, rate):
    """w (1 - exp(-r t)), exact whatever the step: rates of 1/3 and of 170 a step.

    What is left is how L and E share momentum, and that the shape rings a little: within 0.3 %. A single layer finds
    its motion as a whole from its particles: under a steady force, gravity too, it is 1.7 % slow.
    """
    simulation = after(blown(rate, **CARRIERS[name]), 4)
    exact = WIND * -np.expm1(-rate * simulation.time)
    assert simulation.state.motion.numpy()[0] == pytest.approx(
        [exact, 0.0, 0.0], abs=(0.02 if name == "single layer" else 3e-3) * WIND
    )


def test_terminal_velocity(device):
    """Gravity and drag together: g/r, far from where a step of explicit drag is stable."""
    scene = replace(blown(1e3, 0.0, l_per_e=2), surroundings=Surroundings(gravity=(0.0, -9.81, 0.0)))
    simulation = after(scene, 3)
    assert relative_momentum(simulation)[1] == pytest.approx(-9.81e-3, rel=2e-3)


def test_air_takes_part(device):
    """With the air's mass A the bubble answers m/(m + A) times slower; a rate far above 1/dt is stable."""
    air = Surroundings(air="added_mass", air_drag=0.0)
    simulation = Simulation(blown(RATE, surroundings=air))
    mass = simulation.scene.material.areal_mass
    slow = RATE * mass / (mass + simulation.stepper.membrane.rigid_air)
    for _ in range(4):
        simulation.advance_frame()
    exact = WIND * -np.expm1(-slow * simulation.time)
    assert simulation.state.motion.numpy()[0, 0] == pytest.approx(exact, rel=0.02)
    stiff = after(blown(1e5, surroundings=air), 8)
    assert stiff.state.motion.numpy()[0, 0] == pytest.approx(WIND, rel=0.01)


@pytest.mark.parametrize("rate", [RATE, 1e4])
def test_foams_are_taken_along(device, rate):
    """Two bubbles without air take up the wind as one does; touching costs them less than 3 %."""
    scene = load_scene("double_bubble").scene(e_count=230, l_per_e=2, air="none", gravity=0.0, damping=0.0)
    simulation = after(replace(scene, forces=[Force(wind, speed=WIND, rate=rate)]), 5)
    exact = WIND * -np.expm1(-rate * simulation.time)
    assert relative_momentum(simulation)[0] == pytest.approx(exact, rel=0.03)


def test_flow_along_a_film_is_held_back(device):
    """Whirls in a frame decay as under the air's drag of the same rate, with circulation carried along."""
    scene = load_scene("taylor_vortices").scene(e_count=300, l_per_e=4)
    drag = replace(scene.surroundings, drag=2.0 * scene.material.areal_mass)
    by_drag = after(replace(scene, surroundings=drag), 5).diagnostics()
    by_force = after(replace(scene, forces=[Force(wind, speed=0.0, rate=2.0)]), 5)
    for name in ("kinetic_energy", "enstrophy"):
        assert by_force.diagnostics()[name] == pytest.approx(by_drag[name], rel=0.03)
    assert by_force.ledger.share < 1e-3


def test_time_and_place(device):
    """A force that grows with time moves the film at t^2; one that depends on the place knows the scene's, not ours.

    Far from the world's origin positions are measured from the film.
    """
    simulation = after(replace(blown(), forces=[swing]), 6)
    assert simulation.state.motion.numpy()[0, 1] == pytest.approx(simulation.time**2, rel=1e-4)

    simulation = Simulation(replace(blown(), forces=[spring]))
    simulation.state.origin = simulation.state.origin + np.array([0.9, 0.0, 0.0])
    simulation.step(1e-3)
    assert simulation.state.motion.numpy()[0, 0] == pytest.approx(10.0 * 0.1 * 1e-3, rel=1e-3)


def test_work_is_booked(device):
    """What the wind does is all of what the bubble's energy grows by."""
    simulation = after(blown(l_per_e=4), 6)
    ledger = simulation.ledger
    assert ledger.flows["push"] > 1e-8
    assert ledger.share < 0.01
    impulse = np.array(ledger.balance["momentum"])
    assert np.abs(impulse).max() < 0.01 * simulation.diagnostics()["mass"] * WIND


def test_gravity_by_keyframes(device):
    """Gravity that rises linearly: a free bubble falls at g t^2/2 over the ramp, and its work is booked."""
    ramp = Keyframes([(0.0, 0.0), (0.1, -9.81)])
    bubble = replace(blown(l_per_e=4, dt=1.0 / 240.0), forces=())
    simulation = after(replace(bubble, surroundings=Surroundings(gravity=(0.0, ramp, 0.0))), 6)
    assert simulation.state.motion.numpy()[0, 1] == pytest.approx(-9.81 * simulation.time**2 / 0.2, rel=1e-4)
    assert simulation.ledger.flows["push"] > 0.0
    assert simulation.ledger.share < 0.01
    same = after(replace(bubble, surroundings=Surroundings(gravity=(0.0, lambda t: -98.1 * t, 0.0))), 6)
    assert same.state.motion.numpy()[0, 1] == pytest.approx(simulation.state.motion.numpy()[0, 1], rel=1e-5)


def test_gravity_that_stays_is_gravity(device):
    """Keyframes of one value move the film, bit for bit, as the number does; height becomes work, to rounding."""
    for shape in (Disc(0.05), Sphere(0.03)):
        found = []
        for fall in (-9.81, Keyframes([(0.0, -9.81)])):
            scene = Scene("hung", shape, 200, 4, surroundings=Surroundings(gravity=(0.0, fall, 0.0)))
            found.append(after(scene, 3))
        for block in ("e", "l"):
            first, second = (getattr(one.state, block) for one in found)
            assert np.array_equal(first.u.numpy(), second.u.numpy())
            assert np.array_equal(first.x.numpy(), second.x.numpy())
        height, work = (one.ledger for one in found)
        lost = height.start["gravity"] - height.stores["gravity"]
        assert work.flows["push"] == pytest.approx(lost, rel=1e-3, abs=1e-3 * work.moved)
        assert work.rest == pytest.approx(height.rest, abs=1e-3 * work.moved)


@pytest.mark.parametrize("fast", [0.0, 1e-6, 0.019, 0.021, 1.0, 50.0])
def test_hold(device, fast):
    """z/(1 - exp(-z)), by its series near 0."""

    @wp.kernel(module="unique")
    def hold(z: float, out: wp.array(dtype=float)):
        out[0] = hold_of(z, 1.0)

    out = wp.zeros(1, dtype=float, device=device)
    wp.launch(hold, dim=1, inputs=[fast], outputs=[out], device=device)
    assert out.numpy()[0] == pytest.approx(fast / -np.expm1(-fast) if fast else 1.0, rel=1e-6)


def test_absent_costs_nothing(device):
    """Without forces: no arrays, no kernel, the mass itself for the inertia; a force of zero changes no bit."""
    none, zero = after(replace(blown(), forces=()), 2), after(blown(0.0), 2)
    forces = none.stepper.forces
    assert forces.hold is None and forces.rate is None and forces.still is forces.body
    assert forces.inertia is none.state.e.mass and forces.heavy is none.state.e.mass
    for name, array in none.state.numpy().items():
        assert np.array_equal(array, zero.state.numpy()[name]), name


def test_a_run_goes_on(device, tmp_path):
    """Bit for bit from a checkpoint; another function, or another number, is another scene."""
    scene = replace(blown(l_per_e=2, speed=Keyframes([(0.0, 0.0), (0.05, 1.0)])))
    simulation = after(scene, 2)
    simulation.save_checkpoint(tmp_path / "c.npz")
    simulation.advance_frame()
    again = Simulation(scene, checkpoint=tmp_path / "c.npz")
    again.advance_frame()
    for name, array in simulation.state.numpy().items():
        assert np.array_equal(array, again.state.numpy()[name]), name
    for other in ([swing], [Force(wind, speed=WIND, rate=RATE)], ()):
        with pytest.raises(InputError, match=r"forces\.0"):
            Simulation(replace(scene, forces=other), checkpoint=tmp_path / "c.npz")
        Simulation(replace(scene, forces=other), checkpoint=tmp_path / "c.npz", changed=True).advance_frame()


def test_what_tells_functions_apart(device):
    """Code and constants that a function refers to, whatever comments say."""
    assert Force(swing).digest == Force(swing).digest != Force(spring).digest
    assert Force.of(swing).describe() == {"function": f"swing {Force(swing).digest}"}
    assert Force(wind, rate=1.0, speed=2.0).describe()["speed"] == 2.0


@wp.func
def three(x: wp.vec3, t: float, u: wp.vec3):
    """Too few arguments."""
    return x, 0.0


@wp.func
def alone(x: wp.vec3, t: float, u: wp.vec3, eta: float):
    """No rate."""
    return x


@wp.func
def swapped(x: wp.vec3, t: float, u: wp.vec3, eta: float):
    """Rate and acceleration the wrong way round."""
    return t, x


@pytest.mark.parametrize(
    ("force", "numbers", "told"),
    [
        (lambda x: x, {}, "a function of @wp.func"),
        (wp.sin, {}, "a function of @wp.func"),
        (three, {}, r"force three must be \(x: wp.vec3"),
        (alone, {}, "returns acceleration, rate"),
        (wind, {"speed": 1.0}, "one with speed, rate, got 'numbers speed'"),
        (wind, {"speed": 1.0, "rate": 1.0, "more": 1.0}, "one with speed, rate"),
        (wind, {"speed": "fast", "rate": 1.0}, "speed of force wind must be a number"),
        (wind, {"speed": float("nan"), "rate": 1.0}, "speed of force wind must be a number"),
    ],
)
def test_wrong_forces_are_refused(device, force, numbers, told):
    with pytest.raises(InputError, match=told):
        Force(force, **numbers)


def test_what_warp_does_not_compile_is_refused(device, capfd):
    with pytest.raises(InputError, match="force swapped must be"):
        Simulation(replace(blown(), forces=[swapped]))


def test_a_function_of_time_that_gives_no_number(device):
    simulation = Simulation(blown(speed=lambda t: 1.0 if t < 0.02 else float("nan")))
    simulation.advance_frame()
    with pytest.raises(InputError, match="speed of force wind at"):
        simulation.advance_frame()


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler there")
def test_compiles_to_ptx(device, tmp_path):
    kernel = fuse([Force(wind, speed=WIND, rate=RATE), Force(swing)])
    paths = wp.compile_aot_module(kernel.module, arch=ARCHITECTURES, module_dir=tmp_path, use_ptx=True)
    assert all(kernel.key in path.read_text() for path in paths)


@pytest.mark.slow
def test_float64(device, tmp_path):
    """A scene file's force is read as double; one that was not is refused, with what to do."""
    page = tmp_path / "gust.py"
    page.write_text(_GUST)
    code = f"""
import numpy as np
from melp_warp import Simulation, load_scene
simulation = Simulation(load_scene({str(page)!r}).scene())
simulation.advance_frame()
motion = simulation.state.motion.numpy()
assert motion.dtype == np.float64
assert abs(motion[0, 0] / (0.5 * -np.expm1(-20.0 * simulation.time)) - 1.0) < 1e-3, motion
"""
    subprocess.run([sys.executable, "-c", code], env={**os.environ, VARIABLE: "64"}, check=True)


_GUST = """
import warp as wp
from melp_warp import Force, Sphere, declare
PARAMETERS = declare(radius=0.03, e_count=150, l_per_e=0)

@wp.func
def wind(x: wp.vec3, t: float, u: wp.vec3, eta: float, rate: float):
    return rate * (wp.vec3(0.5, 0.0, 0.0) - u), rate

def build(p):
    return p.scene("gust", Sphere(p.radius), forces=[Force(wind, rate=20.0)])
"""
