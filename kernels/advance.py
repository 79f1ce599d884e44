"""Stages 5 and 6: E and L advance (Algorithms 6 and 7), with the projection of L onto the surface."""

import warp as wp

from melp_warp.kernels.mls import Quadric
from melp_warp.kernels.native import gradient_row, height_over_fits
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})

STEEPEST = wp.constant(0.5)
"""Largest half turn of a normal that the path of an E follows in a step."""


@wp.kernel
def advance_e(
    normal: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    frame: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    x: wp.array(dtype=wp.vec3),
):
    """Move E with the normal velocity (19) and along with the film as a whole.

    A translating bubble would otherwise leave its E behind in the tangential direction and pile them up at the rear.

    Seen from the film as a whole E move at w = u_mid - U.n along the normal of the middle of the step, which has turned
    by -dt/2 grad_s w. Along the normal of its start they would drift along the film by dt^2/2 w grad_s w in each step:
    a ringing bubble would lose its even spacing, the faster the larger the steps.

    Args:
        normal: [n] unit normals.
        u_mid: [n_e] normal speed, m/s.
        region: [n] region of each E.
        frame: [regions] velocity U of each region as a whole, m/s.
        surface: [n_e] fitted surfaces.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights, 1/m.
        dt: [1] s.
        x: [n] m.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    whole = frame[region[i]]
    along = tangential(whole, n)
    own = u_mid[i] - wp.dot(whole, n)
    tilt = gradient_row(i, u_mid, rows, gradient, u_mid.shape[0]) + 2.0 * (surface[i].second * along)
    turn = -0.5 * dt[0] * tangential(tilt, n)
    size = wp.length(turn)
    if size > STEEPEST:
        turn *= STEEPEST / size
    x[i] = x[i] + dt[0] * (u_mid[i] * n + along + own * turn)


@wp.kernel
def shift_origin_e(shift: wp.vec3, x: wp.array(dtype=wp.vec3)):
    """Measure positions, of E or of L, from a place `shift` away. [n], m."""
    i = wp.tid()
    x[i] = x[i] - shift


@wp.func
def bent_path(own: wp.vec3, n: wp.vec3, affine: wp.mat33, bend: float, h: float) -> wp.vec3:
    """Velocity of an L on its path of a step h (s): v + bend/2 h B D^-1 w, w its own v along the film."""
    return own + (0.5 * bend * h) * (affine * tangential(own, n))


@wp.kernel
def advance_l(
    v: wp.array(dtype=wp.vec3),
    affine: wp.array(dtype=wp.mat33),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    frame: wp.array(dtype=wp.vec3),
    passed: wp.array(dtype=wp.vec3),
    bend: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    x: wp.array(dtype=wp.vec3),
):
    """Move L with the material velocity, and with the film as a whole as E do.

    The velocity is that of a time in the step or at its end when the film as a whole moves at `passed`; in the step it
    moves at `frame`. L of an accelerating bubble would otherwise be left behind its E.

    Half a step along its path an L meets the velocity v + 1/2 dt B D^-1 w, w its own along the film: with that it moves
    on a path of second order. Less of a bend leads L out of a vortex, whose pressure brings them back and feeds it.

    Args:
        v: [n_l] velocity at the particle, m/s.
        affine: [n_l] velocity gradient B D^-1, 1/s.
        normal: [n_l] unit normals.
        region: [n_l] region of each L.
        frame: [regions] velocity of each region as a whole in the step, m/s.
        passed: [regions] that at the time of v, m/s.
        bend: [1] 1 for paths of second order, 0 for straight ones.
        dt: [1] s.
        x: [n_l] m.
    """
    i = wp.tid()
    h = dt[0]
    own = v[i] - passed[region[i]]
    x[i] = x[i] + h * (bent_path(own, normal[i], affine[i], bend[0], h) + frame[region[i]])


@wp.kernel
def project_l(
    x_e: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    x_l: wp.array(dtype=wp.vec3),
):
    """Put each L on the surface, where the weighted mean of its heights above the quadratic fits of nearby E is 0.

    A step of Newton's method along the mean normal, so that an L on the surface stays where it is. One fit an E serves
    all its L, in place of one fit an L (Proj of section 4.8).

    Args:
        x_e: [n] m.
        surface: [n_e] fitted surfaces.
        rows: L:E neighbours.
        r: radius within which fits are averaged, m.
        n_e: number of E.
        x_l: [n_l] m.
    """
    i = rows.first + wp.tid()
    x_l[i] = x_l[i] - height_over_fits(i, x_l[i], x_e, surface, rows, r, n_e)
