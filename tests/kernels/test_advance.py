"""Motion of E with the film as a whole and along turning normals, projection of L onto the surface."""

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
    film, s = make_stepper(shape, 1000, device, numerics={"redistribution": 0.0})
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


def test_e_move_along_turning_normals(device):
    """E of a sphere with u_n = eps P2 move along normals that turn: those of the middle of the step, to O(dt^3).

    After the step they are at x + dt (u_n n - dt/2 u_n grad_s u_n); along the first normals alone they would miss by
    dt^2/2 u_n |grad_s u_n|.
    """
    _, s = make_stepper(Sphere(RADIUS), 2000, device)
    e, dt, size = s.state.e, 2e-3, 1.0
    n = f64(e.normal)
    x = f64(e.x)
    u_n = size * (1.5 * n[:, 1] ** 2 - 0.5)
    slope = size * 3.0 * n[:, 1:2] * (np.array([0.0, 1.0, 0.0]) - n[:, 1:2] * n) / RADIUS
    s.membrane.u_mid.assign(u_n.astype(np.float32))
    s.e_advance.advance(s.membrane.u_mid, s.state.motion, s.prepare(dt))
    exact = x + dt * u_n[:, None] * n - 0.5 * dt**2 * u_n[:, None] * slope
    miss = np.linalg.norm(f64(e.x) - exact, axis=1).max()
    whole = np.linalg.norm(0.5 * dt**2 * u_n[:, None] * slope, axis=1).max()
    print(f"off by {miss / whole:.3f} of what the turn makes")
    assert miss < 0.05 * whole


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
