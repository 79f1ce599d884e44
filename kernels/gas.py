"""The gas inside a closed film: enclosed volume (11), pressure, and their agreement."""

import warp as wp

from melp_warp.kernels.regions import part_range, part_region, region_total

wp.set_module_options({"enable_backward": False})

# Slots of the gas array (float64).
VOLUME = wp.constant(0)
GAUGE = wp.constant(1)
AMOUNT = wp.constant(2)
INCREMENT = wp.constant(3)
AREA = wp.constant(4)
OFFSET = wp.constant(5)


@wp.kernel
def swept_chunks(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    kappa: wp.array(dtype=float),
    change: wp.array(dtype=float),
    response: wp.array(dtype=float),
    frame: wp.array(dtype=wp.vec3),
    theta: wp.array(dtype=float),
    dt: wp.array(dtype=float),
    n: int,
    # outputs
    swept: wp.array(dtype=wp.vec3d),
):
    """Volume swept in the step as a polynomial in the pressure increment q, in parts and in float64.

    A normal displacement d sweeps a (d - kappa d^2/2). Motion of the film as a whole sweeps nothing and is left out.
    """
    c = wp.tid()
    size = (n + swept.shape[0] - 1) // swept.shape[0]
    total = wp.vec3d()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        ni = normal[i]
        d = dt[0] * (wp.dot(u[i] - frame[0], ni) + theta[0] * change[i])
        e = dt[0] * response[i]
        a = area[i]
        half = 0.5 * kappa[i]
        total += wp.vec3d(
            wp.float64(a * (d - half * d * d)),
            wp.float64(a * (1.0 - 2.0 * half * d) * e),
            wp.float64(-a * half * e * e),
        )
    swept[c] = total


@wp.kernel
def close_gas(
    swept: wp.array(dtype=wp.vec3d),
    p_atm: wp.float64,
    # outputs
    gas: wp.array2d(dtype=wp.float64),
):
    """Pressure increment q with (p + q) V(q) = n_0 R T at the end of the step; the gauge pressure is carried.

    The part linear in q gives a quadratic with exactly one root of positive pressure and volume; three Newton steps
    add the curvature term.
    """
    total = wp.vec3d()
    for c in range(swept.shape[0]):
        total += swept[c]
    p = p_atm + gas[0, GAUGE]
    v = gas[0, VOLUME] + total[0]
    s = total[1]
    amount = gas[0, AMOUNT]
    low = p * v - amount
    mid = v + p * s
    root = wp.sqrt(mid * mid - wp.float64(4.0) * s * low)
    q = wp.float64(0.0)
    if mid > wp.float64(0.0):
        q = -wp.float64(2.0) * low / (mid + root)
    else:
        q = (root - mid) / (wp.float64(2.0) * s)
    for _ in range(3):
        volume = v + (s + total[2] * q) * q
        slope = volume + (p + q) * (s + wp.float64(2.0) * total[2] * q)
        if volume > wp.float64(0.0) and slope > wp.float64(0.0):
            q -= ((p + q) * volume - amount) / slope
    gas[0, INCREMENT] = q
    gas[0, GAUGE] = gas[0, GAUGE] + q


@wp.kernel
def volume_chunks(
    x: wp.array(dtype=wp.vec3),
    cell: wp.array(dtype=float),
    flux: wp.array(dtype=wp.vec3),
    bulge: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array(dtype=wp.vec2d),
):
    """Parts of the enclosed volume (11), a third of the integral of (x - x_0).n over the cells, and of the area.

    Args:
        x: [n] m.
        cell: [n_e] cell areas, m^2.
        flux: [n_e] m^2, see `voronoi_cell_e`.
        bulge: [n_e] m^3, likewise.
        first: see `part_range`.
        part: parts of (volume, area), m^3 and m^2.
    """
    c = wp.tid()
    start, stop = part_range(c, first, part.shape[0])
    total = wp.vec2d()
    o = x[first[part_region(c, first, part.shape[0])]]
    for i in range(start, stop):
        triple = wp.float64(wp.dot(x[i] - o, flux[i])) + wp.float64(bulge[i])
        total += wp.vec2d(triple / wp.float64(3.0), wp.float64(cell[i]))
    part[c] = total


@wp.kernel
def store_volume_r(part: wp.array(dtype=wp.vec2d), gas: wp.array2d(dtype=wp.float64)):
    """Put each region's measured volume and area into its gas slots."""
    g = wp.tid()
    total = region_total(part, g, gas.shape[0])
    gas[g, VOLUME] = total[0]
    gas[g, AREA] = total[1]


@wp.kernel
def find_offset_r(p_atm: wp.float64, limit: wp.float64, gas: wp.array2d(dtype=wp.float64)):
    """Normal offset (at most `limit`, m) that gives the measured volume the size its pressure asks for.

    The swept volume that `close_gas` predicts is of second order in the displacement; what it misses is mended here
    and not left to the next step's pressure. The volume slot then holds the volume after the offset. A region that is
    open to the outside holds no amount and takes whatever volume.
    """
    g = wp.tid()
    wanted = gas[g, AMOUNT] / (p_atm + gas[g, GAUGE])
    if gas[g, AMOUNT] == wp.float64(0.0):
        wanted = gas[g, VOLUME]
    offset = wp.clamp((wanted - gas[g, VOLUME]) / gas[g, AREA], -limit, limit)
    gas[g, OFFSET] = offset
    gas[g, VOLUME] = gas[g, VOLUME] + offset * gas[g, AREA]


@wp.kernel
def offset_surface_e(
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    gas: wp.array2d(dtype=wp.float64),
    # outputs
    x: wp.array(dtype=wp.vec3),
):
    """Move E along their normals by the offset in the gas slots of their region. [n_e], m."""
    i = wp.tid()
    x[i] = x[i] + float(gas[region[i], OFFSET]) * normal[i]
