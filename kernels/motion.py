"""Motion of a closed film as a whole: momentum, outside forces, recoil."""

import warp as wp

from melp_warp.kernels.gas import VOLUME
from melp_warp.kernels.regions import part_range, part_region, region_total
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})


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
    added: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    inertia: wp.array(dtype=wp.mat33),
    net: wp.array(dtype=wp.vec3),
):
    """Parts of sum (m + added a) n n and the momentum sum (m + added a) u_n n, the air's share `added` by region."""
    c = wp.tid()
    start, stop = part_range(c, first, net.shape[0])
    air = added[part_region(c, first, net.shape[0])]
    s0 = wp.mat33()
    s1 = wp.vec3()
    for i in range(start, stop):
        ni = normal[i]
        m = mass[i] + air * area[i]
        s0 += m * wp.outer(ni, ni)
        s1 += m * wp.dot(u[i], ni) * ni
    inertia[c] = s0
    net[c] = s1


@wp.func
def whole_velocity(inertia: wp.mat33, momentum: wp.vec3) -> wp.vec3:
    """inertia^-1 momentum, by the inertia over its trace: the determinant of a small film's would not be a float32."""
    scale = wp.trace(inertia)
    return wp.inverse(inertia / scale) * (momentum / scale)


@wp.kernel
def solve_motion_r(inertia: wp.array(dtype=wp.mat33), net: wp.array(dtype=wp.vec3), motion: wp.array(dtype=wp.vec3)):
    """Velocity U of each region as a whole, (sum (m + added a) n n) U = sum (m + added a) u_n n. [regions], m/s."""
    g = wp.tid()
    regions = motion.shape[0]
    motion[g] = whole_velocity(region_total(inertia, g, regions), region_total(net, g, regions))


@wp.kernel
def weight_chunks(
    mass: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    inertia: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    weight: wp.array(dtype=wp.vec4),
    held: wp.array(dtype=float),
):
    """Parts of each region's weight sum m body, N, of its mass, and of what its inertia has beyond that (null), kg."""
    c = wp.tid()
    start, stop = part_range(c, first, weight.shape[0])
    total = wp.vec4()
    more = float(0.0)
    for i in range(start, stop):
        m = mass[i]
        b = m * body[i]
        total += wp.vec4(b[0], b[1], b[2], m)
        more += inertia[i] - m
    weight[c] = total
    if held:
        held[c] = more


@wp.kernel
def carry_motion_r(
    weight: wp.array(dtype=wp.vec4),
    held: wp.array(dtype=float),
    inertia: wp.array(dtype=wp.mat33),
    gas: wp.array2d(dtype=wp.float64),
    density: float,
    # outputs
    whole: wp.array(dtype=float),
    rigid: wp.array(dtype=wp.mat33),
    fall: wp.array(dtype=wp.vec3),
):
    """Inertia of each region as a whole: its liquid M, all of the air inside and half its volume of air outside.

    Normal motion alone has L = sum m n n of it, with the air of mode 2. What lacks, X = M + 3/2 rho_air V - L, acts on
    the translation U = L^-1 sum m u_n n, and so enters the matrix as p_i.L^-1 X L^-1 p_j with p = m n. Liquid hangs on
    its film, so the whole weight moves it.

    Args:
        weight: from `weight_chunks`.
        held: from it; null for forces that do not depend on the velocity.
        inertia: parts of sum m n n, m with the air's share, kg.
        gas: gas slots.
        density: of the air that moves along, kg/m^3.
        whole: [regions] M + 3/2 rho_air V, kg; what L has at most, where a bubble is drawn out to a disc.
        rigid: [regions] L^-1 X L^-1, 1/kg.
        fall: [regions] acceleration by outside forces, m/s^2.
    """
    g = wp.tid()
    regions = whole.shape[0]
    own = region_total(weight, g, regions)
    normal = region_total(inertia, g, regions)
    most = float(0.0)
    for k in range(3):
        most = wp.max(most, wp.abs(normal[k, 0]) + wp.abs(normal[k, 1]) + wp.abs(normal[k, 2]))
    size = wp.max(own[3] + 1.5 * density * float(gas[g, VOLUME]), most)
    inverse = wp.inverse(normal / size)
    whole[g] = size
    rigid[g] = (inverse * inverse - inverse) / size
    slow = whole[g]
    if held:
        slow += region_total(held, g, regions)
    fall[g] = wp.vec3(own[0], own[1], own[2]) / slow


@wp.kernel
def hold_motion_e(
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Give each region the translation `motion`, which outside forces alone change, in place of the one found. [n_e].

    Momentum is a sum over a surface that has moved since: what turning normals and the implicit stiffness make of it
    would let a wobbling bubble swim away.
    """
    i = wp.tid()
    n = normal[i]
    g = region[i]
    u[i] = u[i] + wp.dot(motion[g] - found[g], n) * n


@wp.kernel
def keep_speed_e(
    before: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Leave E the normal speed against the film as a whole that they had before their normals turned. [n_e], m/s.

    Liquid that flows along the film at w would have the part w.dn of its velocity across it, and so would the air that
    moves with the film: its waves would be carried along by a flow that it does not take part in, by an explicit
    step, and grow by (k w dt)^2/2 in each.

    Args:
        before: [n] normals before, unit.
        normal: [n] unit normals.
        motion: [1] velocity of the film as a whole, m/s.
        u: [n] m/s.
    """
    i = wp.tid()
    n = normal[i]
    u[i] = u[i] + wp.dot(u[i] - motion[0], before[i] - n) * n


@wp.kernel
def push_whole_e(
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    push: wp.array(dtype=wp.vec3),
    share: wp.array(dtype=float),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Add share[0] times a translation `push` of each region to the normal velocity. [n_e], m/s."""
    i = wp.tid()
    n = normal[i]
    u[i] = u[i] + share[0] * wp.dot(push[region[i]], n) * n


@wp.kernel
def push_whole_speed_e(
    normal: wp.array(dtype=wp.vec3),
    push: wp.array(dtype=wp.vec3),
    share: wp.array(dtype=float),
    # outputs
    speed: wp.array(dtype=float),
):
    """Add share[0] times a translation push[0] to a normal speed. [n_e], m/s."""
    i = wp.tid()
    speed[i] = speed[i] + share[0] * wp.dot(push[0], normal[i])


@wp.kernel
def blend_motion(
    start: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    # outputs
    between: wp.array(dtype=wp.vec3),
):
    """Velocity of each region as a whole after the share theta[0] of a step, between start and end. [regions], m/s."""
    k = wp.tid()
    between[k] = start[k] + theta[0] * (motion[k] - start[k])


@wp.kernel
def frame_motion_r(
    motion: wp.array(dtype=wp.vec3),
    pull: wp.array(dtype=wp.vec3),
    kick: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    frame: wp.array(dtype=wp.vec3),
):
    """Mean velocity of each region as a whole in a step that began and ended without contact. [regions], m/s.

    Args:
        motion: [regions] that at its end, m/s.
        pull: [regions] acceleration of the region's cluster by outside forces, m/s^2.
        kick: [regions] change by the drag, m/s; null without.
        dt: [1] s.
        frame: m/s.
    """
    g = wp.tid()
    change = dt[0] * pull[g]
    if kick:
        change += kick[g]
    frame[g] = motion[g] - 0.5 * change


@wp.kernel
def push_motion(rigid: wp.array(dtype=wp.vec3), dt: wp.array(dtype=float), motion: wp.array(dtype=wp.vec3)):
    """motion += dt times the acceleration of the film as a whole, rigid[2]."""
    motion[0] = motion[0] + dt[0] * rigid[2]


@wp.kernel
def net_force_chunks(
    force: wp.array(dtype=float),
    external: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    inertia: wp.array(dtype=float),
    area: wp.array(dtype=float),
    gravity: wp.array(dtype=wp.vec3),
    lift: float,
    added: float,
    n: int,
    # outputs
    moment: wp.array(dtype=wp.mat33),
    whole: wp.array(dtype=wp.mat33),
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
        inertia: [n_e] what resists a change of velocity, m a, kg.
        area: [n_e] m^2.
        gravity: [1] m/s^2.
        lift: share of the weight that the gas carries.
        added: mass per area that the air adds to rigid translation, kg/m^2.
        n: number of E.
        moment: parts of sum a n n.
        whole: parts of sum (a m + a added) n n.
        net: parts of sum a f n.
        net_external: parts of sum a f_ext n.
        lifted: parts of -sum lift m g.
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
        s1 += (inertia[i] / area[i] + added) * nn
        s2 += area[i] * force[i] * ni
        s3 += area[i] * external[i] * ni
        s4 -= lift * mass[i] * gravity[0]
    moment[c] = s0
    whole[c] = s1
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
    stiff: wp.array(dtype=float),
    theta: wp.array(dtype=float),
    dt: wp.array(dtype=float),
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
        stiff: [1] w = (omega dt)^2 of the lowest mode, whose implicit share is w/(1 + w).
        theta: [1] share of the step that the tangential solve was for.
        dt: [1] s.
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
    w = theta[0] * theta[0] * stiff[0]
    share = 1.0 / (1.0 + w / (1.0 + w) * wp.trace(along) / wp.trace(s1))
    kick[0] = -share * dt[0] * (wp.inverse(s1) * s2)
    kick[1] = (1.0 - share) * dt[0] * (wp.inverse(along) * s2)
    motion[0] = motion[0] + kick[0]


@wp.kernel
def apply_recoil_e(
    normal: wp.array(dtype=wp.vec3),
    kick: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    theta_whole: wp.array(dtype=float),
    # outputs
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
):
    """Add the translations of `recoil`, the shares of a step to which u and u_mid belong of them. [n_e], m/s."""
    i = wp.tid()
    n = normal[i]
    k = wp.dot(kick[0], n)
    u[i] = u[i] + theta[0] * (k * n - tangential(kick[1], n))
    u_mid[i] = u_mid[i] + theta_whole[0] * k
