"""Stage 5, redistribution of E: pseudo-pressure (20) and shifts along the surface (Algorithm 5)."""

import warp as wp

from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, region_parts
from melp_warp.kernels.rows import Quadric, away_from_near, change_along, gradient_row
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})

CLOSE = wp.constant(0.8)
"""Distance below which two E push each other apart, spacings."""

APART = wp.constant(0.2)
"""Share of what they lack that each goes in a step."""


@wp.kernel
def spread_chunks(density: wp.array(dtype=float), first: wp.array(dtype=wp.int32), part: wp.array(dtype=wp.vec4)):
    """Parts of (min delta, max delta, sum 1/delta, sum 1/delta^2)."""
    c = wp.tid()
    start, stop = part_range(c, first, part.shape[0])
    total = wp.vec4(1.0e30, 0.0, 0.0, 0.0)
    for i in range(start, stop):
        inverse = 1.0 / density[i]
        total = wp.vec4(
            wp.min(total[0], density[i]), wp.max(total[1], density[i]), total[2] + inverse, total[3] + inverse * inverse
        )
    part[c] = total


@wp.kernel
def summarize_spread_r(part: wp.array(dtype=wp.vec4), threshold: float, spread: wp.array(dtype=wp.vec3)):
    """For each region ((delta_max - delta_min)/delta_mean, delta_mean, 1 where above the threshold)."""
    g = wp.tid()
    start, stop = region_parts(g, part.shape[0], spread.shape[0])
    low = float(1.0e30)
    high = float(0.0)
    s1 = float(0.0)
    s2 = float(0.0)
    for c in range(start, stop):
        p = part[c]
        low = wp.min(low, p[0])
        high = wp.max(high, p[1])
        s1 += p[2]
        s2 += p[3]
    mean = s1 / s2
    width = (high - low) / mean
    spread[g] = wp.vec3(width, mean, wp.where(width > threshold, 1.0, 0.0))


@wp.kernel
def load_pressure_e(
    density: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    spread: wp.array(dtype=wp.vec3),
    # outputs
    b: wp.array(dtype=float),
    start: wp.array(dtype=float),
):
    """Right-hand side of (20), -lap_s C = (delta - mean)/delta times the area; zero where E are even enough. [n_e]."""
    i = wp.tid()
    d = density[i]
    s = spread[region[i]]
    b[i] = s[2] * (d - s[1]) / (d * d)
    start[i] = 0.0


@wp.kernel
def shift_e(
    pressure: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    spread: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    drift: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    strength: float,
    spacing: float,
    limit: float,
    dt: wp.array(dtype=float),
    # outputs
    x_new: wp.array(dtype=wp.vec3),
    u_new: wp.array(dtype=wp.vec3),
    drift_new: wp.array(dtype=wp.vec3),
):
    """Shift E by -strength grad_s C along the fitted surface; the velocity field stays where it is in space.

    The smooth density of (9) hardly sees pairs, which form where a sheet is bent: E that are close are parted.

    Args:
        pressure: [n] C, m^2.
        x: [n] m.
        region: [n] region of each E.
        spread: see `summarize_spread_r`.
        u: [n] material velocity, m/s.
        drift: [n_e] tangential E velocity, m/s.
        normal: [n] unit normals.
        surface: [n_e] fitted surfaces.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights, 1/m.
        strength: beta, 0 to 1.
        spacing: of the E, m.
        limit: largest shift, m; up to four times as much where the E are so uneven that their spread is above 1.
        dt: [1] s.
        x_new: [n_e] m.
        u_new: [n_e] velocity at the place moved to, m/s.
        drift_new: [n_e] drift with the shift's own velocity added (Algorithm 5, line 13), m/s.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    shift = wp.vec3()
    if spread[region[i]][2] > 0.0:
        shift = -strength * tangential(gradient_row(i, pressure, rows, gradient, pressure.shape[0]), n)
        shift += strength * APART * tangential(away_from_near(i, x, normal, rows, CLOSE * spacing), n)
    size = wp.length(shift)
    most = limit * wp.clamp(spread[region[i]][0], 1.0, 4.0)
    if size > most:
        shift = shift * (most / size)
    x_new[i] = x[i] + shift + wp.dot(shift, surface[i].second * shift) * n
    u_new[i] = u[i] + change_along(i, shift + dt[0] * drift[i], u, rows, gradient)
    drift_new[i] = drift[i] + shift / dt[0]
