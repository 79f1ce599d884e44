"""Mixing of what L hold where the flow shears them too finely to tell apart (docs/vortices.md)."""

import warp as wp

from melp_warp.kernels.native import Blocks, exchange_blocks, vec5, write_held, write_rate
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, tangent_basis

wp.set_module_options({"enable_backward": False})

REACH = wp.constant(3.0)
"""Distance within which L mix, L spacings."""

SPREAD = wp.constant(0.1886)
"""16/(27 pi): shares (1 - x^2/R^2)^2 of L at an even spacing d, R = 3 d, spread by 4 d^2 in the mean square with it."""

MOST = wp.constant(0.4)
"""Largest C |S| t of a pass: an L then gives away 0.7 of what it has, in exchange."""

LEFT = wp.constant(0.05)
"""Share of its liquid that an L keeps at least; one that would keep less does not mix."""

LEAST = wp.constant(1.0e-4)
"""C |S| t below which L do not mix."""

SLOWEST = wp.constant(0.1)
"""Shear rate that does not count, 1/s: as much have the small waves of a film at rest, which come and go."""

WOBBLE = wp.constant(0.15)
"""The same as a share of the vorticity: liquid that turns as a whole has as much from transfers, and near a rim."""


@wp.kernel
def find_slope_e(
    u: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    # outputs
    slope: wp.array(dtype=wp.mat33),
):
    """Velocity gradient at E, over E alone: beyond a rim a mirrored velocity would make a shear of rigid rotation.

    Args:
        u: [n] m/s.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights over E alone, 1/m.
        slope: [n_e] slope d is the change of u over d, 1/s.
    """
    i = rows.first + wp.tid()
    total = wp.mat33()
    for k in range(rows.start[i], rows.stop[i]):
        total += wp.outer(u[rows.index[k]] - u[i], gradient[k])
    slope[i] = total


@wp.kernel
def smooth_slope_e(
    x: wp.array(dtype=wp.vec3),
    slope: wp.array(dtype=wp.mat33),
    rows: Neighbors,
    r: float,
    # outputs
    smooth: wp.array(dtype=wp.mat33),
):
    """Beside a rim the mean velocity gradient of the E around, by W; elsewhere the E's own.

    There each E sees L on one side alone: what these, lying unevenly, make of it differs from E to E.

    Args:
        x: [n] m.
        slope: [n_e] 1/s.
        rows: E:E neighbours; an E is beside a rim where there are boundary particles among them.
        r: support radius, m.
        smooth: [n_e] 1/s.
    """
    i = rows.first + wp.tid()
    weight = kernel_w(0.0, r)
    total = weight * slope[i]
    beside = int(0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < slope.shape[0]:
            w = kernel_w(wp.length(x[j] - x[i]), r)
            weight += w
            total += w * slope[j]
        else:
            beside = 1
    smooth[i] = slope[i]
    if beside == 1:
        smooth[i] = total / weight


@wp.kernel
def find_shear_e(
    slope: wp.array(dtype=wp.mat33),
    normal: wp.array(dtype=wp.vec3),
    # outputs
    rate: wp.array(dtype=float),
):
    """Rate sqrt(2 S:S) at which the flow along the film shears, without what it widens or narrows. [n_e], 1/s.

    What nothing but noise makes of it is taken off.
    """
    i = wp.tid()
    e1, e2 = tangent_basis(normal[i])
    along = slope[i] * e1
    beside = slope[i] * e2
    stretch = wp.dot(e1, along) - wp.dot(e2, beside)
    shear = wp.dot(e1, beside) + wp.dot(e2, along)
    turn = wp.abs(wp.dot(e2, along) - wp.dot(e1, beside))
    rate[i] = wp.max(wp.sqrt(stretch * stretch + shear * shear) - SLOWEST - WOBBLE * turn, 0.0)


@wp.kernel
def give_held_l(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    home: wp.array(dtype=wp.int32),
    shear: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    amount: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    density: float,
    surfactant: wp.array(dtype=float),
    usual: float,
    place: wp.array(dtype=wp.int32),
    behind: wp.array(dtype=wp.int32),
    strength: float,
    time: wp.array(dtype=float),
    # outputs
    pack: wp.array(dtype=float),
    held: wp.array(dtype=wp.vec4),
):
    """Sort what L mix by their homes.

    What differs between L that a flow has drawn out is their liquid for their surfactant, which both stay with them. By
    area it differs besides where a flow presses the film together, as around every vortex: evened out, what holds the
    vortex would be gone. So L exchange liquid, and area, for equal amounts of surfactant. The area held here is that
    which they would have at the usual concentration of it.

    Args:
        x: [n_l] m.
        u: [n_l] carried velocity, m/s.
        home: [n_l] nearest E of each L.
        shear: [n_e] from `find_shear_e`, 1/s.
        mass: [n_l] kg.
        amount: [n_l] what is exchanged besides: area, m^2, or surfactant, mol, or what a scene declares.
        eta: [n_l] m.
        density: kg/m^3.
        surfactant: [n_l] mol.
        usual: concentration of surfactant, mol/m^2; 0 for a film without.
        place: [n_l] place of each L.
        behind: [n_l] 1 for L whose liquid is a free rim's, which do not mix; null for a film without holes.
        strength: C.
        time: [1] s since the last pass.
        pack: for the L at each place, packed by `native.write_held`, its position, what it holds and its velocity.
        held: [n_l] area, C |S| t, at most `MOST`, mass and amount on a unit of area.
    """
    i = wp.tid()
    area = mass[i] / (density * eta[i])
    if usual > 0.0 and surfactant[i] > 0.0:
        area = surfactant[i] / usual
    rate = MOST * (1.0 - wp.exp(-strength * shear[home[i]] * time[0] / MOST))
    mine = wp.vec4(1.0, 0.0, 0.0, 0.0)
    lost = area <= 0.0
    if behind:
        lost = lost or behind[i] == 1
    if not lost:
        mine = wp.vec4(area, wp.where(rate < LEAST, 0.0, rate), mass[i] / area, amount[i] / area)
    held[i] = mine
    write_held(place[i], x[i], mine, u[i], pack)


@wp.kernel
def find_exchange_l(
    x_e: wp.array(dtype=wp.vec3),
    home: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    rows: Neighbors,
    block: Blocks,
    x: wp.array(dtype=wp.vec3),
    pack: wp.array(dtype=float),
    held: wp.array(dtype=wp.vec4),
    spacing: float,
    again: int,
    spent: wp.array(dtype=wp.int32),
    # outputs
    found: wp.array(dtype=vec5),
):
    """What near L exchange of liquid and surfactant: as much as diffusion of D = C d^2 |S| does in the time given.

    A pair i, j exchanges k a (q_j - q_i), q the mass and the surfactant a unit of area, a the harmonic mean of their
    areas, and with the mass their mean velocity: both see the same, so that liquid, surfactant and momentum stay to
    rounding. It goes by the smaller of their two rates.

    Args:
        x_e: [n] E, m.
        home: [n_l] nearest E of each L.
        place: [n_l] place of each L.
        rows: E:E neighbours.
        block: blocks of L by homes; L far from any E do not mix.
        x: [n_l] m.
        pack: from `give_held_l`.
        held: [n_l] from `give_held_l`.
        spacing: d of L, m.
        again: how many times it was found already: it is found anew where some were `spent` the last time.
        spent: see `spare_l`.
        found: [n_l] what each gets: mass (kg), surfactant (mol) and the mass times the other's velocity (kg m/s).
    """
    i = wp.tid()
    if again > 0 and spent[again - 1] == 0:
        return
    mine = held[i]
    got = vec5()
    if mine[1] > 0.0 and place[i] < block.start[block.start.shape[0] - 2]:
        got = 2.0 * SPREAD * exchange_blocks(home[i], x[i], mine, x_e, pack, block, rows, REACH * spacing)
    found[i] = got


@wp.kernel
def find_area_l(
    mass: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    density: float,
    # outputs
    area: wp.array(dtype=float),
):
    """Area that each L takes up, mass/(density eta). [n_l], m^2."""
    i = wp.tid()
    area[i] = mass[i] / (density * eta[i])


@wp.kernel
def set_thickness_l(
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    density: float,
    # outputs
    eta: wp.array(dtype=float),
):
    """Thickness of the L that have these areas (m^2), [n_l], m; that of an L without any stays."""
    i = wp.tid()
    if area[i] > 0.0 and mass[i] > 0.0:
        eta[i] = mass[i] / (density * area[i])


@wp.kernel
def spare_l(
    place: wp.array(dtype=wp.int32),
    mass: wp.array(dtype=float),
    amount: wp.array(dtype=float),
    found: wp.array(dtype=vec5),
    turn: int,
    # outputs
    held: wp.array(dtype=wp.vec4),
    pack: wp.array(dtype=float),
    spent: wp.array(dtype=wp.int32),
):
    """Let L that would give more than they have, in a crowd, not mix in this pass.

    One that got from them may lack it then, so that this is done in turns.

    Args:
        place: [n_l] place of each L.
        mass: [n_l] kg.
        amount: [n_l] what is exchanged besides.
        found: [n_l] from `find_exchange_l`.
        turn: which time this is, from 0.
        held: [n_l] from `give_held_l`.
        pack: the same by places.
        spent: [turns] whether there were any in each turn.
    """
    i = wp.tid()
    if turn > 0 and spent[turn - 1] == 0:
        return
    short = mass[i] + found[i][0] < LEFT * mass[i]
    short = short or (amount[i] > 0.0 and amount[i] + found[i][1] < LEFT * amount[i])
    if short:
        held[i] = wp.vec4(held[i][0], 0.0, held[i][2], held[i][3])
        write_rate(place[i], 0.0, pack)
        spent[turn] = 1


@wp.kernel
def mix_l(
    found: wp.array(dtype=vec5),
    spent: wp.array(dtype=wp.int32),
    # outputs
    u: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    eta: wp.array(dtype=float),
):
    """Give L what they get; their areas stay. Nothing where some would have spent more than they have in every turn.

    Args:
        found: [n_l] from `find_exchange_l`.
        spent: [turns] see `spare_l`.
        u: [n_l] m/s.
        mass: [n_l] kg.
        surfactant: [n_l] mol.
        eta: [n_l] m.
    """
    i = wp.tid()
    if spent[spent.shape[0] - 1] == 1:
        return
    got = found[i]
    whole = mass[i] + got[0]
    if wp.dot(got, got) > 0.0:
        u[i] = (mass[i] * u[i] + 0.5 * (wp.vec3(got[2], got[3], got[4]) + got[0] * u[i])) / whole
        eta[i] = eta[i] * whole / mass[i]
        mass[i] = whole
        surfactant[i] = surfactant[i] + got[1]
