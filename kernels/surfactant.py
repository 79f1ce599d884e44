"""Stage 3, tangential dynamics: surfactant equation (14) in symmetric form, Marangoni velocity (15)."""

import warp as wp

from melp_warp.kernels.mls import Quadric
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import tangent_basis, tangential

wp.set_module_options({"enable_backward": False})


@wp.func
def log_mean(a: float, b: float) -> float:
    """(a - b)/log(a/b): with it an exponential film under gravity is at rest exactly."""
    mean = 0.5 * (a + b)
    s = wp.abs(a - b) / (a + b)
    if s < 0.05:
        ss = s * s
        return mean / (1.0 + ss * (1.0 / 3.0 + 0.2 * ss))
    return 2.0 * mean * s / wp.log((1.0 + s) / (1.0 - s))


@wp.kernel
def film_fields_e(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    area: wp.array(dtype=float),
    density: float,
    reference: float,
    # outputs
    eta: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
):
    """eta_E = V_E/a_E and gamma = Gamma_E/Gamma_0.

    Args:
        mass: [n_e] kg.
        surfactant: [n_e] mol.
        area: [n_e] m^2.
        density: rho, kg/m^3.
        reference: Gamma_0, mol/m^2; 0 for a film without surfactant.
        eta: [n_e] m.
        gamma: [n_e] relative concentration.
    """
    i = wp.tid()
    eta[i] = wp.max(mass[i] / (density * area[i]), 1.0e-10)
    g = float(1.0)
    if reference > 0.0:
        g = wp.max(surfactant[i] / (reference * area[i]), 1.0e-4)
    gamma[i] = g


@wp.kernel
def dilation_e(
    u: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    # outputs
    dilation: wp.array(dtype=float),
):
    """div_s u of the whole velocity, so that normal motion of a curved film counts. [n_e], 1/s."""
    i = rows.first + wp.tid()
    ui = u[i]
    total = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        total += wp.dot(gradient[k], u[rows.index[k]] - ui)
    dilation[i] = total


@wp.kernel
def shear_e(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    # outputs
    shear: wp.array(dtype=float),
):
    """Rate of shear within the surface: the lesser of strain sqrt(2 S:S) and vorticity. [n_e], 1/s.

    S is the symmetric part of the surface gradient of u. A wave strains without vorticity, a film that turns as a
    whole has vorticity without strain: neither shears.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    ui = u[i]
    slope = wp.mat33()
    for k in range(rows.start[i], rows.stop[i]):
        slope += wp.outer(gradient[k], tangential(u[rows.index[k]] - ui, n))
    strain = slope + wp.transpose(slope)
    spin = slope - wp.transpose(slope)
    shear[i] = wp.sqrt(0.5 * wp.min(wp.ddot(strain, strain), wp.ddot(spin, spin)))


@wp.kernel
def largest_chunks(
    value: wp.array(dtype=float),
    # outputs
    part: wp.array(dtype=float),
):
    """Largest of each part of a field of n_e numbers of at least 0."""
    c = wp.tid()
    n = value.shape[0]
    size = (n + part.shape[0] - 1) // part.shape[0]
    most = float(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        most = wp.max(most, value[i])
    part[c] = most


@wp.kernel
def find_path_e(
    u: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    passed: wp.array(dtype=wp.vec3),
    midway: float,
    theta: wp.array(dtype=float),
    # outputs
    path: wp.array(dtype=wp.vec3),
):
    """Velocity that L move with around each E, as seen from the film as a whole. [n_e], m/s.

    Args:
        u: [n] velocity after theta dt, m/s.
        before: [n] at the start of the step, m/s; null where L do not look back at it.
        region: [n] region of each E.
        passed: [regions] velocity as a whole at the time of the path, m/s.
        midway: 1 where L move with the velocity half a step on, whatever theta, 0 where with that after theta dt.
        theta: [1] share of the step.
        path: [n] m/s.
    """
    i = wp.tid()
    v = u[i]
    if before:
        v -= midway * (1.0 - 0.5 / theta[0]) * (v - before[i])
    path[i] = v - passed[region[i]]


LEAST_WIDENING = wp.constant(-0.6)
"""Film that is left of an area less itself where L run together: beyond that straight paths cross."""


@wp.kernel
def widen_path_e(
    path: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    bend: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    growth: wp.array(dtype=float),
    swelling: wp.array(dtype=float),
):
    """By how much the film widens as L move, the logarithm of an area over what it was. [n_e].

    An area that moves by v dt becomes 1 + dt div_s v + dt^2 (det grad_s v - K |v|^2/2) of itself, the last as what
    moves along a tangent of a film of Gauss' curvature K is put back onto it. Paths bent by v.grad_s v take 1/2 dt^2 of
    its divergence back, -2 det grad_s v + K |v|^2 but for terms of div_s v that add up to nothing over a film.

    Args:
        path: [n] velocity that L move with, m/s.
        normal: [n] unit normals.
        surface: [n_e] fitted surfaces.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights, 1/m.
        bend: [1] of the paths, 0 to 1.
        dt: [1] s.
        growth: [n_e].
        swelling: [n_e] what of it normal motion of a curved film makes, to the first order; null if nobody asks.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    whole = path[i]
    own = tangential(whole, n)
    total = float(0.0)
    change = wp.mat33()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        g = gradient[k]
        total += wp.dot(path[j] - whole, g)
        change += wp.outer(tangential(path[j], normal[j]) - own, g)
    e1, e2 = tangent_basis(n)
    a = change * e1
    b = change * e2
    det = wp.dot(e1, a) * wp.dot(e2, b) - wp.dot(e1, b) * wp.dot(e2, a)
    second = 2.0 * surface[i].second
    kappa = wp.trace(second)
    gauss = 0.5 * (kappa * kappa - wp.ddot(second, second))
    h = dt[0]
    wider = h * total + (1.0 - bend[0]) * h * h * (det - 0.5 * gauss * wp.length_sq(own))
    growth[i] = wp.log(1.0 + wp.max(wider, LEAST_WIDENING))
    if swelling:
        swelling[i] = h * (total - wp.trace(change))


@wp.kernel
def choose_share(
    shear: wp.array(dtype=float),
    least: wp.array(dtype=float),
    most: wp.array(dtype=float),
    rise: float,
    bend: float,
    dt: wp.array(dtype=float),
    # outputs
    theta: wp.array(dtype=float),
    bent: wp.array(dtype=float),
    ahead: wp.array(dtype=float),
):
    """Share theta of the step that is solved for: 1/2 and more where the flow shears.

    Args:
        shear: parts of the largest rate of shear, 1/s.
        least: [1] bounds of theta.
        most: [1].
        rise: of theta with the shear in a step.
        bend: of the paths of L; below 0: 2 (1 - theta).
        dt: [1] s.
        theta: [1].
        bent: [1] bend of the paths of L.
        ahead: [1] theta dt, s.
    """
    largest = float(0.0)
    for c in range(shear.shape[0]):
        largest = wp.max(largest, shear[c])
    share = wp.clamp(0.5 + rise * largest * dt[0], least[0], most[0])
    theta[0] = share
    bent[0] = wp.where(bend < 0.0, 2.0 * (1.0 - share), bend)
    ahead[0] = share * dt[0]


@wp.kernel
def assemble_surfactant_e(
    x: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    dilation: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    stiffness: float,
    gain: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    b: wp.array(dtype=float),
    start: wp.array(dtype=float),
):
    """Matrix and right-hand side of (14) for gamma = Gamma/Gamma_0 at the end of the step.

    Flux between a pair: C_ij (gamma_j - gamma_i) - f.(x_j - x_i), C = 2 R T Gamma_0/(rho eta) and f the mean of
    the two accelerations; none across a rim.

    Args:
        x: [n] m.
        area: [n_e] m^2.
        eta: [n_e] m.
        gamma: [n_e] relative concentration before the step.
        dilation: [n_e] div_s u before the step, 1/s.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        n_e: number of E.
        stiffness: 2 R T Gamma_0/rho, m^3/s^2.
        gain: [n_e] what fluxes count times, mean of a pair's; null where it is 1.
        body: [n_e] acceleration by outside forces, m/s^2.
        dt: [1] s.
        diag: [n_e].
        pair: [pairs].
        b: [n_e].
        start: [n_e] first guess.
    """
    i = rows.first + wp.tid()
    p = x[i]
    load = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        c = float(0.0)
        if j < n_e:
            w = weight[k]
            if gain:
                w *= 0.5 * (gain[i] + gain[j])
            c = dt[0] * w * stiffness / log_mean(eta[i], eta[j])
            load += w * 0.5 * wp.dot(body[i] + body[j], x[j] - p)
        pair[k] = c
    diag[i] = area[i] / (dt[0] * gamma[i])
    b[i] = area[i] * (1.0 / dt[0] - dilation[i]) - dt[0] * load
    start[i] = gamma[i]


@wp.kernel
def accelerate_tangential_e(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    n_e: int,
    stiffness: float,
    body: wp.array(dtype=wp.vec3),
    rate: wp.array(dtype=float),
    hold: wp.array(dtype=float),
    drag: float,
    region: wp.array(dtype=wp.int32),
    wind: wp.array(dtype=wp.vec3),
    density: float,
    dt: wp.array(dtype=float),
    # outputs
    u: wp.array(dtype=wp.vec3),
    traction: wp.array(dtype=wp.vec3),
):
    """u^T after Marangoni force, gravity and air drag, (15) from the same pair fluxes as (14).

    A film in hydrostatic balance has every pair flux zero and stays at rest to rounding.

    Args:
        x: [n] m.
        normal: [n] unit normals.
        eta: [n_e] m.
        gamma: [n_e] relative concentration at the end of the step.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights over E alone, 1/m.
        n_e: number of E.
        stiffness: 2 R T Gamma_0/rho, m^3/s^2.
        body: [n_e] acceleration by outside forces at rest, m/s^2.
        rate: [n_e] by which it falls as the velocity grows, 1/s; null where no force depends on it.
        hold: [n_e] inertia over mass there.
        drag: traction per speed, Pa s/m, taken implicitly.
        region: [n] region of each E.
        wind: [regions] velocity of the air along the film, m/s; null for air at rest.
        density: kg/m^3.
        dt: [1] s.
        u: [n] m/s.
        traction: [n_e] tangential force of uneven tension, 2 grad_s sigma, Pa; null where nobody asks.
    """
    i = rows.first + wp.tid()
    p = x[i]
    n = normal[i]
    spread = wp.vec3()
    fall = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            flux = stiffness / log_mean(eta[i], eta[j]) * (gamma[j] - gamma[i])
            pull = 0.5 * wp.dot(body[i] + body[j], x[j] - p)
            spread -= flux * gradient[k]
            fall -= (flux - pull) * gradient[k]
    m = density * eta[i]
    if traction:
        traction[i] = m * tangential(spread, n)
    v = u[i]
    un = wp.dot(v, n)
    if wind:
        fall += (drag / m) * wind[region[i]]
    ut = wp.vec3()
    if hold:
        ut = tangential((hold[i] - dt[0] * rate[i]) * v + dt[0] * fall, n) / (hold[i] + dt[0] * drag / m)
    else:
        ut = tangential(v + dt[0] * fall, n) / (1.0 + dt[0] * drag / m)
    u[i] = ut + un * n


@wp.kernel
def assemble_viscosity_e(
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    viscosity: float,
    u: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    b: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
):
    """Implicit in-plane viscosity m u' - dt div(m nu grad u') = m u, conserving momentum pair by pair.

    Args:
        mass: [n_e] kg.
        area: [n_e] m^2.
        normal: [n] unit normals.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        n_e: number of E.
        viscosity: nu, m^2/s.
        u: [n] m/s.
        dt: [1] s.
        diag: [n_e].
        pair: [pairs].
        b: [n_e].
        start: [n_e] first guess.
    """
    i = rows.first + wp.tid()
    mi = mass[i] / area[i]
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        c = float(0.0)
        if j < n_e:
            c = dt[0] * viscosity * 0.5 * (mi + mass[j] / area[j]) * weight[k]
        pair[k] = c
    ut = tangential(u[i], normal[i])
    diag[i] = mass[i]
    b[i] = mass[i] * ut
    start[i] = ut


@wp.kernel
def rescale_change_e(
    before: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    onward: float,
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """The velocity after theta dt from that after dt or, `onward`, the one after dt from that after theta dt.

    Args:
        before: [n] at the start of the step, m/s.
        theta: [1] share of the step.
        onward: 1 or 0.
        u: [n_e] m/s.
    """
    i = wp.tid()
    share = wp.where(onward > 0.0, 1.0 / theta[0], theta[0])
    u[i] = before[i] + share * (u[i] - before[i])


@wp.kernel
def replace_tangential_e(
    ut: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Replace the tangential part of u. [n_e], m/s."""
    i = wp.tid()
    n = normal[i]
    u[i] = tangential(ut[i], n) + wp.dot(u[i], n) * n
