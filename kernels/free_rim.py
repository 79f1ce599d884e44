"""Free rims: the edge of a hole as points with mass that the film's tension pulls along and that sweep the film up.

Point k is followed by `after[k]` and preceded by `before[k]`, -1 at the ends of a chain that ends at a frame. Seen from
outside, where the film's normal n points at the viewer, the film lies to the right of the direction t in which a chain
runs: the conormal t x n points into it.

Particles bring their liquid in lumps. So a point moves with an `inertia` that grows with the area it sweeps, and what
it holds, `mass`, is counted particle by particle, in float64; the one follows the other.
"""

import warp as wp

from melp_warp.kernels.drag import PI, sphere_drag

wp.set_module_options({"enable_backward": False})


@wp.struct
class Chain:
    """The points of all rims.

    Attributes:
        x: [n_f] places, m.
        after: [n_f] index of the next point, -1 for none.
        before: [n_f] index of the one before, -1 for none.
        conormal: [n_f] unit vectors in the film, away from the hole.
        region: [n_f] index of the region whose film the rim runs over.
        other: [n_f] where that film is a partition, the region on its other side; -1 for a film that is free.
    """

    x: wp.array(dtype=wp.vec3)
    after: wp.array(dtype=wp.int32)
    before: wp.array(dtype=wp.int32)
    conormal: wp.array(dtype=wp.vec3)
    region: wp.array(dtype=wp.int32)
    other: wp.array(dtype=wp.int32)


@wp.func
def chord(rim: Chain, k: int) -> wp.vec3:
    """Half of the way from the point before k to the one after it; at an end of a chain from or to k itself."""
    a = rim.before[k]
    b = rim.after[k]
    if a < 0:
        a = k
    if b < 0:
        b = k
    return 0.5 * (rim.x[b] - rim.x[a])


@wp.func
def nearest_on_rim(rim: Chain, x: wp.vec3, region: int) -> wp.vec4:
    """Segment nearest to x of the rims that run over a region's film.

    As (index of its first point, place along it from 0 to 1, signed distance, distance).

    The signed one is along the conormal: above 0 on the film, below 0 behind the rim.
    """
    best = float(1.0e30)
    segment = int(-1)
    place = float(0.0)
    for k in range(rim.x.shape[0]):
        b = rim.after[k]
        if b >= 0 and (rim.region[k] == region or rim.other[k] == region):
            start = rim.x[k]
            d = rim.x[b] - start
            t = wp.clamp(wp.dot(x - start, d) / wp.max(wp.dot(d, d), 1.0e-30), 0.0, 1.0)
            gap = wp.length_sq(x - start - t * d)
            if gap < best:
                best = gap
                segment = k
                place = t
    ahead = float(1.0e30)
    if segment >= 0:
        b = rim.after[segment]
        q = (1.0 - place) * rim.x[segment] + place * rim.x[b]
        ahead = wp.dot(x - q, (1.0 - place) * rim.conormal[segment] + place * rim.conormal[b])
    return wp.vec4(float(segment), place, ahead, wp.sqrt(best))


@wp.kernel
def find_conormals_f(
    rim: Chain,
    normal: wp.array(dtype=wp.vec3),
    # outputs
    conormal: wp.array(dtype=wp.vec3),
):
    """Conormals t x n of the points. [n_f]; `normal` [n_f] is the film's."""
    k = wp.tid()
    conormal[k] = wp.normalize(wp.cross(chord(rim, k), normal[k]))


@wp.kernel
def find_edge_e(
    x: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    rim: Chain,
    reach: float,
    way: float,
    # outputs
    behind: wp.array(dtype=wp.int32),
    edge: wp.array(dtype=wp.vec4),
):
    """Where E are seen from the rims, and which of those near one are behind it.

    Args:
        x: [n] m.
        region: [n] index of each E's region.
        rim: the rims.
        reach: distance within which E matter, m.
        way: how far rim and E may have come closer since the last time, m.
        behind: [n_e] 1 for E that a rim has passed.
        edge: [n_e] see `nearest_on_rim`; of E out of reach the last entry alone holds, a bound of the distance.
    """
    i = wp.tid()
    gap = edge[i][3] - way
    if gap > reach:
        edge[i] = wp.vec4(-1.0, 0.0, 0.0, gap)
        return
    found = nearest_on_rim(rim, x[i], region[i])
    edge[i] = found
    if found[3] <= reach:
        behind[i] = wp.where(found[2] < 0.0, 1, 0)
    else:
        edge[i] = wp.vec4(-1.0, 0.0, 0.0, found[3])


@wp.kernel
def see_film_f(
    edge: wp.array(dtype=wp.vec4),
    behind: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    gamma: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    rim: Chain,
    reach: float,
    # outputs
    seen: wp.array2d(dtype=float),
):
    """Add up the film ahead by rim point: normal, velocity, gamma, eta, height, weight. One thread an E.

    Args:
        edge: [n_e] see `find_edge_e`.
        behind: [n_e] 1 behind a rim.
        x: [n] m.
        normal: [n] unit normals.
        u: [n] m/s.
        region: [n] index of each E's region.
        gamma: [n_e] relative surfactant concentration.
        eta: [n_e] thickness, m.
        rim: the rims.
        reach: distance at which the weight has fallen to 0, m.
        seen: [n_f, 10] sums; the height is that of the film over the point, m.
    """
    i = wp.tid()
    k = int(edge[i][0])
    if k < 0 or behind[i] == 1 or edge[i][3] >= reach:
        return
    t = edge[i][1]
    weight = 1.0 - edge[i][3] / reach
    n = normal[i]
    if region[i] != rim.region[k]:
        n = -n
    for side in range(2):
        point = k
        w = weight * (1.0 - t)
        if side == 1:
            point = rim.after[k]
            w = weight * t
        for c in range(3):
            wp.atomic_add(seen, point, c, w * n[c])
            wp.atomic_add(seen, point, 3 + c, w * u[i][c])
        wp.atomic_add(seen, point, 6, w * gamma[i])
        wp.atomic_add(seen, point, 7, w * eta[i])
        wp.atomic_add(seen, point, 8, w)
        wp.atomic_add(seen, point, 9, w * wp.dot(x[i] - rim.x[point], n))


@wp.kernel
def take_film_f(
    seen: wp.array2d(dtype=float),
    other: wp.array(dtype=wp.int32),
    # outputs
    normal: wp.array(dtype=wp.vec3),
    flow: wp.array(dtype=wp.vec3),
    film: wp.array(dtype=wp.vec2),
    x: wp.array(dtype=wp.vec3),
):
    """The film at each rim point from the sums, and the point on it; one that sees none keeps what it had.

    Args:
        seen: [n_f, 10] see `see_film_f`.
        other: [n_f] see `Chain`: a partition is as thick as its two sheets.
        normal: [n_f] unit normals.
        flow: [n_f] velocity of the film, m/s.
        film: [n_f] relative surfactant concentration and thickness (m).
        x: [n_f] m.
    """
    k = wp.tid()
    w = seen[k, 8]
    if w <= 0.0:
        return
    normal[k] = wp.normalize(wp.vec3(seen[k, 0], seen[k, 1], seen[k, 2]))
    flow[k] = wp.vec3(seen[k, 3], seen[k, 4], seen[k, 5]) / w
    film[k] = wp.vec2(seen[k, 6], seen[k, 7]) / w
    if other[k] >= 0:
        film[k] = wp.vec2(film[k][0], 2.0 * film[k][1])
    x[k] = x[k] + seen[k, 9] / w * normal[k]


@wp.kernel
def go_halfway_f(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    dt: float,
    # outputs
    middle: wp.array(dtype=wp.vec3),
):
    """Where the points are halfway through a step of dt (s) at the speed of the last one. [n_f], m."""
    k = wp.tid()
    middle[k] = x[k] + 0.5 * dt * u[k]


@wp.func
def speed_of(pull: float, mass: float, swept: float, dt: float) -> float:
    """Speed v after a step in which momentum `pull` moves mass + swept dt v: the sweeping is taken at its end.

    Args:
        pull: momentum along the conormal seen from the film ahead, kg m/s.
        mass: kg.
        swept: mass swept a metre, kg/m.
        dt: s.
    """
    a = swept * dt
    if pull <= 0.0 or a * pull < 1.0e-6 * mass * mass:
        return pull / wp.max(mass, 1.0e-30)
    return (wp.sqrt(mass * mass + 4.0 * a * pull) - mass) / (2.0 * a)


@wp.kernel
def pull_rim_f(
    rim: Chain,
    normal: wp.array(dtype=wp.vec3),
    flow: wp.array(dtype=wp.vec3),
    film: wp.array(dtype=wp.vec2),
    mass: wp.array(dtype=wp.float64),
    tension: wp.array(dtype=float),
    slope: float,
    density: float,
    gravity: wp.vec3,
    follow: float,
    dt: float,
    # outputs
    inertia: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    growth: wp.array(dtype=float),
):
    """Let tension and weight act on the rim for a step: d(m V)/dt = 2 sigma (t x n) ds + m g.

    Across the film it goes with it: what is pulled off would have to move the air. With the chord from the point before
    to the one after, a regular ring of any number of points runs at the speed of Taylor and Culick exactly, and the
    pulls of a closed flat chain add up to nothing. Meanwhile the waves grow that break it into drops: on a thread of
    radius a at the rate 0.3433 sqrt(sigma/(rho a^3)) (Rayleigh, the fastest of them).

    Args:
        rim: the rims, halfway through the step.
        normal: [n_f] the film's.
        flow: [n_f] velocity of the film ahead, m/s.
        film: [n_f] relative surfactant concentration and thickness (m) of the film ahead.
        mass: [n_f] what the points hold, kg.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        density: kg/m^3.
        gravity: m/s^2.
        follow: share of its departure from the mass that the inertia loses in a step.
        dt: s.
        inertia: [n_f] kg.
        u: [n_f] m/s.
        growth: [n_f] time since the point last broke, in growth times of the radius that it has had.
    """
    k = wp.tid()
    n = normal[k]
    along = wp.cross(chord(rim, k), n)
    width = wp.length(along)
    whole = tension[rim.region[k]]
    if rim.other[k] >= 0:
        whole = 0.5 * (whole + tension[rim.other[k]])
    sigma = wp.max(whole - slope * film[k][0], 0.0)
    m = inertia[k]
    push = m * (u[k] - flow[k]) + dt * (2.0 * sigma * along + m * gravity)
    push -= wp.dot(push, n) * n
    swept = density * film[k][1] * width
    speed = speed_of(wp.dot(push, wp.normalize(along)), m, swept, dt)
    grown = m + swept * dt * wp.max(speed, 0.0)
    u[k] = flow[k] + push / wp.max(grown, 1.0e-30)
    inertia[k] = grown + follow * (float(mass[k]) - grown)
    a = wp.sqrt(grown / (PI * density * wp.max(width, 1.0e-9)))
    if a > 0.0:
        growth[k] = growth[k] + dt * 0.3433 * wp.sqrt(sigma / (density * a * a * a))


@wp.func
def neighbours_of(rim: Chain, k: int) -> wp.vec4i:
    """The two points before k and the two after it, in order along the chain; -1 for those that are not there."""
    a = rim.before[k]
    b = rim.after[k]
    first = int(-1)
    last = int(-1)
    if a >= 0:
        first = rim.before[a]
    if b >= 0:
        last = rim.after[b]
    return wp.vec4i(first, a, b, last)


@wp.kernel
def smooth_rim_f(
    rim: Chain,
    u: wp.array(dtype=wp.vec3),
    share: float,
    dt: float,
    # outputs
    x: wp.array(dtype=wp.vec3),
    smoothed: wp.array(dtype=wp.vec3),
):
    """Move the points, and take from rims what these do not resolve: `share` of the fourth differences.

    A circle of radius r with points h apart feels h^4/r^4.

    Args:
        rim: the rims.
        u: [n_f] m/s.
        share: of the fourth differences of places and velocities, at most 1/16.
        dt: s.
        x: [n_f] places after the step, m.
        smoothed: [n_f] velocities, m/s.
    """
    k = wp.tid()
    near = neighbours_of(rim, k)
    place = rim.x[k]
    velocity = u[k]
    if near[0] >= 0 and near[3] >= 0:
        a, b, c, d = near[0], near[1], near[2], near[3]
        place -= share * (rim.x[a] + rim.x[d] - 4.0 * (rim.x[b] + rim.x[c]) + 6.0 * place)
        velocity -= share * (u[a] + u[d] - 4.0 * (u[b] + u[c]) + 6.0 * velocity)
    x[k] = place + dt * velocity
    smoothed[k] = velocity


@wp.func
def passed_by(rim: Chain, x: wp.vec3, region: int, edge: wp.vec4, reach: float) -> wp.vec4:
    """Where on the rims a particle is that one has passed, see `nearest_on_rim`; below 0 first where none has.

    Args:
        rim: the rims.
        x: m.
        region: index of its region.
        edge: that of its home, see `find_edge_e`.
        reach: distance of its home within which a particle may meet a rim, m.
    """
    found = wp.vec4(-1.0, 0.0, 0.0, 0.0)
    if edge[3] <= reach:
        near = nearest_on_rim(rim, x, region)
        if near[2] < 0.0 and near[3] <= reach:
            found = near
    return found


@wp.func
def give_to_rim(rim: Chain, found: wp.vec4, held: float, points: wp.array(dtype=wp.float64)):
    """Share what a particle holds among the two points of the rim that it is between."""
    k = int(found[0])
    share = wp.float64(found[1])
    wp.atomic_add(points, k, (wp.float64(1.0) - share) * wp.float64(held))
    wp.atomic_add(points, rim.after[k], share * wp.float64(held))


@wp.kernel
def sweep(
    x: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    home: wp.array(dtype=wp.int32),
    region: wp.array(dtype=wp.int32),
    edge: wp.array(dtype=wp.vec4),
    rim: Chain,
    reach: float,
    # outputs
    behind: wp.array(dtype=wp.int32),
    taken: wp.array(dtype=wp.float64),
    amount: wp.array(dtype=wp.float64),
):
    """Give the liquid and surfactant of particles that a rim has passed to it. One thread a particle.

    Args:
        x: [n] m.
        mass: [n] kg.
        surfactant: [n] mol on one interface.
        home: [n] E near each.
        region: [n] index of each one's region.
        edge: [n_e] see `find_edge_e`.
        rim: the rims.
        reach: distance of its home within which a particle may meet a rim, m.
        behind: [n] 1 once its liquid is a rim's.
        taken: [n_f] mass of the rim points, kg.
        amount: [n_f] their surfactant, mol on one interface.
    """
    i = wp.tid()
    if behind[i] == 1:
        return
    found = passed_by(rim, x[i], region[i], edge[home[i]], reach)
    if found[0] < 0.0:
        return
    behind[i] = 1
    give_to_rim(rim, found, mass[i], taken)
    give_to_rim(rim, found, surfactant[i], amount)


@wp.kernel
def hold_behind_e(
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    edge: wp.array(dtype=wp.vec4),
    behind: wp.array(dtype=wp.int32),
    rim: Chain,
    flow: wp.array(dtype=wp.vec3),
    air: float,
    heavy: float,
    # outputs
    u: wp.array(dtype=wp.vec3),
    inertia: wp.array(dtype=float),
):
    """What resists across the film: its mass and the air's; E behind a rim go on as the film at the rim does.

    Args:
        normal: [n] unit normals.
        mass: [n_e] kg.
        area: [n_e] m^2.
        edge: [n_e] see `find_edge_e`.
        behind: [n_e] 1 behind a rim.
        rim: the rims.
        flow: [n_f] velocity of the film ahead of a rim, m/s.
        air: mass of the air that the film moves, kg/m^2.
        heavy: inertia of an E behind a rim over that of one ahead.
        u: [n] m/s.
        inertia: [n_e] kg.
    """
    i = wp.tid()
    inertia[i] = mass[i] + air * area[i]
    if behind[i] == 1:
        inertia[i] = heavy * inertia[i]
        n = normal[i]
        k = int(edge[i][0])
        speed = float(0.0)
        if k >= 0:
            t = edge[i][1]
            speed = wp.dot((1.0 - t) * flow[k] + t * flow[rim.after[k]], n)
        u[i] = u[i] + (speed - wp.dot(u[i], n)) * n


@wp.kernel
def still_behind_l(
    behind: wp.array(dtype=wp.int32),
    home: wp.array(dtype=wp.int32),
    normal: wp.array(dtype=wp.vec3),
    u_e: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    affine: wp.array(dtype=wp.mat33),
):
    """Let L that a rim has passed lie on their E: whatever flows behind a rim, no film is there.

    Args:
        behind: [n_l] 1 behind a rim.
        home: [n_l] E near each.
        normal: [n] unit normals of E.
        u_e: [n] velocity of E, m/s.
        u: [n_l] carried velocity, m/s.
        v: [n_l] velocity, m/s.
        affine: [n_l] velocity gradient, 1/s.
    """
    i = wp.tid()
    if behind[i] == 1:
        n = normal[home[i]]
        w = wp.dot(u_e[home[i]], n) * n
        u[i] = w
        v[i] = w
        affine[i] = wp.mat33()


@wp.kernel
def move_behind_l(
    behind: wp.array(dtype=wp.int32),
    before: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    x: wp.array(dtype=wp.vec3),
):
    """Move L that a rim has passed with their E, without looking for a surface. [n_l], m; `before` at the start."""
    i = wp.tid()
    if behind[i] == 1:
        x[i] = before[i] + dt[0] * v[i]


@wp.kernel
def fly_d(
    mass: wp.array(dtype=float),
    density: float,
    air: float,
    gravity: wp.vec3,
    dt: float,
    # outputs
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
):
    """Let drops fly: their weight and the drag of spheres in still air, taken at the end of the step.

    Args:
        mass: [n_d] kg.
        density: of the liquid, kg/m^3.
        air: density of the air, kg/m^3; 0 for none.
        gravity: m/s^2.
        dt: s.
        x: [n_d] m.
        u: [n_d] m/s.
    """
    i = wp.tid()
    rate = float(0.0)
    if air > 0.0:
        radius = wp.pow(3.0 * mass[i] / (4.0 * PI * density), 1.0 / 3.0)
        rate = sphere_drag(wp.length(u[i]), radius, air) / mass[i]
    new = (u[i] + dt * gravity) / (1.0 + dt * rate)
    x[i] = x[i] + 0.5 * dt * (u[i] + new)
    u[i] = new
