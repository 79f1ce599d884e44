"""Sums and pair forces of a single layer against NumPy and against the energy they come from."""

import numpy as np
import pytest

from melp_warp.material import Material
from melp_warp.shapes import Rectangle, Samples
from tests.helpers import Patch, make_stepper, spline

SIDE = 0.1


def loose_patch(count=20, amount=0.3):
    """An even grid of points, moved about by up to `amount` spacings; nothing lies beyond its edge."""
    samples = Rectangle(SIDE, SIDE).sample(count * count)
    move = np.random.default_rng(3).uniform(-amount, amount, (len(samples.points), 3)) * [1.0, 1.0, 0.0]
    return Patch(Samples(samples.points + move * SIDE / count, samples.normals, samples.area), flat=True)


def made(device, **numerics):
    """A stepper on the loose patch whose particles hold uneven amounts of liquid and surfactant; positions, amounts."""
    _, s = make_stepper(loose_patch(), 400, device, numerics={"layers": 1, "xsph": 0.0, **numerics})
    rng, e = np.random.default_rng(5), s.state.e
    for held in (e.mass, e.surfactant):
        held.assign(held.numpy() * rng.uniform(0.7, 1.3, s.film.n_e).astype(held.numpy().dtype))
    return s, *(a.numpy().astype(np.float64) for a in (e.x, e.mass, e.surfactant))


def summed(x, amount, r):
    """sum_j amount_j W_ij."""
    return spline(np.linalg.norm(x[:, None] - x, axis=2), r) @ amount


def push(s, dt=1e-6):
    """Change of momentum of each particle by one step's forces, over dt; N."""
    before = s.state.e.u.numpy().astype(np.float64)
    s.prepare(dt)
    next(stage for stage in s.stages if stage.name == "surfactant").run()
    return (s.state.e.u.numpy() - before) * s.state.e.mass.numpy()[:, None] / dt


def test_sums(device):
    """eta = sum V_j W_ij and Gamma = sum c_j W_ij; each particle takes up V/eta."""
    s, x, mass, amount = made(device)
    s.fields.update()
    m = s.film.material
    eta, gamma = summed(x, mass / m.density, s.film.r), summed(x, amount / m.surfactant, s.film.r)
    assert np.allclose(s.fields.eta.numpy(), eta, rtol=2e-5)
    assert np.allclose(s.fields.gamma.numpy(), gamma, rtol=2e-5)
    assert np.allclose(s.fields.own.numpy(), mass / m.density / eta, rtol=2e-5)


def test_pair_force_is_minus_the_gradient_of_the_energy(device):
    """2 R T sum c log Gamma, by central differences in float64; the forces add up to nothing."""
    s, x, _, amount = made(device, gradient="symmetric")
    force = push(s)
    rt = s.film.material.rt

    def energy(points):
        return 2.0 * rt * np.sum(amount * np.log(summed(points, amount, s.film.r)))

    step = 1e-3 * s.film.spacing
    for i in (0, 57, 210, 399):
        for axis in (0, 1):
            ahead, back = x.copy(), x.copy()
            ahead[i, axis] += step
            back[i, axis] -= step
            exact = -(energy(ahead) - energy(back)) / (2.0 * step)
            assert force[i, axis] == pytest.approx(exact, abs=1e-3 * np.abs(force).max())
    assert np.linalg.norm(force.sum(axis=0)) < 1e-5 * np.abs(force).sum()


def test_difference_force_vanishes_where_the_film_is_even(device):
    """(21) sees no gradient in an even concentration however the particles lie; the sum of its forces is not zero."""
    s, *_ = made(device)
    uneven = push(s)
    assert np.linalg.norm(uneven.sum(axis=0)) > 1e-3 * np.abs(uneven).sum()
    s.fields.gamma.fill_(1.0)
    s.fields.update = lambda: None
    assert np.abs(push(s)).max() < 1e-9 * np.abs(uneven).max()


@pytest.mark.parametrize(("viscosity", "xsph"), [(0.02, 0.0), (0.0, 0.99)])
def test_viscosity_keeps_momentum_and_takes_energy(viscosity, xsph, device):
    """Both viscosities act in pairs."""
    material = Material(surfactant=0.0, viscosity=viscosity)
    _, s = make_stepper(loose_patch(), 400, device, numerics={"layers": 1, "xsph": xsph}, material=material)
    u = np.random.default_rng(1).normal(size=(400, 3)) * [1.0, 1.0, 0.0]
    s.state.e.u.assign(u.astype(s.state.e.u.numpy().dtype))
    mass = s.state.e.mass.numpy().astype(np.float64)[:, None]
    momentum, energy = np.sum(mass * u, axis=0), np.sum(mass * u**2)
    push(s, 1e-4)
    after = s.state.e.u.numpy().astype(np.float64)
    assert np.abs(np.sum(mass * after, axis=0) - momentum).max() < 1e-6 * np.sum(mass * np.abs(u))
    assert np.sum(mass * after**2) < 0.9 * energy


def test_confined(device):
    """A particle beyond the rim is put onto it and loses the speed with which it left; it keeps that along the rim."""
    _, s = make_stepper(Rectangle(SIDE, SIDE), 400, device, numerics={"layers": 1, "xsph": 0.0})
    x, u = s.state.e.x.numpy(), s.state.e.u.numpy()
    i = int(np.argmax(x[: s.film.n_e] @ [1.0, 0.1, 0.0]))
    u[i] = (20.0, 0.3, 0.0)
    s.state.e.u.assign(u)
    s.step(2e-4)
    assert s.state.e.x.numpy()[i, 0] == pytest.approx(0.5 * SIDE, rel=1e-6)
    assert s.state.e.u.numpy()[i, 0] == pytest.approx(0.0, abs=1e-4)
    assert s.state.e.u.numpy()[i, 1] == pytest.approx(0.3, rel=0.05)
