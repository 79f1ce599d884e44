"""Foams: what motion along normals leaves out of the forces at lines, and what the foam then owes as a whole."""

import warp as wp

from melp_warp.kernels.contact import MENISCUS, Contact
from melp_warp.kernels.motion import whole_velocity
from melp_warp.kernels.native import sum_vectors, weigh_row
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, part_region, region_parts, region_total
from melp_warp.kernels.sph import kernel_w, tangential

wp.set_module_options({"enable_backward": False})

ROUND = wp.constant(1.0e-3)
"""Inertia of a foam about any axis, over its largest: two bubbles have none about the line through them."""


@wp.kernel
def weigh_near_e(
    x: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    reach: float,
    # outputs
    near: wp.array(dtype=float),
):
    """W of each pair within `reach` (m): `near` [pairs], 1/m^2."""
    i = rows.first + wp.tid()
    weigh_row(i, x[i], x, rows, reach, x.shape[0], near)


@wp.kernel
def seek_normals_e(
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=float),
    rest: wp.array(dtype=wp.vec3),
    cover: wp.array(dtype=float),
    star: Neighbors,
    near: wp.array(dtype=float),
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
    damped by mu^8/(mu^8 + bent^8), or noise on smooth films would be blown up. It follows with a delay: the normals
    themselves answer to it.

    Args:
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        region: [n] region of each E.
        ahead: [regions] predicted gauge pressure, Pa.
        rest: [n_e] tension and contact of sheets at rest, N.
        cover: [n_e]; far from what is covered nothing is passed on.
        star: neighbours across the cell's edges.
        near: [pairs] W of each pair, 1/m^2.
        rows: E:E neighbours.
        reach: of W, m.
        bent: [regions] mean square turn of the normals from which they take up force.
        share: [1] how far l comes towards what it should be in this step, 0 to 1.
        sought: [n_e] l over the sum of weights, N m^2; in and out.
    """
    i = rows.first + wp.tid()
    n = normal[i]
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
        w = near[k]
        total += w
        spread += w * wp.outer(normal[j], normal[j])
    least = bent[region[i]]
    axes, turn = wp.eig3(spread / total)
    found = wp.vec3()
    for k in range(3):
        axis = wp.vec3(axes[0, k], axes[1, k], axes[2, k])
        s = wp.max(turn[k], 0.0) / least
        cube = s * s * s
        eighth = cube * cube * s * s
        found += (cube * cube * s / (1.0 + eighth) / least * wp.dot(axis, along)) * axis
    sought[i] = sought[i] + share[0] * (found / total - sought[i])


@wp.kernel
def gather_load_e(
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    ahead: wp.array(dtype=float),
    force: wp.array(dtype=wp.vec3),
    foot: wp.array(dtype=wp.vec3),
    sought: wp.array(dtype=wp.vec3),
    near: wp.array(dtype=float),
    rows: Neighbors,
    reach: float,
    most: float,
    # outputs
    load: wp.array(dtype=float),
):
    """Force of the film and the gas along each E's normal, with what its neighbours pass on.

    Args:
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        region: [n] region of each E.
        ahead: [regions] predicted gauge pressure, Pa.
        force: [n_e] tension and contact, N.
        foot: [n_e] menisci's force along their walls, N: none in all, so that of a region is no part of `force`.
        sought: [n_e] from `seek_normals_e`.
        near: [pairs] W of each pair, 1/m^2.
        rows: E:E neighbours.
        reach: of W, m.
        most: most that an E takes from its neighbours, N.
        load: [n_e] N.
    """
    i = rows.first + wp.tid()
    found = kernel_w(0.0, reach) * sought[i] + sum_vectors(i, near, sought, rows, sought.shape[0])
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
def walls_of(g: int, regions: int, touch: wp.array(dtype=wp.int32)) -> int:
    """Walls that region g touches, a bit each."""
    start, stop = region_parts(g, touch.shape[0], regions)
    bits = int(0)
    for c in range(start, stop):
        bits = bits | touch[c]
    return bits


@wp.func
def along_walls(v: wp.vec3, walls: int, contact: Contact) -> wp.vec3:
    """The part of v along these walls: across them they take up what there is."""
    for k in range(contact.point.shape[0]):
        if (walls >> k) & 1 == 1:
            v = tangential(v, contact.inward[k])
    return v


@wp.func
def about_walls(spin: wp.vec3, walls: int, contact: Contact) -> wp.vec3:
    """The part of an angular momentum about the normals of these walls: they take up the rest."""
    for k in range(contact.point.shape[0]):
        if (walls >> k) & 1 == 1:
            spin = wp.dot(spin, contact.inward[k]) * contact.inward[k]
    return spin


@wp.kernel
def find_drift_r(
    motion: wp.array(dtype=wp.vec3),
    whole: wp.array(dtype=float),
    fall: wp.array(dtype=wp.vec3),
    cluster: wp.array(dtype=wp.int32),
    touch: wp.array(dtype=wp.int32),
    # outputs
    drift: wp.array(dtype=wp.vec3),
    pull: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=float),
):
    """Velocity and acceleration of the cluster of each region as a whole, 0 where it touches a wall.

    Args:
        motion: [regions] m/s.
        fall: [regions] acceleration by outside forces, m/s^2.
        whole: [regions] inertia of each region as a whole, kg.
        cluster: [regions] number of each region's cluster.
        touch: from `touch_chunks`.
        drift: [regions] m/s.
        pull: [regions] m/s^2.
        held: [regions] 1 where the cluster touches a wall, 0 elsewhere.
    """
    g = wp.tid()
    regions = drift.shape[0]
    momentum = wp.vec3()
    force = wp.vec3()
    inertia = float(0.0)
    walls = int(0)
    for h in range(regions):
        if cluster[h] == cluster[g]:
            momentum += whole[h] * motion[h]
            force += whole[h] * fall[h]
            inertia += whole[h]
            walls = walls | walls_of(h, regions, touch)
    fixed = wp.where(walls == 0, 0.0, 1.0)
    drift[g] = ((1.0 - fixed) / inertia) * momentum
    pull[g] = ((1.0 - fixed) / inertia) * force
    held[g] = fixed


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
    force = along_walls(region_total(net, g, regions), walls_of(g, regions, touch), contact)
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
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    faced: wp.array(dtype=float),
    outer: wp.array(dtype=float),
    inertia: wp.array(dtype=float),
    carried: wp.array(dtype=wp.vec3),
    braked: wp.array(dtype=wp.vec2),
    moments: wp.array(dtype=wp.vec4),
    change: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    gained: wp.array(dtype=wp.vec4),
    turned: wp.array(dtype=wp.vec3),
    middle: wp.array(dtype=wp.vec4),
):
    """Parts of the momentum that each region lost to the foam's own forces, and of where it is.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        area: [n_e] m^2.
        faced: [n_e] share of each E that other regions cover.
        outer: [n_e] loads from outside the foam, kg m/s.
        inertia: [n_e] kg.
        carried: [n_e] p = m n, kg.
        braked: [n_e] what damping within the foam takes, from `load_foam_e`: its angular momentum goes to the air, or a
            foam that turns would for ever.
        moments: [regions] (., K sum p u): what the inertia of the region as a whole adds is p.K sum p u, see
            `carry_motion_r`.
        change: [n_e] change of the normal speed, m/s.
        first: [regions + 1] first E of each region.
        gained: parts of the momentum, kg m/s, and of the area that others cover, m^2.
        turned: parts of the angular momentum about the origin, kg m^2/s.
        middle: parts of the integral of x over the area, m^3, and of the area.
    """
    c = wp.tid()
    start, stop = part_range(c, first, gained.shape[0])
    total = wp.vec3()
    moment = wp.vec3()
    place = wp.vec3()
    touched = float(0.0)
    size = float(0.0)
    own = moments[part_region(c, first, gained.shape[0])]
    moved = wp.vec3(own[1], own[2], own[3])
    for i in range(start, stop):
        lost = (outer[i] - inertia[i] * change[i] - wp.dot(carried[i], moved)) * normal[i]
        total += lost
        moment += wp.cross(x[i], lost - (braked[i][0] + braked[i][1] * change[i]) * normal[i])
        place += area[i] * x[i]
        touched += faced[i] * area[i]
        size += area[i]
    gained[c] = wp.vec4(total[0], total[1], total[2], touched)
    turned[c] = moment
    middle[c] = wp.vec4(place[0], place[1], place[2], size)


@wp.kernel
def owe_r(
    gained: wp.array(dtype=wp.vec4),
    turned: wp.array(dtype=wp.vec3),
    middle: wp.array(dtype=wp.vec4),
    paid: wp.array(dtype=float),
    # outputs
    owed: wp.array(dtype=wp.vec4),
    spin: wp.array(dtype=wp.vec3),
    place: wp.array(dtype=wp.vec3),
):
    """Momentum and angular momentum owed to each region. [regions].

    Inner forces have none in all, and walls none along them; but what stops sheets that close in on each other, and the
    matrix, know normals alone, so that contact kicks and turns a foam as a whole.

    Args:
        gained: from `gained_chunks`.
        turned: the same.
        middle: the same.
        paid: [1] how much of what was owed was paid in the last step, where others covered the region; elsewhere all.
        owed: momentum before a step's payment, kg m/s, and the area that others cover, m^2; in and out.
        spin: angular momentum about the region's centroid, kg m^2/s; in and out.
        place: centroid of the region's surface, m.
    """
    g = wp.tid()
    regions = owed.shape[0]
    old = owed[g]
    left = wp.where(old[3] > 0.0, 1.0 - paid[0], 0.0)
    own = region_total(gained, g, regions)
    size = region_total(middle, g, regions)
    centre = wp.vec3(size[0], size[1], size[2]) / size[3]
    owed[g] = wp.vec4(left * old[0] + own[0], left * old[1] + own[1], left * old[2] + own[2], own[3])
    lost = wp.vec3(own[0], own[1], own[2])
    spin[g] = left * spin[g] + region_total(turned, g, regions) - wp.cross(centre, lost)
    place[g] = centre


@wp.kernel
def pay_debt_r(
    owed: wp.array(dtype=wp.vec4),
    spin: wp.array(dtype=wp.vec3),
    place: wp.array(dtype=wp.vec3),
    cluster: wp.array(dtype=wp.int32),
    whole: wp.array(dtype=float),
    touch: wp.array(dtype=wp.int32),
    contact: Contact,
    share: wp.array(dtype=float),
    # outputs
    recoil: wp.array(dtype=wp.vec3),
):
    """What each region gets of what its cluster is owed; one that touches no other, all its own.

    Each gets a p + b x d by its covered area a, d its distance from the cluster's middle: so much that the cluster as
    a whole gets its momentum (p) and angular momentum (b).

    Args:
        owed: [regions] from `owe_r`.
        spin: [regions] the same.
        place: [regions] the same.
        cluster: [regions] number of each region's cluster.
        whole: [regions] inertia of each region as a whole, kg.
        touch: from `touch_chunks`.
        contact: constants.
        share: [1] how much of the debt is paid in a step.
        recoil: [regions] velocity given back, m/s.
    """
    g = wp.tid()
    regions = recoil.shape[0]
    own = owed[g]
    walls = walls_of(g, regions, touch)
    net = wp.vec3(own[0], own[1], own[2])
    if own[3] > 0.0:
        momentum = wp.vec3()
        around = wp.vec3()
        shift = wp.vec3()
        second = wp.mat33()
        inertia = float(0.0)
        for h in range(regions):
            other = owed[h]
            if cluster[h] == cluster[g] and other[3] > 0.0:
                d = place[h] - place[g]
                lost = wp.vec3(other[0], other[1], other[2])
                momentum += lost
                around += spin[h] + wp.cross(d, lost)
                m = whole[h]
                shift += m * d
                second += m * wp.outer(d, d)
                inertia += m
                walls = walls | walls_of(h, regions, touch)
        middle = shift / inertia
        second -= wp.outer(shift, middle)
        around = about_walls(around - wp.cross(middle, momentum), walls, contact)
        turn = wp.vec3()
        size = wp.trace(second)
        if size > 0.0:
            turn = wp.inverse((1.0 + ROUND) * wp.identity(3, float) - second / size) * around / size
        net = share[0] * whole[g] * (momentum / inertia - wp.cross(turn, middle))
    recoil[g] = along_walls(net, walls, contact) / whole[g]
