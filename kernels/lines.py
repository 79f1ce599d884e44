"""Foams: what motion along normals leaves out of the forces at lines, and what the foam then owes as a whole."""

import warp as wp

from melp_warp.kernels.contact import MENISCUS, Contact
from melp_warp.kernels.motion import whole_velocity
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, region_parts, region_total
from melp_warp.kernels.sph import kernel_w, tangential

wp.set_module_options({"enable_backward": False})


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
    share: wp.array(dtype=float),
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
        share: [1] how far l comes towards what it should be in this step, 0 to 1.
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
        sought[i] = (1.0 - share[0]) * sought[i]
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
    sought[i] = sought[i] + share[0] * (found / total - sought[i])


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
    missing[g] = whole_velocity(region_total(mass, g, regions), force)


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
    share: wp.array(dtype=float),
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
        share: [1] how much of the debt is paid in a step.
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
    paid = share[0] * owed
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
    recoil[g] = whole_velocity(region_total(mass, g, regions), net)
