"""The energy budget: what is stored when E hold all that L carry, and what the stages of a step do to it, by formula.

Each kernel sums over E in parts, region by region, into its own slots of one table [parts, SLOTS] in float64. See
docs/energy.md for the identities.
"""

import warp as wp

from melp_warp.kernels.advance import bent_path
from melp_warp.kernels.air_range import AFTER, BEFORE, SLOPE
from melp_warp.kernels.gas import AMOUNT, GAUGE, INCREMENT, OFFSET, VOLUME
from melp_warp.kernels.mls import Quadric
from melp_warp.kernels.native import sum_differences, sum_squares
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, part_region, region_parts
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})

# What is stored at the start of a step.
KINETIC = wp.constant(0)
SURFACE = wp.constant(1)
SURFACTANT = wp.constant(2)
GAS = wp.constant(3)
AIR = wp.constant(4)
# What the step has done, from here on.
STARTED = wp.constant(5)
FIRST_FLOW = STARTED
HOLD = wp.constant(6)
MEMBRANE = wp.constant(7)
BENDING = wp.constant(8)
PRESSING = wp.constant(9)
FLOW = wp.constant(10)
SPREADING = wp.constant(11)
MENDING = wp.constant(12)
SPLITTING = wp.constant(13)
DRAG = wp.constant(14)
VISCOSITY = wp.constant(15)
DAMPING = wp.constant(16)
LIFT = wp.constant(17)
PUSH = wp.constant(18)
SHIFTS = wp.constant(19)
ENDED = wp.constant(20)
IMPULSE = wp.constant(21)  # three of them
WHOLE = wp.constant(24)
RANGE = wp.constant(25)
CONTACT = wp.constant(26)
STRETCH = wp.constant(27)
LINES = wp.constant(28)
DEBT = wp.constant(29)
# What the E say of the L at the start of a step: their area, and what they claim of it.
WIDE = wp.constant(30)
CLAIMED = wp.constant(31)
SOLUTE = wp.constant(32)
FALLING = wp.constant(33)
WIDENED = wp.constant(34)
CLOSING = wp.constant(35)
STARS = wp.constant(36)
MIXED = wp.constant(37)
ARRIVING = wp.constant(38)
SHAPING = wp.constant(39)
SLOTS = wp.constant(40)


@wp.func
def kinetic(mass: float, u: wp.vec3) -> wp.float64:
    """m u^2/2, J."""
    return wp.float64(0.5) * wp.float64(mass) * wp.float64(wp.length_sq(u))


@wp.func
def begins_region(c: int, parts: int, regions: int) -> bool:
    """Whether part c is the first of a region: it counts what a region has once."""
    start, _ = region_parts(c // (parts // regions), parts, regions)
    return c == start


@wp.func
def carried(mass: float, air: float, n: wp.vec3, a: wp.vec3, b: wp.vec3, kept: int) -> float:
    """What an E adds to a.C b: the inertia C of a bubble as a whole beyond the normal motion of its E. kg m^2/s^2.

    All liquid and air are to move with the bubble. Normal motion has the part m + air of an E along its normal; the air
    is counted by volume, see `carried_air`, so here it is taken off. Liquid along the film is carried where E do not
    know how it flows.
    """
    across = wp.dot(a, n) * wp.dot(b, n)
    found = -air * across
    if kept == 1:
        found += mass * (wp.dot(a, b) - across)
    return found


@wp.func
def carried_air(gas: wp.array2d(dtype=wp.float64), g: int, density: float, a: wp.vec3, b: wp.vec3) -> wp.float64:
    """a.C b of all air that goes along with a bubble, 3/2 rho V, kg m^2/s^2; 0 for a single film, of density 0 here."""
    return wp.float64(1.5 * density) * gas[g, VOLUME] * wp.float64(wp.dot(a, b))


@wp.func
def free_surfactant(
    i: int,
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    packed: float,
    rt: float,
) -> wp.float64:
    """Free energy of the surfactant of a particle on both interfaces, at its own thickness, J; 0 without."""
    free = wp.float64(0.0)
    c = surfactant[i]
    if eta and c > 0.0:
        free = wp.float64(2.0 * rt * c) * (wp.log(wp.float64(c * packed * eta[i] / mass[i])) - wp.float64(1.0))
    return free


@wp.kernel
def open_step_chunks(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    area: wp.array(dtype=float),
    share: wp.array(dtype=float),
    ended: wp.array(dtype=float),
    kappa: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    claim: wp.array(dtype=float),
    cover: wp.array(dtype=float),
    motion: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    tension: wp.array(dtype=float),
    slope: float,
    rt: float,
    added: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    p_atm: wp.float64,
    density: float,
    kept: int,
    closed: int,
    first: wp.array(dtype=wp.int32),
    asked: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array2d(dtype=wp.float64),
    before: wp.array(dtype=wp.vec3),
):
    """What is stored at the start of a step.

    Control areas are those before the offset d that ended the last one: it changed them by -kappa a d.

    Args:
        mass: [n_e] kg.
        surfactant: [n_e] mol on one interface.
        area: [n_e] m^2.
        share: [n_e] area of the stars before the offset, m^2; null for a film without.
        ended: [n_e] that after it, by which the surface is stored: tension is its gradient. Null likewise.
        kappa: [n_e] sum of the principal curvatures, 1/m.
        gamma: [n_e] Gamma/Gamma_0.
        claim: [n_e] area that L take up at their thickness, m^2; null without L, where surfactant is that of E.
        cover: [n_e] share of a sheet that is one film with another region's; null for a film without regions beyond it.
        motion: [regions] velocity as a whole, m/s.
        u: [n] m/s.
        normal: [n] unit normals.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        rt: R T, J/mol.
        added: [regions] mass of the air that moves along with the normal speed, kg/m^2.
        gas: gas slots.
        p_atm: Pa.
        density: of the air that bubbles of a foam carry, kg/m^3; 0 without, and for a single film.
        kept: 1 in a foam whose E know their normal motion alone.
        closed: 1 where there is gas.
        first: see `part_range`.
        asked: [1] 1 where the energy of the surface is asked for.
        part: parts of the slots KINETIC to STARTED and of the last three.
        before: [n_e] the velocity, kept for `book_forces_chunks`.
    """
    c = wp.tid()
    parts = part.shape[0]
    g = part_region(c, first, parts)
    start, stop = part_range(c, first, parts)
    liquid = wp.float64(0.0)
    surface = wp.float64(0.0)
    air = wp.float64(0.0)
    bent = wp.float64(0.0)
    closed_in = wp.float64(0.0)
    size = wp.float64(0.0)
    solved = wp.float64(0.0)
    solute = wp.float64(0.0)
    claimed = wp.float64(0.0)
    wide = wp.float64(0.0)
    taken = added[g]
    for i in range(start, stop):
        v = u[i]
        before[i] = v
        liquid += kinetic(mass[i], v)
        if taken > 0.0:
            air += kinetic(taken * area[i], wp.dot(v, normal[i]) * normal[i])
        size += wp.float64(area[i])
        if asked[0] == 1:
            a = wp.float64(area[i])
            sides = float(2.0)
            if cover:
                sides = 2.0 - cover[i]
            free = wp.float64(tension[g]) * a
            if ended:
                free = wp.float64(tension[g]) * wp.float64(ended[i])
            sigma = tension[g]
            if slope > 0.0:
                sigma = sigma - slope * gamma[i]
                entropy = wp.float64(rt * surfactant[i]) * (wp.log(wp.float64(gamma[i])) - wp.float64(1.0))
                if claim:
                    solute += wp.float64(surfactant[i])
                    claimed += wp.float64(claim[i])
                    wide += a
                    solved -= wp.float64(2.0 - sides) * entropy
                else:
                    solved += wp.float64(sides) * entropy
            surface += wp.float64(sides) * free
            bent += wp.float64(sides * sigma * kappa[i]) * a
    whole = motion[g]
    if density > 0.0 or kept == 1:
        for i in range(start, stop):
            liquid += wp.float64(0.5 * carried(mass[i], 0.0, normal[i], whole, whole, kept))
            air += wp.float64(0.5 * carried(0.0, taken * area[i], normal[i], whole, whole, kept))
    if begins_region(c, parts, first.shape[0] - 1):
        air += wp.float64(0.5) * carried_air(gas, g, density, whole, whole)
    part[c, STARTED] = liquid + air
    part[c, KINETIC] = liquid
    part[c, AIR] = air
    part[c, SURFACE] = surface
    part[c, SURFACTANT] = solved
    part[c, SOLUTE] = solute
    part[c, CLAIMED] = claimed
    part[c, WIDE] = wide
    part[c, GAS] = wp.float64(0.0)
    if closed == 1:
        d = gas[g, OFFSET]
        if ended:
            for i in range(start, stop):
                less = wp.float64(share[i]) - wp.float64(ended[i])
                closed_in += wp.float64((2.0 - cover[i]) * tension[g]) * less
            part[c, CLOSING] = closed_in + d * gas[g, GAUGE] * size
        else:
            part[c, SURFACE] = surface - d * bent
        if begins_region(c, parts, first.shape[0] - 1) and gas[g, AMOUNT] > wp.float64(0.0):
            part[c, GAS] = p_atm * gas[g, VOLUME] - gas[g, AMOUNT] * wp.log(gas[g, VOLUME])


@wp.func
def find_gauss(surface: Quadric) -> float:
    """Gauss' curvature of a fitted surface, 1/m^2."""
    b = 2.0 * surface.second
    kappa = wp.trace(b)
    return 0.5 * (kappa * kappa - wp.ddot(b, b))


@wp.func
def find_bend(surface: Quadric) -> float:
    """Sum of the principal curvatures of a fitted surface where it is fitted, 1/m."""
    slope = surface.normal - surface.gradient
    b = 2.0 * surface.second
    whole = 1.0 + wp.length_sq(slope)
    return (whole * wp.trace(b) - wp.dot(slope, b * slope)) / (whole * wp.sqrt(whole))


@wp.kernel
def find_push_e(
    surface: wp.array(dtype=Quadric),
    area: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    tension: float,
    rt: float,
    gas: wp.array2d(dtype=wp.float64),
    quartic: float,
    # outputs
    push: wp.array(dtype=float),
):
    """Force of tension and gas across the film as it is, 2 sigma kappa + p. [n_e], Pa.

    The fits are those before the offset d that ended the last step, by which kappa has changed by d (kappa^2 - 2 K).
    A fit over the plane takes a part of the quartic height k^3 rho^4/8 of an arc for its curvature k: of the sum of
    curvatures that is `quartic` times the mean of k^3 over all directions, which is taken out.

    Args:
        surface: [n_e] fitted surfaces.
        area: [n_e] m^2.
        surfactant: [n_e] mol on one interface, which changes the tension; null where L have it.
        tension: sigma_0, N/m.
        rt: R T, J/mol.
        gas: gas slots.
        quartic: m^2.
        push: Pa.
    """
    i = wp.tid()
    sigma = tension
    if surfactant:
        sigma -= rt * surfactant[i] / area[i]
    kappa = find_bend(surface[i])
    gauss = find_gauss(surface[i])
    mean = 0.5 * kappa
    cubes = mean * (2.5 * mean * mean - 1.5 * gauss)
    kappa += float(gas[0, OFFSET]) * (kappa * kappa - 2.0 * gauss) - quartic * cubes
    push[i] = 2.0 * sigma * kappa + float(gas[0, GAUGE])


@wp.kernel
def sharpen_e(
    blurred: wp.array(dtype=float),
    found: wp.array(dtype=float),
    area: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    blur: float,
    # outputs
    sharp: wp.array(dtype=float),
):
    """Blurred - blur lap_s found: a step towards (1 + blur lap_s)^-1 of what is blurred. [n_e].

    Args:
        blurred: [n_e] of any unit.
        found: [n] what the step before has found, 0 beyond the E; at first what is blurred itself.
        area: [n_e] m^2.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        blur: m^2.
        sharp: [n_e].
    """
    i = rows.first + wp.tid()
    sharp[i] = blurred[i] + blur * sum_differences(i, found, weight, rows) / area[i]


@wp.kernel
def pack_membrane_e(
    normal: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
    change: wp.array(dtype=float),
    response: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    frame: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    whole_share: float,
    theta: wp.array(dtype=float),
    # outputs
    speed: wp.array(dtype=float),
    grown: wp.array(dtype=float),
    ahead: wp.array(dtype=float),
):
    """What `lose_membrane_e` asks of neighbours.

    Args:
        normal: [n] unit normals.
        u_mid: [n_e] normal speed that moves E, m/s.
        change: [n_e] change of the speed by the load, m/s.
        response: [n_e] by a unit pressure, m/s/Pa.
        gas: gas slots.
        frame: [1] velocity of the film as a whole at the start of the step, m/s.
        motion: [1] at its end, m/s.
        whole_share: of the way from the one to the other at which the film moves.
        theta: [1].
        speed: [n_e] speed against the film as a whole, m/s.
        grown: [n_e] change y of the speed in the step, m/s.
        ahead: [n_e] z: how far the speed that moves E is ahead of the mean of those before and after, m/s.
    """
    i = wp.tid()
    push = float(gas[0, INCREMENT]) * response[i]
    speed[i] = u_mid[i] - wp.dot(frame[0] + whole_share * (motion[0] - frame[0]), normal[i])
    grown[i] = change[i] + push
    ahead[i] = (theta[0] - 0.5) * change[i] + 0.5 * push


@wp.kernel
def lose_membrane_e(
    u: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    cell: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    heavy: wp.array(dtype=float),
    surface: wp.array(dtype=Quadric),
    push: wp.array(dtype=float),
    external: wp.array(dtype=float),
    u_mid: wp.array(dtype=float),
    moved: wp.array(dtype=float),
    grown: wp.array(dtype=float),
    ahead: wp.array(dtype=float),
    speed: wp.array(dtype=float),
    load: wp.array(dtype=float),
    unit: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    frame: wp.array(dtype=wp.vec3),
    found: wp.array(dtype=wp.vec3),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    stiffness: float,
    bent: float,
    left_out: wp.array(dtype=float),
    blur: float,
    added: float,
    air: int,
    theta: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    rt: float,
    dt: wp.array(dtype=float),
    # outputs
    loss: wp.array(dtype=float),
    swelling: wp.array(dtype=float),
):
    """What the scheme of the membrane takes besides `book_forces_chunks`. [n_e], J.

    * Tension and gas do the work of the mean of their forces where the step starts and where it ends, times its way:
      half of it is here, the other half in `book_arrival_chunks`. What the solve has done by its forces is taken off:
      its impulse (1 + blur lap_s)^-1 (b + c (lap_s + s) y), on a film alone m y, less that of outside forces.
    * Air: (m + A) y is that impulse; what is not A y.z of it is booked with the liquid. Translations take along the
      air's mode n = 1.

    Args:
        u: [n] velocity at the end of the step, m/s.
        before: [n_e] at its start, m/s.
        normal: [n] unit normals.
        area: [n_e] m^2.
        cell: [n_e] Voronoi areas, which tell what a motion sweeps where E are uneven, m^2.
        mass: [n_e] kg.
        heavy: [n_e] what resists a change of velocity, kg.
        surface: [n_e] fitted surfaces.
        push: [n_e] from `find_push_e`, sharpened, Pa.
        external: [n_e] outside forces, Pa.
        u_mid: [n_e] normal speed that moves E, m/s.
        moved: [n] from `pack_membrane_e`, as the next two, 0 beyond the E: speed against the film as a whole, m/s.
        grown: [n] y, m/s.
        ahead: [n] z, m/s.
        speed: [n_e] the first of them sharpened, m/s; what it holds does not matter without air.
        load: [n_e] kg m/s.
        unit: [n_e] of a unit pressure.
        gas: gas slots.
        frame: [1] velocity of the film as a whole at the start of the step, m/s.
        found: [1] the one in place of which it is held, m/s.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        n_e: number of E; beyond them the film does not move.
        stiffness: 2 sigma of the matrix, N/m.
        bent: 2/R^2 of the matrix, 1/m^2.
        left_out: [1] what of c bent is not in it, kg/m^2.
        blur: m^2.
        added: mass of the air that translations take along, kg/m^2.
        air: 1 where the air takes part.
        theta: [1].
        surfactant: [n_e] mol on one interface.
        rt: R T, J/mol.
        dt: [1] s.
        loss: [n_e] J.
        swelling: [n_e] what the film has more of its area, relative, by the normal motion d, to the second order:
            -kappa d + (grad_s d)^2/2 + K d^2; the surfactant of L pays for the work of its tension by it. Null without.
    """
    i = rows.first + wp.tid()
    h = dt[0]
    a = area[i]
    own = moved[i]
    y = grown[i]
    z = ahead[i]
    total = 0.5 * h * cell[i] * push[i] * own + h * a * external[i] * own
    if swelling:
        way = h * own
        bend = sum_squares(i, moved, weight, rows, n_e)
        widen = find_gauss(surface[i]) * way - 2.0 * wp.trace(surface[i].second)
        swelling[i] = widen * way + 0.5 * h * h * bend / a
        total += 2.0 * rt * surfactant[i] * swelling[i]
    if air == 0:
        total -= heavy[i] * y * own
    else:
        c = stiffness * theta[0] * theta[0] * h * h
        stiff = (c * bent - left_out[0]) * a * y - c * sum_differences(i, grown, weight, rows)
        impulse = load[i] + float(gas[0, INCREMENT]) * unit[i] + stiff
        sharp = z + blur * sum_differences(i, ahead, weight, rows) / a
        total += impulse * (sharp - speed[i]) - mass[i] * y * z
        n = normal[i]
        start = wp.dot(before[i] + frame[0] - found[0], n)
        end = wp.dot(u[i], n)
        way = u_mid[i] - 0.5 * (start + end)
        whole = end - start - y
        total += added * a * (whole * way + y * (way - z))
    loss[i] = total


@wp.kernel
def book_arrival_chunks(
    cell: wp.array(dtype=float),
    push: wp.array(dtype=float),
    surface: wp.array(dtype=Quadric),
    tension: float,
    normal: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    left: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.vec3),
    gas: wp.array2d(dtype=wp.float64),
    dt: wp.array(dtype=float),
    n: int,
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """The other half of what tension and gas do on the way of E, by their forces where it ends. Slot ARRIVING.

    The way is that before the offset d, for which the mean of the forces before and after it counts.

    Args:
        cell: [n_e] Voronoi areas, m^2.
        push: [n_e] from `find_push_e`, after the offset, sharpened, Pa.
        surface: [n_e] fitted surfaces.
        tension: sigma_0, N/m.
        normal: [n] unit normals.
        x: [n] E at the end of the step, m.
        left: [n] at the start of their way, m.
        frame: [1] velocity of the film as a whole in the step, m/s.
        gas: gas slots.
        dt: [1] s.
        n: number of E.
        part: parts.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    d = float(gas[0, OFFSET])
    total = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        bend = find_bend(surface[i])
        less = 2.0 * tension * d * (bend * bend - 2.0 * find_gauss(surface[i]))
        way = wp.dot(normal[i], x[i] - left[i] - dt[0] * frame[0]) - d
        total += wp.float64(0.5 * cell[i] * ((push[i] - less) * (way + d) + push[i] * d))
    part[c, ARRIVING] = total


@wp.kernel
def book_forces_chunks(
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
    found: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=wp.vec3),
    added: wp.array(dtype=float),
    taken: wp.array(dtype=float),
    bending: wp.array(dtype=float),
    rigid: wp.array(dtype=wp.vec3),
    surfactant: wp.array(dtype=float),
    rt: float,
    turning: wp.array(dtype=float),
    traction: wp.array(dtype=wp.vec3),
    passed: wp.array(dtype=wp.vec3),
    recoil: wp.array(dtype=wp.vec3),
    widening: wp.array(dtype=float),
    swelling: wp.array(dtype=float),
    growth: wp.array(dtype=float),
    claim: wp.array(dtype=float),
    diffused: wp.array(dtype=wp.vec3),
    body: wp.array(dtype=wp.vec3),
    gravity: wp.vec3,
    drag: float,
    wind: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    p_atm: wp.float64,
    pressed: int,
    flowing: int,
    midway: int,
    falls: int,
    dt: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What forces have dissipated and done from outside in a step, and what their schemes have lost.

    The velocity goes from u_h, the one before with the motion as a whole held, to u', and the film moves by v. Forces
    do the work m (u' - u_h).v, kinetic energy grows by m (u' - u_h).(u_h + u')/2: what is between them is the scheme's.

    Args:
        mass: [n_e] kg.
        area: [n_e] m^2.
        normal: [n] unit normals.
        before: [n_e] velocity at the start of the step, m/s.
        u: [n] at its end, m/s.
        u_mid: [n_e] normal speed that moves E, m/s; null for a film that does not move.
        found: [regions] motion as a whole of `before`, m/s; null where none is held.
        held: [regions] the one that took its place, m/s.
        added: [regions] mass of the air that moves along with the normal speed, kg/m^2.
        taken: [regions] that translations take along, kg/m^2.
        bending: [n_e] from `lose_membrane_e`, J; null where there is none.
        rigid: [1] is the pressure p.n that carries the lift, Pa; null where there is none.
        surfactant: [n_e] mol on one interface.
        rt: R T, J/mol.
        turning: [n_e] centrifugal force of the flow along the film, Pa: its work the flow does not feel; null without.
        traction: [n_e] force of uneven tension along the film, Pa; null without surfactant.
        passed: [regions] velocity as a whole at the time of the paths, m/s. Nothing widens by it, so surfactant pays
            for nothing that its traction does by it.
        recoil: from `motion.recoil`, which should make up for that work; null where a film does not recoil.
        widening: [n_e] growth of the film with the paths of L, see `surfactant.widen_path_e`.
        swelling: [n_e] what normal motion makes, which the membrane has.
        growth: [n_e] relative growth of the thickness of L.
        claim: [n_e] area that L take up at their thickness, m^2.
        diffused: [n_e] velocity along the film after viscosity, m/s; null without.
        body: [n_e] acceleration by outside forces, m/s^2.
        gravity: its part that is stored as height, m/s^2.
        drag: Pa s/m.
        wind: [regions] velocity of the air along the film, m/s; null for air at rest.
        theta: [1] share of the step that the flow along the film is solved for.
        gas: gas slots.
        p_atm: Pa.
        pressed: 1 where the gas takes a part that no other formula has.
        flowing: 1 where liquid flows along the film.
        midway: 1 where L move with the velocity half a step on, whatever theta.
        falls: 1 where `fall_chunks` follows.
        dt: [1] s.
        first: see `part_range`.
        part: parts of the slots HOLD to SHIFTS, ENDED, IMPULSE and FALLING.
    """
    c = wp.tid()
    parts = part.shape[0]
    g = part_region(c, first, parts)
    start, stop = part_range(c, first, parts)
    h = wp.float64(dt[0])
    share = wp.float64(theta[0])
    hold = wp.float64(0.0)
    membrane = wp.float64(0.0)
    bend = wp.float64(0.0)
    flow = wp.float64(0.0)
    spread = wp.float64(0.0)
    mended = wp.float64(0.0)
    widened = wp.float64(0.0)
    split = wp.float64(0.0)
    slowed = wp.float64(0.0)
    viscous = wp.float64(0.0)
    lifted = wp.float64(0.0)
    pushed = wp.float64(0.0)
    fallen = wp.float64(0.0)
    ended = wp.float64(0.0)
    impulse = wp.vec3d()
    total = wp.vec3()
    for i in range(start, stop):
        n = normal[i]
        m = wp.float64(mass[i])
        across = m + wp.float64(added[g] * area[i])
        un = wp.float64(wp.dot(before[i], n))
        end = wp.float64(wp.dot(u[i], n))
        outside = mass[i] * body[i]
        moved = wp.float64(0.0)
        if u_mid:
            moved = wp.float64(u_mid[i])
            if found:
                kick = wp.float64(wp.dot(held[g] - found[g], n))
                hold -= (m + wp.float64(taken[g] * area[i])) * kick * (un + wp.float64(0.5) * kick)
                un += kick
            membrane += across * (end - un) * (moved - wp.float64(0.5) * (un + end))
            if bending:
                bend += wp.float64(bending[i])
            if rigid:
                lift = area[i] * wp.dot(rigid[1], n)
                lifted += wp.float64(lift) * moved * h
                outside += lift * n
        ended += wp.float64(0.5) * across * end * end
        other = mass[i] * (body[i] - gravity)
        pushed += wp.float64(wp.dot(other, n)) * moved * h
        if flowing == 1:
            along = tangential(before[i], n)
            last = tangential(u[i], n)
            change = last - along
            ahead = along + theta[0] * change
            path = ahead
            if midway == 1:
                path = along + 0.5 * change
            ended += kinetic(mass[i], last)
            flow += m * wp.float64(wp.dot(change, path - along - 0.5 * change))
            if turning:
                flow -= wp.float64(area[i] * turning[i]) * moved * h
            against = drag * area[i] * ahead
            if wind:
                against -= drag * area[i] * tangential(wind[g], n)
            slowed += wp.float64(wp.dot(against, path)) * h
            pushed += wp.float64(wp.dot(other, path)) * h
            if falls == 1:
                fallen += m * wp.float64(wp.dot(gravity, path)) * h
            outside -= against
            if traction:
                free = wp.float64(2.0 * rt * surfactant[i])
                spread += free * wp.float64(widening[i] - swelling[i])
                spread -= wp.float64(area[i] * wp.dot(traction[i], path - passed[g])) * h
                if recoil:
                    flow -= wp.float64(area[i] * wp.dot(traction[i], passed[g])) * h
                    flow += m * wp.float64(wp.dot(tangential(recoil[1], n), path))
                    flow -= (m + wp.float64(taken[g] * area[i])) * wp.float64(wp.dot(recoil[0], n)) * moved
                mended -= free * wp.float64(growth[i] + widening[i])
                widened += wp.float64(claim[i] * widening[i])
            if diffused:
                still = tangential(diffused[i], n)
                viscous += m * wp.float64(wp.dot(along - still, still)) / share
                split += m * wp.float64(wp.dot(along - still, ahead - still)) / share
        total += outside
    for k in range(3):
        impulse[k] = wp.float64(total[k]) * h
    part[c, HOLD] = hold
    part[c, MEMBRANE] = membrane
    part[c, BENDING] = bend
    part[c, FLOW] = flow
    part[c, SPREADING] = spread
    part[c, MENDING] = mended
    part[c, WIDENED] = widened
    part[c, SPLITTING] = split
    part[c, DRAG] = slowed
    part[c, VISCOSITY] = viscous
    part[c, LIFT] = lifted
    part[c, PUSH] = pushed
    part[c, FALLING] = -fallen
    for k in range(3):
        part[c, IMPULSE + k] = impulse[k]
    part[c, SHIFTS] = wp.float64(0.0)
    part[c, ENDED] = ended
    part[c, PRESSING] = wp.float64(0.0)
    if pressed == 1 and begins_region(c, parts, first.shape[0] - 1):
        swept = gas[g, AMOUNT] / (p_atm + gas[g, GAUGE]) - gas[g, VOLUME]
        part[c, PRESSING] = -wp.float64(0.5) * gas[g, INCREMENT] * swept


@wp.kernel
def fall_chunks(
    mass: wp.array(dtype=float),
    v: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    affine: wp.array(dtype=wp.mat33),
    gravity: wp.vec3,
    start: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    share: float,
    passed: wp.array(dtype=wp.vec3),
    bend: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    n: int,
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What L give up of their height on their way along the film, beyond the work of their weight on E. Slot FALLING.

    Args:
        mass: [n] kg.
        v: [n] velocity at each L, m/s.
        normal: [n] unit normals.
        affine: [n] velocity gradient, 1/s.
        gravity: m/s^2.
        start: [1] velocity of the film as a whole at the start of the step, m/s.
        motion: [1] at its end, m/s.
        share: of the way from the one to the other at which the film moves.
        passed: [1] that at the time of v, m/s.
        bend: [1] of their paths.
        dt: [1] s.
        n: number of L.
        part: parts.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    h = dt[0]
    whole = start[0] + share * (motion[0] - start[0])
    total = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        path = bent_path(v[i] - passed[0], normal[i], affine[i], bend[0], h) + whole
        total += wp.float64(mass[i] * h * wp.dot(gravity, tangential(path, normal[i])))
    part[c, FALLING] = part[c, FALLING] + total


@wp.kernel
def weigh_held_chunks(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    height: wp.vec3,
    packed: float,
    rt: float,
    n: int,
    after: int,
    # outputs
    mixed: wp.array(dtype=wp.float64),
):
    """Parts of what L have less of height and of their surfactant's free energy once they exchanged what they hold, J.

    Args:
        mass: [n] kg.
        surfactant: [n] mol on one interface.
        x: [n] m.
        eta: [n] thickness, m; null where none has surfactant.
        height: gravity that is stored as height, m/s^2.
        packed: rho/Gamma_0, kg/(mol m).
        rt: R T, J/mol.
        n: number of L.
        after: 1 afterwards, 0 before.
        mixed: parts, J; in and out.
    """
    c = wp.tid()
    size = (n + mixed.shape[0] - 1) // mixed.shape[0]
    total = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        total += free_surfactant(i, mass, surfactant, eta, packed, rt)
        total -= wp.float64(mass[i]) * wp.float64(wp.dot(height, x[i]))
    if after == 1:
        total = -total
    mixed[c] = mixed[c] + total


@wp.kernel
def book_mixed_chunks(
    # outputs
    mixed: wp.array(dtype=wp.float64),
    part: wp.array2d(dtype=wp.float64),
):
    """Book what exchanges before this step took, and forget it. Slot MIXED."""
    c = wp.tid()
    part[c, MIXED] = mixed[c]
    mixed[c] = wp.float64(0.0)


@wp.kernel
def book_whole_r(
    force: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    share: float,
    dt: wp.array(dtype=float),
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What the drag on each film as a whole takes of its energy, and gives it of momentum. Slots WHOLE and IMPULSE.

    Args:
        force: [regions] mean drag in the step, N.
        start: [regions] velocity as a whole at the start of the step, m/s.
        motion: [regions] at its end, m/s.
        share: of the way from the one to the other at which the film moves.
        dt: [1] s.
        part: parts.
    """
    g = wp.tid()
    c, _ = region_parts(g, part.shape[0], force.shape[0])
    moved = start[g] + share * (motion[g] - start[g])
    part[c, WHOLE] = -wp.float64(wp.dot(force[g], moved)) * wp.float64(dt[0])
    for k in range(3):
        part[c, IMPULSE + k] = part[c, IMPULSE + k] + wp.float64(force[g][k]) * wp.float64(dt[0])


@wp.kernel
def load_air_e(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    kept: int,
    found: wp.array(dtype=wp.float64),
    limit: wp.float64,
    # outputs
    speed: wp.array(dtype=float),
):
    """Normal speed against the film as a whole. [n_e], m/s.

    Args:
        u: [n] m/s.
        normal: [n] unit normals.
        motion: [1] m/s.
        kept: 1 at the start of a step that begins with `keep_normal_e`.
        found: from `kernels.air_range`; null where nothing is left out beyond the range of the air.
        limit: slope that the range ends with.
        speed: [n_e] m/s.
    """
    i = wp.tid()
    n = normal[i]
    own = wp.dot(u[i], n)
    if kept == 1:
        own = wp.sign(own) * wp.length(u[i])
    speed[i] = own - wp.dot(motion[0], n)
    if found and found[SLOPE] > limit:
        speed[i] = 0.0


@wp.kernel
def air_chunks(
    speed: wp.array(dtype=float),
    moved: wp.array(dtype=float),
    area: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    added: float,
    n: int,
    # outputs
    part: wp.array(dtype=wp.float64),
):
    """Parts of the air's kinetic energy, sum a (v A v + added (U.n)^2)/2, J.

    Args:
        speed: [n_e] v against the film as a whole, m/s.
        moved: [n_e] A v, kg/(m s).
        area: [n_e] m^2.
        normal: [n] unit normals.
        motion: [1] U, m/s.
        added: mass of the air that a translation takes along, kg/m^2.
        n: number of E.
        part: J.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    total = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        across = wp.dot(motion[0], normal[i])
        total += wp.float64(0.5 * area[i] * (speed[i] * moved[i] + added * across * across))
    part[c] = total


@wp.kernel
def book_air_chunks(
    speed: wp.array(dtype=float),
    moved: wp.array(dtype=float),
    area: wp.array(dtype=float),
    found: wp.array(dtype=wp.float64),
    n: int,
    after: int,
    slot: int,
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What the air has less of its energy once E have moved, with the velocity that they had.

    Args:
        speed: [n_e] v against the film as a whole, 0 where it is booked otherwise, m/s.
        moved: [n_e] A v, kg/(m s).
        area: [n_e] m^2.
        found: from `kernels.air_range` where `slow_air_e` takes part of it; null elsewhere.
        n: number of E.
        after: 1 once E have moved, 0 before.
        slot: RANGE or SHAPING.
        part: parts.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    total = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        total += wp.float64(0.5 * area[i] * speed[i] * moved[i])
    if after == 1:
        if found and found[AFTER] > found[BEFORE]:
            total *= found[BEFORE] / found[AFTER]
        part[c, slot] = part[c, slot] - total
    else:
        part[c, slot] = total


@wp.kernel
def lose_tension_e(
    x: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    gamma: wp.array(dtype=float),
    cover: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    tension: wp.array(dtype=float),
    slope: float,
    star: Neighbors,
    tie: wp.array(dtype=float),
    u_mid: wp.array(dtype=float),
    change: wp.array(dtype=float),
    lag: float,
    dt: wp.array(dtype=float),
    # outputs
    pull: wp.array(dtype=wp.vec3),
    loss: wp.array(dtype=float),
):
    """Tension that moves the sheets of a foam, at the predicted place and `lag` later, and what the matrix answers.

    Args:
        x: [n] at the start of the step, m.
        predicted: [n] m.
        gamma: [n_e] relative surfactant concentration.
        cover: [n_e] c.
        region: [n] region of each E.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        star: neighbours across the cell's edges.
        tie: [CORNERS n_e] their w_ij.
        u_mid: [n_e] normal speed that moves E, m/s.
        change: [n_e] of the normal speed in the solve, m/s.
        lag: s.
        dt: [1] s.
        pull: [n_e] tension, N.
        loss: [n_e] minus the work of the matrix' answer, J.
    """
    i = star.first + wp.tid()
    h = dt[0]
    own = tension[region[i]]
    force = wp.vec3()
    answer = float(0.0)
    for s in range(star.start[i], star.stop[i]):
        j = star.index[s]
        c = (own - 0.5 * slope * (gamma[i] + gamma[j])) * (2.0 - 0.5 * (cover[i] + cover[j])) * tie[s]
        then = predicted[j] - predicted[i]
        force += c * (then + lag / h * (then - (x[j] - x[i])))
        answer += h * (h + lag) * c * (change[j] - change[i])
    pull[i] = force
    loss[i] = -answer * u_mid[i]


@wp.kernel
def lose_contact_e(
    area: wp.array(dtype=float),
    share: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    cover: wp.array(dtype=float),
    before: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    added: wp.array(dtype=float),
    damping: float,
    tension: wp.array(dtype=float),
    slope: float,
    force: wp.array(dtype=wp.vec3),
    pull: wp.array(dtype=wp.vec3),
    foot: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
    change: wp.array(dtype=float),
    star: Neighbors,
    diag: wp.array(dtype=float),
    rows: Neighbors,
    pair: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    hold: wp.array(dtype=wp.vec3),
    loss: wp.array(dtype=float),
):
    """Contact that moves the sheets of a foam; what they save as one film, less the work of the matrix' answer.

    Args:
        area: [n_e] m^2.
        share: [n_e] that by which tension is stored, m^2.
        mass: [n_e] kg.
        gamma: [n_e] relative surfactant concentration.
        cover: [n_e] share of a sheet that is one film with another, in this step.
        before: [n_e] that in the last one.
        region: [n] region of each E.
        added: [regions] kg/m^2.
        damping: 1/s.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        force: [n_e] tension and contact, N.
        pull: [n_e] tension, N.
        foot: [n_e] menisci along their walls, N.
        u_mid: [n_e] normal speed that moves E, m/s.
        change: [n_e] of the normal speed in the solve, m/s.
        star: neighbours across the cell's edges, which come first in the matrix' rows.
        diag: [n_e] of the matrix, inertia and damping in it, kg.
        rows: of the matrix.
        pair: its coefficients, kg.
        dt: [1] s.
        hold: [n_e] contact and menisci, N.
        loss: [n_e] J.
    """
    i = rows.first + wp.tid()
    g = region[i]
    inertia = (mass[i] + added[g] * area[i]) * (1.0 + dt[0] * damping)
    answer = -(diag[i] - inertia) * change[i]
    for k in range(rows.start[i] + star.stop[i] - star.start[i], rows.stop[i]):
        answer -= pair[k] * (change[i] - change[rows.index[k]])
    saved = (tension[g] - slope * gamma[i]) * share[i] * (cover[i] - before[i])
    hold[i] = force[i] - pull[i] + foot[i]
    loss[i] = saved - answer * u_mid[i]


@wp.func
def star_size(i: int, x: wp.array(dtype=wp.vec3), star: Neighbors):
    """A third of the area of the star of E i, m^2, and the gradient of the volume, m^2, with E at x."""
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
    return size / 6.0, total / 6.0


@wp.kernel
def measure_stars_e(
    x: wp.array(dtype=wp.vec3),
    star: Neighbors,
    # outputs
    size: wp.array(dtype=float),
):
    """A third of the area of each E's star. [n_e], m^2."""
    i = star.first + wp.tid()
    third, _vector = star_size(i, x, star)
    size[i] = third


@wp.kernel
def lose_move_e(
    x: wp.array(dtype=wp.vec3),
    shifted: wp.array(dtype=wp.vec3),
    moved: wp.array(dtype=wp.vec3),
    gamma: wp.array(dtype=float),
    cover: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    tension: wp.array(dtype=float),
    slope: float,
    star: Neighbors,
    # outputs
    evened: wp.array(dtype=float),
    loss: wp.array(dtype=float),
    swept: wp.array(dtype=float),
    left: wp.array(dtype=float),
):
    """What stars have less of their energy as E are evened out and as they move, and the volume that they sweep. [n_e].

    Args:
        x: [n] at the start of the step, m.
        shifted: [n] once they are evened out, m.
        moved: [n] at its end, m.
        gamma: [n_e] relative surfactant concentration.
        cover: [n_e] share of a sheet that is one film with another.
        region: [n] region of each E.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        star: neighbours across the cell's edges.
        evened: [n_e] J.
        loss: [n_e] J.
        swept: [n_e] m^3.
        left: [n_e] third of the area of the star at the end, m^2.
    """
    i = star.first + wp.tid()
    c = (tension[region[i]] - slope * gamma[i]) * (2.0 - cover[i])
    size, _vector = star_size(i, x, star)
    then, out = star_size(i, shifted, star)
    last, beyond = star_size(i, moved, star)
    evened[i] = c * (size - then)
    loss[i] = c * (then - last)
    left[i] = last
    swept[i] = 0.5 * wp.dot(out + beyond, moved[i] - shifted[i])


@wp.kernel
def book_stars_chunks(
    left: wp.array(dtype=float),
    share: wp.array(dtype=float),
    cover: wp.array(dtype=float),
    tension: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What the energy of a foam has less once its surface is found anew, with E where they are. Added to slot STARS.

    Its area is that of other stars, and its volume another one than what the old stars swept.

    Args:
        left: [n_e] third of the area of the star that the step went with, m^2.
        share: [n_e] that of the one found since, m^2.
        cover: [n_e] share of a sheet that is one film with another.
        tension: [regions] sigma_0, N/m: surfactant stays as it is.
        gas: gas slots, with the volume found anew.
        first: see `part_range`.
        part: parts.
    """
    c = wp.tid()
    parts = part.shape[0]
    g = part_region(c, first, parts)
    start, stop = part_range(c, first, parts)
    total = wp.float64(0.0)
    if begins_region(c, parts, first.shape[0] - 1):
        total = gas[g, GAUGE] * gas[g, VOLUME]
    for i in range(start, stop):
        total += wp.float64(tension[g] * (2.0 - cover[i])) * (wp.float64(left[i]) - wp.float64(share[i]))
    part[c, STARS] = part[c, STARS] + total


@wp.kernel
def book_moves_chunks(
    shifted: wp.array(dtype=wp.vec3),
    moved: wp.array(dtype=wp.vec3),
    gas: wp.array2d(dtype=wp.float64),
    pull: wp.array(dtype=wp.vec3),
    hold: wp.array(dtype=wp.vec3),
    evened: wp.array(dtype=float),
    loss: wp.array(dtype=float),
    swept: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What the forces of a foam would do on the way of its E, added to STRETCH, CONTACT, LINES and SHIFTS.

    What of that does not arrive along normals is passed on along lines. STARS begins with minus the work of the gas
    on the volume that stars sweep, from the one before.

    Args:
        shifted: [n] E once they are evened out, m.
        moved: [n] at the end of the step, m.
        gas: gas slots.
        pull: [n_e] tension, N.
        hold: [n_e] contact and menisci, N.
        evened: [n_e] from `lose_move_e`, J.
        loss: [n_e] the same.
        swept: [n_e] the same, m^3.
        first: see `part_range`.
        part: parts.
    """
    c = wp.tid()
    parts = part.shape[0]
    g = part_region(c, first, parts)
    start, stop = part_range(c, first, parts)
    stretched = wp.float64(0.0)
    held = wp.float64(0.0)
    whole = wp.float64(0.0)
    strained = wp.float64(0.0)
    filled = wp.float64(0.0)
    if begins_region(c, parts, first.shape[0] - 1):
        filled = gas[g, GAUGE] * gas[g, VOLUME]
    for i in range(start, stop):
        way = moved[i] - shifted[i]
        pulled = wp.float64(wp.dot(pull[i], way))
        pressed = wp.float64(wp.dot(hold[i], way))
        stretched += wp.float64(loss[i]) - pulled
        held -= pressed
        filling = wp.float64(swept[i]) * gas[g, GAUGE]
        whole += pulled + pressed + filling
        filled += filling
        strained += wp.float64(evened[i])
    part[c, STRETCH] = part[c, STRETCH] + stretched
    part[c, CONTACT] = part[c, CONTACT] + held
    part[c, LINES] = part[c, LINES] + whole
    part[c, SHIFTS] = part[c, SHIFTS] + strained
    part[c, STARS] = -filled


@wp.kernel
def book_foam_chunks(
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    vector: wp.array(dtype=wp.vec3),
    moments: wp.array(dtype=wp.vec4),
    u_mid: wp.array(dtype=float),
    load: wp.array(dtype=float),
    missing: wp.array(dtype=wp.vec3),
    added: wp.array(dtype=float),
    recoil: wp.array(dtype=wp.vec3),
    gas: wp.array2d(dtype=wp.float64),
    density: float,
    kept: int,
    kick: wp.array(dtype=wp.vec3),
    drift: wp.array(dtype=wp.vec3),
    damping: float,
    tension: wp.array(dtype=float),
    contact: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    begun: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.vec3),
    passed: wp.array(dtype=wp.vec3),
    body: wp.array(dtype=wp.vec3),
    traction: wp.array(dtype=wp.vec3),
    first: wp.array(dtype=wp.int32),
    dt: wp.array(dtype=float),
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What foams do besides `book_forces_chunks`. Slots CONTACT, STRETCH, LINES, DEBT, DAMPING, FLOW and MEMBRANE.

    Damping acts before momentum is given back and drag holds the bubble back. What it takes by the velocity of the
    cluster belongs to the momentum that is given back.

    What a bubble carries as a whole (`carried`) is booked as normal motion is, by the scheme and the recoil.

    Liquid that flows along a film hangs on it: its weight along it, m g_t, moves the bubble as a whole, whose inertia
    has its part K dU = m dU_t. Uneven tension a t holds it up there. m g_t + a t - K dU/dt is what it gets faster or
    slower by than its bubble, and that the bubble does not feel: that impulse times its way is a loss of the flow.

    Args:
        mass: [n_e] kg.
        area: [n_e] m^2.
        normal: [n] unit normals.
        vector: [n_e] gradient of the volume, m^2.
        moments: [regions] what the gas answered in the solve, -Pa, and what does not matter here.
        u_mid: [n_e] normal speed that moves E, m/s.
        load: [n_e] from `lines.gather_load_e`, N.
        missing: [regions] m/s^2.
        added: [regions] kg/m^2.
        recoil: [regions] velocity that gives momentum back, m/s.
        gas: gas slots.
        density: of the air that bubbles carry, kg/m^3; 0 without.
        kept: 1 where E know their normal motion alone.
        kick: [regions] change of the velocity as a whole by drag, m/s; null without.
        drift: [regions] velocity of the cluster, against which the air takes up normal motion, m/s.
        damping: rate at which it does, 1/s.
        tension: [n_e] from `lose_tension_e`, J.
        contact: [n_e] from `lose_contact_e`, J.
        u: [n] at the end of the step, m/s.
        begun: [regions] velocity as a whole at the start of the step, m/s.
        motion: [regions] at its end, m/s.
        frame: [regions] in it, m/s.
        passed: [regions] at the time of the paths along the film, m/s.
        body: [n_e] acceleration by outside forces, m/s^2.
        traction: [n_e] force of uneven tension along the film, Pa; null without surfactant.
        first: see `part_range`.
        dt: [1] s.
        part: parts.
    """
    c = wp.tid()
    parts = part.shape[0]
    g = part_region(c, first, parts)
    start, stop = part_range(c, first, parts)
    stretched = wp.float64(0.0)
    pressed = wp.float64(0.0)
    lined = wp.float64(0.0)
    paid = wp.float64(0.0)
    felt = wp.float64(0.0)
    scheme = wp.float64(0.0)
    damped = wp.float64(0.0)
    change = motion[g] - begun[g]
    late = recoil[g] + drift[g]
    if kick:
        late += kick[g]
    ahead = frame[g] - 0.5 * (begun[g] + motion[g])
    if begins_region(c, parts, first.shape[0] - 1):
        scheme = carried_air(gas, g, density, change, ahead)
        paid = -carried_air(gas, g, density, recoil[g], frame[g])
    for i in range(start, stop):
        n = normal[i]
        air = added[g] * area[i]
        m = mass[i] + air
        stretched += wp.float64(tension[i])
        pressed += wp.float64(contact[i])
        gain = load[i] + m * wp.dot(missing[g], n) - moments[g][0] * wp.dot(vector[i], n)
        lined -= wp.float64(dt[0] * gain * u_mid[i])
        paid -= wp.float64(m * wp.dot(recoil[g], n) * u_mid[i])
        brake = m * damping * dt[0] * wp.dot(u[i] - late, n)
        whole = wp.dot(drift[g], n)
        damped += wp.float64(brake * (u_mid[i] - whole))
        paid += wp.float64(brake * whole)
        paid -= wp.float64(carried(mass[i], air, n, recoil[g], frame[g], kept))
        scheme += wp.float64(carried(mass[i], air, n, change, ahead, kept))
        if kept == 0:
            lag = tangential(change - recoil[g] - dt[0] * body[i], n)
            felt += wp.float64(mass[i] * wp.dot(lag, frame[g]))
            if traction:
                felt -= wp.float64(area[i] * dt[0] * wp.dot(traction[i], passed[g]))
    part[c, STRETCH] = stretched
    part[c, CONTACT] = pressed
    part[c, LINES] = lined
    part[c, DEBT] = paid
    part[c, DAMPING] = damped
    part[c, FLOW] = part[c, FLOW] + felt
    part[c, MEMBRANE] = part[c, MEMBRANE] + scheme


@wp.kernel
def book_shifts_chunks(
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    added: wp.array(dtype=float),
    motion: wp.array(dtype=wp.vec3),
    gas: wp.array2d(dtype=wp.float64),
    density: float,
    kept: int,
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What the shifts of E have taken: they change velocities and nothing else. Slots SHIFTS and ENDED.

    ENDED has what bubbles carry as a whole from here on.
    """
    c = wp.tid()
    parts = part.shape[0]
    g = part_region(c, first, parts)
    start, stop = part_range(c, first, parts)
    total = wp.float64(0.0)
    for i in range(start, stop):
        total += kinetic(mass[i], u[i])
        total += kinetic(added[g] * area[i], wp.dot(u[i], normal[i]) * normal[i])
    part[c, SHIFTS] = part[c, ENDED] - total
    if density > 0.0 or kept == 1:
        for i in range(start, stop):
            air = added[g] * area[i]
            total += wp.float64(0.5 * carried(mass[i], air, normal[i], motion[g], motion[g], kept))
    if begins_region(c, parts, first.shape[0] - 1):
        total += wp.float64(0.5) * carried_air(gas, g, density, motion[g], motion[g])
    part[c, ENDED] = total


@wp.kernel
def settle_step(
    part: wp.array2d(dtype=wp.float64),
    rt: wp.float64,
    # outputs
    book: wp.array2d(dtype=wp.float64),
    asked: wp.array(dtype=wp.int32),
):
    """Add what the last step did to the flows, and note what is stored now where it is asked for.

    Surfactant is that of L on the area that they claim, taken for all of the film's: 2 R T c ln(claimed/area) besides.
    That changes with the mean widening of their paths, which is the flow's, and as it is mended.

    Args:
        part: parts of all slots.
        rt: R T, J/mol.
        asked: [1] 1 where what is stored is asked for; 0 afterwards.
        book: [4, SLOTS] what is stored now, what was at the start of the first step, sums of the flows over the steps
            (J), and in the last row the number of steps that were begun and the last drift, J.
    """
    begun = book[3, 0]
    book[3, 0] = begun + wp.float64(1.0)
    claimed = wp.float64(0.0)
    solute = wp.float64(0.0)
    wide = wp.float64(0.0)
    widened = wp.float64(0.0)
    for c in range(part.shape[0]):
        claimed += part[c, CLAIMED]
        solute += part[c, SOLUTE]
        wide += part[c, WIDE]
        widened += part[c, WIDENED]
    drift = wp.float64(0.0)
    even = wp.float64(0.0)
    if claimed > wp.float64(0.0):
        drift = wp.float64(2.0) * rt * solute * wp.log(claimed / wide)
        even = wp.float64(2.0) * rt * solute * widened / claimed
    for s in range(part.shape[1]):
        total = wp.float64(0.0)
        for c in range(part.shape[0]):
            total += part[c, s]
        if s == SURFACTANT:
            total += drift
        if s == SPREADING:
            total -= even
        if s == MENDING:
            total += even - (drift - book[3, 1])
        if s < FIRST_FLOW:
            if asked[0] == 1:
                book[0, s] = total
            if begun == wp.float64(0.0):
                book[1, s] = total
        elif begun > wp.float64(0.0):
            book[2, s] = book[2, s] + total
    book[3, 1] = drift
    asked[0] = 0


@wp.kernel
def lie_chunks(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    packed: float,
    rt: float,
    n: int,
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """Parts of mass, surfactant, sum m x, momentum and the free energy of the surfactant of particles.

    Args:
        mass: [n] kg.
        surfactant: [n] mol on one interface.
        x: [n] m.
        u: [n] m/s.
        eta: [n] thickness of L, m; null where none has surfactant.
        packed: rho/Gamma_0, kg/(mol m).
        rt: R T, J/mol.
        n: number of particles.
        part: slots 0, 1, 2-4, 5-7, 8; kg, mol, kg m, kg m/s, J.
    """
    t = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    liquid = wp.float64(0.0)
    amount = wp.float64(0.0)
    free = wp.float64(0.0)
    place = wp.vec3d()
    momentum = wp.vec3d()
    for i in range(t * size, wp.min(n, (t + 1) * size)):
        m = wp.float64(mass[i])
        liquid += m
        amount += wp.float64(surfactant[i])
        free += free_surfactant(i, mass, surfactant, eta, packed, rt)
        place += m * wp.vec3d(x[i])
        momentum += m * wp.vec3d(u[i])
    part[t, 0] = liquid
    part[t, 1] = amount
    part[t, 8] = free
    for k in range(3):
        part[t, 2 + k] = place[k]
        part[t, 5 + k] = momentum[k]
