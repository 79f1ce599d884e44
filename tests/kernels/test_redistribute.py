"""Redistribution of E: even spacing, on the surface, with the velocity field left where it is."""

import numpy as np
import pytest

from melp_warp import features
from melp_warp.shapes import Jittered, Sphere, displaced_sphere
from melp_warp.stages.advance import SHIFT_TOLERANCE
from tests.helpers import fitted_order, make_stepper, place_e

RADIUS = 0.05
FAR = 3.0
"""Shifts that are let go as far as they are asked for, spacings."""


def f64(array):
    return array.numpy().astype(np.float64)


RIPPLE = 0.02
"""Amplitude of a wave in shape and thickness, relative."""

FULL = {"redistribution": 1.0, "spread": 0.02}


def clustered(count, device, squeeze=0.13, **numerics):
    """A sphere whose E crowd on one side: directions pushed along z and normalised again."""
    film, s = make_stepper(Sphere(RADIUS), count, device, numerics={**FULL, **numerics})
    d = f64(s.state.e.x) / RADIUS + [0.0, 0.0, squeeze]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    place_e(s, RADIUS * d, d)
    return film, s


def apply(s, times):
    """Redistribute and renew the geometry, as after a time step; returns the spread before each."""
    spread = []
    for _ in range(times):
        s.redistribution.apply(s.membrane.u_mid)
        spread.append(float(s.redistribution.spread.numpy()[0, 0]))
        s.lists.rebuild()
        s.geometry.update()
    return spread


def test_crowded_sphere_is_evened_out(device):
    """(delta_max - delta_min)/delta_mean falls from 50 % to below 5 %, each E moving dx at most in one go.

    E must cross about squeeze R = 2.5 dx at N = 1,000, so three applications at the least. They stay on the sphere: no
    further than 1 % of dx in 60 of them.
    """
    film, s = clustered(1000, device)
    spread = apply(s, 60)
    off = np.abs(np.linalg.norm(f64(s.state.e.x), axis=1) - RADIUS).max()
    print(f"spread {', '.join(f'{v:.3f}' for v in spread[::20])}, {spread[-1]:.3f}; off {off / film.spacing:.1e} dx")
    assert spread[0] > 0.45
    assert spread[-1] < 0.05
    assert off < 0.01 * film.spacing


def test_shifted_points_stay_on_the_surface(device):
    """One application leaves the sphere by O(dx^3): a shift of some dx along a plane and curvature right to O(dx^2)."""
    spacings, errors = [], []
    for count in (500, 1000, 2000, 4000):
        film, s = clustered(count, device)
        s.redistribution._limit = FAR * film.spacing
        apply(s, 1)
        spacings.append(film.spacing)
        errors.append(np.abs(np.linalg.norm(f64(s.state.e.x), axis=1) - RADIUS).max())
    order = fitted_order(spacings, errors)
    print(f"off by {', '.join(f'{e / h:.1e}' for e, h in zip(errors, spacings, strict=True))} dx, order {order:.2f}")
    assert order > 2.7


def test_even_points_are_left_alone(device):
    """Below the scene's spread nothing moves, bit for bit."""
    _, s = make_stepper(Jittered(Sphere(RADIUS)), 1000, device, numerics={"spread": 5.0})
    kept = [s.state.e.x, s.state.e.mass, s.state.e.normal, s.geometry.area]
    before = [array.numpy().copy() for array in kept]
    s.redistribution.apply(s.membrane.u_mid)
    assert all(np.array_equal(array.numpy(), old) for array, old in zip(kept, before, strict=True))
    assert s.redistribution.spread.numpy()[0, 2] == 0.0


def test_pairs_are_parted(device):
    """Two E a fifth of a spacing apart are further apart than half a spacing ten times later, on the sphere.

    The density (9) of a pair is that of two E a spacing apart within a few per cent: it alone leaves pairs as they are.
    """
    film, s = make_stepper(Sphere(RADIUS), 1000, device, numerics=FULL)
    x = f64(s.state.e.x)
    i = 500
    j = np.argsort(np.linalg.norm(x - x[i], axis=1))[1]
    x[j] = x[i] + 0.2 * film.spacing * (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
    x[j] *= RADIUS / np.linalg.norm(x[j])
    place_e(s, x, x / RADIUS)
    apply(s, 10)
    x = f64(s.state.e.x)
    assert np.linalg.norm(x[j] - x[i]) > 0.5 * film.spacing
    assert np.abs(np.linalg.norm(x, axis=1) - RADIUS).max() < 0.01 * film.spacing


def test_velocity_field_stays_in_space(device):
    """u(x) = A x + b on E is still A x + b at the places they are shifted to.

    The gradient is exact for linear fields; only the way along the normal, s^2/2R for a shift s, is not followed.
    """
    film, s = clustered(1000, device)
    a, b = np.random.default_rng(0).normal(size=(3, 3)), np.array([0.1, 0.0, -0.2])
    e = s.state.e
    x = f64(e.x)
    e.u.assign((x @ a.T + b).astype(np.float32))
    s.redistribution.apply(s.membrane.u_mid)
    after = f64(e.x)
    moved = np.linalg.norm(after - x, axis=1)
    error = np.linalg.norm(f64(e.u) - (after @ a.T + b), axis=1).max()
    normal_way = moved.max() ** 2 / (2.0 * RADIUS)
    print(
        f"moved {moved.max() / film.spacing:.2f} dx; error {error:.1e}, bound {np.linalg.norm(a, 2) * normal_way:.1e}"
    )
    assert 0.05 * film.spacing < moved.max() < 1.01 * s.redistribution._limit
    assert error < 1.1 * np.linalg.norm(a, 2) * normal_way + 1e-7


def wave(count, device, degree=4):
    """A crowded sphere with P4 as u.n and as the speed that E move at; positions, normals and P4 of any directions."""
    film, s = clustered(count, device)
    legendre = np.polynomial.legendre.Legendre.basis(degree)

    def value(x):
        return legendre(x[:, 1] / np.linalg.norm(x, axis=1))

    e = s.state.e
    x = f64(e.x)
    e.u.assign((value(x)[:, None] * x / RADIUS).astype(np.float32))
    s.membrane.u_mid.assign(value(x).astype(np.float32))
    return film, s, value


def test_fields_are_found_to_third_order(device):
    """u and u_mid at the new places are those of the field to O(dx^3), a linear interpolation's error is O(dx^2).

    With 1,000 E none is shifted by more than its own fit reaches; with more, the nearest fit is looked for.
    """
    spacings, errors = [], []
    for count in (2000, 4000, 8000):
        film, s, value = wave(count, device)
        s.redistribution._limit = FAR * film.spacing
        s.redistribution.apply(s.membrane.u_mid)
        x = f64(s.state.e.x)
        exact = value(x)
        spacings.append(film.spacing)
        errors.append(
            max(
                np.abs(f64(s.membrane.u_mid) - exact).max(),
                np.abs(f64(s.state.e.u) - exact[:, None] * x / RADIUS).max(),
            )
        )
    order = fitted_order(spacings, errors)
    print(f"off by {', '.join(f'{e:.1e}' for e in errors)}, order {order:.2f}")
    assert order > 2.5
    assert errors[0] < 2e-3


def test_far_shifts_find_the_nearest_fit(device):
    """Shifts of several spacings: on a sphere E end on it, and at the velocity that is there, as after short ones."""
    film, s, value = wave(8000, device)
    s.redistribution._limit = FAR * film.spacing
    before = f64(s.state.e.x)
    s.redistribution.apply(s.membrane.u_mid)
    x = f64(s.state.e.x)
    moved = np.linalg.norm(x - before, axis=1).max() / film.spacing
    off = np.abs(np.linalg.norm(x, axis=1) - RADIUS).max() / film.spacing
    error = np.abs(f64(s.membrane.u_mid) - value(x)).max()
    print(f"moved {moved:.2f} dx, off {off:.1e} dx, field off by {error:.1e}")
    assert moved > 2.0
    assert off < 1e-4
    assert error < 1e-3


def test_liquid_stays_where_it_is(device):
    """A film of E alone, thicker above: a shift keeps its mass to rounding, and its thickness as a field to 0.01 %.

    Carried along with the E the thickness would be off by what the shift compresses: 25 % where E were sparse and run
    together, 2 % in the mean. With liquid that went from E to E over the borders of their cells it was 3 % off there.
    """
    _, s = clustered(2000, device)
    e = s.state.e

    def thickness(x):
        return 1.0 + 0.3 * x[:, 1] / RADIUS

    e.mass.assign((thickness(f64(e.x)) * f64(s.geometry.area)).astype(np.float32))
    e.surfactant.assign(e.mass.numpy())
    before, area = f64(e.mass), f64(s.geometry.area)
    s.redistribution.apply(s.membrane.u_mid)
    s.lists.rebuild()
    s.geometry.update()
    exact = thickness(f64(e.x))

    def worst(change):
        return np.abs(change).max()

    def mean(change):
        return np.sqrt(np.mean(change**2))

    off = f64(e.mass) / f64(s.geometry.area) / exact - 1.0
    carried = before / f64(s.geometry.area) / exact - 1.0
    print(f"off {worst(off):.2%}, carried along {worst(carried):.2%}, area {np.ptp(area) / area.mean():.2f}")
    assert f64(e.mass).sum() == pytest.approx(before.sum(), rel=1e-6)
    assert np.array_equal(e.surfactant.numpy(), e.mass.numpy())
    assert worst(off) < 1e-3 * worst(carried)
    assert mean(off) < 1e-3 * mean(carried)


def rippled(count, device, degree=4):
    """A crowded bubble of shape, speed u_mid, velocity and thickness P_n of the direction; and that P_n."""
    legendre = np.polynomial.legendre.Legendre.basis(degree)

    def value(x):
        return legendre(x[:, 1] / np.linalg.norm(x, axis=1))

    shape = displaced_sphere(RADIUS, lambda d: RIPPLE * legendre(d[:, 1]))
    film, s = make_stepper(shape, count, device, numerics=FULL)
    d = f64(s.state.e.x) + np.array([0.0, 0.0, 0.13 * RADIUS])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    place_e(s, shape.project(RADIUS * d))
    e = s.state.e
    p = value(f64(e.x))
    e.u.assign((p[:, None] * f64(e.normal)).astype(np.float32))
    s.membrane.u_mid.assign(p.astype(np.float32))
    e.mass.assign(((1.0 + RIPPLE * p) * f64(s.geometry.area)).astype(np.float32))
    return film, s, value, shape


def test_nothing_lags_behind_a_shift(device):
    """Shape, velocity and liquid of a wave stay where they are: what a plain quadratic fit leaves behind is not there.

    Its slope lacks 0.2254 (k r/3)^2 of that of a wave, so that as much of the shift would take the field along. Each by
    another share, and to and fro in each swing: a ringing bubble got its energy from that.
    """
    film, s, value, shape = rippled(1500, device)
    x = f64(s.state.e.x)
    before = value(x)
    s.redistribution.apply(s.membrane.u_mid)
    s.lists.rebuild()
    s.geometry.update()
    e = s.state.e
    x = f64(e.x)
    exact = value(x)
    change = exact - before
    plain = 0.2254 * 20.0 * (film.r / 3.0 / RADIUS) ** 2
    scale = np.linalg.norm(shape.project(x), axis=1)
    found = {
        "speed": f64(s.membrane.u_mid),
        "velocity": (f64(e.u) * f64(e.normal)).sum(axis=1),
        "liquid": (f64(e.mass) / f64(s.geometry.area) - 1.0) / RIPPLE,
        "shape": exact + (np.linalg.norm(x, axis=1) - scale) / (RADIUS * RIPPLE),
    }
    lag = {name: -np.dot(field - exact, change) / np.dot(change, change) for name, field in found.items()}
    print(f"a quadratic lags by {plain:.3f}; " + ", ".join(f"{name} {value:+.4f}" for name, value in lag.items()))
    assert np.abs(change).max() > 0.05
    for name, share in lag.items():
        assert abs(share) < 0.25 * plain, name


def test_solve_comes_to_its_tolerance(device):
    """However many E: the cap on iterations follows their number."""
    for count in (500, 2000, 8000):
        _, s = clustered(count, device)
        s.redistribution.apply(s.membrane.u_mid)
        iterations, residual = s.redistribution.solver.report()
        print(f"{count} E: {iterations} iterations, residual {residual:.3f}")
        assert residual < SHIFT_TOLERANCE


@pytest.fixture
def coarse(monkeypatch):
    """Coarser levels for films of any size."""
    monkeypatch.setattr(features, "COARSE_FROM", 0)


@pytest.mark.parametrize("most", [6000, pytest.param(20000, marks=pytest.mark.slow)])
def test_iterations_do_not_grow_with_levels(most, coarse, device):
    """From 2,000 to 20,000 E at most by half; Jacobi's grow threefold, as the film's width in E."""
    taken = []
    for count in (2000, most):
        _, s = clustered(count, device)
        s.redistribution.apply(s.membrane.u_mid)
        iterations, residual = s.redistribution.solver.report()
        print(f"{count} E: {iterations} iterations, residual {residual:.3f}")
        assert residual < SHIFT_TOLERANCE
        taken.append(iterations)
    assert taken[1] <= 1.5 * taken[0]


def test_levels_even_out_as_jacobi_does(monkeypatch, device):
    """With and without them E are shifted alike to the solve's tolerance, and end as even."""
    places, spread = [], []
    for first in (10**9, 0):
        monkeypatch.setattr(features, "COARSE_FROM", first)
        _, s = clustered(1500, device)
        before = f64(s.state.e.x)
        s.redistribution.apply(s.membrane.u_mid)
        places.append(f64(s.state.e.x) - before)
        s.lists.rebuild()
        s.geometry.update()
        spread.append(apply(s, 40)[-1])
    plain, levels = places
    print(f"differ by {np.linalg.norm(levels - plain) / np.linalg.norm(plain):.3f}; spread {spread}")
    assert np.linalg.norm(levels - plain) < 2.0 * SHIFT_TOLERANCE * np.linalg.norm(plain)
    assert spread[1] < max(1.2 * spread[0], 0.05)
