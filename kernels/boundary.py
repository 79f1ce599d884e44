"""Boundary particles: what the film's rim does to the fields."""

import warp as wp

from melp_warp.kernels.mls import Quadric, height_above
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, tangential

wp.set_module_options({"enable_backward": False})


@wp.kernel
def mirror_velocity_b(
    mirror: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Velocity beyond the rim: that of the mirror point, reversed except along the rim (free slip, no motion).

    Args:
        mirror: [n_b] mirror points inside the film, m.
        outward: [n_b] unit vectors across the rim.
        normal: [n] unit normals.
        x_e: [n] m.
        rows: mirror:E neighbours.
        r: interpolation radius, m.
        n_e: number of E; boundary particle b is entry n_e + b of `u`.
        u: [n] m/s.
    """
    b = wp.tid()
    p = mirror[b]
    total = float(0.0)
    v = wp.vec3()
    for k in range(rows.start[b], rows.stop[b]):
        j = rows.index[k]
        if j < n_e:
            w = kernel_w(wp.length(x_e[j] - p), r)
            total += w
            v += w * u[j]
    if total > 0.0:
        v = v / total
    n = normal[n_e + b]
    o = wp.normalize(tangential(outward[b], n))
    u[n_e + b] = v - 2.0 * (wp.dot(v, o) * o + wp.dot(v, n) * n)


@wp.func
def inside_rim(
    i: int,
    p: wp.vec3,
    anchors: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n_e: int,
) -> wp.vec3:
    """What puts point p back onto the rim, by the boundary particles of row i; nothing where p has not crossed it."""
    nearest = float(1.0e30)
    depth = float(0.0)
    across = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        b = rows.index[k] - n_e
        if b >= 0:
            d = p - anchors[b]
            distance = wp.length_sq(d)
            beyond = wp.dot(d, outward[b])
            # Boundary particles beyond a corner share it as their anchor: the one that looks towards p counts.
            if distance < nearest or (distance == nearest and beyond > depth):
                nearest = distance
                across = outward[b]
                depth = beyond
    return -wp.max(depth, 0.0) * across


@wp.kernel
def confine_l(
    anchors: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n_e: int,
    # outputs
    x_l: wp.array(dtype=wp.vec3),
):
    """Put L that have crossed the rim back onto it. [n_l], m. Boundary particles, if any, are last in a row."""
    i = rows.first + wp.tid()
    if rows.stop[i] == rows.start[i] or rows.index[rows.stop[i] - 1] < n_e:
        return
    x_l[i] = x_l[i] + inside_rim(i, x_l[i], anchors, outward, rows, n_e)


@wp.kernel
def extend_film_b(
    anchors: wp.array(dtype=wp.vec3),
    curvature: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    mirror: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
):
    """Continue a moving film beyond its pinned rim.

    The mirror point follows the film at a fixed distance s from the rim. At the rim the film does not move, so its
    curvature there is zero: across the rim it is minus that of the rim curve along the normal, k.n. The odd
    continuation with that curvature is 2 a - mirror - (k.n) s^2 n.

    Args:
        anchors: [n_b] nearest points a of the rim, m.
        curvature: [n_b] curvature vectors k of the rim, 1/m.
        x_e: [n] m.
        surface: [n_e] fitted surfaces.
        rows: mirror:E neighbours.
        r: radius within which fits are averaged, m.
        n_e: number of E; boundary particle b is entry n_e + b.
        mirror: [n_b] mirror points, m.
        x: [n] positions, m; the array x_e itself.
        normal: [n] unit normals.
    """
    b = wp.tid()
    p = mirror[b]
    a = anchors[b]
    total = float(0.0)
    shift = wp.vec3()
    n = wp.vec3()
    for k in range(rows.start[b], rows.stop[b]):
        j = rows.index[k]
        if j < n_e:
            d = p - x_e[j]
            w = kernel_w(wp.length(d), r)
            if w > 0.0:
                q = surface[j]
                total += w
                shift += w * height_above(q, d) * q.normal
                n += w * q.normal
    if total > 0.0:
        s = wp.length(p - a)
        n = wp.normalize(n)
        p = a + s * wp.normalize(p - shift / total - a)
        mirror[b] = p
        x[n_e + b] = 2.0 * a - p - wp.dot(curvature[b], n) * s * s * n
        normal[n_e + b] = n
