"""Drag of the air on a bubble as a whole. `sphere_drag` is the one place that says how large it is."""

import warp as wp

from melp_warp.kernels.gas import AREA, VOLUME
from melp_warp.kernels.regions import region_total

wp.set_module_options({"enable_backward": False})

PI = wp.constant(3.141592653589793)

VISCOSITY = wp.constant(1.81e-5)
"""Dynamic viscosity of air at 20 degrees C, Pa s."""

NEWTON = wp.constant(0.44)
"""Drag coefficient of a sphere at a Reynolds number of 1,000 and above."""

SWEEPS = 4
"""Times that the speed halfway through a step is found anew."""


@wp.func
def sphere_drag(speed: float, radius: float, density: float) -> float:
    """Drag of a sphere in steady motion over its speed against the air, kg/s (Schiller and Naumann 1933).

    6 pi mu R (1 + 0.15 Re^0.687) with Re = 2 rho R U/mu, up to Re 1,000; from there on with C_D = 0.44.
    """
    reynolds = 2.0 * density * radius * speed / VISCOSITY
    factor = NEWTON * reynolds / 24.0
    if reynolds < 1000.0:
        factor = 1.0 + 0.15 * wp.pow(reynolds, 0.687)
    return 6.0 * PI * VISCOSITY * radius * factor


@wp.func
def mean_decay(turn: float) -> float:
    """(1 - exp(-turn))/turn, the mean of exp(-turn t) over 0 < t < 1."""
    if turn < 1.0e-2:
        return 1.0 - turn * (0.5 - turn / 6.0)
    return (1.0 - wp.exp(-turn)) / turn


@wp.kernel
def find_inertia_r(inertia: wp.array(dtype=wp.mat33), whole: wp.array(dtype=float)):
    """Inertia of a film as a whole, the mean of sum m n n over its axes. [regions], kg."""
    g = wp.tid()
    whole[g] = wp.trace(region_total(inertia, g, whole.shape[0])) / 3.0


@wp.kernel
def drag_motion_r(
    start: wp.array(dtype=wp.vec3),
    whole: wp.array(dtype=float),
    gas: wp.array2d(dtype=wp.float64),
    covered: wp.array(dtype=wp.vec4),
    density: float,
    share: float,
    dt: wp.array(dtype=float),
    # outputs
    motion: wp.array(dtype=wp.vec3),
    kick: wp.array(dtype=wp.vec3),
    force: wp.array(dtype=wp.vec3),
):
    """Change of each region's velocity as a whole by the drag of the air at rest, for any step.

    All else changes U evenly in the step, by I dU/dt = F - k U with k that of the speed halfway. With k held this has
    an exact solution, of second order in the step and stable for any.

    A region feels the drag of its sphere by the share of its area that no other region covers: a bubble within a foam
    feels none, and the drag of a large cluster grows as its outer area.

    Args:
        start: [regions] velocity of each region as a whole at the start of the step, m/s.
        whole: [regions] inertia of each region as a whole, kg.
        gas: gas slots: the sphere is that of the region's volume.
        covered: [regions] (., ., ., area that other regions cover, m^2); null for a film that no other touches.
        density: of the air, kg/m^3.
        share: factor on the drag.
        dt: [1] s.
        motion: [regions] that at the end of the step, m/s; in without the drag, out with it.
        kick: [regions] change by the drag, m/s.
        force: [regions] mean drag in the step, N.
    """
    g = wp.tid()
    radius = wp.cbrt(0.75 * float(gas[g, VOLUME]) / PI)
    bare = share
    if covered:
        bare *= wp.clamp(1.0 - covered[g][3] / float(gas[g, AREA]), 0.0, 1.0)
    before = start[g]
    pushed = motion[g] - before
    change = wp.vec3()
    for _ in range(SWEEPS):
        speed = wp.length(before + 0.5 * (pushed + change))
        turn = bare * sphere_drag(speed, radius, density) * dt[0] / whole[g]
        mean = mean_decay(turn)
        change = (mean - 1.0) * pushed - turn * mean * before
    kick[g] = change
    motion[g] = motion[g] + change
    force[g] = (whole[g] / dt[0]) * change
