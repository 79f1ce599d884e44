"""Boundary particles: what the film's rim does to the fields."""

import warp as wp

from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w

wp.set_module_options({"enable_backward": False})


@wp.kernel
def mirror_velocity_b(
    mirror: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Velocity beyond the rim: that of the mirror point, its part across the rim reversed (free slip).

    Args:
        mirror: [n_b] mirror points inside the film, m.
        outward: [n_b] unit vectors across the rim.
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
    o = outward[b]
    u[n_e + b] = v - 2.0 * wp.dot(v, o) * o


@wp.kernel
def confine_l(
    anchors: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n_e: int,
    # outputs
    x_l: wp.array(dtype=wp.vec3),
):
    """Put L that have crossed the rim back onto it. [n_l], m."""
    i = wp.tid()
    p = x_l[i]
    nearest = float(1.0e30)
    depth = float(0.0)
    across = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        b = rows.index[k] - n_e
        if b >= 0:
            d = p - anchors[b]
            distance = wp.length_sq(d)
            beyond = wp.dot(d, outward[b])
            # Boundary particles beyond a corner share it as their anchor: the one that looks towards the L counts.
            if distance < nearest or (distance == nearest and beyond > depth):
                nearest = distance
                across = outward[b]
                depth = beyond
    if depth > 0.0:
        x_l[i] = p - depth * across
