"""Foams: how sheets of different regions face each other, what covers them, how they press and cling; walls."""

import warp as wp

from melp_warp.kernels.gas import GAUGE
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, tangential

wp.set_module_options({"enable_backward": False})

OPEN = wp.constant(0.7)
"""Cosine of the normals from which two sheets have nothing to do with each other: they open by 135 degrees."""

FACING_RAMP = wp.constant(0.4)
"""Range of the cosine over which that sets in."""

EDGE = wp.constant(0.1)
"""Cover below which a sheet counts as free, and below 1 by which it counts as covered: tails that reach flat films."""

DEEPEST = wp.constant(0.4)
"""Overlap, in the reach of contact, beyond which two E are taken to have their backs to each other."""

LAYER = wp.constant(0.05)
"""Thickness of the liquid on a wetted wall, in the range of clinging.

Sheets rest on it, clear of where they are stopped.
"""

MENISCUS = wp.constant(2.0)
"""Height of the meniscus on a wall, in the range of clinging."""


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


@wp.func
def near_share(gap: float, span: float) -> float:
    """How much two sheets are one film: 1 at gap 0, none from `span` on, (1 - gap/span)^2 between."""
    s = wp.clamp(1.0 - gap / span, 0.0, 1.0)
    return s * s


@wp.func
def cut_tails(shared: float) -> float:
    """Cover from the share that is near: 0 below `EDGE`, 1 from 1 - `EDGE` on."""
    return wp.clamp((shared - EDGE) / (1.0 - 2.0 * EDGE), 0.0, 1.0)


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
    free: wp.array(dtype=float),
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
        free: [n_e] share of what holds it to other regions that counts: none where a wall covers it, and as much as
            would cover it once where it faces several.
    """
    i = facing.first + wp.tid()
    p = x[i]
    n = normal[i]
    shared = float(0.0)
    for s in range(facing.start[i], facing.stop[i]):
        j = facing.index[s]
        w, _along, gap = meet_sheets(x[j] - p, n, normal[j], contact.reach)
        shared += area[j] * w * near_share(gap, contact.range)
    held = cut_tails(shared)
    bare = float(1.0)
    over = wp.max(shared, 1.0)
    faced[i] = held
    for k in range(contact.point.shape[0]):
        inward = contact.inward[k]
        level = wp.dot(inward, contact.point[k]) + LAYER * contact.range
        height = wp.dot(inward, p) - level
        if height < contact.reach:
            w, _along, gap = meet_image(wp.vec3(), n, n, height, inward, contact.reach)
            shared = area[i] * w * near_share(gap, contact.range)
            for s in range(own.start[i], own.stop[i]):
                j = own.index[s]
                height = wp.dot(inward, x[j]) - level
                w, _along, gap = meet_image(x[j] - p, n, normal[j], height, inward, contact.reach)
                shared += area[j] * w * near_share(gap, contact.range)
            bare *= 1.0 - cut_tails(shared)
    free[i] = bare / over
    cover[i] = 1.0 - bare * (1.0 - held)


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


@wp.func
def press_wall(
    i: int,
    x: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    vector: wp.array(dtype=wp.vec3),
    push: float,
    inertia: float,
    faced: wp.array(dtype=float),
    own: Neighbors,
    wall: int,
    contact: Contact,
    dt: float,
):
    """Contact of E i with a wall: force, force at rest, the meniscus' force along the wall, N, and stiffness, kg.

    The film holds on to the image of its own region, which would make 120 degrees with the wall as with another
    bubble, and the meniscus around its foot sucks at it, by sigma a length in all, which makes 90: outside the bubble
    the wall is as wet as inside. What another bubble covers does neither. Both pull a sheet that lies on the wall
    towards it, and the wall's spring is such that they are in balance with the gas on its layer of liquid: there the
    sheet has all of its cover, and the meniscus begins. In the matrix the image moves as the E does.
    """
    inward = contact.inward[wall]
    level = wp.dot(inward, contact.point[wall]) + LAYER * contact.range
    n = normal[i]
    half = contact
    strength = push - (1.0 - 1.0 / MENISCUS) * contact.cling / contact.range
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
            half.cling = 0.5 * contact.cling * (1.0 - 0.5 * (faced[i] + faced[j]))
            image = x[j] - x[i] - 2.0 * (wp.dot(inward, x[j]) - level) * inward
            before = 0.5 * wp.dot(image, along)
            elastic, pressure, slope = press(gap, before, strength, inertia, half, dt)
            a = area[i] * area[j] * w
            total -= (a * pressure) * along
            quiet -= (a * elastic) * along
            ci = wp.dot(along, n)
            stiff += dt * dt * a * slope * ci * ci
    depth = MENISCUS * contact.range
    height = wp.clamp(wp.dot(inward, predicted[i]) - level, 0.0, depth)
    suck = ((1.0 - faced[i]) * contact.cling * (1.0 - height / depth) / depth) * vector[i]
    side = tangential(suck, inward)
    return total + suck - side, quiet + suck, side, stiff


@wp.kernel
def press_foam_e(
    x: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    vector: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    density: float,
    region: wp.array(dtype=wp.int32),
    added: wp.array(dtype=float),
    push: wp.array(dtype=float),
    faced: wp.array(dtype=float),
    free: wp.array(dtype=float),
    facing: Neighbors,
    own: Neighbors,
    contact: Contact,
    stride: int,
    dt: wp.array(dtype=float),
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
        vector: [n_e] gradient of the volume, m^2.
        eta: [n_e] thickness, m.
        density: kg/m^3.
        region: [n] region of each E.
        added: [regions] mass of the air that moves along, kg/m^2.
        push: [regions] pressure at gap 0, Pa.
        faced: [n_e] share of each E that other regions cover: there it neither clings to walls nor has a meniscus.
        free: [n_e] share of what holds each E to other regions that counts.
        facing: E of other regions near each E.
        own: E of the same region.
        contact: constants.
        stride: room of a row.
        dt: [1] s.
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
    inertia = density * eta[i] + added[region[i]]
    near = contact
    for s in range(facing.start[i], facing.stop[i]):
        j = facing.index[s]
        m = normal[j]
        w, along, gap = meet_sheets(predicted[j] - at, n, m, contact.reach)
        if w > 0.0 and gap < contact.range:
            strength = 0.5 * (push[region[i]] + push[region[j]])
            both = 0.5 * (inertia + added[region[j]] + density * eta[j])
            near.cling = 0.5 * (free[i] + free[j]) * contact.cling
            elastic, pressure, slope = press(gap, wp.dot(x[j] - p, along), strength, both, near, dt[0])
            a = area[i] * area[j] * w
            total -= (a * pressure) * along
            quiet -= (a * elastic) * along
            ci = wp.dot(along, n)
            cj = -wp.dot(along, m)
            c = dt[0] * dt[0] * a * slope * ci
            stiff += c * (ci + cj)
            if k < room:
                rows.index[k] = j
                pair[k] = -c * cj
            k += 1
    for w in range(contact.point.shape[0]):
        if wp.dot(contact.inward[w], at - contact.point[w]) < contact.reach:
            wall, quiet_wall, side, stiff_wall = press_wall(
                i, x, predicted, normal, area, vector, push[region[i]], inertia, faced, own, w, contact, dt[0]
            )
            total += wall
            quiet += quiet_wall
            drawn += side
            stiff += stiff_wall
    force[i] = force[i] + total
    rest[i] = rest[i] + quiet
    foot[i] = drawn
    diag[i] = stiff
    wanted[i] = wp.max(wanted[i], k - rows.start[i])
    rows.stop[i] = wp.min(k, room)


@wp.kernel
def set_push_r(gas: wp.array2d(dtype=wp.float64), contact: Contact, push: wp.array(dtype=float)):
    """Pressure with which two sheets press on each other at gap 0: the gauge's and what they cling with. [regions]."""
    g = wp.tid()
    push[g] = wp.max(float(gas[g, GAUGE]), 0.0) + 2.0 * contact.cling / contact.range
