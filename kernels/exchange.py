"""Foams: what lies across a partition, and liquid that crosses it (section 5.5)."""

import warp as wp

from melp_warp.kernels.contact import Contact, meet_sheets, near_share
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import tangential

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


@wp.func
def shared_film(
    i: int,
    j: int,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    contact: Contact,
):
    """How much of a film E i and j of different regions share, 1/m^2; the direction of their gap; the gap, m."""
    w, along, gap = meet_sheets(x[j] - x[i], normal[i], normal[j], contact.reach)
    return w * near_share(gap, contact.range), along, gap


@wp.kernel
def weigh_across_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    claim: wp.array(dtype=float),
    facing: Neighbors,
    contact: Contact,
    # outputs
    over: wp.array(dtype=float),
):
    """What the film that each E shares with those across adds up to, 1 at least: beyond that it is shared out.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        area: [n_e] m^2.
        claim: [n_e] area that L take up; E without L exchange nothing.
        facing: E of other regions near each E.
        contact: constants.
        over: [n_e].
    """
    i = facing.first + wp.tid()
    total = float(0.0)
    for k in range(facing.start[i], facing.stop[i]):
        j = facing.index[k]
        if claim[j] > 0.0:
            held, _along, _gap = shared_film(i, j, x, normal, contact)
            total += area[j] * held
    over[i] = wp.max(total, 1.0)


@wp.func
def crossing_share(gamma: float, gamma_across: float, gap: float, closing: float, time: float, dt: float) -> float:
    """Share of its liquid that a film gives to that across, by the rates (27) and (28), half of it at most.

    The rates are psi (1 - |gap after dt|/|gap|) and psi (1 - Gamma_across/Gamma), where they are above 0. What is given
    is half of 1 - exp(-2 rate t): two films with a surfactant of their own come to the same of it, and not beyond.

    Args:
        gamma: relative surfactant concentration.
        gamma_across: the same across.
        gap: between the two, m.
        closing: rate at which it falls, m/s.
        time: psi times the time since the last exchange.
        dt: time that (27) looks ahead, s.
    """
    before = wp.abs(gap)
    toward = wp.max(before - wp.abs(gap - dt * closing), 0.0) / wp.max(before, 1.0e-12)
    thinner = float(0.0)
    if gamma > 0.0:
        thinner = 1.0 - wp.min(1.0, gamma_across / gamma)
    return 0.5 * (1.0 - wp.exp(-2.0 * time * (toward + thinner)))


@wp.kernel
def cross_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    area: wp.array(dtype=float),
    claim: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    circulation: wp.array(dtype=float),
    over: wp.array(dtype=float),
    facing: Neighbors,
    contact: Contact,
    time: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    left: wp.array(dtype=float),
    gained: wp.array(dtype=wp.vec3),
    pushed: wp.array(dtype=wp.vec3),
):
    """What crosses between the films that E share, (27) and (28): what one gives the other gets.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        u: [n] m/s.
        mass: [n_e] kg.
        surfactant: [n_e] mol.
        area: [n_e] m^2.
        claim: [n_e] area that L take up, m^2.
        gamma: [n_e] relative surfactant concentration.
        circulation: [n_e] m^2/s; null where none is carried.
        over: [n_e] from `weigh_across_e`.
        facing: E of other regions near each E.
        contact: constants.
        time: [1] psi times the time since the last exchange.
        dt: [1] step that (27) looks ahead, s.
        left: [n_e] share of the liquid that leaves each E.
        gained: [n_e] mass (kg), surfactant (mol) and mass times vorticity (kg/s) that come to it.
        pushed: [n_e] momentum along the film that comes with them, kg m/s.
    """
    i = facing.first + wp.tid()
    out = float(0.0)
    gain = wp.vec3()
    push = wp.vec3()
    if claim[i] > 0.0:
        for k in range(facing.start[i], facing.stop[i]):
            j = facing.index[k]
            held, along, gap = shared_film(i, j, x, normal, contact)
            if held > 0.0 and claim[j] > 0.0:
                closing = wp.dot(u[i] - u[j], along)
                out += area[j] * held / over[i] * crossing_share(gamma[i], gamma[j], gap, closing, time[0], dt[0])
                share = area[i] * held / over[j] * crossing_share(gamma[j], gamma[i], gap, closing, time[0], dt[0])
                turn = float(0.0)
                if circulation:
                    turn = -circulation[j] / area[j]  # seen from behind
                gain += share * wp.vec3(mass[j], surfactant[j], mass[j] * turn)
                push += share * mass[j] * tangential(u[j], normal[j])
    left[i] = out
    gained[i] = gain
    pushed[i] = push


@wp.kernel
def cross_l(
    normal: wp.array(dtype=wp.vec3),
    u_e: wp.array(dtype=wp.vec3),
    claim: wp.array(dtype=float),
    left: wp.array(dtype=float),
    gained: wp.array(dtype=wp.vec3),
    pushed: wp.array(dtype=wp.vec3),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    density: float,
    # outputs
    u: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    circulation: wp.array(dtype=float),
):
    """Let L give their share of what leaves the E around them, and take theirs, by area, of what comes to these.

    With the weights of (6) the sums over the L are those over the E: liquid, surfactant and momentum stay. L keep their
    areas. What comes brings its velocity, and so its vorticity, into the mean; what leaves takes none along.

    Args:
        normal: [n] unit normals of E.
        u_e: [n] m/s.
        claim: [n_e] area that the L take up, m^2.
        left: [n_e] from `cross_e`.
        gained: [n_e] the same.
        pushed: [n_e] the same.
        weight: [pairs] W(E, L), 0 for boundary particles, 1/m^2.
        rows: L:E neighbours.
        density: kg/m^3.
        u: [n_l] m/s.
        mass: [n_l] kg.
        surfactant: [n_l] mol.
        eta: [n_l] m.
        circulation: [n_l] m^2/s; null where none is carried.
    """
    i = rows.first + wp.tid()
    total = float(0.0)
    out = float(0.0)
    taken = wp.vec3()
    gain = wp.vec3()
    push = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < claim.shape[0] and claim[j] > 0.0:
            w = weight[k]
            total += w
            out += w * left[j]
            taken += w * left[j] * tangential(u_e[j], normal[j])
            gain += w / claim[j] * gained[j]
            push += w / claim[j] * pushed[j]
    m = mass[i]
    if total > 0.0 and m > 0.0:
        area = m / (density * eta[i])
        kept = m * (1.0 - out / total)
        whole = kept + area * gain[0] / total
        u[i] = (m * (u[i] - taken / total) + area / total * push) / whole
        surfactant[i] = surfactant[i] * (1.0 - out / total) + area * gain[1] / total
        eta[i] = eta[i] * whole / m
        mass[i] = whole
        if circulation:
            circulation[i] = (kept * circulation[i] + area * area * gain[2] / total) / whole
