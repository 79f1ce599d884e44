"""L to E and E to L: what is conserved, what is reproduced."""

import numpy as np
import pytest
import warp as wp

from melp_warp.shapes import Disc, Jittered, Sphere
from melp_warp.stages.transfer import THICKNESS_SLACK
from tests.helpers import make_stepper

SHAPES = {"sphere": Jittered(Sphere(0.05)), "flat": Jittered(Disc(0.05))}


def f64(array):
    return array.numpy().astype(np.float64)


def fill_l(stepper, seed=0):
    """Random masses, surfactant, velocities and affine states on L."""
    rng = np.random.default_rng(seed)
    lag, n = stepper.state.l, stepper.film.n_l
    lag.mass.assign(rng.uniform(0.5, 1.5, n).astype(np.float32) * 1e-9)
    lag.surfactant.assign(rng.uniform(0.5, 1.5, n).astype(np.float32) * 1e-13)
    lag.u.assign(rng.normal(size=(n, 3)).astype(np.float32))
    lag.affine.assign((30.0 * rng.normal(size=(n, 3, 3))).astype(np.float32))


@pytest.mark.parametrize("name", SHAPES)
def test_l_to_e_conserves(name, device):
    """Sums over E equal sums over L of mass, surfactant, claimed area and momentum m u, within 1e-6 relative.

    Each L gives shares W/sum W that add up to one over E alone, with rim and boundary particles present, and its affine
    part gives nothing in sum about the weighted mean of its E.
    """
    film, s = make_stepper(SHAPES[name], 600, device, l_per_e=8)
    fill_l(s)
    s.transfer.gather()
    e, lag = s.state.e, s.state.l
    assert f64(e.mass).sum() == pytest.approx(f64(lag.mass).sum(), rel=1e-6)
    assert f64(e.surfactant).sum() == pytest.approx(f64(lag.surfactant).sum(), rel=1e-6)
    claim = f64(lag.mass) / (film.material.density * f64(lag.eta))
    assert f64(s.transfer.claim).sum() == pytest.approx(claim.sum(), rel=1e-6)
    momentum = f64(lag.mass)[:, None] * f64(lag.u)
    error = f64(s.transfer.momentum).sum(axis=0) - momentum.sum(axis=0)
    assert np.abs(error).max() < 1e-6 * np.abs(momentum).sum()
    assert np.all(s.transfer.lost.numpy() == 0)


@pytest.mark.parametrize("name", SHAPES)
def test_constant_velocity_is_exact_from_l_to_e(name, device):
    """u_L = U gives E momentum/mass = U everywhere, at a rim too, and u_E = U with the normal part kept at U.n."""
    film, s = make_stepper(SHAPES[name], 600, device, l_per_e=8)
    constant = np.array([0.4, -0.3, 0.7])
    n = f64(s.state.e.normal)
    u = np.tile(constant, (film.total, 1))
    s.state.e.u.assign((np.sum(u * n, axis=1, keepdims=True) * n).astype(np.float32))
    s.state.l.u.assign(np.tile(constant, (film.n_l, 1)).astype(np.float32))
    s.state.l.affine.zero_()
    s.transfer.l_to_e()
    ratio = f64(s.transfer.momentum) / f64(s.state.e.mass)[:, None]
    assert np.abs(ratio - constant).max() < 2e-6
    assert np.abs(f64(s.state.e.u)[: film.n_e] - constant).max() < 3e-6


def test_constant_velocity_is_exact_from_e_to_l(device):
    """u_E = U gives L the velocity U and no affine part: rounding of 1e-7 U over r."""
    film, s = make_stepper(SHAPES["sphere"], 600, device, l_per_e=8)
    constant = np.array([0.4, -0.3, 0.7])
    s.state.e.u.assign(np.tile(constant, (film.total, 1)).astype(np.float32))
    s.transfer.start_l()
    for velocity in (s.state.l.u, s.state.l.v):
        assert np.abs(f64(velocity) - constant).max() < 3e-6
    assert np.abs(f64(s.state.l.affine)).max() < 1e-5 / film.r


def test_affine_velocity_on_a_flat_film(device):
    """u = A x + b in the plane: L carry it exactly (u, v and affine), and give it back to E, away from the rim.

    APIC with the weighted mean of the E as origin is exact for affine fields on any set of points: D and B come from
    the same sums. Rounding: 1e-6 of |A| R.
    """
    film, s = make_stepper(SHAPES["flat"], 1200, device, l_per_e=6)
    a = np.array([[3.0, 0.0, -20.0], [0.0, 0.0, 0.0], [11.0, 0.0, -7.0]])
    b = np.array([0.2, 0.0, -0.1])
    x, x_l = f64(s.state.e.x)[: film.n_e], f64(s.state.l.x)
    u = np.zeros((film.total, 3))
    u[: film.n_e] = x @ a.T + b
    s.state.e.u.assign(u.astype(np.float32))
    s.transfer.start_l()
    inside_l = np.linalg.norm(x_l, axis=1) < 0.05 - 1.1 * film.r
    inside_e = np.linalg.norm(x, axis=1) < 0.05 - 2.2 * film.r
    assert inside_l.sum() > 1000 and inside_e.sum() > 50
    size = np.abs(u).max()
    assert np.abs(f64(s.state.l.v) - (x_l @ a.T + b))[inside_l].max() < 1e-5 * size
    assert np.abs(f64(s.state.l.affine) - a)[inside_l].max() < 1e-5 * size / film.spacing
    s.state.e.u.zero_()
    s.transfer.l_to_e()
    error = np.abs(f64(s.state.e.u)[: film.n_e] - (x @ a.T + b))[inside_e].max()
    print(f"round trip of an affine field: {error / size:.1e}")
    assert error < 1e-5 * size


def test_rotation_of_a_sphere(device):
    """u = w x r over a sphere comes back from L within the curvature of a support, (r/R)^2/8 of it at most.

    Rigid rotation is tangential and linear in space. The affine part in the tangent plane sees its tangential
    derivatives exactly; what the E at heights d^2/2R off the plane add to the mean velocity is dropped.
    """
    film, s = make_stepper(SHAPES["sphere"], 2000, device, l_per_e=6)
    w = np.array([0.0, 6.0, 8.0])
    x = f64(s.state.e.x)
    u = np.cross(w, x)
    s.state.e.u.assign(u.astype(np.float32))
    s.transfer.start_l()
    s.state.e.u.zero_()
    s.transfer.l_to_e()
    error = np.linalg.norm(f64(s.state.e.u) - u, axis=1).max() / 0.5
    print(f"round trip of a rotation: {error:.1e}, (r/R)^2/8 = {(film.r / 0.05) ** 2 / 8:.1e}")
    assert error < (film.r / 0.05) ** 2 / 8


def test_boundary_particles_take_no_mass(device):
    """Each L shares itself over the E alone: share_L sum_E W = m_L with boundary particles left out of the sum."""
    film, s = make_stepper(SHAPES["flat"], 600, device, l_per_e=4)
    assert film.n_b > 0
    fill_l(s)
    s.state.l.affine.zero_()
    s.transfer.gather()
    before = f64(s.transfer.momentum)
    u = s.state.e.u.numpy()
    u[film.n_e :] = 1e6
    s.state.e.u.assign(u)
    s.transfer.gather()
    assert np.array_equal(f64(s.transfer.momentum), before)
    d = np.linalg.norm(f64(s.state.l.x)[:, None] - f64(s.state.e.x)[None, : film.n_e], axis=2) / (film.r / 3.0)
    w = sum(c * np.maximum(q - d, 0.0) ** 5 for c, q in ((1.0, 3.0), (-6.0, 2.0), (15.0, 1.0)))
    share = w / w.sum(axis=1, keepdims=True)
    assert f64(s.state.e.mass) == pytest.approx(share.T @ f64(s.state.l.mass), rel=2e-5)


def test_thickness_follows_dilation(device):
    """(8): where L claim what E control, D eta/Dt = -eta div u makes eta_L shrink by exp(-dt div u)."""
    film, s = make_stepper(SHAPES["sphere"], 600, device, l_per_e=16)
    s.transfer.normalize()
    wp.copy(s.transfer.claim, s.geometry.area)
    before = f64(s.state.l.eta)
    s.prepare(0.01)
    widening = wp.full(film.n_e, 0.12, dtype=float, device=device)
    s.transfer.e_to_l(widening, None, wp.full(1, 1.0, dtype=float, device=film.device))
    assert f64(s.state.l.eta) / before == pytest.approx(np.exp(-0.12), rel=1e-5)


def test_thickness_relaxes_to_that_of_e(device):
    """L that claim 25 % too much area are thickened at rate 1 - exp(-dt/tau), up to the slack that is left alone."""
    film, s = make_stepper(SHAPES["sphere"], 600, device, l_per_e=16)
    lag = s.state.l
    before = f64(lag.eta)
    lag.eta.assign((before / 1.25).astype(np.float32))
    s.transfer.gather()
    tau = film.numerics.thickness_time
    to_l(film, s, tau * np.log(2.0))
    expected = 0.5 * (np.log(1.25) - THICKNESS_SLACK)
    assert np.log(f64(lag.eta) / before * 1.25).mean() == pytest.approx(expected, abs=0.005)
    for _ in range(12):
        s.transfer.gather()
        to_l(film, s, 10.0 * tau)
    s.transfer.gather()
    claim = f64(s.transfer.claim) / f64(s.geometry.area)
    print(f"claim/area after: {claim.min():.3f} to {claim.max():.3f}")
    assert np.abs(np.log(claim)).max() < 1.5 * THICKNESS_SLACK


def test_thickness_goes_along_with_surfactant(device):
    """eta_L = m Gamma/(rho c) to rounding, with Gamma what the solve makes and what the rest of the step adds.

    Liquid and surfactant of each L are random, their ratio too; E widen by noise, which nothing is made of. Where there
    is no surfactant that is all there is to go by.
    """
    film, s = make_stepper(SHAPES["sphere"], 600, device, l_per_e=16)
    fill_l(s)
    lag, m = s.state.l, film.material
    held = f64(lag.mass) / f64(lag.surfactant) * m.surfactant / m.density
    lag.eta.assign((1.3 * held).astype(np.float32))
    s.transfer.gather()
    noise = np.random.default_rng(1).normal(size=film.n_e).astype(np.float32)
    widening = wp.array(noise, dtype=float, device=film.device)
    gamma = wp.full(film.total, 0.9, dtype=float, device=film.device)
    swelling = wp.full(film.n_e, 0.2, dtype=float, device=film.device)
    theta = wp.full(1, 0.75, dtype=float, device=film.device)
    s.transfer.e_to_l(widening, None, theta, gamma, swelling)
    assert f64(lag.eta) / held == pytest.approx(0.9 * np.exp(-0.05), rel=1e-5)
    lag.surfactant.zero_()
    s.transfer.gather()
    s.transfer.e_to_l(widening, None, theta, gamma, swelling)
    assert np.array_equal(s.transfer.growth.numpy(), -noise)


def to_l(film, s, dt, before=None, theta=1.0):
    """E to L without dilation; `before` the velocity of E at the start of the step."""
    before = None if before is None else wp.array(before, dtype=wp.vec3, device=film.device)
    s.prepare(dt)
    s.transfer.e_to_l(film.zeros(film.n_e), before, wp.full(1, theta, dtype=float, device=film.device))


def in_plane(film, s, seed=2):
    """Random velocities of L and affine states in the plane of a flat film; the E are at rest."""
    fill_l(s, seed)
    rng = np.random.default_rng(seed)
    s.state.l.u.assign((rng.normal(size=(film.n_l, 3)) * [1.0, 0.0, 1.0]).astype(np.float32))
    s.state.e.u.zero_()


@pytest.mark.parametrize("affinity", [0.0, 1.0])
@pytest.mark.parametrize("flip", [0.0, 0.6, 1.0])
def test_any_blend_conserves_momentum(flip, affinity, device):
    """L gain what the E gained between the transfers, sum m_E du_E, whatever the blend: to rounding, at a rim too."""
    film, s = make_stepper(SHAPES["flat"], 600, device, l_per_e=8, numerics={"flip": flip, "affinity": affinity})
    in_plane(film, s)
    mass = f64(s.state.l.mass)[:, None]
    before = (mass * f64(s.state.l.u)).sum(axis=0)
    s.transfer.l_to_e()
    held = s.state.e.u.numpy().copy()
    gain = np.zeros((film.total, 3))
    gain[: film.n_e] = np.random.default_rng(3).normal(size=(film.n_e, 3)) * [1.0, 0.0, 1.0]
    s.state.e.u.assign((f64(s.state.e.u) + gain).astype(np.float32))
    to_l(film, s, 1e-3, held)
    given = (f64(s.state.e.mass)[:, None] * gain[: film.n_e]).sum(axis=0)
    after = (mass * f64(s.state.l.u)).sum(axis=0)
    assert np.abs(after - before - given).max() < 1e-6 * (mass * np.abs(f64(s.state.l.u))).sum()
    assert np.abs(given).max() > 1e-4 * np.abs(mass).sum()


def test_l_carry_on_the_velocity_of_the_end_and_move_with_that_of_the_middle(device):
    """u and the affine state of L are those of u_E + (1/theta - 1)(u_E - before), to rounding; v is that of u_E."""
    film, s = make_stepper(SHAPES["sphere"], 600, device, l_per_e=8)
    fill_l(s)
    s.transfer.l_to_e()
    change = np.cross(f64(s.state.e.x), [3.0, 1.0, 2.0]).astype(np.float32)
    now = s.state.e.u.numpy().copy()
    s.transfer.start_l()
    v = f64(s.state.l.v)
    to_l(film, s, 1e-3, now - change, theta=4.0 / 7.0)
    u, affine = f64(s.state.l.u), f64(s.state.l.affine)
    assert np.array_equal(f64(s.state.l.v), v)
    s.state.e.u.assign(now + np.float32(0.75) * change)
    s.transfer.start_l()
    assert np.abs(u - f64(s.state.l.u)).max() < 1e-5 * np.abs(u).max()
    assert np.abs(affine - f64(s.state.l.affine)).max() < 1e-4 * np.abs(affine).max()


def test_flip_without_forces_leaves_each_l_its_velocity(device):
    """Where no force acts FLIP changes no velocity, PIC makes a weighted mean of it: random ones all but vanish."""
    left = {}
    for flip in (0.0, 1.0):
        film, s = make_stepper(SHAPES["flat"], 600, device, l_per_e=8, numerics={"flip": flip})
        in_plane(film, s)
        s.state.l.affine.zero_()
        before = f64(s.state.l.u)
        s.transfer.l_to_e()
        to_l(film, s, 1e-3, s.state.e.u.numpy())
        left[flip] = np.abs(f64(s.state.l.u) - before).max()
    assert left[1.0] < 1e-5
    assert left[0.0] > 1.0


def test_flip_leaves_the_normal_motion_to_the_e(device):
    """On a sphere L get the normal velocity of the E around them, whatever they carried."""
    _, s = make_stepper(SHAPES["sphere"], 600, device, l_per_e=8, numerics={"flip": 1.0})
    plain, p = make_stepper(SHAPES["sphere"], 600, device, l_per_e=8)
    for stepper in (s, p):
        fill_l(stepper)
        stepper.transfer.l_to_e()
        to_l(plain, stepper, 1e-3, stepper.state.e.u.numpy())
    n = f64(s.state.l.normal)
    assert np.abs(np.sum((f64(s.state.l.u) - f64(p.state.l.u)) * n, axis=1)).max() < 1e-5
    assert np.abs(f64(s.state.l.u) - f64(p.state.l.u)).max() > 1.0
