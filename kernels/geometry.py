"""Stage 2, geometry of E: frames by PCA, quadratic fits, curvature, control area, density (Algorithm 2)."""

import warp as wp

from melp_warp.kernels.mls import (
    Quadric,
    cholesky_solve,
    fit_height,
    fitted_curvature,
    make_quadric,
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
    scale = 3.0 / r
    total = kernel_w(0.0, 3.0)
    mean = wp.vec3()
    square = wp.vec3()
    mixed = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        d = scale * (x[rows.index[k]] - p)
        w = kernel_w(wp.length(d), 3.0)
        wd = w * d
        total += w
        mean += wd
        square += wp.cw_mul(wd, d)
        mixed += wp.vec3(wd[1] * d[2], wd[2] * d[0], wd[0] * d[1])
    mean = mean / total
    square = square / total - wp.cw_mul(mean, mean)
    mixed = mixed / total - wp.vec3(mean[1] * mean[2], mean[2] * mean[0], mean[0] * mean[1])
    cov = wp.mat33(square[0], mixed[2], mixed[1], mixed[2], square[1], mixed[0], mixed[1], mixed[0], square[2])
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
    scale = 3.0 / r
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
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        g = wp.vec3()
        if j < limit:
            d = scale * (x[j] - p)
            w = kernel_w(wp.length(d), 3.0)
            if w > 0.0:
                b = quadratic_basis(wp.dot(d, e1), wp.dot(d, e2))
                g = (w * scale) * (wp.dot(y1, b) * up1 + wp.dot(y2, b) * up2)
        gradient[k] = g


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
    i = wp.tid()
    n = normal[i]
    low, c = fit_height(i, x, n, rows, r, x.shape[0])
    surface[i] = make_quadric(c, n, r / 3.0)
    normal[i] = slope_normal(c, n)
    kappa[i] = fitted_curvature(c, r / 3.0)
    write_gradient(i, x, n, rows, r, x.shape[0], low, c, gradient)


@wp.kernel
def sharpen_normal_e(
    kappa: wp.array(dtype=float),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    n_e: int,
    r: float,
    # outputs
    normal: wp.array(dtype=wp.vec3),
):
    """Take the cubic part of the surface out of the fitted slope. [n_e].

    A linear slope fitted with isotropic weights to a cubic is off by <rho^4>/(8 <rho^2>) grad_s kappa; for the
    quintic spline the factor is 0.2254 (r/3)^2. Left in, it biases the enclosed volume by x.grad_s kappa.

    Args:
        kappa: [n_e] sum of principal curvatures, 1/m.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights, 1/m.
        n_e: number of E.
        r: support radius, m.
        normal: [n_e] unit normals.
    """
    i = wp.tid()
    slope = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            slope += (kappa[j] - kappa[i]) * gradient[k]
    h = r / 3.0
    normal[i] = wp.normalize(normal[i] + 0.2254 * h * h * slope)


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
    i = wp.tid()
    n = surface[i].normal
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
    _low, c = fit_height(i, x, normal[i], rows, r, x.shape[0])
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
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        w = kernel_w(wp.length(x[j] - p), r)
        if j < n_e:
            inner += w
        else:
            outer += w
    density[i] = inner + outer
    density_inner[i] = inner


@wp.func
def clip_cell(cell: mat2x16, count: int, u: float, v: float, half: float):
    """Cut a polygon by the line q.(u, v) = half, keeping the origin's side."""
    kept = mat2x16()
    n = int(0)
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


@wp.func
def square_cell(half: float) -> mat2x16:
    """The square of side 2 half about the origin."""
    cell = mat2x16()
    cell[0, 0] = -half
    cell[1, 0] = -half
    cell[0, 1] = half
    cell[1, 1] = -half
    cell[0, 2] = half
    cell[1, 2] = half
    cell[0, 3] = -half
    cell[1, 3] = half
    return cell


@wp.kernel
def voronoi_cell_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    r: float,
    # outputs
    area: wp.array(dtype=float),
    flux: wp.array(dtype=wp.vec3),
    bulge: wp.array(dtype=float),
):
    """Voronoi cell of each E on its fitted surface: area and what the volume (11) needs.

    The cell is cut in the tangent plane. The bisector of a neighbour at (u, v, z) lies at half (u^2 + v^2 + z^2/2) next
    to the neighbour and, as the surface falls away, further in towards the ends of the edge: 0.444 z^2 is the mean over
    a hexagon's edge.
    With z = q.Q q/2 over the plane, area = |C| + tr(Q Q M)/2 and, for p = x_i + offset, the integral of p.n over the
    cell is x_i.flux + bulge with flux = |C| n - Q m, bulge = -tr(Q M)/2, m and M the moments of C. Unlike 1/delta
    of (9), whose sum is biased on uneven particles, the cells tile the surface to second order.

    Args:
        x: [n] positions, m.
        normal: [n] unit normals.
        surface: [n_e] fitted surfaces.
        rows: E:E neighbours.
        r: support radius, m.
        area: [n_e] m^2.
        flux: [n_e] m^2.
        bulge: [n_e] m^3.
    """
    i = wp.tid()
    p = x[i]
    n = normal[i]
    e1, e2 = tangent_basis(n)
    cell = square_cell(0.5 * r)
    count = int(4)
    reach = float(0.5) * r * r
    near = 0.2 * r * r
    # Near neighbours first: they leave a cell so small that few of the others reach it.
    for far in range(2):
        for k in range(rows.start[i], rows.stop[i]):
            d = x[rows.index[k]] - p
            dd = wp.length_sq(d)
            if dd < 4.0 * reach and (dd < near) == (far == 0):
                u = wp.dot(d, e1)
                v = wp.dot(d, e2)
                z = wp.dot(d, n)
                cell, count = clip_cell(cell, count, u, v, 0.5 * (u * u + v * v + 0.444 * z * z))
                reach = float(0.0)
                for m in range(count):
                    reach = wp.max(reach, cell[0, m] * cell[0, m] + cell[1, m] * cell[1, m])
    flat = float(0.0)
    first = wp.vec2()
    uu = float(0.0)
    uv = float(0.0)
    vv = float(0.0)
    for m in range(count):
        q = m + 1
        if q == count:
            q = 0
        ax = cell[0, m]
        ay = cell[1, m]
        bx = cell[0, q]
        by = cell[1, q]
        cross = ax * by - ay * bx
        flat += cross / 2.0
        first += cross / 6.0 * wp.vec2(ax + bx, ay + by)
        uu += cross / 12.0 * (ax * ax + ax * bx + bx * bx)
        uv += cross / 24.0 * (2.0 * ax * ay + ax * by + bx * ay + 2.0 * bx * by)
        vv += cross / 12.0 * (ay * ay + ay * by + by * by)
    second = 2.0 * surface[i].second
    s1 = second * e1
    s2 = second * e2
    q11 = wp.dot(e1, s1)
    q12 = wp.dot(e1, s2)
    q22 = wp.dot(e2, s2)
    stretch = (q11 * q11 + q12 * q12) * uu + 2.0 * q12 * (q11 + q22) * uv + (q12 * q12 + q22 * q22) * vv
    area[i] = flat + 0.5 * stretch
    flux[i] = flat * n - (q11 * first[0] + q12 * first[1]) * e1 - (q12 * first[0] + q22 * first[1]) * e2
    bulge[i] = -0.5 * (q11 * uu + 2.0 * q12 * uv + q22 * vv)


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
    for k in range(rows.start[i], rows.stop[i]):
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
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        a = rim_area
        if j < n_e:
            a = area[j]
        weight[k] = area[i] * a * laplacian_weight(wp.length(x[j] - p), r)
