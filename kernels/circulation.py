"""Circulation that L carry along the film, and what E restore of it (vortex particles on a film, Tao et al. 2024)."""

import warp as wp

from melp_warp.kernels.native import Blocks, gather_amount, sum_shares
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import balanced_load
from melp_warp.kernels.sph import kernel_w, tangential

wp.set_module_options({"enable_backward": False})


@wp.kernel
def give_amount_l(
    amount: wp.array(dtype=float),
    share: wp.array(dtype=float),
    place: wp.array(dtype=wp.int32),
    # outputs
    given: wp.array(dtype=float),
):
    """What each L gives of an amount per weight W(E, L): amount/alpha_L, alpha_L = sum_E W as in (6).

    Args:
        amount: [n_l] carried by each L.
        share: [n_l] 1/alpha, m^2.
        place: [n_l] place of each L among those sorted by their homes.
        given: [n_l, rounded up to eights] by place.
    """
    i = wp.tid()
    given[place[i]] = amount[i] * share[i]


@wp.kernel
def gather_amount_e(
    x_e: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    rows: Neighbors,
    block: Blocks,
    r: float,
    pack: wp.array(dtype=float),
    given: wp.array(dtype=float),
    # outputs
    amount: wp.array(dtype=float),
):
    """Gather an amount from L by the weights of (6); its sum over the E is that over the L.

    Args:
        x_e: [n] m.
        region: [n] region of each E.
        rows: wide E:E neighbours.
        block: blocks of the L by their homes.
        r: support radius, m.
        pack: from `transfer.normalize_l`, which holds the positions of the L.
        given: from `give_amount_l`.
        amount: [n_e].
    """
    i = rows.first + wp.tid()
    amount[i] = gather_amount(i, x_e, region[i], pack, given, block, rows, r)


SPREAD = wp.constant(0.026838292)
"""Fourth part of the second moment of W over r^2: W blurs a field f to f + SPREAD r^2 lap f."""


@wp.kernel
def sharpen_e(
    blurred: wp.array(dtype=float),
    area: wp.array(dtype=float),
    rows: Neighbors,
    pair: wp.array(dtype=float),
    r: float,
    n_e: int,
    # outputs
    amount: wp.array(dtype=float),
):
    """Take back what W has blurred, f - SPREAD r^2 lap_s f with f = blurred/a. The sum over the E stays.

    What was blurred is exp(-k^2 s) of a wave, s = SPREAD r^2, and what comes back at most (1 + k^2 s) exp(-k^2 s) < 1:
    no wave grows.

    Args:
        blurred: [n_e].
        area: [n_e] m^2.
        rows: E:E neighbours.
        pair: [pairs] a_i a_j K_ij of the surface Laplacian.
        r: support radius, m.
        n_e: number of E; nothing passes to boundary particles.
        amount: [n_e].
    """
    i = rows.first + wp.tid()
    own = blurred[i] / area[i]
    total = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            total += pair[k] * (blurred[j] / area[j] - own)
    amount[i] = blurred[i] - SPREAD * r * r * total


@wp.func
def curl_row(
    i: int,
    n: wp.vec3,
    u: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
) -> float:
    """n.curl_s u at E i, 1/s."""
    ui = u[i]
    total = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        total += wp.cross(gradient[k], u[rows.index[k]] - ui)
    return wp.dot(n, total)


@wp.kernel
def find_deficit_e(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    circulation: wp.array(dtype=float),
    area: wp.array(dtype=float),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    # outputs
    deficit: wp.array(dtype=float),
):
    """Circulation that the L carry near each E less that of its velocity, Omega_E - a n.curl_s u. [n_e], m^2/s.

    The gradient is over E alone: mirrored beyond a rim, a film that turns as a whole would seem to turn by half there.
    """
    i = rows.first + wp.tid()
    deficit[i] = circulation[i] - area[i] * curl_row(i, normal[i], u, rows, gradient)


@wp.kernel
def load_stream_e(
    deficit: wp.array(dtype=float),
    area: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    part: wp.array(dtype=wp.vec2),
    regions: int,
    # outputs
    b: wp.array(dtype=float),
    start: wp.array(dtype=float),
):
    """Right-hand side of -lap_s psi = -delta. Without a frame delta has no mean, as no curl on a closed film has.

    Args:
        deficit: [n_e] m^2/s.
        area: [n_e] m^2.
        region: [n] region of each E.
        part: from `regions.load_chunks`; null for a film with a frame, where psi is 0 at the rim.
        regions: number of regions.
        b: [n_e] m^2/s.
        start: [n] first guess, 0.
    """
    i = wp.tid()
    lacking = deficit[i]
    if part:
        lacking = balanced_load(lacking, area[i], part, region[i], regions)
    b[i] = -lacking
    start[i] = 0.0


@wp.kernel
def mirror_stream_b(
    mirror: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    psi: wp.array(dtype=float),
):
    """Stream function beyond the rim, minus that of the mirror point: 0 at the rim, along which the film slips.

    Args:
        mirror: [n_b] mirror points inside the film, m.
        x_e: [n] m.
        rows: mirror:E neighbours.
        r: interpolation radius, m.
        n_e: number of E; boundary particle b is entry n_e + b.
        psi: [n] m^2/s.
    """
    b = wp.tid()
    p = mirror[b]
    total = float(0.0)
    value = float(0.0)
    for k in range(rows.start[b], rows.stop[b]):
        j = rows.index[k]
        if j < n_e:
            w = kernel_w(wp.length(x_e[j] - p), r)
            total += w
            value += w * psi[j]
    psi[n_e + b] = wp.where(total > 0.0, -value / total, 0.0)


@wp.kernel
def add_stream_e(
    psi: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """u += n x grad_s psi, which has the curl lap_s psi and no divergence. [n], m/s."""
    i = rows.first + wp.tid()
    own = psi[i]
    slope = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        slope += (psi[rows.index[k]] - own) * gradient[k]
    u[i] = u[i] + wp.cross(normal[i], slope)


@wp.kernel
def note_change_e(
    u: wp.array(dtype=wp.vec3),
    onward: float,
    # outputs
    push: wp.array(dtype=wp.vec3),
):
    """Change of velocity between two calls: push = -u, then push + u. [n_e], m/s."""
    i = wp.tid()
    push[i] = onward * (push[i] + u[i]) - (1.0 - onward) * u[i]


@wp.kernel
def note_drag_e(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    wind: wp.array(dtype=wp.vec3),
    drag: float,
    density: float,
    dt: wp.array(dtype=float),
    # outputs
    push: wp.array(dtype=wp.vec3),
):
    """Add the change of velocity along the film by the air's drag, which is taken at the end of dt.

    Args:
        u: [n] velocity after dt, m/s.
        normal: [n] unit normals.
        eta: [n_e] m.
        region: [n] region of each E.
        wind: [regions] velocity of the air, m/s; null for air at rest.
        drag: traction per speed, Pa s/m.
        density: kg/m^3.
        dt: [1] s.
        push: [n] m/s.
    """
    i = wp.tid()
    relative = u[i]
    if wind:
        relative -= wind[region[i]]
    push[i] = push[i] - dt[0] * drag / (density * eta[i]) * tangential(relative, normal[i])


@wp.func
def thickness_ahead(
    i: int, eta: wp.array(dtype=float), gamma: wp.array(dtype=float), ahead: wp.array(dtype=float)
) -> float:
    """Thickness of E i once its surfactant has come from gamma to `ahead`, m."""
    if gamma[i] > 0.0:
        return eta[i] * ahead[i] / gamma[i]
    return eta[i]


@wp.kernel
def make_circulation_e(
    eta: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    ahead: wp.array(dtype=float),
    stiffness: float,
    body: wp.array(dtype=wp.vec3),
    push: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    rows: Neighbors,
    inner_gradient: wp.array(dtype=wp.vec3),
    gradient: wp.array(dtype=wp.vec3),
    n_e: int,
    dt: wp.array(dtype=float),
    # outputs
    made: wp.array(dtype=float),
):
    """Circulation that the step's forces make around each E.

    Uneven tension on a film of uneven mass: n.curl(-C/eta grad gamma) = C/eta^2 n.(grad eta x grad gamma), which is 0
    where the one is proportional to the other, to rounding. Both are those after the share theta of the step, in which
    liquid and surfactant widen alike: in long steps elastic waves leave nothing of the gamma that a step starts with.

    Outside forces by the curl of their field. Viscosity and drag by that of the velocity that they have made. The curl
    of the whole change of velocity would have, besides, the error of the curl of a discrete gradient, which is of the
    second order and makes vortices grow.

    Args:
        eta: [n_e] m.
        gamma: [n_e] relative concentration.
        ahead: [n_e] that of which the step takes the gradient, after its share theta.
        stiffness: C = 2 R T Gamma_0/rho, m^3/s^2; 0 without surfactant.
        body: [n_e] acceleration by outside forces, m/s^2.
        push: [n] change of velocity by viscosity and drag over theta dt, m/s; null without both.
        theta: [1] share of the step.
        normal: [n] unit normals.
        area: [n_e] m^2.
        rows: E:E neighbours.
        inner_gradient: [pairs] gradient weights over E alone, 1/m.
        gradient: [pairs] the same with boundary particles.
        n_e: number of E.
        dt: [1] s.
        made: [n_e] m^2/s.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    own = thickness_ahead(i, eta, gamma, ahead)
    thicker = wp.vec3()
    richer = wp.vec3()
    forced = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            g = inner_gradient[k]
            thicker += (thickness_ahead(j, eta, gamma, ahead) - own) * g
            richer += (ahead[j] - ahead[i]) * g
            forced += wp.cross(g, body[j] - body[i])
    turn = dt[0] * (stiffness / (own * own) * wp.dot(n, wp.cross(thicker, richer)) + wp.dot(n, forced))
    if push:
        turn += curl_row(i, n, push, rows, gradient) / theta[0]
    made[i] = turn * area[i]


@wp.kernel
def spread_made_e(
    made: wp.array(dtype=float),
    claim: wp.array(dtype=float),
    # outputs
    dense: wp.array(dtype=float),
):
    """What was made at each E, on a unit of the area that the L claim there; 0 where no L is.

    Args:
        made: [n_e].
        claim: [n_e] area that the L take up at their thickness, m^2.
        dense: [n] made/claim.
    """
    i = wp.tid()
    dense[i] = wp.where(claim[i] > 0.0, made[i] / claim[i], 0.0)


@wp.kernel
def take_made_l(
    dense: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    share: wp.array(dtype=float),
    density: float,
    weight: wp.array(dtype=float),
    rows: Neighbors,
    # outputs
    amount: wp.array(dtype=float),
):
    """Give L what was made in a step, each by the area that it claims: their sum is that over the E.

    Args:
        dense: [n] from `spread_made_e`.
        mass: [n_l] kg.
        eta: [n_l] m.
        share: [n_l] 1/alpha, m^2.
        density: kg/m^3.
        weight: [pairs] W(E, L), 0 for boundary particles, 1/m^2.
        rows: L:E neighbours.
        amount: [n_l] what they carry of it.
    """
    i = rows.first + wp.tid()
    area = mass[i] / (density * eta[i])
    amount[i] = amount[i] + area * share[i] * sum_shares(i, dense, weight, rows)


@wp.kernel
def clear_beyond_b(n_e: int, psi: wp.array(dtype=float)):
    """Set the stream function of boundary particles to 0. [n], m^2/s."""
    psi[n_e + wp.tid()] = 0.0
