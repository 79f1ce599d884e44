"""Stage 3, normal dynamics (12): forces at the predicted surface, gas, and the implicit correction."""

import warp as wp

from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})

# Slots of the gas array (float64).
VOLUME = wp.constant(0)
GAUGE = wp.constant(1)
AMOUNT = wp.constant(2)
INCREMENT = wp.constant(3)
AREA = wp.constant(4)
OFFSET = wp.constant(5)


@wp.kernel
def mean_speed_chunks(
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    n: int,
    # outputs
    swept: wp.array(dtype=wp.vec2),
):
    """Parts of (sum a u.n, sum a)."""
    c = wp.tid()
    size = (n + swept.shape[0] - 1) // swept.shape[0]
    total = wp.vec2()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        total += area[i] * wp.vec2(wp.dot(u[i], normal[i]), 1.0)
    swept[c] = total


@wp.kernel
def mean_speed(swept: wp.array(dtype=wp.vec2), swelling: wp.array(dtype=float)):
    """Mean normal speed of the film, swelling[0], m/s."""
    total = wp.vec2()
    for c in range(swept.shape[0]):
        total += swept[c]
    swelling[0] = total[0] / total[1]


@wp.kernel
def momentum_chunks(
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    added: float,
    n: int,
    # outputs
    inertia: wp.array(dtype=wp.mat33),
    net: wp.array(dtype=wp.vec3),
):
    """Parts of sum (m + added a) n n and of the momentum sum (m + added a) u_n n, with the air's share `added`."""
    c = wp.tid()
    size = (n + net.shape[0] - 1) // net.shape[0]
    s0 = wp.mat33()
    s1 = wp.vec3()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        ni = normal[i]
        m = mass[i] + added * area[i]
        s0 += m * wp.outer(ni, ni)
        s1 += m * wp.dot(u[i], ni) * ni
    inertia[c] = s0
    net[c] = s1


@wp.kernel
def solve_motion(inertia: wp.array(dtype=wp.mat33), net: wp.array(dtype=wp.vec3), motion: wp.array(dtype=wp.vec3)):
    """Velocity U of the film as a whole, (sum (m + added a) n n) U = sum (m + added a) u_n n. motion[0], m/s."""
    s0 = wp.mat33()
    s1 = wp.vec3()
    for c in range(net.shape[0]):
        s0 += inertia[c]
        s1 += net[c]
    motion[0] = wp.inverse(s0) * s1


@wp.kernel
def hold_motion_e(
    normal: wp.array(dtype=wp.vec3),
    found: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Give the film the translation `motion`, which outside forces alone change, in place of the one found. [n_e].

    Momentum is a sum over a surface that has moved since: what turning normals and the implicit stiffness make of it
    would let a wobbling bubble swim away.
    """
    i = wp.tid()
    n = normal[i]
    u[i] = u[i] + wp.dot(motion[0] - found[0], n) * n


@wp.kernel
def blend_motion(
    start: wp.array(dtype=wp.vec3), motion: wp.array(dtype=wp.vec3), theta: float, frame: wp.array(dtype=wp.vec3)
):
    """Velocity of the film as a whole in the step: between those of its start and of its end. frame[0], m/s."""
    frame[0] = start[0] + theta * (motion[0] - start[0])


@wp.kernel
def push_motion(rigid: wp.array(dtype=wp.vec3), dt: float, motion: wp.array(dtype=wp.vec3)):
    """motion += dt times the acceleration of the film as a whole, rigid[2]."""
    motion[0] = motion[0] + dt * rigid[2]


@wp.kernel
def predict_position_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.vec3),
    swelling: wp.array(dtype=float),
    step: float,
    # outputs
    predicted: wp.array(dtype=wp.vec3),
):
    """x + theta dt ((u - U).n - s) n, seen from the film as a whole. [n], m.

    Moving along the normals alone would turn a translation U of finite length into a stretch. The mean speed s is
    left out as well: the gas undoes it, and the tension of a bubble swollen by it would push it further.
    """
    i = wp.tid()
    n = normal[i]
    predicted[i] = x[i] + step * (wp.dot(u[i] - frame[0], n) - swelling[0]) * n


@wp.kernel
def film_force_e(
    kappa: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    gas: wp.array(dtype=wp.float64),
    tension: float,
    slope: float,
    body: wp.array(dtype=wp.vec3),
    # outputs
    force: wp.array(dtype=float),
    external: wp.array(dtype=float),
):
    """Normal force per area: 2 sigma kappa + p_in - p_out, and apart from it the outside forces m f.n.

    Args:
        kappa: [n_e] sum of principal curvatures, 1/m.
        gamma: [n_e] relative surfactant concentration.
        normal: [n] unit normals.
        mass: [n_e] kg.
        area: [n_e] m^2.
        gas: gas slots; gauge pressure in Pa.
        tension: sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        body: [n_e] acceleration by outside forces, m/s^2.
        force: [n_e] internal, Pa.
        external: [n_e] Pa.
    """
    i = wp.tid()
    sigma = tension - slope * gamma[i]
    force[i] = 2.0 * sigma * kappa[i] + float(gas[GAUGE])
    external[i] = mass[i] / area[i] * wp.dot(body[i], normal[i])


@wp.kernel
def net_force_chunks(
    force: wp.array(dtype=float),
    external: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    lift: float,
    added: float,
    n: int,
    # outputs
    moment: wp.array(dtype=wp.mat33),
    inertia: wp.array(dtype=wp.mat33),
    net: wp.array(dtype=wp.vec3),
    net_external: wp.array(dtype=wp.vec3),
    lifted: wp.array(dtype=wp.vec3),
):
    """Sums over the film of a n n, a m n n, a f n, a f_ext n and of the gas's lift, in parts.

    Args:
        force: [n_e] Pa.
        external: [n_e] Pa.
        normal: [n] unit normals.
        mass: [n_e] kg.
        area: [n_e] m^2.
        body: [n_e] acceleration by outside forces, m/s^2.
        lift: share of the weight that the gas carries.
        added: mass per area that the air adds to rigid translation, kg/m^2.
        n: number of E.
        moment: parts of sum a n n.
        inertia: parts of sum (a m + a added) n n.
        net: parts of sum a f n.
        net_external: parts of sum a f_ext n.
        lifted: parts of -sum lift m body.
    """
    c = wp.tid()
    size = (n + net.shape[0] - 1) // net.shape[0]
    s0 = wp.mat33()
    s1 = wp.mat33()
    s2 = wp.vec3()
    s3 = wp.vec3()
    s4 = wp.vec3()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        ni = normal[i]
        nn = area[i] * wp.outer(ni, ni)
        s0 += nn
        s1 += (mass[i] / area[i] + added) * nn
        s2 += area[i] * force[i] * ni
        s3 += area[i] * external[i] * ni
        s4 -= lift * mass[i] * body[i]
    moment[c] = s0
    inertia[c] = s1
    net[c] = s2
    net_external[c] = s3
    lifted[c] = s4


@wp.kernel
def rigid_motion(
    moment: wp.array(dtype=wp.mat33),
    inertia: wp.array(dtype=wp.mat33),
    net: wp.array(dtype=wp.vec3),
    net_external: wp.array(dtype=wp.vec3),
    lifted: wp.array(dtype=wp.vec3),
    # outputs
    rigid: wp.array(dtype=wp.vec3),
):
    """What moves the film as a whole, from the sums of `net_force_chunks`.

    Args:
        moment: parts, as the next four.
        inertia: parts.
        net: parts.
        net_external: parts.
        lifted: parts.
        rigid: [0] and [1], forces per area p.n that carry the sum of f and the lift (Pa); [2], the acceleration
            (sum a m n n)^-1 (sum a f_ext n + lift), m/s^2.
    """
    s0 = wp.mat33()
    s1 = wp.mat33()
    s2 = wp.vec3()
    s3 = wp.vec3()
    s4 = wp.vec3()
    for c in range(net.shape[0]):
        s0 += moment[c]
        s1 += inertia[c]
        s2 += net[c]
        s3 += net_external[c]
        s4 += lifted[c]
    inverse = wp.inverse(s0)
    rigid[0] = inverse * s2
    rigid[1] = inverse * s4
    rigid[2] = wp.inverse(s1) * (s3 + s4)


@wp.kernel
def load_membrane_e(
    force: wp.array(dtype=float),
    external: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    rigid: wp.array(dtype=wp.vec3),
    added: float,
    dt: float,
    # outputs
    b: wp.array(dtype=float),
    unit: wp.array(dtype=float),
    diag: wp.array(dtype=float),
):
    """Load dt a f on each E, freed of what moves the film as a whole.

    Tension and pressure add up to nothing on a closed film, but for what undoes the tangential forces of uneven tension
    (`recoil`): their discrete sum is taken out. What outside forces do to the film as a whole is the acceleration
    `rigid[2]`, which costs no surface.

    Args:
        force: [n_e] Pa.
        external: [n_e] Pa.
        normal: [n] unit normals.
        mass: [n_e] kg.
        area: [n_e] m^2.
        rigid: from `rigid_motion`; zeros for an open film.
        added: as in `net_force_chunks`.
        dt: s.
        b: [n_e] load, kg m/s.
        unit: [n_e] load of a unit pressure.
        diag: [n_e] mass.
    """
    i = wp.tid()
    n = normal[i]
    inside = force[i] - wp.dot(rigid[0], n)
    outside = external[i] + wp.dot(rigid[1], n) - (mass[i] / area[i] + added) * wp.dot(rigid[2], n)
    b[i] = dt * area[i] * (inside + outside)
    unit[i] = dt * area[i]
    diag[i] = mass[i]


@wp.kernel
def explicit_response_e(b: wp.array(dtype=float), diag: wp.array(dtype=float), x: wp.array(dtype=float)):
    """Velocity change of the paper's explicit scheme, load over mass. [n_e], m/s."""
    i = wp.tid()
    x[i] = b[i] / diag[i]


@wp.kernel
def lower_residual_e(
    b: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    x: wp.array(dtype=float),
    # outputs
    rhs: wp.array(dtype=float),
):
    """(b - (m - mean) a x)/a: what the operator with even mass must be applied to. [n_e]."""
    i = wp.tid()
    rhs[i] = (b[i] - (mass[i] - mean[0] * area[i]) * x[i]) / area[i]


@wp.kernel
def swept_chunks(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    kappa: wp.array(dtype=float),
    change: wp.array(dtype=float),
    response: wp.array(dtype=float),
    frame: wp.array(dtype=wp.vec3),
    theta: float,
    dt: float,
    n: int,
    # outputs
    swept: wp.array(dtype=wp.vec3d),
):
    """Volume swept in the step as a polynomial in the pressure increment q, in parts and in float64.

    A normal displacement d sweeps a (d - kappa d^2/2). Motion of the film as a whole sweeps nothing and is left out.
    """
    c = wp.tid()
    size = (n + swept.shape[0] - 1) // swept.shape[0]
    total = wp.vec3d()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        ni = normal[i]
        d = dt * (wp.dot(u[i] - frame[0], ni) + theta * change[i])
        e = dt * response[i]
        a = area[i]
        half = 0.5 * kappa[i]
        total += wp.vec3d(
            wp.float64(a * (d - half * d * d)),
            wp.float64(a * (1.0 - 2.0 * half * d) * e),
            wp.float64(-a * half * e * e),
        )
    swept[c] = total


@wp.kernel
def close_gas(
    swept: wp.array(dtype=wp.vec3d),
    p_atm: wp.float64,
    # outputs
    gas: wp.array(dtype=wp.float64),
):
    """Pressure increment q with (p + q) V(q) = n_0 R T at the end of the step; the gauge pressure is carried.

    The part linear in q gives a quadratic with exactly one root of positive pressure and volume; three Newton steps
    add the curvature term.
    """
    total = wp.vec3d()
    for c in range(swept.shape[0]):
        total += swept[c]
    p = p_atm + gas[GAUGE]
    v = gas[VOLUME] + total[0]
    s = total[1]
    amount = gas[AMOUNT]
    low = p * v - amount
    mid = v + p * s
    root = wp.sqrt(mid * mid - wp.float64(4.0) * s * low)
    q = wp.float64(0.0)
    if mid > wp.float64(0.0):
        q = -wp.float64(2.0) * low / (mid + root)
    else:
        q = (root - mid) / (wp.float64(2.0) * s)
    for _ in range(3):
        volume = v + (s + total[2] * q) * q
        slope = volume + (p + q) * (s + wp.float64(2.0) * total[2] * q)
        if volume > wp.float64(0.0) and slope > wp.float64(0.0):
            q -= ((p + q) * volume - amount) / slope
    gas[INCREMENT] = q
    gas[GAUGE] = gas[GAUGE] + q


@wp.kernel
def apply_membrane_e(
    normal: wp.array(dtype=wp.vec3),
    change: wp.array(dtype=float),
    response: wp.array(dtype=float),
    gas: wp.array(dtype=wp.float64),
    rigid: wp.array(dtype=wp.vec3),
    theta: float,
    dt: float,
    # outputs
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
):
    """Add the change of normal velocity and give the speed that moves E in this step.

    Args:
        normal: [n] unit normals.
        change: [n_e] m/s.
        response: [n_e] change per unit pressure, m/s/Pa.
        gas: gas slots.
        rigid: see `rigid_motion`.
        theta: 1 backward Euler, 1/2 midpoint; the pressure's share always counts in full.
        dt: s.
        u: [n] m/s.
        u_mid: [n_e] m/s.
    """
    i = wp.tid()
    n = normal[i]
    q = float(gas[INCREMENT])
    delta = change[i] + dt * wp.dot(rigid[2], n)
    push = q * response[i]
    u_mid[i] = wp.dot(u[i], n) + theta * delta + push
    u[i] = u[i] + (delta + push) * n


@wp.kernel
def volume_chunks(
    x: wp.array(dtype=wp.vec3),
    cell: wp.array(dtype=float),
    flux: wp.array(dtype=wp.vec3),
    bulge: wp.array(dtype=float),
    n: int,
    # outputs
    part: wp.array(dtype=wp.vec2d),
):
    """Parts of the enclosed volume (11), a third of the integral of (x - x_0).n over the cells, and of the area.

    Args:
        x: [n] m.
        cell: [n_e] cell areas, m^2.
        flux: [n_e] m^2, see `voronoi_cell_e`.
        bulge: [n_e] m^3, likewise.
        n: number of E.
        part: parts of (volume, area), m^3 and m^2.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    total = wp.vec2d()
    o = x[0]
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        triple = wp.float64(wp.dot(x[i] - o, flux[i])) + wp.float64(bulge[i])
        total += wp.vec2d(triple / wp.float64(3.0), wp.float64(cell[i]))
    part[c] = total


@wp.kernel
def store_volume(part: wp.array(dtype=wp.vec2d), gas: wp.array(dtype=wp.float64)):
    """Put the measured volume and area into the gas slots."""
    total = wp.vec2d()
    for c in range(part.shape[0]):
        total += part[c]
    gas[VOLUME] = total[0]
    gas[AREA] = total[1]


@wp.kernel
def find_offset(p_atm: wp.float64, limit: wp.float64, gas: wp.array(dtype=wp.float64)):
    """Normal offset (at most `limit`, m) that gives the measured volume the size its pressure asks for.

    The swept volume that `close_gas` predicts is of second order in the displacement; what it misses is mended here
    and not left to the next step's pressure. The volume slot then holds the volume after the offset.
    """
    wanted = gas[AMOUNT] / (p_atm + gas[GAUGE])
    offset = wp.clamp((wanted - gas[VOLUME]) / gas[AREA], -limit, limit)
    gas[OFFSET] = offset
    gas[VOLUME] = gas[VOLUME] + offset * gas[AREA]


@wp.kernel
def offset_surface_e(normal: wp.array(dtype=wp.vec3), gas: wp.array(dtype=wp.float64), x: wp.array(dtype=wp.vec3)):
    """Move E along their normals by the offset in the gas slots. [n_e], m."""
    i = wp.tid()
    x[i] = x[i] + float(gas[OFFSET]) * normal[i]


@wp.kernel
def traction_chunks(
    traction: wp.array(dtype=wp.vec3), area: wp.array(dtype=float), n: int, net: wp.array(dtype=wp.vec3)
):
    """Parts of the sum of a traction, N."""
    c = wp.tid()
    size = (n + net.shape[0] - 1) // net.shape[0]
    total = wp.vec3()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        total += area[i] * traction[i]
    net[c] = total


@wp.kernel
def recoil(
    moment: wp.array(dtype=wp.mat33),
    inertia: wp.array(dtype=wp.mat33),
    net: wp.array(dtype=wp.vec3),
    added: float,
    stiff: float,
    dt: float,
    # outputs
    kick: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
):
    """Translations of surface and liquid by the tangential impulse J of uneven tension, an inner force.

    The integral of 2 sigma kappa n + 2 grad_s sigma over a closed surface is zero, so the surface takes -J. The
    tangential solve took the surface for fixed: the part of J that it found implicitly is shared by both masses, or two
    bodies on a stiff spring would overshoot.

    Args:
        moment: parts of sum a n n.
        inertia: parts of sum (m + added a) n n.
        net: parts of J/dt.
        added: mass per area of the air, kg/m^2.
        stiff: implicit share w/(1 + w) of the lowest mode, w = (omega dt)^2.
        dt: s.
        kick: [0] added to the surface, [1] taken from the liquid, m/s.
        motion: velocity of the film as a whole, m/s.
    """
    s0 = wp.mat33()
    s1 = wp.mat33()
    s2 = wp.vec3()
    for c in range(net.shape[0]):
        s0 += moment[c]
        s1 += inertia[c]
        s2 += net[c]
    across = s1 - added * s0
    along = wp.trace(across) * wp.identity(n=3, dtype=float) - across
    share = 1.0 / (1.0 + stiff * wp.trace(along) / wp.trace(s1))
    kick[0] = -share * dt * (wp.inverse(s1) * s2)
    kick[1] = (1.0 - share) * dt * (wp.inverse(along) * s2)
    motion[0] = motion[0] + kick[0]


@wp.kernel
def apply_recoil_e(
    normal: wp.array(dtype=wp.vec3),
    kick: wp.array(dtype=wp.vec3),
    theta: float,
    # outputs
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
):
    """Add the translations of `recoil`. [n_e], m/s."""
    i = wp.tid()
    n = normal[i]
    k = wp.dot(kick[0], n)
    u[i] = u[i] + k * n - tangential(kick[1], n)
    u_mid[i] = u_mid[i] + theta * k
