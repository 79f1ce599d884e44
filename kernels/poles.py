"""Systems (W + p_k A) y_k = A b of several poles p_k at once, by conjugate gradients over levels.

W is the stiffness of the surface Laplacian in pairs, A the areas. An unknown has eight lanes. A real pole takes one of
them; a pole that is complex takes two, real and imaginary part, the first one of even number, and stands for its
conjugate too. A complex number (c, d) per pole is held as `real` = c in both lanes and `cross` = -d, d:
`times` then is the product, and that of real numbers where `cross` is 0.
"""

import warp as wp

from melp_warp.kernels.levels import STIFF
from melp_warp.kernels.linear import COUNT, ERROR, LEAST_NORM, LIMIT, START, total_of, vec8
from melp_warp.kernels.native import sum_lane_differences, sum_lane_products_of, sum_lane_shares
from melp_warp.kernels.neighbors import Neighbors

wp.set_module_options({"enable_backward": False})

# Slots of the array of what lanes are advanced with.
PRODUCT = wp.constant(0)
REAL = wp.constant(2)
CROSS = wp.constant(3)


@wp.struct
class Lanes:
    """Poles and what is done with them.

    Attributes:
        real: [1] p, 1/m^2, as above.
        cross: [1] the same.
        paired: [1] 1 in the two lanes of a complex pole, else 0.
        tied: [1] 1 where the real part of p is above 0. Elsewhere, in short steps, |p| is above all eigenvalues: p A
            alone is near the matrix, and 0 here leaves W out of the preconditioner.
        load: [1] 1 where a lane's right-hand side is that of all, 0 where it is an imaginary part, or none.
        residue: [1] share of each lane in the sum.
        weight: [1] of each pole in the error of the sum, over the energy norm of its residual; 0 in imaginary lanes.
    """

    real: wp.array(dtype=vec8)
    cross: wp.array(dtype=vec8)
    paired: wp.array(dtype=vec8)
    tied: wp.array(dtype=vec8)
    load: wp.array(dtype=vec8)
    residue: wp.array(dtype=vec8)
    weight: wp.array(dtype=vec8)


@wp.func
def times(real: vec8, cross: vec8, v: vec8) -> vec8:
    """Product of the numbers (real, cross) with v."""
    out = vec8()
    for m in range(4):
        out[2 * m] = real[2 * m] * v[2 * m] + cross[2 * m] * v[2 * m + 1]
        out[2 * m + 1] = real[2 * m + 1] * v[2 * m + 1] + cross[2 * m + 1] * v[2 * m]
    return out


@wp.func
def over(v: vec8, rest: float, mass: float, lanes: Lanes) -> vec8:
    """v/(rest + p mass)."""
    real = lanes.real[0]
    cross = lanes.cross[0]
    tied = lanes.tied[0]
    for k in range(8):
        c = tied[k] * rest + real[k] * mass
        d = cross[k] * mass
        size = 1.0 / wp.max(c * c + d * d, 1.0e-37)
        real[k] = c * size
        cross[k] = -d * size
    return times(real, cross, v)


@wp.func
def apply_lanes(
    i: int,
    y: wp.array(dtype=vec8),
    area: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    rows: Neighbors,
    lanes: Lanes,
) -> vec8:
    """((W + p A) y)_i."""
    return area[i] * times(lanes.real[0], lanes.cross[0], y[i]) + sum_lane_differences(i, y, pair, rows)


@wp.kernel
def load_lanes(
    b: wp.array(dtype=float),
    area: wp.array(dtype=float),
    lanes: Lanes,
    # outputs
    r: wp.array(dtype=vec8),
    y: wp.array(dtype=vec8),
):
    """Residual A b of y = 0. [n]."""
    i = wp.tid()
    r[i] = area[i] * b[i] * lanes.load[0]
    y[i] = vec8()


@wp.kernel
def find_residual_lanes(
    b: wp.array(dtype=float),
    y: wp.array(dtype=vec8),
    area: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    rows: Neighbors,
    lanes: Lanes,
    # outputs
    r: wp.array(dtype=vec8),
):
    """Residual of y, whose entries beyond the unknowns are 0. [n]."""
    i = rows.first + wp.tid()
    r[i] = area[i] * b[i] * lanes.load[0] - apply_lanes(i, y, area, pair, rows, lanes)


@wp.kernel
def apply_all_lanes(
    p: wp.array(dtype=vec8),
    area: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    rows: Neighbors,
    lanes: Lanes,
    # outputs
    q: wp.array(dtype=vec8),
):
    """q = (W + p A) p. [n]."""
    i = rows.first + wp.tid()
    q[i] = apply_lanes(i, p, area, pair, rows, lanes)


@wp.kernel
def coarsen_mass_p(
    down: Neighbors,
    weight: wp.array(dtype=float),
    fade: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    # outputs
    mass_next: wp.array(dtype=float),
):
    """Area that each place of the next level stands for, m^2: of a wave that its neighbours are part of, too."""
    c = down.first + wp.tid()
    total = float(0.0)
    for k in range(down.start[c], down.stop[c]):
        i = down.index[k]
        total += weight[k] * fade[i] * fade[i] * mass[i]
    mass_next[c] = total


@wp.kernel
def divide_lanes(
    r: wp.array(dtype=vec8),
    held: wp.array(dtype=float),
    stiff: wp.array(dtype=float),
    area: wp.array(dtype=float),
    lanes: Lanes,
    # outputs
    z: wp.array(dtype=vec8),
):
    """z = D^-1 r. [n]."""
    i = wp.tid()
    z[i] = over(r[i], held[i] + stiff[i], area[i], lanes)


@wp.kernel
def restrict_lanes_p(
    down: Neighbors,
    weight: wp.array(dtype=float),
    fade: wp.array(dtype=float),
    r: wp.array(dtype=vec8),
    held: wp.array(dtype=float),
    stiff: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    lanes: Lanes,
    # outputs
    r_next: wp.array(dtype=vec8),
    z_next: wp.array(dtype=vec8),
):
    """What of a residual each place of the next level stands for, and that over the diagonal there.

    `held`, `stiff` and `mass` are of the next level. An empty place has none of them, and no residual.
    """
    c = down.first + wp.tid()
    total = sum_lane_products_of(c, r, fade, weight, down)
    r_next[c] = total
    z_next[c] = wp.cw_mul(lanes.tied[0], over(total, held[c] + STIFF * stiff[c], mass[c], lanes))


@wp.kernel
def add_next_lanes_p(
    up: Neighbors,
    weight: wp.array(dtype=float),
    fade: wp.array(dtype=float),
    z_next: wp.array(dtype=vec8),
    # outputs
    z: wp.array(dtype=vec8),
):
    """Add to each point what the places of the next level that it is shared among have."""
    i = up.first + wp.tid()
    z[i] = z[i] + fade[i] * sum_lane_shares(i, z_next, weight, up)


@wp.kernel
def dot_lanes_chunks(
    a: wp.array(dtype=vec8),
    b: wp.array(dtype=vec8),
    n: int,
    # outputs
    same: wp.array(dtype=vec8),
    other: wp.array(dtype=vec8),
):
    """Parts of sum a_k b_k in each lane, and of a_k times the lane beside."""
    c = wp.tid()
    size = (n + same.shape[0] - 1) // same.shape[0]
    straight = vec8()
    across = vec8()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        u = a[i]
        v = b[i]
        for m in range(4):
            straight[2 * m] += u[2 * m] * v[2 * m]
            straight[2 * m + 1] += u[2 * m + 1] * v[2 * m + 1]
            across[2 * m] += u[2 * m] * v[2 * m + 1]
            across[2 * m + 1] += u[2 * m + 1] * v[2 * m]
    same[c] = straight
    other[c] = across


@wp.func
def lane_total(part: wp.array(dtype=vec8)) -> vec8:
    """Sum of the parts."""
    total = vec8()
    for c in range(part.shape[0]):
        total += part[c]
    return total


@wp.func
def real_product(same: vec8, paired: vec8, k: int) -> float:
    """Real part of a.b of the pole in lane k, nothing conjugated."""
    other = k + 1 - 2 * (k % 2)
    sign = 1.0 - 2.0 * float(k % 2)
    return wp.where(paired[k] > 0.0, sign * (same[k] - same[other]), same[k])


@wp.func
def imaginary_product(across: vec8, paired: vec8, k: int) -> float:
    """The imaginary part, as `cross`."""
    other = k + 1 - 2 * (k % 2)
    sign = 2.0 * float(k % 2) - 1.0
    return wp.where(paired[k] > 0.0, sign * (across[k] + across[other]), 0.0)


@wp.func
def divide_numbers(real: vec8, cross: vec8, by_real: vec8, by_cross: vec8, slot: int, numbers: wp.array(dtype=vec8)):
    """Set the numbers at `slot` to a quotient; 0 where the divisor has died away. Scaled: squares would underflow."""
    out_real = vec8()
    out_cross = vec8()
    for k in range(8):
        size = wp.max(wp.abs(by_real[k]), wp.abs(by_cross[k]))
        if size > 0.0:
            c = by_real[k] / size
            d = by_cross[k] / size
            e = real[k] / size
            f = cross[k] / size
            square = c * c + d * d
            out_real[k] = (e * c + f * d) / square
            out_cross[k] = (f * c - e * d) / square
    numbers[slot] = out_real
    numbers[slot + 1] = out_cross


@wp.func
def set_products(
    same: wp.array(dtype=vec8),
    across: wp.array(dtype=vec8),
    lanes: Lanes,
    numbers: wp.array(dtype=vec8),
) -> float:
    """Set (r, z) of each pole from the sums of its lanes; returns the square of the bound of the error of the sum."""
    straight = lane_total(same)
    beside = lane_total(across)
    paired = lanes.paired[0]
    weight = lanes.weight[0]
    real = vec8()
    cross = vec8()
    bound = float(0.0)
    for k in range(8):
        real[k] = real_product(straight, paired, k)
        cross[k] = imaginary_product(beside, paired, k)
        other = k + 1 - 2 * (k % 2)
        energy = wp.where(paired[k] > 0.0, wp.abs(straight[k] + straight[other]), wp.abs(straight[k]))
        turned = wp.where(paired[k] > 0.0, wp.abs(beside[k] - beside[other]), 0.0)
        bound += weight[k] * wp.sqrt(energy + turned)
    numbers[PRODUCT] = real
    numbers[PRODUCT + 1] = cross
    return bound * bound


@wp.kernel
def start_lane_scalars(
    same: wp.array(dtype=vec8),
    across: wp.array(dtype=vec8),
    loaded: wp.array(dtype=float),
    control: wp.array(dtype=float),
    lanes: Lanes,
    # outputs
    numbers: wp.array(dtype=vec8),
    scalar: wp.array(dtype=float),
    go: wp.array(dtype=int),
):
    """Set the stopping limit, tol^2 sum a b^2, and whether to iterate at all. control = (tolerance, iterations)."""
    error = set_products(same, across, lanes, numbers)
    reference = wp.max(total_of(loaded), LEAST_NORM)
    scalar[ERROR] = error
    scalar[START] = reference
    scalar[LIMIT] = control[0] * control[0] * reference
    scalar[COUNT] = 0.0
    go[0] = wp.where(error > scalar[LIMIT] and control[1] >= 1.0, 1, 0)


@wp.kernel
def set_lane_steps(
    same: wp.array(dtype=vec8),
    across: wp.array(dtype=vec8),
    lanes: Lanes,
    go: wp.array(dtype=int),
    # outputs
    numbers: wp.array(dtype=vec8),
):
    """alpha = (r, z)/(p, A p) of each pole; 0 where iterations are counted off and `go` is 0 already."""
    straight = lane_total(same)
    beside = lane_total(across)
    paired = lanes.paired[0]
    real = vec8()
    cross = vec8()
    if go[0] != 0:
        for k in range(8):
            real[k] = real_product(straight, paired, k)
            cross[k] = imaginary_product(beside, paired, k)
    divide_numbers(numbers[PRODUCT], numbers[PRODUCT + 1], real, cross, REAL, numbers)


@wp.kernel
def set_lane_turns(
    same: wp.array(dtype=vec8),
    across: wp.array(dtype=vec8),
    control: wp.array(dtype=float),
    lanes: Lanes,
    # outputs
    numbers: wp.array(dtype=vec8),
    scalar: wp.array(dtype=float),
    go: wp.array(dtype=int),
):
    """beta = (r, z)_new/(r, z)_old of each pole, and whether to go on. Where `go` is 0 already nothing changes."""
    if go[0] == 0:
        return
    real = numbers[PRODUCT]
    cross = numbers[PRODUCT + 1]
    error = set_products(same, across, lanes, numbers)
    divide_numbers(numbers[PRODUCT], numbers[PRODUCT + 1], real, cross, REAL, numbers)
    scalar[ERROR] = error
    scalar[COUNT] = scalar[COUNT] + 1.0
    if not (error > scalar[LIMIT]) or scalar[COUNT] >= control[1]:
        go[0] = 0


@wp.kernel
def advance_lanes(
    numbers: wp.array(dtype=vec8),
    p: wp.array(dtype=vec8),
    q: wp.array(dtype=vec8),
    held: wp.array(dtype=float),
    stiff: wp.array(dtype=float),
    area: wp.array(dtype=float),
    lanes: Lanes,
    # outputs
    y: wp.array(dtype=vec8),
    r: wp.array(dtype=vec8),
    z: wp.array(dtype=vec8),
):
    """y += alpha p, r -= alpha q, z = D^-1 r. [n]."""
    i = wp.tid()
    real = numbers[REAL]
    cross = numbers[CROSS]
    y[i] = y[i] + times(real, cross, p[i])
    left = r[i] - times(real, cross, q[i])
    r[i] = left
    z[i] = over(left, held[i] + stiff[i], area[i], lanes)


@wp.kernel
def turn_lanes(numbers: wp.array(dtype=vec8), z: wp.array(dtype=vec8), p: wp.array(dtype=vec8)):
    """p = z + beta p. [n]."""
    i = wp.tid()
    p[i] = z[i] + times(numbers[REAL], numbers[CROSS], p[i])


@wp.kernel
def sum_lanes(y: wp.array(dtype=vec8), lanes: Lanes, x: wp.array(dtype=float)):
    """x = sum of the poles' solutions times their residues. [n]."""
    i = wp.tid()
    x[i] = wp.dot(lanes.residue[0], y[i])
