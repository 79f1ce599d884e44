"""Stage 2, geometry of E: frames by PCA, quadratic fits, curvature, density (Algorithm 2)."""

import warp as wp

from melp_warp.kernels.mls import SLOPE_BLUR, fit_height, fitted_curvature, make_quadric, slope_normal
from melp_warp.kernels.native import (
    Quadric,
    cloud_moments,
    gradient_row,
    mat53,
    mat55,
    solve_fit,
    vec5,
    weigh_row,
    weigh_row_laplacian,
    write_row_gradient,
)
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, laplacian_weight, tangent_basis

wp.set_module_options({"enable_backward": False})

PLANE, BALL = wp.constant(0.45), wp.constant(0.65)
"""Least variance of a cloud of E over the middle one up to which it has a plane (0.35 on a right angle), and from which
it has none."""


RESOLVED = wp.constant(0.02)
"""Correction of a slope up to which a cubic tells how the normal varies over a cell: in rougher shapes the next terms
of the series outweigh it, and it is faded out."""

STEEPEST = wp.constant(0.2)
"""Largest correction of a slope for the cubic part of the surface: beyond it, in corners, a cubic says nothing."""


@wp.func
def mean_normal(i: int, x: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), rows: Neighbors, r: float):
    """Mean of the normals around E i, of unit length."""
    total = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        total += kernel_w(wp.length(x[j] - x[i]), r) * normal[j]
    return wp.normalize(total)


@wp.func
def least_axis(cov: wp.mat33, start: wp.vec3) -> wp.vec3:
    """Axis of the least eigenvalue of a covariance, on the side of `start`; 0 where it is at right angles to that.

    The adjugate has the products of the other two eigenvalues, of which that axis has the largest: eight applications
    to `start` leave (least/next)^8 of the other axes.
    """
    a = wp.vec3(cov[0, 0], cov[0, 1], cov[0, 2])
    b = wp.vec3(cov[1, 0], cov[1, 1], cov[1, 2])
    c = wp.vec3(cov[2, 0], cov[2, 1], cov[2, 2])
    power = wp.matrix_from_rows(wp.cross(b, c), wp.cross(c, a), wp.cross(a, b))
    for _ in range(3):
        power = power / wp.max(wp.trace(power), 1.0e-30)
        power = power * power
    return wp.normalize(power * start)


@wp.func
def flatness(cov: wp.mat33, n: wp.vec3) -> float:
    """Least eigenvalue of a covariance, whose axis is n, over the middle one."""
    least = wp.dot(n, cov * n)
    others = wp.trace(cov) - least
    minors = 0.5 * (wp.trace(cov) * wp.trace(cov) - wp.trace(cov * cov))
    product = minors - least * others
    return least / (0.5 * others - wp.sqrt(wp.max(0.25 * others * others - product, 0.0)))


@wp.kernel
def orient_frames_e(
    x: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    normal: wp.array(dtype=wp.vec3),
):
    """PCA normal of each E, turned to the side of the previous one (section 4.8, steps 1 and 2).

    In a corner of a foam the cloud has no plane: there the normal is the mean of those around.

    Args:
        x: [n] positions, m.
        before: [n] in foams, previous unit normals; null for a single film, which has no corners.
        rows: E:E neighbours.
        r: support radius, m.
        normal: [n_e] unit normals, previous in, new out.
    """
    i = rows.first + wp.tid()
    m = cloud_moments(i, x, rows, r)
    total = kernel_w(0.0, 3.0) + m[0]
    mean = wp.vec3(m[1], m[2], m[3])
    square = wp.vec3(m[4], m[5], m[6])
    mixed = wp.vec3(m[7], m[8], m[9])
    mean = mean / total
    square = square / total - wp.cw_mul(mean, mean)
    mixed = mixed / total - wp.vec3(mean[1] * mean[2], mean[2] * mean[0], mean[0] * mean[1])
    cov = wp.mat33(square[0], mixed[2], mixed[1], mixed[2], square[1], mixed[0], mixed[1], mixed[0], square[2])
    old = normal[i]
    n = least_axis(cov, old)
    if before:
        round = (flatness(cov, n) - PLANE) / (BALL - PLANE)
        if round > 0.0:
            n = wp.normalize(wp.lerp(n, mean_normal(i, x, before, rows, r), wp.min(round, 1.0)))
    # A cloud without a plane (clumped or collinear particles) gives no trustworthy PCA: keep the old normal.
    if wp.dot(n, old) > 0.5:
        normal[i] = n


@wp.func
def write_gradient(
    i: int,
    x: wp.array(dtype=wp.vec3),
    n: wp.vec3,
    rows: Neighbors,
    r: float,
    limit: int,
    factor: mat55,
    c: vec5,
    gradient: wp.array(dtype=wp.vec3),
):
    """Write g_ij with grad_s f = sum_j (f_j - f_i) g_ij, exact for quadratics, into row i. 1/m."""
    e1, e2 = tangent_basis(n)
    # Covariant basis of the fitted surface and its inverse metric: the g of (10).
    t1 = e1 + c[0] * n
    t2 = e2 + c[1] * n
    g11 = 1.0 + c[0] * c[0]
    g12 = c[0] * c[1]
    g22 = 1.0 + c[1] * c[1]
    det = g11 * g22 - g12 * g12
    up1 = (g22 * t1 - g12 * t2) / det
    up2 = (g11 * t2 - g12 * t1) / det
    y1 = solve_fit(factor, vec5(1.0, 0.0, 0.0, 0.0, 0.0))
    y2 = solve_fit(factor, vec5(0.0, 1.0, 0.0, 0.0, 0.0))
    turn = mat53()
    for m in range(5):
        turn[m] = y1[m] * up1 + y2[m] * up2
    write_row_gradient(i, x, e1, e2, turn, rows, r, limit, gradient)


@wp.kernel
def fit_surface_e(
    x: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    normal: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    kappa: wp.array(dtype=float),
    gradient: wp.array(dtype=wp.vec3),
):
    """Fit the surface by MLS, refine the normal by its slope, store the fit and the gradient weights.

    Args:
        x: [n] positions, m.
        rows: E:E neighbours.
        r: support radius, m.
        normal: [n_e] PCA normal in, refined out (section 4.8, step 4).
        surface: [n_e] fitted surfaces.
        kappa: [n_e] sum of principal curvatures, 1/m.
        gradient: [pairs] see `write_gradient`.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    factor, c = fit_height(i, x, n, rows, r, x.shape[0], False)
    surface[i] = make_quadric(c, n, r / 3.0)
    normal[i] = slope_normal(c, n)
    kappa[i] = fitted_curvature(c, r / 3.0)
    write_gradient(i, x, n, rows, r, x.shape[0], factor, c, gradient)


@wp.kernel
def sharpen_normal_e(
    kappa: wp.array(dtype=float),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    n_e: int,
    r: float,
    # outputs
    normal: wp.array(dtype=wp.vec3),
    steepening: wp.array(dtype=wp.vec3),
):
    """Take the cubic part of the surface out of the fitted slope. [n_e].

    A linear slope fitted with isotropic weights to a cubic is off by <rho^4>/(8 <rho^2>) grad_s kappa; for the
    quintic spline the factor is `SLOPE_BLUR` (r/3)^2. Left in, it biases the enclosed volume by x.grad_s kappa.

    Args:
        kappa: [n_e] sum of principal curvatures, 1/m.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights, 1/m.
        n_e: number of E.
        r: support radius, m.
        normal: [n_e] unit normals.
        steepening: [n_e] grad_s kappa, faded out in rough shapes, 1/m^2; null where nobody asks.
    """
    i = rows.first + wp.tid()
    h = r / 3.0
    cubic = SLOPE_BLUR * h * h * gradient_row(i, kappa, rows, gradient, n_e)
    size = wp.length(cubic)
    if size > STEEPEST:
        cubic *= STEEPEST / size
    normal[i] = wp.normalize(normal[i] + cubic)
    if steepening:
        steepening[i] = cubic * (wp.max(1.0 - size * size / (RESOLVED * RESOLVED), 0.0) / (SLOPE_BLUR * h * h))


@wp.kernel
def fit_inner_gradient_e(
    x: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    gradient: wp.array(dtype=wp.vec3),
):
    """Gradient weights over E alone, one-sided at a rim: for fields that boundary particles do not carry.

    Args:
        x: [n] positions, m.
        surface: [n_e] fitted surfaces, for their planes.
        rows: E:E neighbours.
        r: support radius, m.
        n_e: number of E; particles from here on are boundary.
        gradient: [pairs] see `write_gradient`; zero for boundary neighbours.
    """
    i = rows.first + wp.tid()
    n = surface[i].normal
    factor, c = fit_height(i, x, n, rows, r, n_e, False)
    write_gradient(i, x, n, rows, r, n_e, factor, c, gradient)


@wp.kernel
def curvature_mls_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    chords: bool,
    # outputs
    kappa: wp.array(dtype=float),
):
    """Sum of principal curvatures by a quadratic fit, full formula of (10). [n_e], 1/m."""
    i = rows.first + wp.tid()
    _factor, c = fit_height(i, x, normal[i], rows, r, x.shape[0], chords)
    kappa[i] = fitted_curvature(c, r / 3.0)


@wp.kernel
def curvature_sph_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    n_e: int,
    rim_area: float,
    # outputs
    kappa: wp.array(dtype=float),
):
    """Sum of principal curvatures as the SPH Laplacian of the height, (10) with (21). [n_e], 1/m."""
    i = rows.first + wp.tid()
    p = x[i]
    n = normal[i]
    total = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        d = x[j] - p
        a = rim_area
        if j < n_e:
            a = area[j]
        total += a * wp.dot(d, n) * laplacian_weight(wp.length(d), r)
    kappa[i] = total


@wp.kernel
def density_e(
    x: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    near: wp.array(dtype=float),
    density: wp.array(dtype=float),
    density_inner: wp.array(dtype=float),
):
    """Number density delta of (9), over all particles and over E alone. [n_e], 1/m^2.

    The kernel takes the 3D distance: the area within a chord s of a point of a sphere is pi s^2 exactly, so the
    density is free of the curvature error that distances in the tangent plane bring. `near` is W of each pair. [pairs].
    """
    i = rows.first + wp.tid()
    inner = kernel_w(0.0, r) + weigh_row(i, x[i], x, rows, r, n_e, near)[3]
    outer = float(0.0)
    if x.shape[0] > n_e:
        for k in range(rows.start[i], rows.stop[i]):
            j = rows.index[k]
            if j >= n_e:
                outer += kernel_w(wp.length(x[j] - x[i]), r)
    density[i] = inner + outer
    density_inner[i] = inner


@wp.kernel
def pair_weights_e(
    x: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    n_e: int,
    rim_area: float,
    # outputs
    weight: wp.array(dtype=float),
):
    """a_i a_j 2|W'(d)|/d of the symmetric SPH Laplacian for each pair, d the 3D distance. [pairs], dimensionless.

    Boundary particles, of index n_e on, have the area `rim_area`.
    """
    i = rows.first + wp.tid()
    weigh_row_laplacian(i, x, area, rows, r, n_e, rim_area, weight)


@wp.kernel
def rim_gain_e(
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    # outputs
    gain: wp.array(dtype=float),
):
    """1 + share of an E's weights that lies beyond the rim. [n_e].

    One-sided gradients are steep. With fluxes of (14) that count this much more, the midpoint rule holds at any step:
    the divergence of the gradient of (15) is then at most 0.99 of its Laplacian, where it was 1.08 beside a round rim
    and 1.15 in a corner; on closed films it is at most 0.98.
    """
    i = rows.first + wp.tid()
    whole = float(0.0)
    beyond = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        whole += weight[k]
        beyond += wp.where(rows.index[k] < n_e, 0.0, weight[k])
    gain[i] = 1.0 + beyond / wp.max(whole, 1.0e-30)
