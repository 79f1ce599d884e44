"""The explicit single-layer step: film as SPH sums, forces along it in pairs, motion within a rim."""

import warp as wp

from melp_warp.kernels.boundary import inside_rim
from melp_warp.kernels.native import weigh_row
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import kernel_w, laplacian_weight, tangential

wp.set_module_options({"enable_backward": False})

LEAST_INSIDE = wp.constant(0.1)
"""Least share of a kernel taken to lie within the rim: a quarter does in a corner."""


@wp.kernel
def sum_film_e(
    x: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    n_e: int,
    rim_area: float,
    density: float,
    reference: float,
    # outputs
    near: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    own: wp.array(dtype=float),
):
    """eta_i = sum_j V_j W_ij and Gamma_i = sum_j c_j W_ij, over the share of the kernel that is within the rim.

    Args:
        x: [n] m.
        mass: [n_e] kg.
        surfactant: [n_e] amount on one interface, mol.
        rows: E:E neighbours.
        r: support radius, m.
        n_e: number of E; particles from here on are boundary.
        rim_area: area that a boundary particle stands for, m^2.
        density: rho, kg/m^3.
        reference: Gamma_0, mol/m^2; 0 for a film without surfactant.
        near: [pairs] W of each pair, 1/m^2.
        eta: [n_e] m.
        gamma: [n_e] Gamma/Gamma_0; 1 without surfactant.
        own: [n_e] V_i/eta_i, m^2.
    """
    i = rows.first + wp.tid()
    weigh_row(i, x[i], x, rows, r, x.shape[0], near)
    centre = kernel_w(0.0, r)
    m = centre * mass[i]
    c = centre * surfactant[i]
    beyond = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            m += near[k] * mass[j]
            c += near[k] * surfactant[j]
        else:
            beyond += near[k] * rim_area
    inside = wp.max(1.0 - beyond, LEAST_INSIDE)
    thickness = m / (density * inside)
    eta[i] = thickness
    own[i] = mass[i] / (density * thickness)
    g = float(1.0)
    if reference > 0.0:
        g = wp.max(c / (reference * inside), 1.0e-4)
    gamma[i] = g


@wp.kernel
def mirror_concentration_b(
    mirror: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    gamma: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    n_e: int,
    # outputs
    beyond: wp.array(dtype=float),
):
    """Concentration beyond the rim: that at the mirror point within; where no E is near, as it was. [n_b]."""
    b = wp.tid()
    p = mirror[b]
    total = float(0.0)
    g = float(0.0)
    for k in range(rows.start[b], rows.stop[b]):
        j = rows.index[k]
        if j < n_e:
            w = kernel_w(wp.length(x_e[j] - p), r)
            total += w
            g += w * gamma[j]
    if total > 0.0:
        beyond[b] = g / total


@wp.kernel
def push_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    surfactant: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    beyond: wp.array(dtype=float),
    own: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    hold: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    n_e: int,
    rim_area: float,
    density: float,
    reference: float,
    stiffness: float,
    symmetric: int,
    viscosity: float,
    drag: float,
    region: wp.array(dtype=wp.int32),
    wind: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    pushed: wp.array(dtype=wp.vec3),
    traction: wp.array(dtype=wp.vec3),
):
    """Velocity after the explicit forces along the film; its normal part stays.

    Marangoni force on i, with a = V/eta and grad_i W_ij along the film: in pairs,
    -2 R T sum_j c_i c_j (1/Gamma_i + 1/Gamma_j) grad_i W_ij, minus the gradient of 2 R T sum_i c_i log Gamma_i; or by
    the differences of (21), -2 R T a_i sum_j a_j (Gamma_j - Gamma_i) grad_i W_ij. Viscosity acts in pairs.

    Args:
        x: [n] m.
        u: [n] m/s.
        normal: [n] unit normals.
        surfactant: [n_e] amount c on one interface, mol.
        eta: [n_e] m.
        gamma: [n_e] Gamma/Gamma_0.
        beyond: [n_b] the same of boundary particles.
        own: [n_e] a, m^2.
        body: [n_e] acceleration by outside forces, m/s^2.
        hold: [n_e] inertia over mass where these fall as the velocity grows; null where they do not depend on it.
        rows: E:E neighbours.
        r: support radius, m.
        n_e: number of E; particles from here on are boundary.
        rim_area: area that a boundary particle stands for, m^2.
        density: rho, kg/m^3.
        reference: Gamma_0, mol/m^2.
        stiffness: 2 R T Gamma_0/rho, m^3/s^2; 0 for a film without surfactant.
        symmetric: 1 for pairs, 0 for differences.
        viscosity: nu, m^2/s.
        drag: traction per speed, Pa s/m, taken implicitly.
        region: [n] region of each E.
        wind: [regions] velocity of the air along the film, m/s; null for air at rest.
        dt: [1] s.
        pushed: [n_e] m/s.
        traction: [n_e] Marangoni force per area, Pa; null where nobody asks.
    """
    i = rows.first + wp.tid()
    p = x[i]
    n = normal[i]
    spread = wp.vec3()
    shear = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        d = p - x[j]
        lap = laplacian_weight(wp.length(d), r)  # grad_i W_ij = -lap d/2
        area = rim_area
        g = float(1.0)
        amount = rim_area
        if j < n_e:
            area = own[j]
            g = gamma[j]
            if reference > 0.0:
                amount = surfactant[j] / reference
            shear += 0.5 * (eta[i] + eta[j]) * area * lap * (u[j] - u[i])
        else:
            g = beyond[j - n_e]
            amount = rim_area * g
        if symmetric == 1:
            spread += 0.5 * amount * (1.0 / gamma[i] + 1.0 / g) * lap * d
        else:
            spread += 0.5 * area * (g - gamma[i]) * lap * d
    m = density * eta[i]
    force = wp.vec3()
    if stiffness > 0.0:
        force = density * stiffness * tangential(spread, n)
        if symmetric == 1:
            force *= surfactant[i] / (reference * own[i])
    if traction:
        traction[i] = force
    v = u[i]
    un = wp.dot(v, n)
    change = body[i] + (viscosity / eta[i]) * shear + force / m
    if wind:
        change += (drag / m) * wind[region[i]]
    if hold:
        pushed[i] = tangential(hold[i] * v + dt[0] * change, n) / (hold[i] + dt[0] * drag / m) + un * n
    else:
        pushed[i] = tangential(v + dt[0] * change, n) / (1.0 + dt[0] * drag / m) + un * n


@wp.kernel
def smooth_velocity_e(
    normal: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    own: wp.array(dtype=float),
    pushed: wp.array(dtype=wp.vec3),
    near: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    strength: float,
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """XSPH artificial viscosity along the film (Schechter and Bridson 2012), in pairs so that momentum stays.

    u_i + strength sum_j a_j (eta_i + eta_j)/(2 eta_i) W_ij (u_j - u_i), for each step the same whatever its size.

    Args:
        normal: [n] unit normals.
        eta: [n_e] m.
        own: [n_e] a = V/eta, m^2.
        pushed: [n_e] velocity before, m/s.
        near: [pairs] W of each pair, 1/m^2.
        rows: E:E neighbours.
        n_e: number of E; particles from here on are boundary.
        strength: 0 to 1.
        u: [n] m/s.
    """
    i = rows.first + wp.tid()
    v = pushed[i]
    change = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            change += 0.5 * (1.0 + eta[j] / eta[i]) * own[j] * near[k] * (pushed[j] - v)
    u[i] = v + strength * tangential(change, normal[i])


@wp.kernel
def confine_e(
    anchors: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n_e: int,
    # outputs
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
):
    """Put E that have crossed the rim back onto it, and take the velocity across it from them. [n], m and m/s."""
    i = rows.first + wp.tid()
    back = inside_rim(i, x[i], anchors, outward, rows, n_e)
    if wp.length_sq(back) > 0.0:
        x[i] = x[i] + back
        across = wp.normalize(back)
        u[i] = u[i] - wp.min(wp.dot(u[i], across), 0.0) * across


@wp.kernel
def move_e(
    normal: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    # outputs
    x: wp.array(dtype=wp.vec3),
):
    """Move E with the liquid: at `u_mid` along their normals and with the velocity u along the film. [n_e], m."""
    i = wp.tid()
    n = normal[i]
    x[i] = x[i] + dt[0] * (u_mid[i] * n + tangential(u[i], n))
