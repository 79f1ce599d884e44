"""Foams: tension on Voronoi stars, gas, load and motion of many regions."""

import warp as wp

from melp_warp.kernels.contact import Contact
from melp_warp.kernels.gas import AMOUNT, GAUGE, INCREMENT, VOLUME
from melp_warp.kernels.native import sum_vectors, weigh_row
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, region_total
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})


@wp.kernel
def pair_star_e(
    star: Neighbors,
    weight: wp.array(dtype=float),
    # outputs
    paired: wp.array(dtype=float),
):
    """Symmetric weights: the mean of the two that a pair found, 0 where only one of them sees the other."""
    i = star.first + wp.tid()
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
    share: wp.array(dtype=float),
):
    """Gradient of the polyhedral volume, sum d_j x d_j+1 / 6 over the star, and a third of the star's area. m^2."""
    i = star.first + wp.tid()
    p = x[i]
    total = wp.vec3()
    size = float(0.0)
    first = star.start[i]
    last = star.stop[i]
    for k in range(first, last):
        m = k + 1
        if m == last:
            m = first
        twice = wp.cross(x[star.index[k]] - p, x[star.index[m]] - p)
        total += twice
        size += wp.length(twice)
    vector[i] = total / 6.0
    share[i] = size / 6.0


@wp.kernel
def predict_foam_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    frame: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    predicted: wp.array(dtype=wp.vec3),
):
    """Where E are at the end of the step with the velocity of its start: x + dt (u_n n + U_t). [n], m."""
    i = wp.tid()
    n = normal[i]
    predicted[i] = x[i] + dt[0] * (wp.dot(u[i], n) * n + tangential(frame[region[i]], n))


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


@wp.func
def gas_slope(p_atm: wp.float64, g: int, gas: wp.array2d(dtype=wp.float64)) -> wp.float64:
    """Rise of a region's pressure by volume lost, p/V, Pa/m^3; 0 where it is open and holds no amount."""
    if gas[g, AMOUNT] == wp.float64(0.0):
        return wp.float64(0.0)
    return (p_atm + gas[g, GAUGE]) / gas[g, VOLUME]


@wp.kernel
def predict_gas_r(
    part: wp.array(dtype=wp.float64),
    p_atm: wp.float64,
    dt: wp.array(dtype=float),
    # outputs
    gas: wp.array2d(dtype=wp.float64),
    stiff: wp.array(dtype=float),
    ahead: wp.array(dtype=float),
):
    """Pressure at the end of the step with the velocity of its start, and dp/dV of each region's gas.

    Args:
        part: from `swept_volume_chunks`.
        p_atm: Pa.
        dt: [1] s.
        gas: gas slots.
        stiff: [regions] p/V, Pa/m^3.
        ahead: [regions] gauge pressure p - (p/V) dV, Pa.
    """
    g = wp.tid()
    swept = region_total(part, g, gas.shape[0])
    slope = gas_slope(p_atm, g, gas)
    stiff[g] = float(slope)
    ahead[g] = float(gas[g, GAUGE] - slope * wp.float64(dt[0]) * swept)


@wp.kernel
def store_gas_r(
    part: wp.array(dtype=wp.float64),
    p_atm: wp.float64,
    dt: wp.array(dtype=float),
    # outputs
    gas: wp.array2d(dtype=wp.float64),
):
    """Pressure at the end of the step, from the volume that its velocity sweeps."""
    g = wp.tid()
    swept = region_total(part, g, gas.shape[0])
    q = -gas_slope(p_atm, g, gas) * wp.float64(dt[0]) * swept
    gas[g, INCREMENT] = q
    gas[g, GAUGE] = gas[g, GAUGE] + q


@wp.kernel
def pull_foam_e(
    x: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    gamma: wp.array(dtype=float),
    cover: wp.array(dtype=float),
    lag: float,
    region: wp.array(dtype=wp.int32),
    tension: wp.array(dtype=float),
    slope: float,
    star: Neighbors,
    tie: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    force: wp.array(dtype=wp.vec3),
    rest: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    pair: wp.array(dtype=float),
):
    """Tension: minus the gradient of the area of the stars, weighed with (2 - c) sigma, and its part of the matrix.

    A sheet has tension 2 sigma, and what is one film with another sheet half of it.

    Args:
        x: [n] m.
        predicted: [n] m.
        gamma: [n_e] relative surfactant concentration.
        cover: [n_e] c.
        lag: time by which the forces of sheets that face others look ahead, s.
        region: [n] region of each E.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        star: neighbours across the cell's edges.
        tie: [CORNERS n_e] their w_ij.
        dt: [1] s.
        force: [n_e] of sheets that move, N.
        rest: [n_e] of sheets at rest, N.
        rows: coupled E, here those of the star.
        pair: coefficients, aligned with `rows`, kg.
    """
    i = rows.first + wp.tid()
    p = x[i]
    at = predicted[i]
    own = tension[region[i]]
    k = rows.start[i]
    pull = wp.vec3()
    quiet = wp.vec3()
    for s in range(star.start[i], star.stop[i]):
        j = star.index[s]
        sigma = own - 0.5 * slope * (gamma[i] + gamma[j])
        c = sigma * (2.0 - 0.5 * (cover[i] + cover[j])) * tie[s]
        d = predicted[j] - at
        pull += c * (d + lag / dt[0] * (d - (x[j] - p)))
        quiet += c * d
        rows.index[k] = j
        pair[k] = dt[0] * (dt[0] + lag) * c
        k += 1
    rows.stop[i] = k
    force[i] = pull
    rest[i] = quiet


@wp.kernel
def load_foam_e(
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    heavy: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    balance: wp.array(dtype=wp.vec3),
    missing: wp.array(dtype=wp.vec3),
    drift: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=float),
    added: wp.array(dtype=float),
    damping: float,
    u: wp.array(dtype=wp.vec3),
    load: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    b: wp.array(dtype=float),
    diag: wp.array(dtype=float),
    inertia: wp.array(dtype=float),
    outer: wp.array(dtype=float),
    sweep: wp.array(dtype=float),
    carried: wp.array(dtype=wp.vec3),
    braked: wp.array(dtype=wp.vec2),
):
    """Right-hand side and inertia of the solve.

    Args:
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        area: [n_e] m^2.
        mass: [n_e] kg.
        heavy: [n_e] the mass, and by how much outside forces fall as the velocity grows, kg.
        body: [n_e] acceleration by outside forces, m/s^2.
        region: [n] region of each E.
        balance: [regions] acceleration with which the normal loads of outside forces have no sum, m/s^2: what they do
            to the region as a whole is done already.
        missing: [regions] acceleration by the force that the loads leave out, m/s^2.
        drift: [regions] velocity of the region's cluster as a whole, m/s.
        held: [regions] 1 where the cluster touches a wall, which takes up what damping takes of its momentum. Elsewhere
            the cluster keeps it: that damping is a force within the foam.
        added: [regions] mass of the air that moves along, kg/m^2.
        damping: rate at which the air takes up normal motion against `drift`, 1/s.
        u: [n] m/s.
        load: [n_e] from `gather_load_e`, N.
        dt: [1] s.
        b: [n_e] kg m/s.
        diag: [n_e] contact in, inertia added, kg.
        inertia: [n_e] mass with the air's, and what damping and forces from outside add, kg.
        outer: [n_e] the load's part from outside the foam, kg m/s.
        sweep: [n_e] dt N.n, volume swept per normal speed, m^2 s.
        carried: [n_e] momentum of the region as a whole per normal speed, m n, kg.
        braked: [n_e] what damping within the foam takes, kg m/s, and how much more per change of the speed, kg.
    """
    i = wp.tid()
    n = normal[i]
    g = region[i]
    m = mass[i] + added[g] * area[i]
    slow = dt[0] * damping * m
    weight = dt[0] * (mass[i] * wp.dot(body[i], n) - m * wp.dot(balance[g], n))
    damped = slow * wp.dot(u[i] - drift[g], n)
    b[i] = weight - damped + dt[0] * (load[i] + m * wp.dot(missing[g], n))
    outside = heavy[i] - mass[i]
    diag[i] = diag[i] + m + slow + outside
    outer[i] = weight - held[g] * damped
    inertia[i] = m + held[g] * slow + outside
    sweep[i] = dt[0] * wp.dot(vector[i], n)
    carried[i] = m * n
    braked[i] = (1.0 - held[g]) * wp.vec2(damped, slow)


@wp.kernel
def apply_foam_e(
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    change: wp.array(dtype=float),
    recoil: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Add the change of normal speed and the region's recoil. [n_e]."""
    i = wp.tid()
    n = normal[i]
    u[i] = u[i] + (change[i] + wp.dot(recoil[region[i]], n)) * n


@wp.kernel
def move_foam_e(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    motion: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.vec3),
    # outputs
    u_mid: wp.array(dtype=float),
):
    """E move with the speed at the end of the step, and as `frame` has it as a whole. [n_e], m/s."""
    i = wp.tid()
    n = normal[i]
    g = region[i]
    u_mid[i] = wp.dot(u[i] - motion[g] + frame[g], n)


@wp.kernel
def recall_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    reach: float,
    leash: float,
    contact: Contact,
    # outputs
    near: wp.array(dtype=float),
    kept: wp.array(dtype=wp.vec3),
    slowed: wp.array(dtype=wp.vec3),
    turned: wp.array(dtype=wp.vec3),
):
    """Where E may be: inside the walls, at most `leash` from the mean of their neighbours, and facing as they do.

    On the sharpest line that a sheet makes, a right angle, that distance is half a spacing and the normal is off by 45
    degrees. An E that is pressed out of its sheet has no normal and no cell to be pulled back by.

    Args:
        x: [n] m.
        u: [n] m/s.
        normal: [n] unit normals.
        rows: E:E neighbours.
        reach: m.
        leash: m.
        contact: constants.
        near: [pairs] W of each pair, 1/m^2.
        kept: [n_e] m.
        slowed: [n_e] m/s.
        turned: [n_e] unit normals.
    """
    i = rows.first + wp.tid()
    p = x[i]
    v = u[i]
    n = normal[i]
    s = weigh_row(i, p, x, rows, reach, x.shape[0], near)
    total = s[3]
    if total > 0.0:
        facing = sum_vectors(i, near, normal, rows, x.shape[0])
        away = -wp.vec3(s[0], s[1], s[2]) / total
        far = wp.length(away)
        reversed = wp.dot(facing, n) < 0.0
        if reversed:
            n = wp.normalize(facing)
        if far > leash or reversed:
            p -= (1.0 - wp.min(leash / far, 0.5)) * away
            v = sum_vectors(i, near, u, rows, x.shape[0]) / total
    for w in range(contact.point.shape[0]):
        inward = contact.inward[w]
        height = wp.dot(p - contact.point[w], inward)
        if height < 0.0:
            p -= height * inward
            v -= wp.min(wp.dot(v, inward), 0.0) * inward
    kept[i] = p
    slowed[i] = v
    turned[i] = n
