"""Moving least squares: quadratic fits of the surface over a tangent plane."""

import warp as wp

from melp_warp.kernels.native import Quadric, factor_fit, fit_moments, solve_fit, vec5
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import tangent_basis

wp.set_module_options({"enable_backward": False})

STEEPEST = wp.constant(4.0)
"""Largest curvature that a fit may give, in 1/h = 3/r: clumped or collinear particles make it up."""

SLOPE_BLUR = wp.constant(0.2254)
"""What the slope of a quadratic fitted to a smooth f lacks, over h^2 grad_s lap_s f: <rho^4>/(8 <rho^2>) over h^2, with
the quintic spline as weight."""


@wp.func
def fit_height(
    i: int,
    x: wp.array(dtype=wp.vec3),
    n: wp.vec3,
    rows: Neighbors,
    r: float,
    limit: int,
    chords: bool,
):
    """Fit z = c.(u, v, u^2, uv, v^2) through x_i over the plane with normal n.

    There is no constant term: a particle displaced alone must enter its own curvature. Lengths are in h = r/3.
    Only neighbours below index `limit` take part. If `chords`, (u, v) is lengthened to the distance in space: on a
    sphere z = -|d|^2/(2R) then, and its curvature is exact, where the quartic part of z over (u, v) adds to it.

    Returns:
        The factors of the normal matrix and the coefficients c.
    """
    e1, e2 = tangent_basis(n)
    m = fit_moments(i, x, e1, e2, n, rows, r, limit, chords)
    factor = factor_fit(m)
    return factor, solve_fit(factor, vec5(m[12], m[13], m[14], m[15], m[16]))


@wp.func
def slope_normal(c: vec5, n: wp.vec3) -> wp.vec3:
    """Unit normal of the fitted surface at its origin."""
    e1, e2 = tangent_basis(n)
    return wp.normalize(n - c[0] * e1 - c[1] * e2)


@wp.func
def fitted_curvature(c: vec5, h: float) -> float:
    """Sum of principal curvatures kappa of z = c.b at the origin, signed along the normal (sphere: -2/R). 1/m.

    At most `STEEPEST`/h, a radius of half an h, which no spacing resolves.
    """
    zx = c[0]
    zy = c[1]
    g = 1.0 + zx * zx + zy * zy
    top = (1.0 + zy * zy) * (2.0 * c[2]) - 2.0 * zx * zy * c[3] + (1.0 + zx * zx) * (2.0 * c[4])
    return wp.clamp(top / (g * wp.sqrt(g)), -STEEPEST, STEEPEST) / h


@wp.func
def make_quadric(c: vec5, n: wp.vec3, h: float) -> Quadric:
    """The fit z = c.b over the plane with normal n, in world axes; lengths of c in h."""
    e1, e2 = tangent_basis(n)
    q = Quadric()
    q.normal = n
    q.gradient = n - c[0] * e1 - c[1] * e2
    cross = 0.5 * c[3] * (wp.outer(e1, e2) + wp.outer(e2, e1))
    q.second = (c[2] * wp.outer(e1, e1) + c[4] * wp.outer(e2, e2) + cross) / h
    return q


@wp.func
def height_above(q: Quadric, d: wp.vec3) -> float:
    """Height along the plane's normal of the point at d above the surface, m."""
    return wp.dot(d, q.gradient - q.second * d)
