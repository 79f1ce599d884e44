"""Stage 2, areas of E: Voronoi cells on the fitted surface and the control areas made from them."""

import warp as wp

from melp_warp.kernels.mls import Quadric
from melp_warp.kernels.native import cut_cell, sum_quotients
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, tangent_basis

wp.set_module_options({"enable_backward": False})


@wp.kernel
def voronoi_cell_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    steepening: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    area: wp.array(dtype=float),
    flux: wp.array(dtype=wp.vec3),
    bulge: wp.array(dtype=float),
    star: Neighbors,
    weight: wp.array(dtype=float),
):
    """Voronoi cell of each E on its fitted surface: area and what the volume (11) needs.

    The cell is cut in the tangent plane. The bisector of a neighbour at (u, v, z) lies at half its distance in space,
    sqrt(u^2 + v^2 + z^2), next to the neighbour (exact on a circle) and, as the surface falls away, further in towards
    the ends of the edge: 0.888 z^2 is the mean over a hexagon's edge.
    With z = q.Q q/2 over the plane, area = |C| sqrt(1 + tr(Q Q M)/|C|), the root of the mean square of what slopes
    stretch it by: no more than neighbours are apart, however sharp a corner the E sits on. For p = x_i + offset, the
    integral of p.n over the cell is x_i.flux + bulge with flux = |C| n - Q m, bulge = -tr(Q M)/2, m and M the moments
    of C. The cubic part of the surface tilts the mean of the normal over the cell by -<q^2>/4 grad_s kappa. Unlike
    1/delta of (9), whose sum is biased on uneven particles, the cells tile the surface to second order.

    Args:
        x: [n] positions, m.
        normal: [n] unit normals.
        surface: [n_e] fitted surfaces.
        steepening: [n_e] grad_s kappa, 1/m^2; null where it is left out.
        rows: E:E neighbours.
        r: support radius, m.
        area: [n_e] m^2.
        flux: [n_e] m^2.
        bulge: [n_e] m^3.
        star: the neighbours that the cell's edges are shared with, in order around it; null where nobody asks.
        weight: [CORNERS n_e] edge over distance of those neighbours: w_ij of the Laplacian sum_j w_ij (f_j - f_i).
    """
    i = rows.first + wp.tid()
    n = normal[i]
    e1, e2 = tangent_basis(n)
    m = cut_cell(i, x, e1, e2, n, rows, r, star, weight)
    flat = m[0]
    first = wp.vec2(m[1], m[2])
    uu = m[3]
    uv = m[4]
    vv = m[5]
    second = 2.0 * surface[i].second
    s1 = second * e1
    s2 = second * e2
    q11 = wp.dot(e1, s1)
    q12 = wp.dot(e1, s2)
    q22 = wp.dot(e2, s2)
    stretch = (q11 * q11 + q12 * q12) * uu + 2.0 * q12 * (q11 + q22) * uv + (q12 * q12 + q22 * q22) * vv
    area[i] = wp.sqrt(flat * (flat + stretch))
    through = flat * n - (q11 * first[0] + q12 * first[1]) * e1 - (q12 * first[0] + q22 * first[1]) * e2
    if steepening:
        through -= 0.25 * (uu + vv) * steepening[i]
    flux[i] = through
    bulge[i] = -0.5 * (q11 * uu + 2.0 * q12 * uv + q22 * vv)


@wp.kernel
def control_area_e(
    cell: wp.array(dtype=float),
    density_inner: wp.array(dtype=float),
    near: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    area: wp.array(dtype=float),
):
    """Control area a = integral of the transfer weight W(E, x)/sum_E' W(E', x) over the film. [n_e], m^2.

    The weights are those of (6), so that an even film is transferred to an even eta_E = V_E/a_E; the integral is
    taken over the Voronoi cells and sums to their area. `near` is W of each pair, from `geometry.density_e`.
    """
    i = rows.first + wp.tid()
    own = kernel_w(0.0, r) * cell[i] / density_inner[i]
    area[i] = own + sum_quotients(i, near, cell, density_inner, rows, n_e)
