"""Motion of E with the film as a whole, smoothing of their drift, projection of L onto the surface."""

import numpy as np
import pytest
import warp as wp

from melp_warp.shapes import Disc, Ellipsoid, Jittered, Sphere
from tests.helpers import fitted_order, make_stepper

RADIUS = 0.05
AXES = np.array([0.06, 0.05, 0.042])


def f64(array):
    return array.numpy().astype(np.float64)


@pytest.mark.parametrize("shape", [Jittered(Sphere(RADIUS)), Jittered(Ellipsoid(*AXES))])
def test_translation_is_found_and_followed(shape, device):
    """u_n = U.n gives (sum m n n)^-1 sum m u_n n = U on any points; E then move by dt U, none is left behind.

    To rounding: 1e-6 of |U|.
    """
    film, s = make_stepper(shape, 1000, device)
    speed = np.array([0.4, -1.1, 0.7])
    e = s.state.e
    u_n = (f64(e.normal) @ speed).astype(np.float32)
    e.u.assign(u_n[:, None] * e.normal.numpy())
    s.membrane.start_motion()
    assert s.state.motion.numpy()[0] == pytest.approx(speed, abs=3e-6)
    x = f64(e.x)
    s.e_advance.advance(wp.array(u_n, dtype=float, device=device), s.state.motion, s.prepare(0.02))
    assert np.abs(f64(e.x)[: film.n_e] - x - 0.02 * speed).max() < 5e-6 * 0.02 + 1e-8


def test_swelling_and_modes_are_no_translation(device):
    """u_n = 1 and u_n = P2 have no translation in them: what is found is their quadrature error, below 1e-3."""
    film, s = make_stepper(Jittered(Sphere(RADIUS)), 2000, device)
    n = f64(s.state.e.normal)
    for values in (np.ones(film.n_e), 1.5 * n[:, 1] ** 2 - 0.5):
        s.state.e.u.assign((values[:, None] * n).astype(np.float32))
        s.membrane.start_motion()
        assert np.linalg.norm(s.state.motion.numpy()[0]) < 1e-3


def test_drift_is_smoothed(device):
    """XSPH: an even drift stays, independent noise averaged with weights W shrinks to sqrt(sum W^2)/sum W.

    That is dx sqrt(int W^2 dA) with int W dA = 1, 0.30 for the quintic spline at r = 4 dx; s = 0.99 adds 1 % W(0) dx^2.
    """
    film, s = make_stepper(Jittered(Sphere(RADIUS)), 2000, device, numerics={"xsph": 0.99})
    e = s.state.e
    still = film.zeros(film.n_e)
    constant = np.tile([0.1, 0.2, -0.1], (film.n_e, 1))
    e.drift.assign(constant.astype(np.float32))
    s.e_advance.advance(still, s.state.motion, s.dt.at(0.0))
    assert np.abs(f64(e.drift) - constant).max() < 1e-6
    noise = np.random.default_rng(0).normal(size=(film.n_e, 3))
    e.drift.assign(noise.astype(np.float32))
    s.e_advance.advance(still, s.state.motion, s.dt.at(0.0))
    d = np.linspace(0.0, 3.0, 3001)
    w = 0.004661441847 * sum(c * np.maximum(q - d, 0.0) ** 5 for c, q in ((1.0, 3.0), (-6.0, 2.0), (15.0, 1.0)))
    h = film.r / 3.0 / film.spacing
    expected = np.sqrt(2.0 * np.pi * np.sum(w * w * d) * d[1]) / h
    print(f"noise left {f64(e.drift).std():.3f}, expected {expected:.3f}")
    assert f64(e.drift).std() == pytest.approx(expected, rel=0.1)


def distance_to_ellipsoid(x):
    """First-order distance F/|grad F| of points near the ellipsoid."""
    f = np.sum((x / AXES) ** 2, axis=1) - 1.0
    return f / np.linalg.norm(2.0 * x / AXES**2, axis=1)


@pytest.mark.parametrize("name", ["sphere", "ellipsoid"])
def test_projection_converges(name, device):
    """L up to 0.3 dx off the surface come onto it within O(dx^2) or better, from both sides (Algorithm 7).

    The fits of the nearest E are quadrics through them: the cubic term they miss is O(dx^3), on a sphere, where the
    tangent planes are right to O(dx^3) too, the quartic one O(dx^4).
    """
    shape = Sphere(RADIUS) if name == "sphere" else Ellipsoid(*AXES)
    spacings, errors = [], []
    for count in (500, 1000, 2000, 4000):
        film, s = make_stepper(Jittered(shape), count, device, l_per_e=4)
        lag = s.state.l
        x = f64(lag.x)
        off = np.random.default_rng(0).uniform(-0.3, 0.3, film.n_l) * film.spacing
        lag.x.assign((x + off[:, None] * f64(lag.normal)).astype(np.float32))
        s.l_advance.project()
        x = f64(lag.x)
        left = np.linalg.norm(x, axis=1) - RADIUS if name == "sphere" else distance_to_ellipsoid(x)
        spacings.append(film.spacing)
        errors.append(np.abs(left).max())
    order = fitted_order(spacings, errors)
    print(
        f"{name}: largest distance {', '.join(f'{e / h:.1e}' for e, h in zip(errors, spacings, strict=True))} dx, "
        f"order {order:.2f}"
    )
    assert np.all(np.diff(errors) < 0.0)
    assert order >= 2.0


def test_projection_moves_along_the_normal(device):
    """L on the surface stay to O(dx^3) and none moves along it: 0.1 % of dx."""
    film, s = make_stepper(Jittered(Sphere(RADIUS)), 2000, device, l_per_e=4)
    lag = s.state.l
    on = f64(lag.x)
    n = on / np.linalg.norm(on, axis=1, keepdims=True)
    lag.x.assign((on + 0.3 * film.spacing * n).astype(np.float32))
    s.l_advance.project()
    moved = f64(lag.x) - on
    along = np.linalg.norm(moved - np.sum(moved * n, axis=1, keepdims=True) * n, axis=1)
    print(f"along the surface {along.max() / film.spacing:.1e} dx")
    assert along.max() < 0.02 * film.spacing


def test_paths_of_second_order_keep_to_the_circle(device):
    """In a rotation of h = 0.2 rad a step an L leaves its circle by h^4/8 of the radius; straight on by h^2/2."""
    spin, h = 5.0, 0.2
    for l_order, growth in ((1, 0.5 * h**2), (2, 0.125 * h**4)):
        film, s = make_stepper(
            Disc(RADIUS), 400, device, l_per_e=8, numerics={"l_order": l_order, "flow": "backward_euler"}
        )
        lag = s.state.l
        x = f64(lag.x)
        inner = np.hypot(x[:, 0], x[:, 2]) < 0.5 * RADIUS
        turn = spin * np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
        lag.v.assign((x @ turn.T).astype(np.float32))
        lag.affine.assign(np.tile(turn, (film.n_l, 1, 1)).astype(np.float32))
        dt = s.prepare(h / spin)
        s.tangential.choose_share(dt)
        s.l_advance.advance(s.frame, s.frame, s.tangential.bend, dt)
        radius = np.hypot(*f64(lag.x)[inner][:, [0, 2]].T) / np.hypot(*x[inner][:, [0, 2]].T)
        assert radius - 1.0 == pytest.approx(growth, rel=0.02, abs=1e-5)
