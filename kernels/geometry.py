"""Stage 2, geometry of E: frames by PCA, quadratic fits, curvature, control area, density (Algorithm 2)."""

import warp as wp

from melp_warp.kernels.mls import (
    cholesky_solve,
    fit_height,
    fitted_curvature,
    mat55,
    quadratic_basis,
    slope_normal,
    vec5,
)
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, laplacian_weight, tangent_basis

wp.set_module_options({"enable_backward": False})

mat2x16 = wp.types.matrix(shape=(2, 16), dtype=wp.float32)


@wp.kernel
def orient_frames_e(
    x: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    normal: wp.array(dtype=wp.vec3),
):
    """PCA normal of each E, turned to the side of the previous one (section 4.8, steps 1 and 2).

    Args:
        x: [n] positions, m.
        rows: E:E neighbours.
        r: support radius, m.
        normal: [n_e] unit normals, previous in, new out.
    """
    i = wp.tid()
    p = x[i]
    w0 = kernel_w(0.0, 3.0)
    total = float(w0)
    mean = wp.vec3()
    second = wp.mat33()
    h = r / 3.0
    for k in range(rows.start[i], rows.start[i + 1]):
        d = (x[rows.index[k]] - p) / h
        w = kernel_w(wp.length(d), 3.0)
        total += w
        mean += w * d
        second += w * wp.outer(d, d)
    mean = mean / total
    cov = second / total - wp.outer(mean, mean)
    vectors, values = wp.eig3(cov)
    least = int(0)
    for c in range(1, 3):
        if values[c] < values[least]:
            least = c
    n = wp.vec3(vectors[0, least], vectors[1, least], vectors[2, least])
    old = normal[i]
    if wp.length_sq(n) > 0.25:
        n = wp.normalize(n)
        if wp.dot(n, old) < 0.0:
            n = -n
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
    low: mat55,
    c: vec5,
    gradient: wp.array(dtype=wp.vec3),
):
    """Write g_ij with grad_s f = sum_j (f_j - f_i) g_ij, exact for quadratics, into row i. 1/m."""
    h = r / 3.0
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
    y1 = cholesky_solve(low, vec5(1.0, 0.0, 0.0, 0.0, 0.0))
    y2 = cholesky_solve(low, vec5(0.0, 1.0, 0.0, 0.0, 0.0))
    p = x[i]
    for k in range(rows.start[i], rows.start[i + 1]):
        j = rows.index[k]
        g = wp.vec3()
        if j < limit:
            d = (x[j] - p) / h
            w = kernel_w(wp.length(d), 3.0)
            b = quadratic_basis(wp.dot(d, e1), wp.dot(d, e2))
            g = (w / h) * (wp.dot(y1, b) * up1 + wp.dot(y2, b) * up2)
        gradient[k] = g


@wp.kernel
def fit_surface_e(
    x: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    normal: wp.array(dtype=wp.vec3),
    base: wp.array(dtype=wp.vec3),
    fit: wp.array(dtype=vec5),
    gradient: wp.array(dtype=wp.vec3),
):
    """Fit the surface by MLS, refine the normal by its slope, store the fit and the gradient weights.

    Args:
        x: [n] positions, m.
        rows: E:E neighbours.
        r: support radius, m.
        normal: [n_e] PCA normal in, refined out (section 4.8, step 4).
        base: [n_e] normal of the plane that `fit` refers to.
        fit: [n_e] coefficients over that plane, lengths in r/3.
        gradient: [pairs] see `write_gradient`.
    """
    i = wp.tid()
    n = normal[i]
    low, c = fit_height(i, x, n, rows, r, x.shape[0])
    base[i] = n
    fit[i] = c
    normal[i] = slope_normal(c, n)
    write_gradient(i, x, n, rows, r, x.shape[0], low, c, gradient)


@wp.kernel
def fit_inner_gradient_e(
    x: wp.array(dtype=wp.vec3),
    base: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    gradient: wp.array(dtype=wp.vec3),
):
    """Gradient weights over E alone, one-sided at a rim: for fields that boundary particles do not carry.

    Args:
        x: [n] positions, m.
        base: [n_e] normals of the fitting planes.
        rows: E:E neighbours.
        r: support radius, m.
        n_e: number of E; particles from here on are boundary.
        gradient: [pairs] see `write_gradient`; zero for boundary neighbours.
    """
    i = wp.tid()
    n = base[i]
    low, c = fit_height(i, x, n, rows, r, n_e)
    write_gradient(i, x, n, rows, r, n_e, low, c, gradient)


@wp.kernel
def curvature_mls_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    kappa: wp.array(dtype=float),
):
    """Sum of principal curvatures by a quadratic fit, full formula of (10). [n_e], 1/m."""
    i = wp.tid()
    low, c = fit_height(i, x, normal[i], rows, r, x.shape[0])
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
    i = wp.tid()
    p = x[i]
    n = normal[i]
    total = float(0.0)
    for k in range(rows.start[i], rows.start[i + 1]):
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
    density: wp.array(dtype=float),
    density_inner: wp.array(dtype=float),
):
    """Number density delta of (9), over all particles and over E alone. [n_e], 1/m^2.

    The kernel takes the 3D distance: the area within a chord s of a point of a sphere is pi s^2 exactly, so the
    density is free of the curvature error that distances in the tangent plane bring.
    """
    i = wp.tid()
    p = x[i]
    inner = kernel_w(0.0, r)
    outer = float(0.0)
    for k in range(rows.start[i], rows.start[i + 1]):
        j = rows.index[k]
        w = kernel_w(wp.length(x[j] - p), r)
        if j < n_e:
            inner += w
        else:
            outer += w
    density[i] = inner + outer
    density_inner[i] = inner


@wp.func
def clip_cell(cell: mat2x16, count: int, u: float, v: float):
    """Cut a polygon by the perpendicular bisector of the origin and (u, v), keeping the origin's side."""
    kept = mat2x16()
    n = int(0)
    half = 0.5 * (u * u + v * v)
    px = cell[0, count - 1]
    py = cell[1, count - 1]
    sp = px * u + py * v - half
    for m in range(count):
        qx = cell[0, m]
        qy = cell[1, m]
        sq = qx * u + qy * v - half
        if (sp < 0.0) != (sq < 0.0) and n < 16:
            t = sp / (sp - sq)
            kept[0, n] = px + t * (qx - px)
            kept[1, n] = py + t * (qy - py)
            n += 1
        if sq < 0.0 and n < 16:
            kept[0, n] = qx
            kept[1, n] = qy
            n += 1
        px = qx
        py = qy
        sp = sq
    return kept, n


@wp.kernel
def voronoi_area_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    area: wp.array(dtype=float),
):
    """Area of each E's Voronoi cell in its tangent plane, distances kept as chords. [n_e], m^2.

    Unlike 1/delta of (9), whose sum is biased on uneven particles, the cells tile the surface to second order.
    """
    i = wp.tid()
    p = x[i]
    n = normal[i]
    e1, e2 = tangent_basis(n)
    cell = mat2x16()
    half = 0.5 * r
    cell[0, 0] = -half
    cell[1, 0] = -half
    cell[0, 1] = half
    cell[1, 1] = -half
    cell[0, 2] = half
    cell[1, 2] = half
    cell[0, 3] = -half
    cell[1, 3] = half
    count = int(4)
    reach = float(2.0) * half * half
    for k in range(rows.start[i], rows.start[i + 1]):
        d = x[rows.index[k]] - p
        dd = wp.length_sq(d)
        if dd < 4.0 * reach:
            u = wp.dot(d, e1)
            v = wp.dot(d, e2)
            flat = u * u + v * v
            if flat > 0.0:
                stretch = wp.sqrt(dd / flat)
                cell, count = clip_cell(cell, count, u * stretch, v * stretch)
                reach = float(0.0)
                for m in range(count):
                    reach = wp.max(reach, cell[0, m] * cell[0, m] + cell[1, m] * cell[1, m])
    twice = float(0.0)
    for m in range(count):
        q = m + 1
        if q == count:
            q = 0
        twice += cell[0, m] * cell[1, q] - cell[1, m] * cell[0, q]
    area[i] = 0.5 * twice


@wp.kernel
def control_area_e(
    x: wp.array(dtype=wp.vec3),
    cell: wp.array(dtype=float),
    density_inner: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    area: wp.array(dtype=float),
):
    """Control area a = integral of the transfer weight W(E, x)/sum_E' W(E', x) over the film. [n_e], m^2.

    The weights are those of (6), so that an even film is transferred to an even eta_E = V_E/a_E; the integral is
    taken over the Voronoi cells and sums to their area.
    """
    i = wp.tid()
    p = x[i]
    total = kernel_w(0.0, r) * cell[i] / density_inner[i]
    for k in range(rows.start[i], rows.start[i + 1]):
        j = rows.index[k]
        if j < n_e:
            total += kernel_w(wp.length(x[j] - p), r) * cell[j] / density_inner[j]
    area[i] = total


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
    i = wp.tid()
    p = x[i]
    for k in range(rows.start[i], rows.start[i + 1]):
        j = rows.index[k]
        a = rim_area
        if j < n_e:
            a = area[j]
        weight[k] = area[i] * a * laplacian_weight(wp.length(x[j] - p), r)
