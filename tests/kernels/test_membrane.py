"""Normal dynamics piece by piece: gas, net force, response, swept volume, prediction."""

import numpy as np
import pytest
import warp as wp

from melp_warp.device.launch import launch
from melp_warp.kernels import gas as kg
from melp_warp.material import Surroundings
from melp_warp.shapes import Ellipsoid, Jittered, Sphere
from tests.helpers import make_stepper

RADIUS = 0.05
P_ATM = 101325.0


def f64(array):
    return array.numpy().astype(np.float64)


def close_gas(volume, gauge, amount, swept, device):
    """Gas slots after `close_gas` for a swept volume swept[0] + swept[1] q + swept[2] q^2."""
    gas = wp.array([[volume, gauge, amount, 0.0, 0.0, 0.0]], dtype=wp.float64, device=device)
    parts = wp.array(np.array([0.25 * swept, 0.75 * swept]), dtype=wp.vec3d, device=device)
    launch(kg.close_gas, 1, [parts, P_ATM], [gas], device)
    return gas.numpy()[0]


def test_gas_law_at_the_end_of_the_step(device):
    """(p + q) V(q) = n_0 R T within 1e-12 relative, V and p above 0, for random bubbles, steps and displacements.

    Bubbles of 1 mm to 1 m, film masses of 1e-5 to 1e-2 kg/m^2 and steps of 1 us to 1/60 s; the surface moves by up to
    +-20 % of the radius, unevenly, before the gas answers with e = dt^2/m per pressure. V is the swept polynomial
    of `swept_chunks`: sum a (d - kappa d^2/2) with d + q e for d.
    """
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(300):
        r = 10.0 ** rng.uniform(-3.0, 0.0)
        e = 10.0 ** rng.uniform(-12.0, -3.6) / 10.0 ** rng.uniform(-5.0, -2.0)
        volume, area = 4.0 / 3.0 * np.pi * r**3, 4.0 * np.pi * r**2
        gauge = 0.3 / r
        amount = (P_ATM + gauge) * volume * (1.0 + rng.normal() * 1e-3)
        d = r * 0.2 * rng.uniform(-1.0, 1.0, 64)
        a, half = area / 64, -1.0 / r
        swept = np.array([np.sum(a * (d - half * d * d)), np.sum(a * (1.0 - 2.0 * half * d) * e), -area * half * e * e])
        gas = close_gas(volume, gauge, amount, swept, device)
        q = gas[3]
        after = volume + swept[0] + swept[1] * q + swept[2] * q * q
        assert gas[1] == gauge + q
        assert after > 0.0 and P_ATM + gauge + q > 0.0
        worst = max(worst, abs((P_ATM + gauge + q) * after / amount - 1.0))
    print(f"largest relative error {worst:.1e}")
    assert worst < 1e-12


def test_gas_survives_a_collapse(device):
    """A step that would turn the volume negative: pressure and volume of the linear part stay above 0, q is finite.

    Without the curvature term (p + q)(v + s q) = n_0 R T is a quadratic with exactly one root where both are positive.
    """
    rng = np.random.default_rng(1)
    for _ in range(100):
        volume = 10.0 ** rng.uniform(-8.0, -3.0)
        amount = P_ATM * volume
        swept = np.array([-volume * rng.uniform(1.0, 10.0), volume / P_ATM * 10.0 ** rng.uniform(-3.0, 6.0), 0.0])
        q = close_gas(volume, 6.0, amount, swept, device)[3]
        after = volume + swept[0] + swept[1] * q
        assert P_ATM + 6.0 + q > 0.0 and after > 0.0
        assert (P_ATM + 6.0 + q) * after == pytest.approx(amount, rel=1e-6)


def test_balanced_gas_stays(device):
    """Nothing swept, gas law met: q = 0 to rounding of float64, 1e-16 of 101,325 Pa, though the gauge is 6 Pa."""
    volume = 5e-4
    gas = close_gas(volume, 5.8, (P_ATM + 5.8) * volume, np.array([0.0, 1e-7, 0.0]), device)
    assert abs(gas[3]) < 1e-10


def loaded(s, dt=1e-3):
    """Load of the membrane after `_load`, the fields being up to date. [n_e]."""
    s.fields.update()
    s.forces.update()
    step = s.prepare(dt)
    s.membrane._load(step, step)
    return f64(s.membrane.response.load.b)


def test_internal_forces_add_up_to_nothing(device):
    """sum b n = 0 after the net force is taken out, to rounding of sum |b|; before, discretisation leaves some.

    An ellipsoid with uneven thickness and surfactant.
    """
    film, s = make_stepper(
        Jittered(Ellipsoid(0.06, 0.05, 0.042)),
        1000,
        device,
        thickness=lambda x: 4e-7 * (1.0 + 5.0 * x[:, 0]),
        concentration=lambda x: 1e-7 * (1.0 - 6.0 * x[:, 1]),
    )
    b = loaded(s)
    n, a = f64(s.state.e.normal), f64(s.geometry.area)
    before = 1e-3 * n.T @ (a * f64(s.membrane.force))
    print(
        f"net before {np.abs(before).max() / np.abs(b).sum():.1e}, after {np.abs(n.T @ b).max() / np.abs(b).sum():.1e}"
    )
    assert film.features.closed
    assert np.abs(n.T @ b).max() < 1e-6 * np.abs(b).sum()


def test_free_fall(device):
    """Weight m g.n on a film of any thickness is the rigid acceleration g; no load is left to deform the film.

    (sum a m n n)^-1 sum a m (g.n) n = g on any set of points, to rounding.
    """
    _, s = make_stepper(
        Jittered(Sphere(RADIUS)),
        1000,
        device,
        thickness=lambda x: 4e-7 * (1.0 + 8.0 * x[:, 2]),
        surroundings=Surroundings(gravity=(1.0, -9.81, 2.0)),
    )
    loaded(s)
    m = s.membrane
    assert m.rigid.numpy()[2] == pytest.approx([1.0, -9.81, 2.0], abs=1e-4)
    weight = f64(s.state.e.mass) / f64(s.geometry.area) * (f64(s.state.e.normal) @ m.rigid.numpy()[2])
    assert np.abs(f64(m.external)).max() < 1e-5 * np.abs(weight).max()


def test_lift_and_air_in_free_fall(device):
    """A lighter gas inside carries a share of the weight; the air's 3/2 rho R adds to the inertia of a fall.

    On the surface of an even film act the normal part of the weight, a third of it, and the whole lift:
    a = (1 - 3 lift) g m/(m + 3/2 rho_air R). The rest of the weight comes through the tension.
    """
    air = Surroundings(gravity=(0.0, -9.81, 0.0), air="added_mass", lift=0.4)
    film, s = make_stepper(Jittered(Sphere(RADIUS)), 1000, device, surroundings=air)
    loaded(s)
    m = film.material.areal_mass
    expected = 0.2 * 9.81 * m / (m + 1.5 * 1.204 * film.radius)
    assert s.membrane.rigid.numpy()[2] == pytest.approx([0.0, expected, 0.0], rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("dt", [1e-4, 1.0 / 60.0])
def test_response_to_a_unit_pressure(dt, device):
    """Constants are in the null space of lap_s: an even film answers to 1 Pa with dt/(m - c 2/R^2) everywhere.

    c = 2 sigma theta^2 dt^2; by and by less is taken off as c 2/R^2 nears m/8, and nothing beyond. Up to the
    solver's tolerance, 1e-6 here, times the condition of the smooth modes.
    """
    film, s = make_stepper(Jittered(Sphere(RADIUS)), 1000, device, numerics={"tolerance": 1e-6, "max_iterations": 500})
    loaded(s, dt)
    _, unit = s.membrane.response.solve()
    m, c = film.material.areal_mass, 2.0 * film.material.film_tension * (s.membrane.theta * dt) ** 2
    bent = 2.0 * c / film.radius**2
    ratio = f64(unit)[: film.n_e] * (m - bent * max(1.0 - 8.0 * bent / m, 0.0)) / dt
    print(f"dt {dt:.1e}: largest deviation {np.abs(ratio - 1.0).max():.1e}")
    assert np.abs(ratio - 1.0).max() < 2e-5


def test_explicit_scheme_is_load_over_mass(device):
    """The paper's symplectic Euler step: du = dt a f/m for each E alone."""
    film, s = make_stepper(Ellipsoid(0.06, 0.05, 0.042), 600, device, numerics={"scheme": "explicit"})
    b = loaded(s, 1e-6)
    change, unit = s.membrane.response.solve()
    mass = f64(s.state.e.mass)
    assert f64(change)[: film.n_e] == pytest.approx(b / mass, rel=1e-5, abs=1e-12)
    assert f64(unit)[: film.n_e] == pytest.approx(1e-6 * f64(s.geometry.area) / mass, rel=1e-5)


def swept_volume(s, u, dt):
    """Parts of the swept volume summed, for velocities u [n, 3], no change and no response."""
    film = s.film
    s.state.e.u.assign(u.astype(np.float32))
    s.fields.update()
    s.membrane._find_motion(s.membrane.start)
    s.membrane._predict(s.dt.at(0.0))
    s.geometry.curvature(s.state.e.x)
    none = film.zeros(film.n_e)
    s.membrane._close_gas(none, none, s.prepare(dt))
    return f64(s.membrane.swept).sum(axis=0)[0]


def test_swept_volume(device):
    """An even displacement d of a sphere sweeps 4 pi R^2 (d + d^2/R), short of the exact volume by d^3/3R^2 a.

    A translation sweeps nothing, however far: it is seen from the film as a whole.
    """
    _, s = make_stepper(Jittered(Sphere(RADIUS)), 2000, device)
    n = f64(s.state.e.normal)
    area = 4.0 * np.pi * RADIUS**2
    for d in (-0.2 * RADIUS, 0.01 * RADIUS, 0.1 * RADIUS):
        exact = 4.0 / 3.0 * np.pi * ((RADIUS + d) ** 3 - RADIUS**3)
        allowed = area * (abs(d) ** 3 / (3.0 * RADIUS**2) + 1e-2 * d * d / RADIUS + 5e-4 * abs(d))
        assert abs(swept_volume(s, n * d, 1.0) - exact) < allowed
    translation = swept_volume(s, np.tile([0.3, 0.1, -0.2], (len(n), 1)), 1.0)
    assert abs(translation) < 1e-5 * area * 0.4


def test_prediction_leaves_out_the_motion_as_a_whole(device):
    """x + step ((u - U).n - s) n: translation and even swelling leave the surface where it is, a mode does not.

    U and s are found one after the other, so that what the surface lacks in closure, sum a n/sum a of some 1e-5, mixes
    them by as much.
    """
    _, s = make_stepper(Jittered(Sphere(RADIUS)), 1000, device)
    e, n = s.state.e, f64(s.state.e.normal)
    x = f64(e.x)
    e.u.assign((np.array([0.5, -0.3, 0.2]) + 0.7 * n).astype(np.float32))
    s.membrane._find_motion(s.membrane.start)
    s.membrane._predict(s.dt.at(0.01))
    area = f64(s.geometry.area)
    closure = np.linalg.norm(area @ n) / area.sum()
    print(f"closure {closure:.1e}")
    assert closure < 1e-4
    assert np.abs(f64(s.membrane.predicted) - x).max() < (3.0 * closure * (0.7 + 0.62) + 2e-6) * 0.01
    p2 = 1.5 * n[:, 1] ** 2 - 0.5
    e.u.assign((p2[:, None] * n).astype(np.float32))
    s.membrane._find_motion(s.membrane.start)
    s.membrane._predict(s.dt.at(0.01))
    moved = np.sum((f64(s.membrane.predicted) - x) * n, axis=1)
    assert np.abs(moved - 0.01 * p2).max() < 0.01 * 2e-3


def test_offset_restores_the_gas_law(device):
    """A bubble inflated by 0.3 % against its gas is offset until (p_atm + p) V = n_0 R T.

    The offset d is linear: V(d) = V + A d + A d^2/R and d/R = 1e-3, so 3 (d/R)^2 = 3e-6 of the volume may stay.
    """
    _, s = make_stepper(Jittered(Sphere(RADIUS)), 2000, device)
    s.state.e.x.assign((s.state.e.x.numpy() * 1.001).astype(np.float32))
    s.geometry.update()
    gas = s.state.gas.numpy()[0]
    assert (P_ATM + gas[1]) * gas[0] / gas[2] - 1.0 == pytest.approx(3e-3, rel=0.01)
    s.membrane.close_volume()
    gas = s.state.gas.numpy()[0]
    assert (P_ATM + gas[1]) * gas[0] == pytest.approx(gas[2], rel=1e-12)
    s.geometry.update()
    gas = s.state.gas.numpy()[0]
    assert (P_ATM + gas[1]) * gas[0] == pytest.approx(gas[2], rel=4e-6)
