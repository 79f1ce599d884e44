"""Foams: tension of each interface on its Voronoi stars, contact of facing interfaces, what is exposed to the air."""

import warp as wp

from melp_warp.kernels.gas import GAUGE, INCREMENT, VOLUME
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, region_total
from melp_warp.kernels.sph import kernel_w, tangential

wp.set_module_options({"enable_backward": False})

BACK_TO_BACK = wp.constant(-0.2)
"""Cosine of the normals below which two interfaces face each other."""


@wp.struct
class Contact:
    """How interfaces of different regions meet; made once a run."""

    point: wp.array(dtype=wp.vec3)  # a point of each wall, m
    inward: wp.array(dtype=wp.vec3)  # unit normal of each wall
    reach: float  # distance within which facing E press on each other, m
    give: float  # gap beyond which they do not, m
    ball: float  # radius that decides what is exposed, m
    ramp: float  # depth over which the exposure falls from 1 to 0, m
    suction: float  # pressure of the atmosphere over that of the liquid in the borders, Pa


@wp.kernel
def pair_star_e(
    star: Neighbors,
    weight: wp.array(dtype=float),
    # outputs
    paired: wp.array(dtype=float),
):
    """Symmetric weights: the mean of the two that a pair found, 0 where only one of them sees the other."""
    i = wp.tid()
    for k in range(star.start[i], star.stop[i]):
        j = star.index[k]
        w = float(0.0)
        for m in range(star.start[j], star.stop[j]):
            if star.index[m] == i:
                w = 0.5 * (weight[k] + weight[m])
        paired[k] = w


@wp.kernel
def star_vector_e(
    x: wp.array(dtype=wp.vec3),
    star: Neighbors,
    # outputs
    vector: wp.array(dtype=wp.vec3),
):
    """Gradient of the polyhedral volume, sum d_j x d_j+1 / 6 over the star: a third of its area, with normal. m^2."""
    i = wp.tid()
    p = x[i]
    total = wp.vec3()
    first = star.start[i]
    last = star.stop[i]
    for k in range(first, last):
        m = k + 1
        if m == last:
            m = first
        total += wp.cross(x[star.index[k]] - p, x[star.index[m]] - p)
    vector[i] = total / 6.0


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
def find_exposure_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    facing: Neighbors,
    contact: Contact,
    # outputs
    exposure: wp.array(dtype=float),
):
    """Whether a ball fits outside each E: 1 where the atmosphere lies on the film, 0 in borders and partitions.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        facing: E of other regions near each E.
        contact: constants.
        exposure: [n_e] 0 to 1.
    """
    i = wp.tid()
    c = x[i] + contact.ball * normal[i]
    depth = float(1.0e30)
    j = nearest_in_row(c, i, x, facing)
    if j >= 0:
        depth = wp.dot(c - x[j], normal[j])
    for w in range(contact.point.shape[0]):
        depth = wp.min(depth, wp.dot(c - contact.point[w], contact.inward[w]))
    exposure[i] = wp.clamp(0.5 + (depth - contact.ball) / contact.ramp, 0.0, 1.0)


@wp.kernel
def smooth_exposure_e(exposure: wp.array(dtype=float), star: Neighbors, smoothed: wp.array(dtype=float)):
    """Mean over the star, an E counting as much as two of its neighbours: keeps single E from flickering. [n_e]."""
    i = wp.tid()
    total = exposure[i]
    count = float(1.0)
    for k in range(star.start[i], star.stop[i]):
        total += 0.5 * exposure[star.index[k]]
        count += 0.5
    smoothed[i] = total / count


@wp.kernel
def predict_foam_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    frame: wp.array(dtype=wp.vec3),
    dt: float,
    # outputs
    predicted: wp.array(dtype=wp.vec3),
):
    """Where E are at the end of the step with the velocity of its start: x + dt (u_n n + U_t). [n], m."""
    i = wp.tid()
    n = normal[i]
    predicted[i] = x[i] + dt * (wp.dot(u[i], n) * n + tangential(frame[region[i]], n))


@wp.kernel
def swept_volume_chunks(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array(dtype=wp.float64),
):
    """Parts of the rate at which each region's volume grows, sum N.n u_n, m^3/s."""
    c = wp.tid()
    start, stop = part_range(c, first, part.shape[0])
    total = wp.float64(0.0)
    for i in range(start, stop):
        n = normal[i]
        total += wp.float64(wp.dot(vector[i], n) * wp.dot(u[i], n))
    part[c] = total


@wp.kernel
def predict_gas_r(
    part: wp.array(dtype=wp.float64),
    p_atm: wp.float64,
    dt: wp.float64,
    # outputs
    gas: wp.array2d(dtype=wp.float64),
    stiff: wp.array(dtype=float),
    ahead: wp.array(dtype=float),
):
    """Pressure at the end of the step with the velocity of its start, and dp/dV of each region's gas.

    Args:
        part: from `swept_volume_chunks`.
        p_atm: Pa.
        dt: s.
        gas: gas slots.
        stiff: [regions] p/V, Pa/m^3.
        ahead: [regions] gauge pressure p - (p/V) dV, Pa.
    """
    g = wp.tid()
    swept = region_total(part, g, gas.shape[0])
    slope = (p_atm + gas[g, GAUGE]) / gas[g, VOLUME]
    stiff[g] = float(slope)
    ahead[g] = float(gas[g, GAUGE] - slope * dt * swept)


@wp.kernel
def store_gas_r(
    part: wp.array(dtype=wp.float64),
    p_atm: wp.float64,
    dt: wp.float64,
    # outputs
    gas: wp.array2d(dtype=wp.float64),
):
    """Pressure at the end of the step, from the volume that its velocity sweeps."""
    g = wp.tid()
    swept = region_total(part, g, gas.shape[0])
    q = -(p_atm + gas[g, GAUGE]) / gas[g, VOLUME] * dt * swept
    gas[g, INCREMENT] = q
    gas[g, GAUGE] = gas[g, GAUGE] + q


@wp.func
def press(gap: float, push: float, give: float, hard: float):
    """Pressure between two interfaces, Pa, and minus its slope, Pa/m.

    It is `push` at gap 0 and none from `give` on. Where they overlap, `hard` (Pa/m) is added to the slope: enough to
    stop in a step what comes faster than `push` could stop.
    """
    pressure = wp.max(0.0, push * (1.0 - gap / give))
    slope = wp.where(pressure > 0.0, push / give, 0.0)
    if gap < 0.0:
        pressure -= hard * gap
        slope += hard
    return pressure, slope


@wp.kernel
def pull_foam_e(
    predicted: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    gamma: wp.array(dtype=float),
    exposure: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    tension: wp.array(dtype=float),
    slope: float,
    star: Neighbors,
    tie: wp.array(dtype=float),
    dt: float,
    # outputs
    force: wp.array(dtype=float),
    rows: Neighbors,
    pair: wp.array(dtype=float),
):
    """Tension: sigma (1 + e) kappa a, and its part of the matrix, dt^2 sigma (1 + e) w_ij.

    Each region's interface has tension sigma everywhere, the atmosphere's that lies on the exposed part has it again.

    Args:
        predicted: [n] m.
        normal: [n] unit normals.
        gamma: [n_e] relative surfactant concentration.
        exposure: [n_e] e.
        region: [n] region of each E.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        star: neighbours across the cell's edges.
        tie: [CORNERS n_e] their w_ij.
        dt: s.
        force: [n_e] N.
        rows: coupled E, here those of the star.
        pair: coefficients, aligned with `rows`, kg.
    """
    i = wp.tid()
    e = exposure[i]
    at = predicted[i]
    own = tension[region[i]]
    k = rows.start[i]
    pull = wp.vec3()
    for s in range(star.start[i], star.stop[i]):
        j = star.index[s]
        sigma = own - 0.5 * slope * (gamma[i] + gamma[j])
        c = sigma * (1.0 + 0.5 * (e + exposure[j])) * tie[s]
        pull += c * (predicted[j] - at)
        rows.index[k] = j
        pair[k] = dt * dt * c
        k += 1
    rows.stop[i] = k
    force[i] = wp.dot(pull, normal[i])


@wp.kernel
def press_foam_e(
    predicted: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    added: wp.array(dtype=float),
    push: wp.array(dtype=float),
    facing: Neighbors,
    contact: Contact,
    stride: int,
    dt: float,
    # outputs
    force: wp.array(dtype=float),
    diag: wp.array(dtype=float),
    rows: Neighbors,
    pair: wp.array(dtype=float),
    wanted: wp.array(dtype=wp.int32),
):
    """Contact: facing E press on each other along the mean of their normals, and on walls; added to force and matrix.

    A pair's pressure falls with the gap, from the suction that holds the two together at gap 0 to nothing at `give`.
    Along the mean normal two points of one sphere have no gap, whatever their distance. The matrix couples
    c_i u_i + c_j u_j, the speed at which a gap closes, which `LinearOperator` takes as a negative pair coefficient.

    Args:
        predicted: [n] m.
        normal: [n] unit normals.
        area: [n_e] m^2.
        mass: [n_e] kg.
        region: [n] region of each E.
        added: [regions] mass of the air that moves along, kg/m^2.
        push: [regions] pressure at gap 0, Pa.
        facing: E of other regions near each E.
        contact: constants.
        stride: room of a row.
        dt: s.
        force: [n_e] N.
        diag: [n_e] kg.
        rows: coupled E.
        pair: coefficients, aligned with `rows`, kg.
        wanted: [n_e] entries that the row needs.
    """
    i = wp.tid()
    n = normal[i]
    at = predicted[i]
    room = rows.start[i] + stride
    k = rows.stop[i]
    total = float(0.0)
    stiff = float(0.0)
    inertia = mass[i] / area[i] + added[region[i]]
    for s in range(facing.start[i], facing.stop[i]):
        j = facing.index[s]
        d = predicted[j] - at
        w = kernel_w(wp.length(d), contact.reach)
        m = normal[j]
        if w > 0.0 and wp.dot(n, m) < BACK_TO_BACK:
            along = wp.normalize(n - m)
            gap = wp.dot(d, along)
            strength = 0.5 * (push[region[i]] + push[region[j]])
            hard = 0.5 * (inertia + added[region[j]] + mass[j] / area[j]) / (dt * dt)
            pressure, slope = press(gap, strength, contact.give, hard)
            if pressure > 0.0:
                a = area[i] * area[j] * w
                ci = wp.dot(along, n)
                cj = -wp.dot(along, m)
                total -= a * pressure * ci
                c = dt * dt * a * slope * ci
                stiff += c * (ci + cj)
                if k < room:
                    rows.index[k] = j
                    pair[k] = -c * cj
                k += 1
    for w in range(contact.point.shape[0]):
        facing_wall = -wp.dot(n, contact.inward[w])
        if facing_wall > 0.0:
            gap = wp.dot(at - contact.point[w], contact.inward[w])
            strength = push[region[i]]
            pressure, slope = press(gap, strength, contact.give, inertia / (dt * dt))
            if pressure > 0.0:
                total -= area[i] * pressure * facing_wall
                stiff += dt * dt * area[i] * slope * facing_wall * facing_wall
    force[i] = force[i] + total
    diag[i] = stiff
    wanted[i] = k - rows.start[i]
    rows.stop[i] = wp.min(k, room)


@wp.kernel
def load_foam_e(
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    exposure: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=float),
    added: wp.array(dtype=float),
    suction: float,
    damping: float,
    u: wp.array(dtype=wp.vec3),
    force: wp.array(dtype=float),
    dt: float,
    # outputs
    b: wp.array(dtype=float),
    diag: wp.array(dtype=float),
    sweep: wp.array(dtype=float),
):
    """Load of the solve: tension and contact, gas against the pressure outside, weight; and the inertia.

    Outside is the atmosphere, or where nothing is exposed the liquid of the borders at `suction` below it.

    Args:
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        area: [n_e] m^2.
        mass: [n_e] kg.
        exposure: [n_e] e.
        body: [n_e] acceleration by outside forces, m/s^2.
        region: [n] region of each E.
        ahead: [regions] predicted gauge pressure, Pa.
        added: [regions] mass of the air that moves along, kg/m^2.
        suction: Pa.
        damping: rate at which the air takes up normal motion, 1/s.
        u: [n] m/s.
        force: [n_e] tension and contact, N.
        dt: s.
        b: [n_e] kg m/s.
        diag: [n_e] contact in, inertia added, kg.
        sweep: [n_e] dt N.n, volume swept per normal speed, m^2 s.
    """
    i = wp.tid()
    n = normal[i]
    g = region[i]
    face = wp.dot(vector[i], n)
    inertia = mass[i] + added[g] * area[i]
    pressure = ahead[g] + (1.0 - exposure[i]) * suction
    slow = dt * damping * inertia
    b[i] = dt * (force[i] + pressure * face + mass[i] * wp.dot(body[i], n)) - slow * wp.dot(u[i], n)
    diag[i] = diag[i] + inertia + slow
    sweep[i] = dt * face


@wp.kernel
def set_push_r(gas: wp.array2d(dtype=wp.float64), suction: float, push: wp.array(dtype=float)):
    """Pressure that holds two interfaces of a region's kind together, gauge + suction. [regions], Pa."""
    g = wp.tid()
    push[g] = wp.max(float(gas[g, GAUGE]), 0.0) + suction


@wp.kernel
def apply_foam_e(
    normal: wp.array(dtype=wp.vec3),
    change: wp.array(dtype=float),
    # outputs
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
):
    """Add the change of normal speed; E move with the speed at the end of the step. [n_e], m/s."""
    i = wp.tid()
    n = normal[i]
    u[i] = u[i] + change[i] * n
    u_mid[i] = wp.dot(u[i], n)


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
    i = wp.tid()
    partner[i] = nearest_facing(x[i], normal[i], i, x, normal, facing, reach)


@wp.kernel
def find_nearest_e(x: wp.array(dtype=wp.vec3), facing: Neighbors, nearest: wp.array(dtype=wp.int32)):
    """The nearest E of another region, -1 for none. [n_e]."""
    i = wp.tid()
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
    region: wp.array(dtype=wp.int32),
    seed: int,
    chance: float,
    dt: float,
    # outputs
    region_l: wp.array(dtype=wp.int32),
):
    """Let L change to the region across the partition with the probabilities (27) and (28). They keep all they carry.

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
        region: [n] region of each E.
        seed: differs from call to call.
        chance: psi_1 = psi_2, the largest value of each of the two.
        dt: step that (27) looks ahead, s.
        region_l: [n_l] region of each L.
    """
    i = wp.tid()
    p = x_l[i]
    own = nearest_in_row(p, i, x, rows)
    j = int(-1)
    if own >= 0:
        j = nearest_facing(p, normal[own], own, x, normal, facing, reach)
    if j >= 0:
        gap = wp.abs(wp.dot(p - x[j], normal[j]))
        ahead = wp.abs(wp.dot(p + dt * v_l[i] - x[j], normal[j]))
        toward = 1.0 - wp.min(1.0, ahead / wp.max(gap, 1.0e-12))
        thinner = 1.0 - wp.min(1.0, gamma[j] / gamma[own])
        draw = wp.randf(wp.rand_init(seed, number[i]))
        if draw < chance * (toward + thinner):
            region_l[i] = region[j]
