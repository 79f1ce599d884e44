"""What the rim does: mirrored velocity of boundary particles, L kept inside."""

import numpy as np
import pytest

from melp_warp.shapes import Catenoid, Disc, Jittered, Rectangle
from tests.helpers import fitted_order, make_stepper

WIDTH, HEIGHT, RADIUS = 0.2, 0.1, 0.05
SHEET = Rectangle(WIDTH, HEIGHT)


def f64(array):
    return array.numpy().astype(np.float64)


def set_e(stepper, function):
    n = stepper.film.n_e
    u = np.zeros((stepper.film.total, 3))
    u[:n] = function(f64(stepper.state.e.x)[:n])
    stepper.state.e.u.assign(u.astype(np.float32))


@pytest.mark.parametrize("shape", [Jittered(SHEET), Jittered(Disc(RADIUS))])
def test_constant_velocity_is_mirrored_exactly(shape, device):
    """u_b = U - 2 (U.o) o - 2 (U.n) n: reversed across the rim and along the normal, kept along the rim (free slip)."""
    film, s = make_stepper(shape, 800, device, l_per_e=1)
    constant = np.array([0.6, -0.4, 0.3])
    set_e(s, lambda x: np.tile(constant, (len(x), 1)))
    s.rim.mirror_velocity()
    out = f64(film.rim.outward)
    n = f64(s.state.e.normal)[film.n_e :]
    expected = constant - 2.0 * ((out @ constant)[:, None] * out + (n @ constant)[:, None] * n)
    assert np.abs(f64(s.state.e.u)[film.n_e :] - expected).max() < 2e-6


def on_the_walls(stepper):
    """L put on the four walls, away from the corners, and the unit vectors across the walls."""
    film, lag = stepper.film, stepper.state.l
    n = film.n_l
    t = np.linspace(-1.0, 1.0, n // 4)
    far = 0.5 * np.array([WIDTH, HEIGHT]) - film.r
    sides = []
    for sign in (-1.0, 1.0):
        sides.append((np.stack([0.5 * sign * WIDTH + 0.0 * t, far[1] * t, 0.0 * t], axis=1), [sign, 0.0, 0.0]))
        sides.append((np.stack([far[0] * t, 0.5 * sign * HEIGHT + 0.0 * t, 0.0 * t], axis=1), [0.0, sign, 0.0]))
    x = f64(lag.x)
    count = 4 * len(t)
    x[:count] = np.concatenate([p for p, _ in sides])
    out = np.concatenate([np.tile(o, (len(t), 1)) for _, o in sides])
    lag.x.assign(x.astype(np.float32))
    stepper.lists.rebuild()
    return out


def leak(stepper, across, function):
    """Largest normal velocity at the first L, which lie on the rim."""
    set_e(stepper, function)
    stepper.transfer.start_l()
    return np.abs(np.sum(f64(stepper.state.l.v)[: len(across)] * across, axis=1)).max()


def test_no_flow_through_a_straight_wall(device):
    """A flow that dies out towards the wall as u' d is affine: L on the wall see it stop, on uneven points too."""
    slope = 30.0
    for shape in (SHEET, Jittered(SHEET)):
        _, s = make_stepper(shape, 1800, device, l_per_e=2)
        out = on_the_walls(s)
        near = leak(s, out, lambda x: slope * np.stack([0.0 * x[:, 0], 0.05 - x[:, 1], 0.0 * x[:, 0]], axis=1))
        lower = np.isclose(out[:, 1], -1.0)
        assert near == pytest.approx(slope * HEIGHT, rel=1e-4)  # the lower wall, where that flow does not stop
        v = np.abs(np.sum(f64(s.state.l.v)[: len(out)] * out, axis=1))
        assert v[~lower].max() < 1e-4 * slope * HEIGHT


def test_dilation_sees_the_wall(device):
    """An even flow onto a wall is compressed there: sum a div u = -U (length of the wall), by the mirrored velocities.

    The flow jumps at the wall; the gradient of a jump is right to 10 % of it, corners included. Nothing happens at the
    walls along which the flow slips.
    """
    film, s = make_stepper(SHEET, 1800, device, l_per_e=2)
    set_e(s, lambda x: np.tile([1.0, 0.0, 0.0], (len(x), 1)))
    dilation, area = f64(s.tangential.find_dilation()), f64(s.geometry.area)
    x = f64(s.state.e.x)[: film.n_e]
    right = x[:, 0] > 0.0
    assert np.sum((area * dilation)[right]) == pytest.approx(-HEIGHT, rel=0.1)
    assert np.sum((area * dilation)[~right]) == pytest.approx(HEIGHT, rel=0.1)
    assert np.abs(dilation[np.abs(x[:, 0]) < 0.5 * WIDTH - 1.1 * film.r]).max() < 1e-2


def test_no_flow_through_a_round_rim(device):
    """A radial flow 1 - (rho/R)^2 that dies out at the rim crosses it by O(dx^2) of its curvature only."""
    spacings, leaks = [], []
    for count in (800, 1600, 3200, 6400):
        film, s = make_stepper(Disc(RADIUS), count, device, l_per_e=2)
        phi = np.linspace(0.0, 2.0 * np.pi, film.n_l, endpoint=False)
        rim = np.stack([np.cos(phi), 0.0 * phi, np.sin(phi)], axis=1)
        s.state.l.x.assign((RADIUS * rim).astype(np.float32))
        s.lists.rebuild()
        radial = lambda x: (1.0 - np.sum(x * x, axis=1, keepdims=True) / RADIUS**2) * x / RADIUS  # noqa: E731
        spacings.append(film.spacing)
        leaks.append(leak(s, rim, radial))
    print("leaks", leaks, "order", fitted_order(spacings, leaks))
    assert fitted_order(spacings, leaks) > 1.7


def push_out(stepper, factor):
    """Move L away from the centre by a factor [n_l]; returns their places."""
    lag = stepper.state.l
    lag.x.assign((f64(lag.x) * factor[:, None]).astype(np.float32))
    stepper.lists.rebuild()
    return f64(lag.x)


def confine(stepper):
    stepper.rim.confine()
    return f64(stepper.state.l.x)


def beyond(shape, x):
    """Distance by which each point lies beyond the rim, m; negative inside."""
    if isinstance(shape, Disc):
        return np.linalg.norm(x, axis=1) - RADIUS
    return np.maximum(np.abs(x[:, 0]) - 0.5 * WIDTH, np.abs(x[:, 1]) - 0.5 * HEIGHT)


@pytest.mark.parametrize("shape", [SHEET, Disc(RADIUS)])
def test_l_stay_inside(shape, device):
    """L pushed across the rim by up to a spacing are put back onto it, others stay where they are.

    A disc's rim is met at the tangent of the nearest anchor, less than half a spacing away: off by dx^2/(8 R) at most.
    """
    film, s = make_stepper(shape, 800, device, l_per_e=4)
    x = f64(s.state.l.x)
    factor = np.where(np.arange(film.n_l) % 3, 1.0, 1.0 + film.spacing / np.linalg.norm(x, axis=1).max())
    moved = push_out(s, factor)
    out = beyond(shape, moved)
    after = confine(s)
    corner = np.all(np.abs(moved[:, :2]) > [0.5 * WIDTH, 0.5 * HEIGHT], axis=1)
    print(f"outside by {out.max() / film.spacing:.2f} dx: {np.sum(out > 0)} L, {corner.sum()} beyond a corner")
    assert out.max() > 0.5 * film.spacing
    limit = film.spacing**2 / (8.0 * RADIUS) if isinstance(shape, Disc) else 1e-7
    assert beyond(shape, after)[~corner].max() < limit
    assert np.array_equal(after[out < -1e-8], moved[out < -1e-8])
    assert np.linalg.norm(after - moved, axis=1).max() < 1.01 * film.spacing


def test_l_beyond_a_corner_come_back(device):
    """In a corner the boundary particle that looks towards the L decides: off by its direction, gone in a few steps.

    Several boundary particles have the corner as their anchor. Their directions are some 10 degrees apart, so that a
    fifth of the distance may be left at first. What stays is the width of a boundary particle seen from the corner:
    0.006 dx with the strip of support 4, 0.012 dx with that of support 3.
    """
    film, s = make_stepper(SHEET, 800, device, l_per_e=4, numerics={"support": 4.0})
    lag = s.state.l
    rng = np.random.default_rng(0)
    corner = 0.5 * np.array([WIDTH, HEIGHT])
    x = f64(lag.x)
    x[:200, :2] = rng.choice([-1.0, 1.0], (200, 2)) * (corner + film.spacing * rng.uniform(0.0, 0.7, (200, 2)))
    lag.x.assign(x.astype(np.float32))
    s.lists.rebuild()
    left = [beyond(SHEET, confine(s)).max() / film.spacing for _ in range(5)]
    print("left outside, dx:", ", ".join(f"{v:.3f}" for v in left))
    assert left[0] < 0.25
    assert left[-1] < 0.01


def distance_to_catenoid(x, neck):
    """First-order distance F/|grad F| for F = rho - neck cosh(y/neck)."""
    y = x[:, 1] / neck
    return (np.hypot(x[:, 0], x[:, 2]) - neck * np.cosh(y)) / np.hypot(1.0, np.sinh(y))


def test_minimal_surface_is_continued(device):
    """Boundary particles beyond a pinned rim continue a catenoid: 2 a - mirror - (k.n) s^2 n, off by O(s^3).

    A film at rest without pressure has no mean curvature: across its rim it curves by minus the curvature of the rim.
    The odd terms of x(s) are exact, the even one errs as far as n is that of the mirror point, by O(s). Third order is
    reached for the particles next to the rim, which weigh most; the outermost, at 4.5 dx, are still on their way there.
    """
    spacings, near, far = [], [], []
    for count in (1500, 3000, 6000, 12000):
        film, s = make_stepper(Jittered(Catenoid(0.04, 0.05), 0.0), count, device)
        for _ in range(3):
            s.rim.extend()
            s.lists.rebuild()
            s.geometry.update()
        off = np.abs(distance_to_catenoid(f64(s.state.e.x)[film.n_e :], 0.04))
        depth = np.linalg.norm(f64(s.state.b.mirror) - f64(film.rim.anchors), axis=1)
        spacings.append(film.spacing)
        near.append(off[depth < 2.0 * film.spacing].max())
        far.append(off.max())
    for name, values in (("within 2 dx", near), ("all", far)):
        print(
            f"{name}: off by {', '.join(f'{e / h:.1e}' for e, h in zip(values, spacings, strict=True))} dx, "
            f"order {fitted_order(spacings, values):.2f}"
        )
    assert fitted_order(spacings, near) > 2.5
    assert np.all(np.array(far) < 0.05 * np.array(spacings))


def test_plane_is_continued(device):
    """The boundary particles of a plane film that is free to bulge stay where they are, to rounding."""
    film, s = make_stepper(Disc(RADIUS, flat=False), 800, device)
    before = f64(s.state.e.x)[film.n_e :]
    for _ in range(10):
        s.rim.extend()
    assert np.abs(f64(s.state.e.x)[film.n_e :] - before).max() < 1e-6 * RADIUS
