"""Stage 2, areas of E: Voronoi cells on the fitted surface and the control areas made from them."""

import warp as wp

from melp_warp.kernels.mls import Quadric
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, tangent_basis

wp.set_module_options({"enable_backward": False})

CORNERS = 16
"""Most corners of a cell."""

mat3x16 = wp.types.matrix(shape=(3, CORNERS), dtype=wp.float32)


@wp.func
def clip_cell(cell: mat3x16, count: int, u: float, v: float, half: float, label: float):
    """Cut a polygon by the line q.(u, v) = half, keeping the origin's side.

    Columns of a cell are corners: coordinates and the label of the line that the edge to the next corner lies on.
    """
    kept = mat3x16()
    n = int(0)
    px = cell[0, count - 1]
    py = cell[1, count - 1]
    pl = cell[2, count - 1]
    sp = px * u + py * v - half
    for m in range(count):
        qx = cell[0, m]
        qy = cell[1, m]
        sq = qx * u + qy * v - half
        if (sp < 0.0) != (sq < 0.0) and n < 16:
            t = sp / (sp - sq)
            kept[0, n] = px + t * (qx - px)
            kept[1, n] = py + t * (qy - py)
            kept[2, n] = wp.where(sp < 0.0, label, pl)
            n += 1
        if sq < 0.0 and n < 16:
            kept[0, n] = qx
            kept[1, n] = qy
            kept[2, n] = cell[2, m]
            n += 1
        px = qx
        py = qy
        pl = cell[2, m]
        sp = sq
    return kept, n


@wp.func
def square_cell(half: float) -> mat3x16:
    """The square of side 2 half about the origin, its edges labelled -1."""
    cell = mat3x16()
    cell[0, 0] = -half
    cell[1, 0] = -half
    cell[0, 1] = half
    cell[1, 1] = -half
    cell[0, 2] = half
    cell[1, 2] = half
    cell[0, 3] = -half
    cell[1, 3] = half
    for m in range(4):
        cell[2, m] = -1.0
    return cell


@wp.func
def write_star(
    i: int,
    x: wp.array(dtype=wp.vec3),
    cell: mat3x16,
    count: int,
    rows: Neighbors,
    star: Neighbors,
    weight: wp.array(dtype=float),
):
    """Write the neighbours that the edges of a cell are shared with, and w_ij = edge/distance."""
    k = star.start[i]
    for m in range(count):
        q = m + 1
        if q == count:
            q = 0
        if cell[2, m] >= 0.0:
            j = rows.index[rows.start[i] + int(cell[2, m])]
            edge = wp.length(wp.vec2(cell[0, q] - cell[0, m], cell[1, q] - cell[1, m]))
            star.index[k] = j
            weight[k] = edge / wp.length(x[j] - x[i])
            k += 1
    star.stop[i] = k


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
    of C. Unlike 1/delta of (9), whose sum is biased on uneven particles, the cells tile the surface to second order.

    Args:
        x: [n] positions, m.
        normal: [n] unit normals.
        surface: [n_e] fitted surfaces.
        rows: E:E neighbours.
        r: support radius, m.
        area: [n_e] m^2.
        flux: [n_e] m^2.
        bulge: [n_e] m^3.
        star: the neighbours that the cell's edges are shared with, in order around it; null where nobody asks.
        weight: [CORNERS n_e] edge over distance of those neighbours: w_ij of the Laplacian sum_j w_ij (f_j - f_i).
    """
    i = rows.first + wp.tid()
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
                plane = u * u + v * v
                half = 0.5 * wp.sqrt(plane * (plane + 0.888 * z * z))
                cell, count = clip_cell(cell, count, u, v, half, float(k - rows.start[i]))
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
    area[i] = wp.sqrt(flat * (flat + stretch))
    flux[i] = flat * n - (q11 * first[0] + q12 * first[1]) * e1 - (q12 * first[0] + q22 * first[1]) * e2
    bulge[i] = -0.5 * (q11 * uu + 2.0 * q12 * uv + q22 * vv)
    if weight:
        write_star(i, x, cell, count, rows, star, weight)


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
    total = kernel_w(0.0, r) * cell[i] / density_inner[i]
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            total += near[k] * cell[j] / density_inner[j]
    area[i] = total
