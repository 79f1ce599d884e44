"""Stages 1 and 4: conservative APIC transfer between L and E (Algorithms 1 and 4)."""

import warp as wp

from melp_warp.kernels.native import Blocks, gather_blocks, mat68, moment_row, vec16, weigh_row, write_pack
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, tangent_basis, tangential

wp.set_module_options({"enable_backward": False})


CONTRAST = wp.constant(1000.0)
"""Most that the thickness of an L differs from that of the film around it, as a factor."""


@wp.kernel
def normalize_l(
    x_l: wp.array(dtype=wp.vec3),
    u_l: wp.array(dtype=wp.vec3),
    affine_l: wp.array(dtype=wp.mat33),
    mass_l: wp.array(dtype=float),
    surfactant_l: wp.array(dtype=float),
    eta_l: wp.array(dtype=float),
    x_e: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    n_e: int,
    density: float,
    affinity: float,
    place: wp.array(dtype=wp.int32),
    # outputs
    weight: wp.array(dtype=float),
    given: wp.array(dtype=float),
    lost: wp.array(dtype=int),
    share: wp.array(dtype=float),
):
    """What each L gives per weight W(E, L): its quantities over alpha_L = sum_E W of (6), E alone.

    The affine part is taken about the weighted mean of the E, where the carried velocity belongs: its sum over the
    E vanishes, so momentum is conserved to rounding, and affine fields are reproduced.

    Args:
        x_l: [n_l] m.
        u_l: [n_l] carried velocity, m/s.
        affine_l: [n_l] velocity gradient B D^-1, 1/s.
        mass_l: [n_l] kg.
        surfactant_l: [n_l] amount c, mol (of one interface).
        eta_l: [n_l] thickness, m.
        x_e: [n] m.
        rows: L:E neighbours.
        r: support radius, m.
        n_e: number of E; boundary particles beyond take no part, so that the transfer conserves.
        density: rho, kg/m^3.
        affinity: share of the affine part that is given: 1 APIC, 0 PIC.
        place: [n_l] place of each L among those sorted by their homes.
        weight: [pairs] W(E, L), 0 for boundary particles, 1/m^2.
        given: for the L at each place, packed by `rows.write_pack`, its position and over alpha: momentum m (u - C o)
            with o the weighted mean of the E as seen from the L, its slope m C, and mass, surfactant, area m/(rho eta).
        lost: [n_l] 1 for an L that no E is near to.
        share: [n_l] 1/alpha, m^2, 0 for those; null where nobody asks for it.
    """
    i = rows.first + wp.tid()
    p = x_l[i]
    sums = weigh_row(i, p, x_e, rows, r, n_e, weight)
    mean = wp.vec3(sums[0], sums[1], sums[2])
    total = sums[3]
    inverse = float(0.0)
    if total > 0.0:
        inverse = 1.0 / total
    m = mass_l[i] * inverse
    c = affinity * affine_l[i]
    amounts = wp.vec3(m, surfactant_l[i] * inverse, m / (density * eta_l[i]))
    write_pack(place[i], p, m * (u_l[i] - c * (inverse * mean)), amounts, m * c, given)
    lost[i] = wp.where(total > 0.0, 0, 1)
    if share:
        share[i] = inverse


@wp.kernel
def gather_l_to_e(
    x_e: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    rows: Neighbors,
    block: Blocks,
    r: float,
    given: wp.array(dtype=float),
    # outputs
    mass_e: wp.array(dtype=float),
    surfactant_e: wp.array(dtype=float),
    claim_e: wp.array(dtype=float),
    momentum_e: wp.array(dtype=wp.vec3),
):
    """Gather mass, surfactant, claimed area and APIC momentum, (6) and (7).

    Args:
        x_e: [n] m.
        region: [n] region of each E.
        rows: wide E:E neighbours.
        block: blocks of the L by their homes.
        r: support radius, m.
        given: from `normalize_l`.
        mass_e: [n_e] kg.
        surfactant_e: [n_e] mol.
        claim_e: [n_e] area that the L take up at their thickness, m^2.
        momentum_e: [n_e] kg m/s.
    """
    i = rows.first + wp.tid()
    total = gather_blocks(i, x_e, region[i], given, block, rows, r)
    momentum_e[i] = wp.vec3(total[0], total[1], total[2])
    mass_e[i] = total[3]
    surfactant_e[i] = total[4]
    claim_e[i] = total[5]


@wp.kernel
def split_velocity_e(
    mass: wp.array(dtype=float),
    momentum: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """u_E: tangential part from the L, none where no L is near, normal part kept.

    E move with the normal velocity, so it needs no transport; passing it through the L would only smear it.
    """
    i = wp.tid()
    n = normal[i]
    v = wp.vec3()
    if mass[i] > 0.0:
        v = momentum[i] / mass[i]
    u[i] = tangential(v, n) + wp.dot(u[i], n) * n


@wp.kernel
def keep_normal_e(normal: wp.array(dtype=wp.vec3), u: wp.array(dtype=wp.vec3)):
    """u_E of an E-only film: along the normal, which has turned since, at the speed that it had.

    Taking the normal part of it instead would take dt/2 |grad_s u|^2 of its energy a second.
    """
    i = wp.tid()
    u[i] = wp.sign(wp.dot(u[i], normal[i])) * wp.length(u[i]) * normal[i]


@wp.kernel
def pack_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    growth: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    density: float,
    # outputs
    pack: wp.array(dtype=vec16),
):
    """What L gather from each E, for `rows.moment_row`: u and its change, growth, position, normal and thickness.

    [n]; boundary particles have no growth and no thickness; no change without `before`.
    """
    i = wp.tid()
    g = float(0.0)
    eta = float(0.0)
    if i < growth.shape[0]:
        g = growth[i]
        eta = mass[i] / (density * area[i])
    p = x[i]
    v = u[i]
    n = normal[i]
    c = wp.vec3()
    if before:
        c = v - before[i]
    pack[i] = vec16(v[0], v[1], v[2], c[0], c[1], c[2], g, 1.0, p[0], p[1], p[2], 0.0, n[0], n[1], n[2], eta)


@wp.func
def slope_of(moment: wp.mat33, cov: wp.vec3, e1: wp.vec3, e2: wp.vec3):
    """B D^-1 (17) in the plane of e1 and e2, from B and D = (d11, d12, d22). 0 where the E lie on one line."""
    det = cov[0] * cov[2] - cov[1] * cov[1]
    slope = wp.mat33()
    if det > 1.0e-4 * cov[0] * cov[2]:
        b1 = moment * e1
        b2 = moment * e2
        slope = wp.outer((cov[2] * b1 - cov[1] * b2) / det, e1) + wp.outer((cov[0] * b2 - cov[1] * b1) / det, e2)
    return slope


@wp.func
def moment_of(sums: mat68, column: int, mean: wp.vec3, first: wp.vec3):
    """B of (17), mean of (a - mean a) x (d - mean d), of the vector in three columns of `moment_row`."""
    moment = wp.mat33()
    for a in range(3):
        for c in range(3):
            moment[a, c] = sums[c + 1, column + a] / sums[0, 7] - mean[a] * first[c]
    return moment


@wp.kernel
def gather_e_to_l(
    x_l: wp.array(dtype=wp.vec3),
    pack: wp.array(dtype=vec16),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    flip: float,
    midway: float,
    theta: wp.array(dtype=float),
    # outputs
    u_l: wp.array(dtype=wp.vec3),
    affine_l: wp.array(dtype=wp.mat33),
    v_l: wp.array(dtype=wp.vec3),
    normal_l: wp.array(dtype=wp.vec3),
    eta_l: wp.array(dtype=float),
):
    """Velocity (16), affine state (17), inertia (18) and thickness (8) of each L.

    The velocity that L move with is that of the E after theta dt, u_E'; the one they carry on, and the affine state,
    are extrapolated to the end of the step, u_E' + (1/theta - 1)(u_E' - u_E).

    FLIP (Brackbill and Ruppel 1986) keeps of an L its own velocity less what the E made of it, u_L - sum W^ u_E, here
    the share `flip` of it along the film: the normal motion is the E's. Its mass-weighted sum over the L is 0, as the
    E hold the momentum of the L.

    With the weights of (6), over E alone: a round trip then cannot add energy. With boundary particles in these sums
    and not in those, a flow along a rim fed on the difference.

    Args:
        x_l: [n_l] m.
        pack: [n] velocities after theta dt, their change, relative change of the thickness in this step, positions
            normals and thickness, see `pack_e`.
        weight: [pairs] W(E, L), 0 for boundary particles, 1/m^2.
        rows: L:E neighbours.
        flip: share of an L's departure from the E that it keeps, 0 to 1.
        midway: 1 for L that move with the velocity half a step on, whatever theta, 0 for that after theta dt.
        theta: [1] share of the step after which u_E' is.
        u_l: [n_l] carried velocity, m/s.
        affine_l: [n_l] B D^-1 with differences of position in the tangent plane, 1/s.
        v_l: [n_l] velocity at the particle itself, m/s.
        normal_l: [n_l] unit normals.
        eta_l: [n_l] m.
    """
    i = rows.first + wp.tid()
    sums = moment_row(i, x_l[i], pack, weight, rows)
    total = sums[0, 7]
    if total > 0.0:
        n = wp.normalize(wp.vec3(sums[5, 0], sums[5, 1], sums[5, 2]))
        velocity = wp.vec3(sums[0, 0], sums[0, 1], sums[0, 2]) / total
        change = wp.vec3(sums[0, 3], sums[0, 4], sums[0, 5]) / total
        first = wp.vec3(sums[1, 7], sums[2, 7], sums[3, 7]) / total
        s = sums[4]
        cov = wp.mat33(s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]) / total - wp.outer(first, first)
        e1, e2 = tangent_basis(n)
        d = wp.vec3(wp.dot(e1, cov * e1), wp.dot(e1, cov * e2), wp.dot(e2, cov * e2))
        slope = slope_of(moment_of(sums, 0, velocity, first), d, e1, e2)
        beyond = 1.0 / theta[0] - 1.0
        departure = tangential(u_l[i] - velocity + change, n)
        u_l[i] = velocity + beyond * change + flip * departure
        affine_l[i] = slope + beyond * slope_of(moment_of(sums, 3, change, first), d, e1, e2)
        v_l[i] = velocity - midway * (1.0 - 0.5 / theta[0]) * change - slope * first
        normal_l[i] = n
        eta = eta_l[i] * wp.exp(wp.clamp(sums[0, 6] / total, -1.0, 1.0))
        mean = sums[5, 3] / total
        eta_l[i] = wp.where(mean > 0.0, wp.clamp(eta, mean / CONTRAST, mean * CONTRAST), eta)


@wp.kernel
def thickness_growth_e(
    widening: wp.array(dtype=float),
    claim: wp.array(dtype=float),
    area: wp.array(dtype=float),
    rate: wp.array(dtype=float),
    slack: float,
    most: float,
    # outputs
    growth: wp.array(dtype=float),
):
    """Relative growth of the thickness of the L around each E: (8), kept in step with eta_E.

    eta falls as the film dilates, and where the L at their thickness claim more area than the E control
    (claim/area > 1) it is raised at `rate`: detail between L is carried, their mean cannot drift. What is beyond
    `most` is mended at once: L that meet head-on or leave a place empty do not obey (8).

    Args:
        widening: [n_e] logarithm of an area after the step over that before.
        claim: [n_e] claimed area, m^2.
        area: [n_e] control area, m^2.
        rate: [1] share of the mismatch mended in this step, 0 to 1.
        slack: relative mismatch that is left alone: mending the noise of single E would sharpen it step by step.
        most: relative mismatch beyond which it is mended at once.
        growth: [n_e].
    """
    i = wp.tid()
    mended = float(0.0)
    if claim[i] > 0.0:
        mismatch = wp.log(claim[i] / area[i])
        near = wp.clamp(mismatch, -most, most)
        mended = rate[0] * (near - wp.clamp(near, -slack, slack)) + mismatch - near
    growth[i] = mended - widening[i]


@wp.kernel
def follow_surfactant_e(
    x: wp.array(dtype=wp.vec3),
    claim: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    reference: float,
    rows: Neighbors,
    r: float,
    widening: wp.array(dtype=float),
    swelling: wp.array(dtype=float),
    theta: wp.array(dtype=float),
    # outputs
    growth: wp.array(dtype=float),
):
    """Relative growth of the thickness of the L around each E, such that their surfactant is as dense as E have it.

    Liquid and surfactant of an L get thinner and thicker together: eta/Gamma stays along its path. What the solve makes
    of Gamma is smooth. What E make of the film's widening has the noise of their sums in it, which elasticity sees as
    film that is pressed together here and there: summed up, it is as large as the dye that a picture shows.

    The concentration is the mean of those around by W, as L see it: what single E say would be sharpened step by step.

    Args:
        x: [n] m.
        claim: [n_e] area that the L take up at their thickness, m^2.
        surfactant: [n_e] mol.
        gamma: [n] relative concentration after theta dt.
        reference: Gamma_0, mol/m^2.
        rows: E:E neighbours.
        r: support radius, m.
        widening: [n_e] logarithm of an area after the step over that before; L without surfactant go by that.
        swelling: [n_e] what normal motion of a curved film makes of it in a step, to the first order, of which the
            share 1 - theta is still to come; null for a film that stays where it is.
        theta: [1] share of the step.
        growth: [n_e].
    """
    i = rows.first + wp.tid()
    if claim[i] > 0.0 and surfactant[i] > 0.0:
        weight = kernel_w(0.0, r)
        total = weight * wp.log(gamma[i])
        for k in range(rows.start[i], rows.stop[i]):
            j = rows.index[k]
            if j < claim.shape[0] and surfactant[j] > 0.0:
                w = kernel_w(wp.length(x[j] - x[i]), r)
                weight += w
                total += w * wp.log(gamma[j])
        change = total / weight - wp.log(surfactant[i] / (reference * claim[i]))
        if swelling:
            change -= (1.0 - theta[0]) * swelling[i]
        growth[i] = change
    else:
        growth[i] = -widening[i]
