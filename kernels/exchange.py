"""Foams: what lies across a partition, and L that cross it (section 5.5)."""

import warp as wp

from melp_warp.kernels.neighbors import Neighbors

wp.set_module_options({"enable_backward": False})

BACK_TO_BACK = wp.constant(-0.2)
"""Cosine of the normals below which two sheets face each other."""


@wp.func
def nearest_facing(
    p: wp.vec3,
    n: wp.vec3,
    i: int,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    facing: Neighbors,
    reach: float,
) -> int:
    """The E in row i of `facing` nearest to p within `reach` that faces a film with normal n; -1 for none."""
    best = int(-1)
    near = reach * reach
    for k in range(facing.start[i], facing.stop[i]):
        j = facing.index[k]
        s = wp.length_sq(x[j] - p)
        if s < near and wp.dot(n, normal[j]) < BACK_TO_BACK:
            near = s
            best = j
    return best


@wp.func
def nearest_in_row(p: wp.vec3, i: int, x: wp.array(dtype=wp.vec3), rows: Neighbors) -> int:
    """The E in row i nearest to p, -1 for none."""
    best = int(-1)
    near = float(1.0e30)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        s = wp.length_sq(x[j] - p)
        if s < near:
            near = s
            best = j
    return best


@wp.kernel
def find_partner_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    facing: Neighbors,
    reach: float,
    # outputs
    partner: wp.array(dtype=wp.int32),
):
    """The nearest E that faces each E across a partition, -1 for none. [n_e]."""
    i = facing.first + wp.tid()
    partner[i] = nearest_facing(x[i], normal[i], i, x, normal, facing, reach)


@wp.kernel
def find_nearest_e(x: wp.array(dtype=wp.vec3), facing: Neighbors, nearest: wp.array(dtype=wp.int32)):
    """The nearest E of another region, -1 for none. [n_e]."""
    i = facing.first + wp.tid()
    nearest[i] = nearest_in_row(x[i], i, x, facing)


@wp.kernel
def find_partner_l(
    x_l: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    facing: Neighbors,
    reach: float,
    # outputs
    partner: wp.array(dtype=wp.int32),
):
    """The nearest E that faces each L across a partition, -1 for none.

    Args:
        x_l: [n_l] m.
        rows: L:E neighbours of the same region.
        x: [n] m.
        normal: [n] unit normals.
        facing: E of other regions near each E.
        reach: m.
        partner: [n_l] index of the E.
    """
    i = wp.tid()
    p = x_l[i]
    j = nearest_in_row(p, i, x, rows)
    partner[i] = -1
    if j >= 0:
        partner[i] = nearest_facing(p, normal[j], j, x, normal, facing, reach)


@wp.kernel
def exchange_l(
    x_l: wp.array(dtype=wp.vec3),
    v_l: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    number: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    facing: Neighbors,
    reach: float,
    gamma: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    seed: wp.array(dtype=wp.int32),
    chance: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    region_l: wp.array(dtype=wp.int32),
    eta_l: wp.array(dtype=float),
    circulation_l: wp.array(dtype=float),
):
    """Let L change to the region across the partition with the probabilities (27) and (28). They keep all they carry.

    Their thickness is that of the film they come to: it says how thick the film is where they are.

    Args:
        x_l: [n_l] m.
        v_l: [n_l] m/s.
        rows: L:E neighbours of the same region.
        number: [n_l] number of each L.
        x: [n] m.
        normal: [n] unit normals.
        facing: E of other regions near each E.
        reach: distance within which a film is shared, m.
        gamma: [n_e] relative surfactant concentration.
        eta: [n_e] thickness, m.
        region: [n] region of each E.
        seed: [1] differs from call to call.
        chance: [1] psi_1 = psi_2, the largest value of each of the two.
        dt: [1] step that (27) looks ahead, s.
        region_l: [n_l] region of each L.
        eta_l: [n_l] m.
        circulation_l: [n_l] m^2/s, about a normal that is the other way on the other side; null where none is carried.
    """
    i = wp.tid()
    p = x_l[i]
    own = nearest_in_row(p, i, x, rows)
    j = int(-1)
    if own >= 0:
        j = nearest_facing(p, normal[own], own, x, normal, facing, reach)
    if j >= 0:
        gap = wp.abs(wp.dot(p - x[j], normal[j]))
        ahead = wp.abs(wp.dot(p + dt[0] * v_l[i] - x[j], normal[j]))
        toward = 1.0 - wp.min(1.0, ahead / wp.max(gap, 1.0e-12))
        thinner = 1.0 - wp.min(1.0, gamma[j] / gamma[own])
        draw = wp.randf(wp.rand_init(seed[0], number[i]))
        if draw < chance[0] * (toward + thinner):
            region_l[i] = region[j]
            eta_l[i] = eta[j]
            if circulation_l:
                circulation_l[i] = -circulation_l[i]
