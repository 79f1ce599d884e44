"""The energy budget: what is stored when E hold all that L carry, and what the stages of a step do to it, by formula.

Each kernel sums over E in parts, region by region, into its own slots of one table [parts, SLOTS] in float64. See
docs/energy.md for the identities.
"""

import warp as wp

from melp_warp.kernels.gas import AMOUNT, GAUGE, INCREMENT, OFFSET, VOLUME
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, part_region, region_parts
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})

# What is stored at the start of a step.
KINETIC = wp.constant(0)
SURFACE = wp.constant(1)
GAS = wp.constant(2)
AIR = wp.constant(3)
# What the step has done, from here on.
OFFSETS = wp.constant(4)
STARTED = wp.constant(5)
FIRST_FLOW = OFFSETS
HOLD = wp.constant(6)
MEMBRANE = wp.constant(7)
BENDING = wp.constant(8)
PRESSING = wp.constant(9)
FLOW = wp.constant(10)
SPREADING = wp.constant(11)
SPLITTING = wp.constant(12)
DRAG = wp.constant(13)
VISCOSITY = wp.constant(14)
DAMPING = wp.constant(15)
LIFT = wp.constant(16)
PUSH = wp.constant(17)
SHIFTS = wp.constant(18)
ENDED = wp.constant(19)
IMPULSE = wp.constant(20)  # three of them
SLOTS = wp.constant(23)


@wp.func
def kinetic(mass: float, u: wp.vec3) -> wp.float64:
    """m u^2/2, J."""
    return wp.float64(0.5) * wp.float64(mass) * wp.float64(wp.length_sq(u))


@wp.func
def begins_region(c: int, parts: int, regions: int) -> bool:
    """Whether part c is the first of a region: it counts what a region has once."""
    start, _ = region_parts(c // (parts // regions), parts, regions)
    return c == start


@wp.kernel
def open_step_chunks(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    area: wp.array(dtype=float),
    kappa: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    cover: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    tension: wp.array(dtype=float),
    slope: float,
    rt: float,
    added: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    p_atm: wp.float64,
    closed: int,
    moving: int,
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array2d(dtype=wp.float64),
    before: wp.array(dtype=wp.vec3),
):
    """What is stored at the start of a step, and what the offset of the last one has done.

    The areas are those before the offset d, which changed them by -kappa a d and did the work
    d sum a (2 sigma kappa + p).

    Args:
        mass: [n_e] kg.
        surfactant: [n_e] mol on one interface.
        area: [n_e] m^2.
        kappa: [n_e] sum of the principal curvatures, 1/m.
        gamma: [n_e] Gamma/Gamma_0.
        cover: [n_e] share of a sheet that is one film with another region's; null for a film without regions beyond it.
        u: [n] m/s.
        normal: [n] unit normals.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        rt: R T, J/mol.
        added: [regions] mass of the air that moves along with the normal speed, kg/m^2.
        gas: gas slots.
        p_atm: Pa.
        closed: 1 where there is gas.
        moving: 1 where the surface moves.
        first: see `part_range`.
        part: parts of the slots KINETIC to STARTED.
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
    size = wp.float64(0.0)
    for i in range(start, stop):
        v = u[i]
        before[i] = v
        liquid += kinetic(mass[i], v)
        a = wp.float64(area[i])
        size += a
        sides = float(2.0)
        if cover:
            sides = 2.0 - cover[i]
        free = wp.float64(tension[g]) * a
        sigma = tension[g]
        if slope > 0.0:
            free += wp.float64(rt * surfactant[i]) * (wp.log(wp.float64(gamma[i])) - wp.float64(1.0))
            sigma = sigma - slope * gamma[i]
        surface += wp.float64(sides) * free
        if moving == 1:
            air += kinetic(added[g] * area[i], wp.dot(v, normal[i]) * normal[i])
            bent += wp.float64(sides * sigma * kappa[i]) * a
    part[c, KINETIC] = liquid
    part[c, AIR] = air
    part[c, SURFACE] = surface
    part[c, OFFSETS] = wp.float64(0.0)
    part[c, GAS] = wp.float64(0.0)
    part[c, STARTED] = liquid + air
    if closed == 1:
        d = gas[g, OFFSET]
        part[c, SURFACE] = surface - d * bent
        part[c, OFFSETS] = d * (bent + gas[g, GAUGE] * size)
        if begins_region(c, parts, first.shape[0] - 1):
            part[c, GAS] = p_atm * gas[g, VOLUME] - gas[g, AMOUNT] * wp.log(gas[g, VOLUME])


@wp.kernel
def bend_film_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    u_mid: wp.array(dtype=float),
    frame: wp.array(dtype=wp.vec3),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    tension: float,
    slope: float,
    bent: float,
    theta: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    loss: wp.array(dtype=float),
):
    """What the membrane's scheme takes by its forces: (theta - 1/2) d.K d with the way d of E in a step. [n_e], J.

    K = -2 sigma (lap_s + 2/R^2): of a force taken at theta of the way that share is not stored. Rows share
    pairs evenly.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        area: [n_e] m^2.
        gamma: [n_e] relative surfactant concentration.
        u_mid: [n_e] normal speed that moves E, m/s.
        frame: [1] velocity of the film as a whole, whose motion bends nothing, m/s.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        n_e: number of E; beyond them the film does not move.
        tension: sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        bent: 2/R^2, 1/m^2.
        theta: [1].
        dt: [1] s.
        loss: [n_e] J.
    """
    i = rows.first + wp.tid()
    loss[i] = 0.0
    over = theta[0] - 0.5
    if over == 0.0:
        return
    own = u_mid[i] - wp.dot(frame[0], normal[i])
    total = -bent * area[i] * own * own
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            change = u_mid[j] - wp.dot(frame[0], normal[j]) - own
            total += 0.5 * weight[k] * change * change
        else:
            total += weight[k] * own * own
    loss[i] = over * 2.0 * (tension - slope * gamma[i]) * dt[0] * dt[0] * total


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
    bending: wp.array(dtype=float),
    left_out: wp.array(dtype=float),
    rigid: wp.array(dtype=wp.vec3),
    gamma: wp.array(dtype=float),
    gamma_ahead: wp.array(dtype=float),
    slope: float,
    diffused: wp.array(dtype=wp.vec3),
    body: wp.array(dtype=wp.vec3),
    gravity: wp.vec3,
    drag: float,
    damping: float,
    theta: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    p_atm: wp.float64,
    closed: int,
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
        bending: [n_e] from `bend_film_e`, J; null where there is none.
        left_out: [1] stiffness that the membrane's matrix lacks, kg/m^2.
        rigid: [1] is the pressure p.n that carries the lift, Pa; null where there is none.
        gamma: [n_e] Gamma/Gamma_0 at the start of the step.
        gamma_ahead: [n_e] after the share theta of the step; null without surfactant.
        slope: R T Gamma_0, N/m.
        diffused: [n_e] velocity along the film after viscosity, m/s; null without.
        body: [n_e] acceleration by outside forces, m/s^2.
        gravity: its part that is stored as height, m/s^2.
        drag: Pa s/m.
        damping: rate at which the air takes up normal motion, 1/s.
        theta: [1] share of the step that the flow along the film is solved for.
        gas: gas slots.
        p_atm: Pa.
        closed: 1 where there is gas.
        dt: [1] s.
        first: see `part_range`.
        part: parts of the slots HOLD to SHIFTS, ENDED and IMPULSE.
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
    split = wp.float64(0.0)
    slowed = wp.float64(0.0)
    viscous = wp.float64(0.0)
    damped = wp.float64(0.0)
    lifted = wp.float64(0.0)
    pushed = wp.float64(0.0)
    ended = wp.float64(0.0)
    impulse = wp.vec3d()
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
                hold -= across * kick * (un + wp.float64(0.5) * kick)
                un += kick
            membrane += across * (end - un) * (moved - wp.float64(0.5) * (un + end))
            damped += across * wp.float64(damping) * h * moved * moved
            if bending:
                bend += wp.float64(bending[i]) + wp.float64(left_out[0] * area[i]) * moved * (end - un)
            if rigid:
                lift = area[i] * wp.dot(rigid[1], n)
                lifted += wp.float64(lift) * moved * h
                outside += lift * n
        ended += wp.float64(0.5) * across * end * end
        along = tangential(before[i], n)
        last = tangential(u[i], n)
        change = last - along
        ahead = along + theta[0] * change
        ended += kinetic(mass[i], last)
        flow += (share - wp.float64(0.5)) * m * wp.float64(wp.length_sq(change))
        slowed += wp.float64(drag * area[i] * wp.length_sq(ahead)) * h
        other = mass[i] * (body[i] - gravity)
        pushed += (wp.float64(wp.dot(other, ahead)) + wp.float64(wp.dot(other, n)) * moved) * h
        outside -= drag * area[i] * ahead
        for k in range(3):
            impulse[k] += wp.float64(outside[k]) * h
        if gamma_ahead:
            rise = wp.float64(gamma_ahead[i] - gamma[i]) / share
            spread += wp.float64(2.0 * slope * area[i] / gamma[i]) * (share - wp.float64(0.5)) * rise * rise
        if diffused:
            still = tangential(diffused[i], n)
            viscous += m * wp.float64(wp.dot(along - still, still)) / share
            split += m * wp.float64(wp.dot(along - still, ahead - still)) / share
    part[c, HOLD] = hold
    part[c, MEMBRANE] = membrane
    part[c, BENDING] = bend
    part[c, FLOW] = flow
    part[c, SPREADING] = spread
    part[c, SPLITTING] = split
    part[c, DRAG] = slowed
    part[c, VISCOSITY] = viscous
    part[c, DAMPING] = damped
    part[c, LIFT] = lifted
    part[c, PUSH] = pushed
    for k in range(3):
        part[c, IMPULSE + k] = impulse[k]
    part[c, SHIFTS] = wp.float64(0.0)
    part[c, ENDED] = ended
    part[c, PRESSING] = wp.float64(0.0)
    if closed == 1 and begins_region(c, parts, first.shape[0] - 1):
        swept = gas[g, AMOUNT] / (p_atm + gas[g, GAUGE]) - gas[g, VOLUME]
        part[c, PRESSING] = -wp.float64(0.5) * gas[g, INCREMENT] * swept


@wp.kernel
def book_shifts_chunks(
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    added: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """What the shifts of E have taken: they change velocities and nothing else. Slots SHIFTS and ENDED."""
    c = wp.tid()
    parts = part.shape[0]
    g = part_region(c, first, parts)
    start, stop = part_range(c, first, parts)
    total = wp.float64(0.0)
    for i in range(start, stop):
        total += kinetic(mass[i], u[i])
        total += kinetic(added[g] * area[i], wp.dot(u[i], normal[i]) * normal[i])
    part[c, SHIFTS] = part[c, ENDED] - total
    part[c, ENDED] = total


@wp.kernel
def settle_step(
    part: wp.array2d(dtype=wp.float64),
    # outputs
    book: wp.array2d(dtype=wp.float64),
):
    """Add what the last step did to the flows, and note what is stored now.

    Args:
        part: parts of all slots.
        book: [4, SLOTS] what is stored now, what was at the start of the first step, sums of the flows over the steps
            (J), and first in the last row the number of steps that were begun.
    """
    begun = book[3, 0]
    book[3, 0] = begun + wp.float64(1.0)
    for s in range(part.shape[1]):
        total = wp.float64(0.0)
        for c in range(part.shape[0]):
            total += part[c, s]
        if s < FIRST_FLOW:
            book[0, s] = total
            if begun == wp.float64(0.0):
                book[1, s] = total
        elif begun > wp.float64(0.0):
            book[2, s] = book[2, s] + total


@wp.kernel
def lie_chunks(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    n: int,
    # outputs
    part: wp.array2d(dtype=wp.float64),
):
    """Parts of mass, surfactant, sum m x and momentum of particles. Slots 0, 1, 2-4, 5-7; kg, mol, kg m, kg m/s."""
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    for s in range(part.shape[1]):
        part[c, s] = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        m = wp.float64(mass[i])
        part[c, 0] = part[c, 0] + m
        part[c, 1] = part[c, 1] + wp.float64(surfactant[i])
        for k in range(3):
            part[c, 2 + k] = part[c, 2 + k] + m * wp.float64(x[i][k])
            part[c, 5 + k] = part[c, 5 + k] + m * wp.float64(u[i][k])
