"""Body accelerations on the film, and how they enter implicit solves.

A force whose acceleration a falls at the rate r as the velocity grows changes a velocity by dt a/h in a step,
h = r dt/(1 - exp(-r dt)): alone it is followed exactly, however stiff it is, and for small r dt this is the midpoint
rule. With other forces F in the same solve (h m) du = dt (m a + F): h m takes the place of the inertia.
"""

import warp as wp

from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})


@wp.kernel
def set_gravity_e(gravity: wp.array(dtype=wp.vec3), body: wp.array(dtype=wp.vec3)):
    """Start the field of body accelerations with gravity. [n_e], m/s^2."""
    i = wp.tid()
    body[i] = gravity[0]


@wp.func
def hold_of(rate: float, dt: float) -> float:
    """z/(1 - exp(-z)), z = rate dt: inertia over mass. 1 where the force does not fall with the velocity."""
    z = wp.max(rate, 0.0) * dt
    if z < 0.02:
        return 1.0 + z * (0.5 + z / 12.0)
    return z / (1.0 - wp.exp(-z))


@wp.kernel
def weigh_down_e(
    mass: wp.array(dtype=float),
    hold: wp.array(dtype=float),
    hung: wp.array(dtype=float),
    gain: wp.array(dtype=float),
    # outputs
    inertia: wp.array(dtype=float),
    heavy: wp.array(dtype=float),
    ease: wp.array(dtype=float),
):
    """What resists a change of velocity.

    Args:
        mass: [n_e] kg.
        hold: [n_e] inertia over mass.
        hung: [n_e] mass with what hangs on E, kg; null where nothing does.
        gain: [n_e] see `Geometry.gain`; null where it is 1.
        inertia: [n_e] kg.
        heavy: [n_e] the same with what hangs on E, kg; null where nothing does.
        ease: [n_e] what fluxes of (14) count times; null where there are none.
    """
    i = wp.tid()
    more = (hold[i] - 1.0) * mass[i]
    inertia[i] = mass[i] + more
    if heavy:
        heavy[i] = hung[i] + more
    if ease:
        own = 1.0 / hold[i]
        if gain:
            own *= gain[i]
        ease[i] = own


@wp.kernel
def take_flow_e(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    still: wp.array(dtype=wp.vec3),
    rate: wp.array(dtype=float),
    # outputs
    body: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
):
    """Along the film, go on from the velocity u [n] (m/s), as viscosity has left it. [n_e].

    Args:
        u: [n] m/s.
        normal: [n] unit normals.
        still: [n_e] acceleration at rest, m/s^2.
        rate: [n_e] by which it falls as the velocity grows, 1/s.
        body: [n_e] acceleration, m/s^2.
        before: [n_e] velocity that it is of, m/s.
    """
    i = wp.tid()
    n = normal[i]
    along = tangential(u[i], n)
    body[i] = wp.dot(body[i], n) * n + tangential(still[i], n) - rate[i] * along
    before[i] = wp.dot(before[i], n) * n + along


@wp.kernel
def settle_body_e(
    u: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
    hold: wp.array(dtype=float),
    theta: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    body: wp.array(dtype=wp.vec3),
):
    """What the forces were in the mean of the step, a - (h - 1) du/dt.

    Args:
        u: [n] velocity after the share theta of the step, m/s.
        before: [n_e] that from which the forces went on, m/s.
        hold: [n_e] h.
        theta: [1].
        dt: [1] s.
        body: [n_e] acceleration at the start of the step, then its mean, m/s^2.
    """
    i = wp.tid()
    body[i] = body[i] - (hold[i] - 1.0) / (theta[0] * dt[0]) * (u[i] - before[i])


@wp.kernel
def note_braking_e(
    body: wp.array(dtype=wp.vec3),
    still: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    # outputs
    push: wp.array(dtype=wp.vec3),
):
    """Add theta dt times the mean acceleration (m/s^2) of a step less that at rest. [n_e], m/s."""
    i = wp.tid()
    push[i] = push[i] + theta[0] * dt[0] * (body[i] - still[i])
