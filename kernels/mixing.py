"""Mixing of what L hold where the flow shears them too finely to tell apart (docs/vortices.md)."""

import warp as wp

from melp_warp.kernels.native import Blocks
from melp_warp.kernels.neighbors import Neighbors

wp.set_module_options({"enable_backward": False})

REACH = wp.constant(2.0)
"""Distance within which L mix, L spacings."""

SPREAD = wp.constant(0.9549297)
"""3/pi: with it the shares (1 - x^2/R^2)^2 of L at an even spacing d, R = 2 d, spread by 4 d^2 in the mean square."""

MOST = wp.constant(0.125)
"""Largest C |S| t of a pass: an L then gives away half of what it has, in exchange."""


SLOWEST = wp.constant(0.1)
"""Shear rate of which a half counts, 1/s: slower ones are the small waves of a film at rest, which come and go."""

WOBBLE = wp.constant(0.15)
"""The same as a share of the vorticity: liquid that turns as a whole has as much of it from transfers."""


@wp.func
def shear_of(affine: wp.mat33, n: wp.vec3) -> float:
    """Shear rate sqrt(2 S:S) of a velocity gradient along the film, without what it widens or narrows, 1/s.

    Of shear near what nothing but noise makes little counts: s^2/(s + s_0).
    """
    across = wp.identity(n=3, dtype=float) - wp.outer(n, n)
    g = across * affine * across
    s = 0.5 * (g + wp.transpose(g)) - 0.5 * wp.trace(g) * across
    rate = wp.sqrt(2.0 * wp.ddot(s, s))
    turn = g - wp.transpose(g)
    noise = SLOWEST + WOBBLE * wp.sqrt(0.5 * wp.ddot(turn, turn))
    return rate * rate / (rate + noise)


@wp.kernel
def give_held_l(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    affine: wp.array(dtype=wp.mat33),
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    density: float,
    place: wp.array(dtype=wp.int32),
    behind: wp.array(dtype=wp.int32),
    # outputs
    where: wp.array(dtype=wp.vec3),
    flow: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=wp.vec4),
):
    """Sort what L mix by their homes. [n_l] each, by place.

    Args:
        x: [n_l] m.
        u: [n_l] carried velocity, m/s.
        affine: [n_l] velocity gradient, 1/s.
        normal: [n_l] unit normals.
        mass: [n_l] kg.
        surfactant: [n_l] mol.
        eta: [n_l] m.
        density: kg/m^3.
        place: [n_l] place of each L.
        behind: [n_l] 1 for L whose liquid is a free rim's, which have no area to mix by; null for a film without holes.
        where: x.
        flow: u.
        held: (mass, surfactant, area, shear rate).
    """
    i = wp.tid()
    k = place[i]
    where[k] = x[i]
    flow[k] = u[i]
    area = mass[i] / (density * eta[i])
    if behind:
        if behind[i] == 1:
            area = 0.0
    held[k] = wp.vec4(mass[i], surfactant[i], area, shear_of(affine[i], normal[i]))


@wp.kernel
def mix_l(
    x_e: wp.array(dtype=wp.vec3),
    home: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    rows: Neighbors,
    block: Blocks,
    where: wp.array(dtype=wp.vec3),
    flow: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=wp.vec4),
    spacing: float,
    strength: float,
    time: wp.array(dtype=float),
    # outputs
    u: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    eta: wp.array(dtype=float),
):
    """Exchange liquid and surfactant between near L, as much as diffusion of D = C d^2 |S| does in the time given.

    A pair i, j exchanges k a (q_j - q_i), q the mass and the surfactant a unit of area, a the harmonic mean of their
    areas, and with the mass their mean velocity: both see the same, so that liquid, surfactant and momentum stay to
    rounding, and so do the areas.

    Args:
        x_e: [n] E, m.
        home: [n_l] nearest E of each L.
        place: [n_l] place of each L.
        rows: E:E neighbours.
        block: blocks of L by homes; L far from any E do not mix.
        where: from `give_held_l`, m.
        flow: from `give_held_l`, m/s.
        held: from `give_held_l`.
        spacing: d of L, m.
        strength: C.
        time: [1] s since the last pass.
        u: [n_l] m/s.
        mass: [n_l] kg.
        surfactant: [n_l] mol.
        eta: [n_l] m.
    """
    i = wp.tid()
    own = place[i]
    limit = block.start.shape[0] - 2
    if own < block.start[limit]:
        h = home[i]
        p = where[own]
        mine = held[own]
        if mine[2] <= 0.0:
            return
        reach = REACH * spacing
        gained = float(0.0)
        active = float(0.0)
        pushed = wp.vec3()
        for k in range(rows.start[h] - 1, rows.stop[h]):
            j = h
            if k >= rows.start[h]:
                j = rows.index[k]
            if j < limit:
                far = reach + block.reach[j]
                if wp.length_sq(x_e[j] - p) < far * far:
                    for m in range(block.start[j], block.start[j + 1]):
                        s = wp.length_sq(where[m] - p) / (reach * reach)
                        if s < 1.0 and m != own:
                            other = held[m]
                            if other[2] <= 0.0:
                                continue
                            rate = strength * 0.5 * (mine[3] + other[3]) * time[0]
                            share = SPREAD * MOST * (1.0 - wp.exp(-rate / MOST)) * (1.0 - s) * (1.0 - s)
                            shared = share * 2.0 * mine[2] * other[2] / (mine[2] + other[2])
                            gain = shared * (other[0] / other[2] - mine[0] / mine[2])
                            gained += gain
                            active += shared * (other[1] / other[2] - mine[1] / mine[2])
                            pushed += gain * 0.5 * (flow[own] + flow[m])
        whole = mine[0] + gained
        if whole > 0.0:
            u[i] = (mine[0] * flow[own] + pushed) / whole
            eta[i] = eta[i] * whole / mine[0]
            mass[i] = whole
            surfactant[i] = mine[1] + active
