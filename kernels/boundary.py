"""Boundary particles: what the film's rim does to the fields."""

import warp as wp

from melp_warp.kernels.mls import Quadric, height_above
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, laplacian_weight, tangential

wp.set_module_options({"enable_backward": False})

vec7d = wp.types.vector(length=7, dtype=wp.float64)

SQUARE = wp.constant(0.5)
"""Cosine between the directions across two walls below which they are two, not one that bends."""


@wp.kernel
def mirror_velocity_b(
    mirror: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Velocity beyond the rim: that of the mirror point, reversed except along the rim (free slip, no motion).

    Args:
        mirror: [n_b] mirror points inside the film, m.
        outward: [n_b] unit vectors across the rim.
        normal: [n] unit normals.
        x_e: [n] m.
        rows: mirror:E neighbours.
        r: interpolation radius, m.
        n_e: number of E; boundary particle b is entry n_e + b of `u`.
        u: [n] m/s.
    """
    b = wp.tid()
    p = mirror[b]
    total = float(0.0)
    v = wp.vec3()
    for k in range(rows.start[b], rows.stop[b]):
        j = rows.index[k]
        if j < n_e:
            w = kernel_w(wp.length(x_e[j] - p), r)
            total += w
            v += w * u[j]
    if total > 0.0:
        v = v / total
    n = normal[n_e + b]
    o = wp.normalize(tangential(outward[b], n))
    u[n_e + b] = v - 2.0 * (wp.dot(v, o) * o + wp.dot(v, n) * n)


@wp.func
def inside_rim(
    i: int,
    p: wp.vec3,
    anchors: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n_e: int,
) -> wp.vec3:
    """What puts point p back onto the rim, by the boundary particles of row i; nothing where p has not crossed it."""
    nearest = float(1.0e30)
    depth = float(0.0)
    across = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        b = rows.index[k] - n_e
        if b >= 0:
            d = p - anchors[b]
            distance = wp.length_sq(d)
            beyond = wp.dot(d, outward[b])
            # Boundary particles beyond a corner share it as their anchor: the one that looks towards p counts.
            if distance < nearest or (distance == nearest and beyond > depth):
                nearest = distance
                across = outward[b]
                depth = beyond
    return -wp.max(depth, 0.0) * across


@wp.kernel
def confine_l(
    anchors: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n_e: int,
    gravity: wp.array(dtype=wp.vec3),
    height: wp.vec3,
    hold: float,
    eta_l: wp.array(dtype=float),
    packed: float,
    rt: float,
    # outputs
    x_l: wp.array(dtype=wp.vec3),
    u_l: wp.array(dtype=wp.vec3),
    v_l: wp.array(dtype=wp.vec3),
    mass_l: wp.array(dtype=float),
    surfactant_l: wp.array(dtype=float),
    collected: wp.array(dtype=wp.vec2),
    impulse: wp.array(dtype=wp.vec3),
    energy: wp.array(dtype=wp.vec2),
):
    """Put L that have crossed the rim back onto it; the rim takes what drives them out.

    Where the weight of an L pulls it across the rim and its surfactant cannot hold it off within a spacing, 2 R T c <
    spacing m g.o, its liquid goes into the border behind the rim. Any other L loses the part of its velocity across the
    rim, but no more than it carries: what it carries is the mean around it, which may stop at the rim already.

    Args:
        anchors: [n_b] nearest points of the rim, m.
        outward: [n_b] unit vectors o across the rim.
        rows: L:E neighbours; boundary particles, if any, are last in a row.
        n_e: number of E; boundary particle b is entry n_e + b of a row.
        gravity: [1] m/s^2.
        height: its part that is stored as height, m/s^2.
        hold: 2 R T/spacing, J/(mol m).
        eta_l: [n_l] m.
        packed: rho/Gamma_0, kg/(mol m); 0 without surfactant.
        rt: R T, J/mol.
        x_l: [n_l] m.
        u_l: [n_l] carried velocity, m/s.
        v_l: [n_l] velocity at the particle, m/s.
        mass_l: [n_l] kg.
        surfactant_l: [n_l] mol, of one interface.
        collected: [n_l] mass and surfactant that went into the border, added to; kg, mol.
        impulse: [n_l] momentum that the rim took, added to; kg m/s.
        energy: [n_l] energy that the rim took, added to: of motion, of height and surfactant, J; null if nobody asks.
    """
    i = rows.first + wp.tid()
    if rows.stop[i] == rows.start[i] or rows.index[rows.stop[i] - 1] < n_e:
        return
    back = inside_rim(i, x_l[i], anchors, outward, rows, n_e)
    depth = wp.length(back)
    if depth == 0.0:
        return
    x_l[i] = x_l[i] + back
    o = -back / depth
    m = mass_l[i]
    c = surfactant_l[i]
    if m > 0.0 and hold * c < m * wp.dot(gravity[0], o):
        collected[i] = collected[i] + wp.vec2(m, c)
        impulse[i] = impulse[i] + m * u_l[i]
        if energy:
            stored = -m * wp.dot(height, x_l[i] - back)
            if c > 0.0:
                stored += 2.0 * rt * c * (wp.log(c * packed * eta_l[i] / m) - 1.0)
            energy[i] = energy[i] + wp.vec2(0.5 * m * wp.length_sq(u_l[i]), stored)
        mass_l[i] = 0.0
        surfactant_l[i] = 0.0
        u_l[i] = wp.vec3()
        v_l[i] = wp.vec3()
        return
    lost = wp.max(wp.min(wp.dot(v_l[i], o), wp.dot(u_l[i], o)), 0.0)
    if energy:
        energy[i] = energy[i] + wp.vec2(m * lost * (wp.dot(u_l[i], o) - 0.5 * lost), m * wp.dot(height, back))
    u_l[i] = u_l[i] - lost * o
    v_l[i] = v_l[i] - lost * o
    impulse[i] = impulse[i] + m * lost * o


@wp.kernel
def take_pull_e(
    traction: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    impulse: wp.array(dtype=wp.vec3),
):
    """Add to what the rim takes that of the tension: liquid that it drives pushes the rim the other way. [n_e], kg m/s.

    Where there is no liquid there is nothing to drive.
    """
    i = wp.tid()
    if mass[i] > 0.0:
        impulse[i] = impulse[i] - dt[0] * area[i] * traction[i]


@wp.kernel
def take_friction_e(
    friction: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    # outputs
    impulse: wp.array(dtype=wp.vec3),
):
    """The same of the viscosity, from `rub_walls_e` over theta dt. [n_e], kg m/s."""
    i = wp.tid()
    impulse[i] = impulse[i] + friction[i] / theta[0]


@wp.kernel
def taken_chunks(
    collected: wp.array(dtype=wp.vec2),
    impulse_l: wp.array(dtype=wp.vec3),
    impulse_e: wp.array(dtype=wp.vec3),
    energy: wp.array(dtype=wp.vec2),
    # outputs
    part: wp.array(dtype=vec7d),
):
    """Parts of what the rim has taken: mass, surfactant, momentum, energy of motion, all other; kg, mol, kg m/s, J."""
    c = wp.tid()
    n = impulse_l.shape[0]
    size = (n + part.shape[0] - 1) // part.shape[0]
    s = vec7d()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        s[0] += wp.float64(collected[i][0])
        s[1] += wp.float64(collected[i][1])
        for k in range(3):
            s[2 + k] += wp.float64(impulse_l[i][k])
        if energy:
            s[5] += wp.float64(energy[i][0])
            s[6] += wp.float64(energy[i][1])
    n = impulse_e.shape[0]
    size = (n + part.shape[0] - 1) // part.shape[0]
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        for k in range(3):
            s[2 + k] += wp.float64(impulse_e[i][k])
    part[c] = s


@wp.kernel
def add_taken(
    part: wp.array(dtype=vec7d),
    # outputs
    border: wp.array(dtype=wp.float64),
):
    """Add the parts to what the border holds and the rim has taken, see `state.BORDER_SLOTS`."""
    for c in range(part.shape[0]):
        for k in range(7):
            border[k] = border[k] + part[c][k]


@wp.kernel
def extend_film_b(
    anchors: wp.array(dtype=wp.vec3),
    curvature: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    mirror: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
):
    """Continue a moving film beyond its pinned rim.

    The mirror point follows the film at a fixed distance s from the rim. At the rim the film does not move, so its
    curvature there is zero: across the rim it is minus that of the rim curve along the normal, k.n. The odd
    continuation with that curvature is 2 a - mirror - (k.n) s^2 n.

    Args:
        anchors: [n_b] nearest points a of the rim, m.
        curvature: [n_b] curvature vectors k of the rim, 1/m.
        x_e: [n] m.
        surface: [n_e] fitted surfaces.
        rows: mirror:E neighbours.
        r: radius within which fits are averaged, m.
        n_e: number of E; boundary particle b is entry n_e + b.
        mirror: [n_b] mirror points, m.
        x: [n] positions, m; the array x_e itself.
        normal: [n] unit normals.
    """
    b = wp.tid()
    p = mirror[b]
    a = anchors[b]
    total = float(0.0)
    shift = wp.vec3()
    n = wp.vec3()
    for k in range(rows.start[b], rows.stop[b]):
        j = rows.index[k]
        if j < n_e:
            d = p - x_e[j]
            w = kernel_w(wp.length(d), r)
            if w > 0.0:
                q = surface[j]
                total += w
                shift += w * height_above(q, d) * q.normal
                n += w * q.normal
    if total > 0.0:
        s = wp.length(p - a)
        n = wp.normalize(n)
        p = a + s * wp.normalize(p - shift / total - a)
        mirror[b] = p
        x[n_e + b] = 2.0 * a - p - wp.dot(curvature[b], n) * s * s * n
        normal[n_e + b] = n


@wp.kernel
def find_walls_e(
    x: wp.array(dtype=wp.vec3),
    anchors: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n_e: int,
    # outputs
    walls: wp.array2d(dtype=wp.vec4),
):
    """The rim near each E as straight walls: the nearest one, and beside a corner the one that it meets there.

    Args:
        x: [n] m.
        anchors: [n_b] nearest points of the rim, m.
        outward: [n_b] unit vectors across the rim.
        rows: E:E neighbours.
        n_e: number of E; boundary particle b is entry n_e + b.
        walls: [n_e, 2] unit vector across the wall and the distance to it, m; distance -1 for none.
    """
    i = rows.first + wp.tid()
    p = x[i]
    for w in range(2):
        nearest = float(1.0e30)
        wall = wp.vec4(0.0, 0.0, 0.0, -1.0)
        for k in range(rows.start[i], rows.stop[i]):
            b = rows.index[k] - n_e
            if b >= 0:
                o = outward[b]
                s = wp.max(wp.dot(anchors[b] - p, o), 0.0)
                other = bool(True)
                if w == 1:
                    first = walls[i, 0]
                    other = wp.abs(o[0] * first[0] + o[1] * first[1] + o[2] * first[2]) < SQUARE
                if s < nearest and other:
                    nearest = s
                    wall = wp.vec4(o[0], o[1], o[2], s)
        walls[i, w] = wall


@wp.func
def reflected(v: wp.vec3, o: wp.vec3) -> wp.vec3:
    """v with its part along the unit vector o reversed."""
    return v - 2.0 * wp.dot(v, o) * o


@wp.func
def across(wall: wp.vec4) -> wp.vec3:
    """Unit vector across a wall."""
    return wp.vec3(wall[0], wall[1], wall[2])


@wp.func
def image_friction(
    i: int,
    j: int,
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    walls: wp.array2d(dtype=wp.vec4),
    r: float,
) -> wp.vec3:
    """sum 2|W'(d)|/d (u_i - R u_j) over the images of E j in the walls that i and j share, and in their corner.

    An image lies at d^2 = |x_j - x_i|^2 + 4 s_i s_j, s the distances to the wall, and moves at R u_j. In a corner the
    image of the image lies at the sum of both, moving at R R' u_j. The coupling is the same from j to i.
    """
    gap = wp.length_sq(x[j] - x[i])
    ui = u[i]
    total = wp.vec3()
    corner = gap
    twice = u[j]
    shared = int(0)
    for a in range(2):
        one = walls[i, a]
        if one[3] >= 0.0:
            for c in range(2):
                two = walls[j, c]
                if two[3] >= 0.0 and wp.dot(across(one), across(two)) > SQUARE:
                    o = wp.normalize(across(one) + across(two))
                    more = 4.0 * one[3] * two[3]
                    total += laplacian_weight(wp.sqrt(gap + more), r) * (ui - reflected(u[j], o))
                    corner += more
                    twice = reflected(twice, o)
                    shared += 1
    if shared == 2:
        total += laplacian_weight(wp.sqrt(corner), r) * (ui - twice)
    return total


@wp.func
def wall_friction(
    i: int,
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    walls: wp.array2d(dtype=wp.vec4),
    rows: Neighbors,
    r: float,
    n_e: int,
) -> wp.vec3:
    """What images add to the sum of `rub_walls_e` of E i, over nu dt. kg m/s over m^2."""
    mi = mass[i] / area[i]
    total = mi * area[i] * image_friction(i, i, x, u, walls, r)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            total += 0.5 * (mi + mass[j] / area[j]) * area[j] * image_friction(i, j, x, u, walls, r)
    return area[i] * total


@wp.kernel
def rub_walls_e(
    u: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    walls: wp.array2d(dtype=wp.vec4),
    rows: Neighbors,
    r: float,
    n_e: int,
    viscosity: float,
    dt: wp.array(dtype=float),
    # outputs
    y: wp.array(dtype=wp.vec3),
):
    """Add to y the viscous coupling of E with the images of E beyond the rim: no flow across it, free slip along it.

    y_i += dt nu sum_j (m_i/a_i + m_j/a_j)/2 a_i a_j 2|W'(d)|/d (u_i - R u_j), the symmetric sum that pairs of E have,
    over the images that are missing from it.

    Args:
        u: [n] m/s, or a direction of search.
        x: [n] m.
        mass: [n_e] kg.
        area: [n_e] m^2.
        walls: [n_e, 2] from `find_walls_e`.
        rows: E:E neighbours.
        r: support radius, m.
        n_e: number of E.
        viscosity: nu, m^2/s.
        dt: [1] s.
        y: [n_e] kg m/s.
    """
    i = rows.first + wp.tid()
    if walls[i, 0][3] >= 0.0:
        y[i] = y[i] + dt[0] * viscosity * wall_friction(i, x, u, mass, area, walls, rows, r, n_e)


@wp.kernel
def start_walls_e(
    u: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    walls: wp.array2d(dtype=wp.vec4),
    rows: Neighbors,
    r: float,
    n_e: int,
    viscosity: float,
    dt: wp.array(dtype=float),
    inverse: wp.array(dtype=float),
    # outputs
    residual: wp.array(dtype=wp.vec3),
    z: wp.array(dtype=wp.vec3),
    p: wp.array(dtype=wp.vec3),
):
    """Take the same from the first residual of conjugate gradients; z = residual/A_ii, p = z. [n_e]."""
    i = rows.first + wp.tid()
    if walls[i, 0][3] >= 0.0:
        left = residual[i] - dt[0] * viscosity * wall_friction(i, x, u, mass, area, walls, rows, r, n_e)
        residual[i] = left
        z[i] = inverse[i] * left
        p[i] = inverse[i] * left
