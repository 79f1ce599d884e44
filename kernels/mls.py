"""Moving least squares: quadratic fits of the surface over a tangent plane."""

from typing import Any

import warp as wp

from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, tangent_basis

wp.set_module_options({"enable_backward": False})

STEEPEST = wp.constant(4.0)
"""Largest curvature that a fit may give, in 1/h = 3/r: clumped or collinear particles make it up."""

vec5 = wp.types.vector(length=5, dtype=wp.float32)
mat55 = wp.types.matrix(shape=(5, 5), dtype=wp.float32)


@wp.func
def quadratic_basis(u: float, v: float) -> vec5:
    """(u, v, u^2, uv, v^2)."""
    return vec5(u, v, u * u, u * v, v * v)


@wp.func
def cholesky(a: mat55) -> mat55:
    """Lower Cholesky factor of a symmetric positive matrix, its diagonal slightly raised."""
    low = mat55()
    ridge = 1.0e-6 * (a[0, 0] + a[1, 1] + a[2, 2] + a[3, 3] + a[4, 4]) + 1.0e-30
    for i in range(5):
        for j in range(i + 1):
            s = a[i, j]
            if i == j:
                s += ridge
            for k in range(j):
                s -= low[i, k] * low[j, k]
            if i == j:
                low[i, i] = wp.sqrt(wp.max(s, 1.0e-30))
            else:
                low[i, j] = s / low[j, j]
    return low


@wp.func
def cholesky_solve(low: mat55, b: vec5) -> vec5:
    """Solve L L^T y = b."""
    y = vec5()
    for i in range(5):
        s = b[i]
        for k in range(i):
            s -= low[i, k] * y[k]
        y[i] = s / low[i, i]
    for m in range(5):
        i = 4 - m
        s = y[i]
        for k in range(i + 1, 5):
            s -= low[k, i] * y[k]
        y[i] = s / low[i, i]
    return y


@wp.func
def fit_height(
    i: int,
    x: wp.array(dtype=wp.vec3),
    n: wp.vec3,
    rows: Neighbors,
    r: float,
    limit: int,
):
    """Fit z = c.(u, v, u^2, uv, v^2) through x_i over the plane with normal n.

    There is no constant term: a particle displaced alone must enter its own curvature. Lengths are in h = r/3.
    Only neighbours below index `limit` take part.

    Returns:
        The Cholesky factor of the normal matrix and the coefficients c.
    """
    # The normal matrix holds only the moments of w up to the fourth order.
    scale = 3.0 / r
    e1, e2 = tangent_basis(n)
    p = x[i]
    m20 = float(0.0)
    m11 = float(0.0)
    m02 = float(0.0)
    m30 = float(0.0)
    m21 = float(0.0)
    m12 = float(0.0)
    m03 = float(0.0)
    m40 = float(0.0)
    m31 = float(0.0)
    m22 = float(0.0)
    m13 = float(0.0)
    m04 = float(0.0)
    z1 = float(0.0)
    z2 = float(0.0)
    z3 = float(0.0)
    z4 = float(0.0)
    z5 = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        d = scale * (x[j] - p)
        w = kernel_w(wp.length(d), 3.0)
        if w > 0.0 and j < limit:
            u = wp.dot(d, e1)
            v = wp.dot(d, e2)
            wz = w * wp.dot(d, n)
            uu = u * u
            uv = u * v
            vv = v * v
            z1 += wz * u
            z2 += wz * v
            z3 += wz * uu
            z4 += wz * uv
            z5 += wz * vv
            wuu = w * uu
            wuv = w * uv
            wvv = w * vv
            m20 += wuu
            m11 += wuv
            m02 += wvv
            m30 += wuu * u
            m21 += wuu * v
            m12 += wvv * u
            m03 += wvv * v
            m40 += wuu * uu
            m31 += wuu * uv
            m22 += wuu * vv
            m13 += wvv * uv
            m04 += wvv * vv
    a = mat55(
        m20, m11, m30, m21, m12,
        m11, m02, m21, m12, m03,
        m30, m21, m40, m31, m22,
        m21, m12, m31, m22, m13,
        m12, m03, m22, m13, m04,
    )  # fmt: skip
    low = cholesky(a)
    return low, cholesky_solve(low, vec5(z1, z2, z3, z4, z5))


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


@wp.struct
class Quadric:
    """The surface near a particle at o: points o + d with d.gradient = d.(second d), over the plane with `normal`."""

    normal: wp.vec3
    gradient: wp.vec3
    second: wp.mat33


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


@wp.func
def gradient_at(i: int, f: wp.array(dtype=Any), rows: Neighbors, gradient: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Surface gradient sum_j (f_j - f_i) g_ij of a scalar field."""
    total = wp.vec3()
    fi = f[i]
    for k in range(rows.start[i], rows.stop[i]):
        total += (f[rows.index[k]] - fi) * gradient[k]
    return total
