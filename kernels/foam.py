"""Foams: tension on Voronoi stars, facing sheets that cling to each other, force that normal motion leaves out."""

import warp as wp

from melp_warp.kernels.gas import GAUGE, INCREMENT, VOLUME
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, region_parts, region_total
from melp_warp.kernels.sph import kernel_w, tangential

wp.set_module_options({"enable_backward": False})

BACK_TO_BACK = wp.constant(-0.2)
"""Cosine of the normals below which two sheets face each other."""

OPEN = wp.constant(0.7)
"""Cosine of the normals from which two sheets have nothing to do with each other: they open by 135 degrees."""

FACING_RAMP = wp.constant(0.4)
"""Range of the cosine over which that sets in."""

DEEPEST = wp.constant(0.4)
"""Overlap, in the reach of contact, beyond which two E are taken to have their backs to each other."""

MENISCUS = wp.constant(2.0)
"""Height of the meniscus on a wall, in the range of clinging."""

EDGE = wp.constant(0.1)
"""Cover below which a sheet counts as free, and below 1 by which it counts as covered: tails that reach flat films."""


@wp.struct
class Contact:
    """How sheets of different regions meet; made once a run."""

    point: wp.array(dtype=wp.vec3)  # a point of each wall, m
    inward: wp.array(dtype=wp.vec3)  # unit normal of each wall
    reach: float  # distance along the sheets within which facing E act on each other, m
    give: float  # gap beyond which they do not press on each other, m
    range: float  # gap beyond which they do not cling to each other, m
    cling: float  # 2 sigma, work of adhesion of two sheets, N/m
    lag: float  # time by which forces near a line look ahead, s


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
):
    """Gradient of the polyhedral volume, sum d_j x d_j+1 / 6 over the star: a third of its area, with normal. m^2."""
    i = star.first + wp.tid()
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


@wp.func
def near_share(gap: float, span: float) -> float:
    """How much two sheets are one film: 1 at gap 0, none from `span` on, (1 - gap/span)^2 between."""
    s = wp.clamp(1.0 - gap / span, 0.0, 1.0)
    return s * s


@wp.func
def meet_sheets(d: wp.vec3, n: wp.vec3, m: wp.vec3, reach: float):
    """How two E of different regions face each other.

    Their gap is taken along the mean of their normals, along which two points of one sphere have none.

    Args:
        d: from the first to the second, m.
        n: normal of the first.
        m: normal of the second.
        reach: m.

    Returns:
        The weight of the pair, W of their distance across the gap, 1/m^2, 0 where they do not face each other; the
        direction of the gap; the gap, m.
    """
    w = float(0.0)
    gap = float(0.0)
    along = wp.vec3()
    facing = wp.dot(n, m)
    if facing < OPEN:
        along = wp.normalize(n - m)
        gap = wp.dot(d, along)
        if gap > -DEEPEST * reach:
            beside = wp.sqrt(wp.max(wp.length_sq(d) - gap * gap, 0.0))
            w = kernel_w(beside, reach) * wp.min((OPEN - facing) / FACING_RAMP, 1.0)
    return w, along, gap


@wp.func
def meet_image(d: wp.vec3, n: wp.vec3, m: wp.vec3, height: float, inward: wp.vec3, reach: float):
    """How an E faces the image of one of its own region in a wall, as `meet_sheets` has it; half the gap.

    Args:
        d: from the first to the second, m.
        n: normal of the first.
        m: normal of the second.
        height: of the second above the wall, m.
        inward: normal of the wall.
        reach: m.
    """
    image = d - 2.0 * height * inward
    w, along, gap = meet_sheets(image, n, m - 2.0 * wp.dot(m, inward) * inward, reach)
    if wp.max(wp.dot(n, inward), wp.dot(m, inward)) > 0.0:
        w = 0.0
    return w, along, 0.5 * gap


@wp.kernel
def find_cover_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    facing: Neighbors,
    own: Neighbors,
    contact: Contact,
    # outputs
    cover: wp.array(dtype=float),
    faced: wp.array(dtype=float),
):
    """How much of each E's sheet is one film with another region's: 1 in a partition and on a wall, 0 outside.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        area: [n_e] m^2.
        facing: E of other regions near each E.
        own: E of the same region.
        contact: constants.
        cover: [n_e] 0 to 1.
        faced: [n_e] the same by other regions alone.
    """
    i = facing.first + wp.tid()
    p = x[i]
    n = normal[i]
    shared = float(0.0)
    for s in range(facing.start[i], facing.stop[i]):
        j = facing.index[s]
        w, _along, gap = meet_sheets(x[j] - p, n, normal[j], contact.reach)
        shared += area[j] * w * near_share(gap, contact.range)
    held = wp.clamp((shared - EDGE) / (1.0 - 2.0 * EDGE), 0.0, 1.0)
    faced[i] = held
    for k in range(contact.point.shape[0]):
        inward = contact.inward[k]
        level = wp.dot(inward, contact.point[k])
        height = wp.dot(inward, p) - level
        if height < contact.reach:
            w, _along, gap = meet_image(wp.vec3(), n, n, height, inward, contact.reach)
            shared = area[i] * w * near_share(gap, contact.range)
            for s in range(own.start[i], own.stop[i]):
                j = own.index[s]
                height = wp.dot(inward, x[j]) - level
                w, _along, gap = meet_image(x[j] - p, n, normal[j], height, inward, contact.reach)
                shared += area[j] * w * near_share(gap, contact.range)
            held += wp.clamp((shared - EDGE) / (1.0 - 2.0 * EDGE), 0.0, 1.0)
    cover[i] = wp.min(held, 1.0)


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
def hold(gap: float, spring: float, contact: Contact):
    """Pressure between two sheets at rest, Pa, and the stiffness with which a step answers it, Pa/m.

    They cling to each other with the slope of the energy that one film saves against two, -`cling` near_share', and
    press on each other with `spring` (Pa/m) from a gap of `contact.give` on. Clinging grows as a gap closes; in the
    stiffness it counts as a spring that would just close the gap, so that a large step does not carry sheets into each
    other.
    """
    pull = 2.0 * contact.cling / contact.range * wp.clamp(1.0 - gap / contact.range, 0.0, 1.0)
    pressure = wp.max(0.0, spring * (contact.give - gap)) - pull
    slope = wp.where(gap < contact.give, spring, 0.0) + pull / wp.max(gap, contact.give)
    return pressure, slope


@wp.func
def press(gap: float, before: float, push: float, inertia: float, contact: Contact, dt: float):
    """Pressure between two sheets, at rest and in motion, Pa, and the stiffness with which a step answers it, Pa/m.

    In motion it is that of `contact.lag` later than the step ends, which damps, and what drives sheets into each other
    is stopped within the step.

    Args:
        gap: at the end of the step with the velocity of its start, m.
        before: at the start of the step, m.
        push: Pa.
        inertia: mean of the two sheets, kg/m^2.
        contact: constants.
        dt: s.
    """
    later = contact.lag / dt
    spring = push / contact.give
    elastic, slope = hold(gap, spring, contact)
    pressure, _slope = hold(gap + later * (gap - before), spring, contact)
    slope *= 1.0 + later
    if gap < 0.0:
        hard = inertia / (dt * dt)
        pressure += hard * wp.clamp(before - gap, 0.0, -gap)
        slope += hard
    return elastic, pressure, slope


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
    dt: float,
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
        dt: s.
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
        pull += c * (d + lag / dt * (d - (x[j] - p)))
        quiet += c * d
        rows.index[k] = j
        pair[k] = dt * (dt + lag) * c
        k += 1
    rows.stop[i] = k
    force[i] = pull
    rest[i] = quiet


@wp.func
def press_wall(
    i: int,
    x: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    push: float,
    inertia: float,
    faced: float,
    own: Neighbors,
    wall: int,
    contact: Contact,
    dt: float,
):
    """Contact of E i with a wall: force, force at rest, the meniscus' force along the wall, N, and stiffness, kg.

    The film holds on to the image of its own region, which would make 120 degrees with the wall as with another
    bubble, and the meniscus around its foot sucks at it, by sigma a length in all, which makes 90: outside the bubble
    the wall is as wet as inside. In the matrix the image moves as the E does.
    """
    inward = contact.inward[wall]
    level = wp.dot(inward, contact.point[wall])
    n = normal[i]
    half = contact
    half.cling = 0.5 * contact.cling
    total = wp.vec3()
    quiet = wp.vec3()
    stiff = float(0.0)
    for s in range(own.start[i] - 1, own.stop[i]):
        j = i
        if s >= own.start[i]:
            j = own.index[s]
        height = wp.dot(inward, predicted[j]) - level
        w, along, gap = meet_image(predicted[j] - predicted[i], n, normal[j], height, inward, contact.reach)
        if w > 0.0 and gap < contact.range:
            image = x[j] - x[i] - 2.0 * (wp.dot(inward, x[j]) - level) * inward
            before = 0.5 * wp.dot(image, along)
            elastic, pressure, slope = press(gap, before, push, inertia, half, dt)
            a = area[i] * area[j] * w
            total -= (a * pressure) * along
            quiet -= (a * elastic) * along
            ci = wp.dot(along, n)
            stiff += dt * dt * a * slope * ci * ci
    depth = MENISCUS * contact.range
    height = wp.clamp(wp.dot(inward, predicted[i]) - level, 0.0, depth)
    suck = (area[i] * (1.0 - faced) * contact.cling * (1.0 - height / depth) / depth) * n
    side = tangential(suck, inward)
    return total + suck - side, quiet + suck, side, stiff


@wp.kernel
def press_foam_e(
    x: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    added: wp.array(dtype=float),
    push: wp.array(dtype=float),
    faced: wp.array(dtype=float),
    facing: Neighbors,
    own: Neighbors,
    contact: Contact,
    stride: int,
    dt: float,
    # outputs
    force: wp.array(dtype=wp.vec3),
    rest: wp.array(dtype=wp.vec3),
    foot: wp.array(dtype=wp.vec3),
    diag: wp.array(dtype=float),
    rows: Neighbors,
    pair: wp.array(dtype=float),
    wanted: wp.array(dtype=wp.int32),
):
    """Contact: facing E press on each other and cling to each other, and to walls; added to force and matrix.

    Every pair's force has its opposite. The matrix couples c_i u_i + c_j u_j, the speed at which a gap closes, which
    `LinearOperator` takes as a negative pair coefficient.

    Args:
        x: [n] m.
        predicted: [n] m.
        normal: [n] unit normals.
        area: [n_e] m^2.
        mass: [n_e] kg.
        region: [n] region of each E.
        added: [regions] mass of the air that moves along, kg/m^2.
        push: [regions] pressure at gap 0, Pa.
        faced: [n_e] share of each E that other regions cover: there is no meniscus there.
        facing: E of other regions near each E.
        own: E of the same region.
        contact: constants.
        stride: room of a row.
        dt: s.
        force: [n_e] of sheets that move, N.
        rest: [n_e] of sheets at rest, with the menisci, N.
        foot: [n_e] menisci's force along their walls, N.
        diag: [n_e] kg.
        rows: coupled E.
        pair: coefficients, aligned with `rows`, kg.
        wanted: [n_e] entries that the row needs.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    p = x[i]
    at = predicted[i]
    room = rows.start[i] + stride
    k = rows.stop[i]
    total = wp.vec3()
    quiet = wp.vec3()
    drawn = wp.vec3()
    stiff = float(0.0)
    inertia = mass[i] / area[i] + added[region[i]]
    for s in range(facing.start[i], facing.stop[i]):
        j = facing.index[s]
        m = normal[j]
        w, along, gap = meet_sheets(predicted[j] - at, n, m, contact.reach)
        if w > 0.0 and gap < contact.range:
            strength = 0.5 * (push[region[i]] + push[region[j]])
            both = 0.5 * (inertia + added[region[j]] + mass[j] / area[j])
            elastic, pressure, slope = press(gap, wp.dot(x[j] - p, along), strength, both, contact, dt)
            a = area[i] * area[j] * w
            total -= (a * pressure) * along
            quiet -= (a * elastic) * along
            ci = wp.dot(along, n)
            cj = -wp.dot(along, m)
            c = dt * dt * a * slope * ci
            stiff += c * (ci + cj)
            if k < room:
                rows.index[k] = j
                pair[k] = -c * cj
            k += 1
    for w in range(contact.point.shape[0]):
        if wp.dot(contact.inward[w], at - contact.point[w]) < contact.reach:
            wall, quiet_wall, side, stiff_wall = press_wall(
                i, x, predicted, normal, area, push[region[i]], inertia, faced[i], own, w, contact, dt
            )
            total += wall
            quiet += quiet_wall
            drawn += side
            stiff += stiff_wall
    force[i] = force[i] + total
    rest[i] = rest[i] + quiet
    foot[i] = drawn
    diag[i] = stiff
    wanted[i] = k - rows.start[i]
    rows.stop[i] = wp.min(k, room)


@wp.kernel
def seek_normals_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=float),
    rest: wp.array(dtype=wp.vec3),
    cover: wp.array(dtype=float),
    star: Neighbors,
    rows: Neighbors,
    reach: float,
    bent: wp.array(dtype=float),
    share: float,
    # outputs
    sought: wp.array(dtype=wp.vec3),
):
    """What the normals around an E make of the force that its own normal leaves out; see `gather_load_e`.

    Motion along the normal leaves out what of a force lies in the sheet, F_t. Nothing does where the sheet is smooth;
    at a line, where the tension jumps, it is what holds the angle. The normals n_j around, with weights w_j, take it up
    as w_j n_j.l, where (sum w n n^T) l = F_t. The normals turn by mu, the mean square along a principal axis; l is
    damped by mu^4/(mu^4 + bent^4), or noise on smooth films would be blown up. It follows with a delay: the normals
    themselves answer to it.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        region: [n] region of each E.
        ahead: [regions] predicted gauge pressure, Pa.
        rest: [n_e] tension and contact of sheets at rest, N.
        cover: [n_e]; far from what is covered nothing is passed on.
        star: neighbours across the cell's edges.
        rows: E:E neighbours.
        reach: m.
        bent: [regions] mean square turn of the normals from which they take up force.
        share: how far l comes towards what it should be in this step, 0 to 1.
        sought: [n_e] l over the sum of weights, N m^2; in and out.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    p = x[i]
    along = tangential(rest[i] + ahead[region[i]] * vector[i], n)
    held = cover[i]
    for k in range(star.start[i], star.stop[i]):
        held = wp.max(held, cover[star.index[k]])
    if held == 0.0:
        sought[i] = (1.0 - share) * sought[i]
        return
    total = kernel_w(0.0, reach)
    spread = total * wp.outer(n, n)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        w = kernel_w(wp.length(x[j] - p), reach)
        total += w
        spread += w * wp.outer(normal[j], normal[j])
    least = bent[region[i]]
    axes, turn = wp.eig3(spread / total)
    found = wp.vec3()
    for k in range(3):
        axis = wp.vec3(axes[0, k], axes[1, k], axes[2, k])
        s = wp.max(turn[k], 0.0) / least
        found += (s * s * s / (1.0 + s * s * s * s) / least * wp.dot(axis, along)) * axis
    sought[i] = sought[i] + share * (found / total - sought[i])


@wp.kernel
def gather_load_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=float),
    force: wp.array(dtype=wp.vec3),
    foot: wp.array(dtype=wp.vec3),
    sought: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    reach: float,
    most: float,
    # outputs
    load: wp.array(dtype=float),
):
    """Force of the film and the gas along each E's normal, with what its neighbours pass on.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        region: [n] region of each E.
        ahead: [regions] predicted gauge pressure, Pa.
        force: [n_e] tension and contact, N.
        foot: [n_e] menisci's force along their walls, N: none in all, so that of a region is no part of `force`.
        sought: [n_e] from `seek_normals_e`.
        rows: E:E neighbours.
        reach: m.
        most: most that an E takes from its neighbours, N.
        load: [n_e] N.
    """
    i = rows.first + wp.tid()
    p = x[i]
    found = kernel_w(0.0, reach) * sought[i]
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        found += kernel_w(wp.length(x[j] - p), reach) * sought[j]
    n = normal[i]
    passed = wp.clamp(wp.dot(found, n), -most, most)
    load[i] = wp.dot(force[i] + foot[i] + ahead[region[i]] * vector[i], n) + passed


@wp.kernel
def touch_chunks(
    x: wp.array(dtype=wp.vec3),
    contact: Contact,
    first: wp.array(dtype=wp.int32),
    # outputs
    touch: wp.array(dtype=wp.int32),
):
    """Walls that a part of a region touches, a bit each."""
    c = wp.tid()
    start, stop = part_range(c, first, touch.shape[0])
    bits = int(0)
    for k in range(contact.point.shape[0]):
        level = wp.dot(contact.inward[k], contact.point[k])
        near = bool(False)
        for i in range(start, stop):
            near = near or wp.dot(contact.inward[k], x[i]) - level < MENISCUS * contact.range
        if near:
            bits = bits | (1 << k)
    touch[c] = bits


@wp.func
def along_walls(v: wp.vec3, g: int, regions: int, touch: wp.array(dtype=wp.int32), contact: Contact) -> wp.vec3:
    """The part of v along the walls that region g touches: across them the walls take up what there is."""
    start, stop = region_parts(g, touch.shape[0], regions)
    bits = int(0)
    for c in range(start, stop):
        bits = bits | touch[c]
    for k in range(contact.point.shape[0]):
        if (bits >> k) & 1 == 1:
            v = tangential(v, contact.inward[k])
    return v


@wp.kernel
def find_missing_r(
    net: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=wp.mat33),
    touch: wp.array(dtype=wp.int32),
    contact: Contact,
    # outputs
    missing: wp.array(dtype=wp.vec3),
):
    """Acceleration of each region by the force that its loads leave out, along the walls it touches. [regions]."""
    g = wp.tid()
    regions = missing.shape[0]
    force = along_walls(region_total(net, g, regions), g, regions, touch, contact)
    missing[g] = wp.inverse(region_total(mass, g, regions)) * force


@wp.kernel
def missing_chunks(
    normal: wp.array(dtype=wp.vec3),
    force: wp.array(dtype=wp.vec3),
    rest: wp.array(dtype=wp.vec3),
    foot: wp.array(dtype=wp.vec3),
    load: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    net: wp.array(dtype=wp.vec3),
):
    """Parts of the force on each region at rest that its loads still leave out, N.

    The gas has none on a closed surface, nor have menisci along their walls.

    Args:
        normal: [n] unit normals.
        force: [n_e] tension and contact, N.
        rest: [n_e] the same of sheets at rest, menisci included, N.
        foot: [n_e] menisci's force along their walls, N.
        load: [n_e] from `gather_load_e`, N.
        first: [regions + 1] first E of each region.
        net: parts.
    """
    c = wp.tid()
    start, stop = part_range(c, first, net.shape[0])
    total = wp.vec3()
    for i in range(start, stop):
        n = normal[i]
        moving = wp.dot(force[i] + foot[i] - rest[i], n)
        total += rest[i] - foot[i] - (load[i] - moving) * n
    net[c] = total


@wp.kernel
def kick_foam_e(
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    fall: wp.array(dtype=wp.vec3),
    dt: float,
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Outside forces give each region a velocity dt `fall` before the solve, whose stiffness would resist. [n_e]."""
    i = wp.tid()
    n = normal[i]
    u[i] = u[i] + dt * wp.dot(fall[region[i]], n) * n


@wp.kernel
def load_foam_e(
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    fall: wp.array(dtype=wp.vec3),
    missing: wp.array(dtype=wp.vec3),
    added: wp.array(dtype=float),
    damping: float,
    u: wp.array(dtype=wp.vec3),
    load: wp.array(dtype=float),
    dt: float,
    # outputs
    b: wp.array(dtype=float),
    diag: wp.array(dtype=float),
    inertia: wp.array(dtype=float),
    outer: wp.array(dtype=float),
    sweep: wp.array(dtype=float),
):
    """Right-hand side and inertia of the solve.

    Args:
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        area: [n_e] m^2.
        mass: [n_e] kg.
        body: [n_e] acceleration by outside forces, m/s^2.
        region: [n] region of each E.
        fall: [regions] acceleration that outside forces have given already, m/s^2.
        missing: [regions] acceleration by the force that the loads leave out, m/s^2.
        added: [regions] mass of the air that moves along, kg/m^2.
        damping: rate at which the air takes up normal motion, 1/s.
        u: [n] m/s.
        load: [n_e] from `gather_load_e`, N.
        dt: s.
        b: [n_e] kg m/s.
        diag: [n_e] contact in, inertia added, kg.
        inertia: [n_e] mass with the air's and what damping adds, kg.
        outer: [n_e] the load's part from outside the foam, kg m/s.
        sweep: [n_e] dt N.n, volume swept per normal speed, m^2 s.
    """
    i = wp.tid()
    n = normal[i]
    g = region[i]
    m = mass[i] + added[g] * area[i]
    slow = dt * damping * m
    outer[i] = dt * (mass[i] * wp.dot(body[i], n) - m * wp.dot(fall[g], n)) - slow * wp.dot(u[i], n)
    b[i] = outer[i] + dt * (load[i] + m * wp.dot(missing[g], n))
    inertia[i] = m + slow
    diag[i] = diag[i] + inertia[i]
    sweep[i] = dt * wp.dot(vector[i], n)


@wp.kernel
def set_push_r(gas: wp.array2d(dtype=wp.float64), contact: Contact, push: wp.array(dtype=float)):
    """Pressure with which two sheets press on each other at gap 0: the gauge's and what they cling with. [regions]."""
    g = wp.tid()
    push[g] = wp.max(float(gas[g, GAUGE]), 0.0) + 2.0 * contact.cling / contact.range


@wp.kernel
def gained_chunks(
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    faced: wp.array(dtype=float),
    outer: wp.array(dtype=float),
    inertia: wp.array(dtype=float),
    change: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    gained: wp.array(dtype=wp.vec4),
):
    """Parts of the momentum that each region lost to the foam's own forces, kg m/s, and of its area that others cover.

    Args:
        normal: [n] unit normals.
        area: [n_e] m^2.
        faced: [n_e] share of each E that other regions cover.
        outer: [n_e] loads from outside the foam, kg m/s.
        inertia: [n_e] kg.
        change: [n_e] change of the normal speed, m/s.
        first: [regions + 1] first E of each region.
        gained: parts.
    """
    c = wp.tid()
    start, stop = part_range(c, first, gained.shape[0])
    total = wp.vec3()
    touched = float(0.0)
    for i in range(start, stop):
        total += (outer[i] - inertia[i] * change[i]) * normal[i]
        touched += faced[i] * area[i]
    gained[c] = wp.vec4(total[0], total[1], total[2], touched)


@wp.kernel
def pool_debt(
    gained: wp.array(dtype=wp.vec4),
    touch: wp.array(dtype=wp.int32),
    contact: Contact,
    share: float,
    regions: int,
    # outputs
    debt: wp.array(dtype=wp.vec4),
):
    """Momentum owed to all bubbles that touch others, kg m/s, and what of it is paid in this step.

    Inner forces have none in all, and walls none along them; but what stops sheets that close in on each other, and the
    matrix, know normals alone, so that contact kicks a foam as a whole.

    Args:
        gained: from `gained_chunks`.
        touch: from `touch_chunks`.
        contact: constants.
        share: how much of the debt is paid in a step.
        regions: number of regions.
        debt: what is owed; what is paid now, with the area that others cover.
    """
    total = wp.vec4()
    owed = wp.vec3(debt[0][0], debt[0][1], debt[0][2])
    for g in range(regions):
        own = region_total(gained, g, regions)
        if own[3] > 0.0:
            total += own
    owed += wp.vec3(total[0], total[1], total[2])
    for g in range(regions):
        own = region_total(gained, g, regions)
        if own[3] > 0.0:
            owed = along_walls(owed, g, regions, touch, contact)
    paid = share * owed
    owed -= paid
    debt[0] = wp.vec4(owed[0], owed[1], owed[2], 0.0)
    debt[1] = wp.vec4(paid[0], paid[1], paid[2], total[3])


@wp.kernel
def pay_debt_r(
    gained: wp.array(dtype=wp.vec4),
    mass: wp.array(dtype=wp.mat33),
    touch: wp.array(dtype=wp.int32),
    contact: Contact,
    debt: wp.array(dtype=wp.vec4),
    # outputs
    recoil: wp.array(dtype=wp.vec3),
):
    """What each region gets of the debt, by its covered area; one that touches no other, all its own. [regions]."""
    g = wp.tid()
    regions = recoil.shape[0]
    own = region_total(gained, g, regions)
    net = along_walls(wp.vec3(own[0], own[1], own[2]), g, regions, touch, contact)
    if own[3] > 0.0:
        net = own[3] / debt[1][3] * wp.vec3(debt[1][0], debt[1][1], debt[1][2])
    recoil[g] = wp.inverse(region_total(mass, g, regions)) * net


@wp.kernel
def apply_foam_e(
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    change: wp.array(dtype=float),
    recoil: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
):
    """Add the change of normal speed and the region's recoil; E move with the speed at the end of the step. [n_e]."""
    i = wp.tid()
    n = normal[i]
    u[i] = u[i] + (change[i] + wp.dot(recoil[region[i]], n)) * n
    u_mid[i] = wp.dot(u[i], n)


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
        kept: [n_e] m.
        slowed: [n_e] m/s.
        turned: [n_e] unit normals.
    """
    i = rows.first + wp.tid()
    p = x[i]
    v = u[i]
    n = normal[i]
    total = float(0.0)
    mean = wp.vec3()
    flow = wp.vec3()
    facing = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        w = kernel_w(wp.length(x[j] - p), reach)
        total += w
        mean += w * x[j]
        flow += w * u[j]
        facing += w * normal[j]
    if total > 0.0:
        away = p - mean / total
        far = wp.length(away)
        reversed = wp.dot(facing, n) < 0.0
        if reversed:
            n = wp.normalize(facing)
        if far > leash or reversed:
            p -= (1.0 - wp.min(leash / far, 0.5)) * away
            v = flow / total
    for w in range(contact.point.shape[0]):
        inward = contact.inward[w]
        height = wp.dot(p - contact.point[w], inward)
        if height < 0.0:
            p -= height * inward
            v -= wp.min(wp.dot(v, inward), 0.0) * inward
    kept[i] = p
    slowed[i] = v
    turned[i] = n


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
    seed: int,
    chance: float,
    dt: float,
    # outputs
    region_l: wp.array(dtype=wp.int32),
    eta_l: wp.array(dtype=float),
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
        seed: differs from call to call.
        chance: psi_1 = psi_2, the largest value of each of the two.
        dt: step that (27) looks ahead, s.
        region_l: [n_l] region of each L.
        eta_l: [n_l] m.
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
            eta_l[i] = eta[j]
