"""Stage 3, normal dynamics (12): forces at the predicted surface and the implicit correction."""

import warp as wp

from melp_warp.kernels.gas import GAUGE, INCREMENT
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})


@wp.kernel
def predict_position_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.vec3),
    swelling: wp.array(dtype=float),
    step: wp.array(dtype=float),
    # outputs
    predicted: wp.array(dtype=wp.vec3),
):
    """x + theta dt ((u - U).n - s) n, seen from the film as a whole. [n], m.

    Moving along the normals alone would turn a translation U of finite length into a stretch. The mean speed s is
    left out as well: the gas undoes it, and the tension of a bubble swollen by it would push it further.
    """
    i = wp.tid()
    n = normal[i]
    predicted[i] = x[i] + step[0] * (wp.dot(u[i] - frame[0], n) - swelling[0]) * n


@wp.kernel
def film_force_e(
    kappa: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    u: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.vec3),
    swelling: wp.array(dtype=float),
    step: wp.array(dtype=float),
    tension: float,
    slope: float,
    body: wp.array(dtype=wp.vec3),
    # outputs
    force: wp.array(dtype=float),
    external: wp.array(dtype=float),
):
    """Normal force per area: 2 sigma kappa + p_in - p_out, and apart from it the outside forces m f.n.

    The area is that at the start of the step; at the predicted place it is 1 - kappa d times that, d the way there.

    Args:
        kappa: [n_e] sum of principal curvatures, 1/m.
        gamma: [n_e] relative surfactant concentration.
        normal: [n] unit normals.
        mass: [n_e] kg.
        area: [n_e] m^2.
        gas: gas slots; gauge pressure in Pa.
        u: [n] m/s.
        frame: [1] velocity of the film as a whole, m/s.
        swelling: [1] mean normal speed, m/s.
        step: [1] time to the predicted place, s.
        tension: sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        body: [n_e] acceleration by outside forces, m/s^2.
        force: [n_e] internal, Pa.
        external: [n_e] Pa.
    """
    i = wp.tid()
    sigma = tension - slope * gamma[i]
    n = normal[i]
    stretch = 1.0 - kappa[i] * step[0] * (wp.dot(u[i] - frame[0], n) - swelling[0])
    force[i] = wp.clamp(stretch, 0.5, 2.0) * (2.0 * sigma * kappa[i] + float(gas[0, GAUGE]))
    external[i] = mass[i] / area[i] * wp.dot(body[i], n)


@wp.kernel
def add_turning_e(
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    # outputs
    external: wp.array(dtype=float),
    turning: wp.array(dtype=float),
):
    """Add the centrifugal force of liquid that flows along a bent film, m w.(w.grad_s n) a unit of area.

    With w the velocity along the film, seen from the film as a whole, liquid on a path along the film has the normal
    acceleration d(u.n)/dt + 2 w.grad(u.n) - w.(w.grad_s n), d/dt at an E: on a sphere w^2/R of it is not the surface's.
    Its second term, small where the film swings slowly against the flow, is left out.

    Args:
        normal: [n] unit normals.
        mass: [n_e] kg.
        area: [n_e] m^2.
        u: [n] m/s.
        frame: [1] velocity of the film as a whole, m/s.
        rows: E:E neighbours.
        gradient: [pairs] surface-gradient weights, 1/m.
        external: [n_e] Pa.
        turning: [n_e] that force alone, Pa; null where nobody asks.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    w = tangential(u[i] - frame[0], n)
    turn = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        turn += wp.dot(gradient[k], w) * wp.dot(normal[rows.index[k]] - n, w)
    force = mass[i] / area[i] * turn
    external[i] = external[i] + force
    if turning:
        turning[i] = force


@wp.kernel
def free_force_e(
    normal: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    rigid: wp.array(dtype=wp.vec3),
    added: float,
    # outputs
    force: wp.array(dtype=float),
    external: wp.array(dtype=float),
):
    """Free the forces of what moves the film as a whole.

    Tension and pressure add up to nothing on a closed film, but for what undoes the tangential forces of uneven tension
    (`recoil`): their discrete sum is taken out. What outside forces do to the film as a whole is the acceleration
    `rigid[2]`, which costs no surface.

    Args:
        normal: [n] unit normals.
        mass: [n_e] kg.
        area: [n_e] m^2.
        rigid: from `rigid_motion`; zeros for an open film.
        added: as in `net_force_chunks`.
        force: [n_e] Pa.
        external: [n_e] Pa.
    """
    i = wp.tid()
    n = normal[i]
    force[i] = force[i] - wp.dot(rigid[0], n)
    external[i] = external[i] + wp.dot(rigid[1], n) - (mass[i] / area[i] + added) * wp.dot(rigid[2], n)


@wp.kernel
def load_membrane_e(
    force: wp.array(dtype=float),
    external: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    blur: float,
    dt: wp.array(dtype=float),
    # outputs
    b: wp.array(dtype=float),
    unit: wp.array(dtype=float),
    diag: wp.array(dtype=float),
):
    """Load dt a (f + (1 + blur lap_s) f_ext) on each E.

    Args:
        force: [n_e] Pa.
        external: [n_e] Pa.
        mass: [n_e] kg.
        area: [n_e] m^2.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        n_e: number of E; outside forces know of no boundary.
        blur: m^2.
        dt: [1] s.
        b: [n_e] load, kg m/s.
        unit: [n_e] load of a unit pressure.
        diag: [n_e] mass.
    """
    i = rows.first + wp.tid()
    outside = external[i]
    change = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e:
            change += weight[k] * (external[j] - outside)
    b[i] = dt[0] * (area[i] * (force[i] + outside) + blur * change)
    unit[i] = dt[0] * area[i]
    diag[i] = mass[i]


@wp.func
def softening(mass: float, bent: float) -> float:
    """What the bend of a film takes off the matrix: c 2/R^2 in small steps, nothing from m/8 on. kg/m^2."""
    return bent * wp.max(1.0 - 8.0 * bent / mass, 0.0)


@wp.kernel
def stiffen_pairs_e(
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    stiffness: wp.array(dtype=float),
    blur: float,
    bent: float,
    # outputs
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
):
    """Matrix m (1 + blur lap_s) - stiffness (lap_s + bent), times the area, with the lesser m of two E.

    It stays definite: of m no more than a 32nd is taken away, see `softening`.

    Args:
        mass: [n_e] kg.
        area: [n_e] m^2.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        n_e: number of E.
        stiffness: [1] kg.
        blur: m^2.
        bent: 2/R^2, sum of the squares of the principal curvatures of the film as a sphere, 1/m^2.
        diag: [n_e] kg.
        pair: [pairs] kg.
    """
    i = rows.first + wp.tid()
    own = mass[i] / area[i]
    diag[i] = mass[i] - area[i] * softening(own, bent * stiffness[0])
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        least = own
        if j < n_e:
            least = wp.min(own, mass[j] / area[j])
        pair[k] = weight[k] * (stiffness[0] - blur * least)


@wp.kernel
def explicit_response_e(
    b: wp.array(dtype=float),
    diag: wp.array(dtype=float),
    area: wp.array(dtype=float),
    lumped: float,
    # outputs
    x: wp.array(dtype=float),
):
    """Velocity change of the paper's explicit scheme, load over mass with `lumped` kg/m^2 of air. [n_e], m/s."""
    i = wp.tid()
    x[i] = b[i] / (diag[i] + lumped * area[i])


@wp.kernel
def lower_residual_e(
    b: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    mean: wp.array(dtype=float),
    x: wp.array(dtype=float),
    # outputs
    rhs: wp.array(dtype=float),
):
    """(b - (m - mean) a x)/a: what the operator with even mass must be applied to. [n_e].

    Where m is more than twice the mean, as an outside force holds the film, only a part of the way there from the last
    `rhs`, that of `x`: the sweeps converge whatever m is.
    """
    i = wp.tid()
    even = mean[0] * area[i]
    more = mass[i] - even
    wanted = (b[i] - more * x[i]) / area[i]
    if more > even:
        wanted = rhs[i] + even / more * (wanted - rhs[i])
    rhs[i] = wanted


@wp.kernel
def apply_membrane_e(
    normal: wp.array(dtype=wp.vec3),
    change: wp.array(dtype=float),
    response: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    rigid: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    theta_whole: float,
    dt: wp.array(dtype=float),
    # outputs
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
):
    """Add the change of normal velocity and give the speed that moves E in this step.

    Args:
        normal: [n] unit normals.
        change: [n_e] m/s.
        response: [n_e] change per unit pressure, m/s/Pa.
        gas: gas slots.
        rigid: see `rigid_motion`.
        theta: [1] 1 backward Euler, 1/2 midpoint; the pressure's share always counts in full.
        theta_whole: the same for the motion of the film as a whole.
        dt: [1] s.
        u: [n] m/s.
        u_mid: [n_e] m/s.
    """
    i = wp.tid()
    n = normal[i]
    q = float(gas[0, INCREMENT])
    whole = dt[0] * wp.dot(rigid[2], n)
    push = q * response[i]
    u_mid[i] = wp.dot(u[i], n) + theta[0] * change[i] + theta_whole * whole + push
    u[i] = u[i] + (change[i] + whole + push) * n
