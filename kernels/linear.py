"""Matrix-free solvers for A x = b with (A x)_i = diag_i x_i + scale sum_j c_ij (x_i - x_j), c symmetric.

All scalars stay on the device, so that a whole solve is one graph. Neighbours beyond the unknowns hold x = 0
(Dirichlet) or have c = 0 (Neumann).
"""

from typing import Any

import warp as wp

from melp_warp.kernels.native import advance_entries, sum_differences, sum_products, sum_row, turn_entries, vec8
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import part_range, region_total

wp.set_module_options({"enable_backward": False})

POLES = 8

# Slots of the scalar arrays.
RZ = wp.constant(0)
LIMIT = wp.constant(1)
ALPHA = wp.constant(2)
BETA = wp.constant(3)
COUNT = wp.constant(4)
START = wp.constant(5)
ALPHA_OLD = wp.constant(6)
ERROR = wp.constant(7)

# Slots of the array in which solves are watched.
WORST = wp.constant(0)
LATE = wp.constant(1)
SOLVES = wp.constant(2)
MOST = wp.constant(3)

LEAST_NORM = wp.constant(1.0e-37)
"""Least squared norm of a load that a residual is measured against: what lies below float32 cannot square."""


@wp.func
def inner(a: float, b: float) -> float:
    """Product of scalars, so that one kernel serves scalars and vectors."""
    return a * b


@wp.func
def inner(a: wp.vec3, b: wp.vec3) -> float:  # noqa: F811
    """Dot product."""
    return wp.dot(a, b)


@wp.func
def products(a: wp.array(dtype=float), b: wp.array(dtype=float), begin: int, end: int) -> float:
    """sum_k a_k.b_k for k from `begin` to `end`."""
    return sum_products(a, b, begin, end)


@wp.func
def products(a: wp.array(dtype=wp.vec3), b: wp.array(dtype=wp.vec3), begin: int, end: int) -> float:  # noqa: F811
    """The same for vectors."""
    total = float(0.0)
    for k in range(begin, end):
        total += wp.dot(a[k], b[k])
    return total


@wp.func
def differences(i: int, x: wp.array(dtype=float), pair: wp.array(dtype=float), rows: Neighbors) -> float:
    """sum_j pair_ij (x_i - x_j)."""
    return sum_differences(i, x, pair, rows)


@wp.func
def differences(i: int, x: wp.array(dtype=wp.vec3), pair: wp.array(dtype=float), rows: Neighbors) -> wp.vec3:  # noqa: F811
    """The same for vectors."""
    xi = x[i]
    total = wp.vec3()
    for k in range(rows.start[i], rows.stop[i]):
        total += pair[k] * (xi - x[rows.index[k]])
    return total


@wp.func
def step(
    begin: int,
    end: int,
    alpha: float,
    p: wp.array(dtype=float),
    q: wp.array(dtype=float),
    inverse: wp.array(dtype=float),
    x: wp.array(dtype=float),
    r: wp.array(dtype=float),
    z: wp.array(dtype=float),
):
    """x += alpha p, r -= alpha q, z = inverse r for entries `begin` to `end`."""
    advance_entries(begin, end, alpha, p, q, inverse, x, r, z)


@wp.func
def step(  # noqa: F811
    begin: int,
    end: int,
    alpha: float,
    p: wp.array(dtype=wp.vec3),
    q: wp.array(dtype=wp.vec3),
    inverse: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    r: wp.array(dtype=wp.vec3),
    z: wp.array(dtype=wp.vec3),
):
    """The same for vectors."""
    for k in range(begin, end):
        x[k] = x[k] + alpha * p[k]
        left = r[k] - alpha * q[k]
        r[k] = left
        z[k] = inverse[k] * left


@wp.func
def turn(begin: int, end: int, beta: float, z: wp.array(dtype=float), p: wp.array(dtype=float)):
    """p = z + beta p for entries `begin` to `end`."""
    turn_entries(begin, end, beta, z, p)


@wp.func
def turn(begin: int, end: int, beta: float, z: wp.array(dtype=wp.vec3), p: wp.array(dtype=wp.vec3)):  # noqa: F811
    """The same for vectors."""
    for k in range(begin, end):
        p[k] = z[k] + beta * p[k]


@wp.func
def apply_row(
    i: int,
    x: wp.array(dtype=Any),
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    scale: float,
    rows: Neighbors,
):
    """(A x)_i."""
    return diag[i] * x[i] + scale * differences(i, x, pair, rows)


@wp.kernel
def invert_diagonal(
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    rows: Neighbors,
    # outputs
    inverse: wp.array(dtype=float),
):
    """1/A_ii, the Jacobi preconditioner. [n]."""
    i = rows.first + wp.tid()
    a = diag[i] + scale[0] * sum_row(i, pair, rows)
    inverse[i] = wp.where(a > 0.0, 1.0 / a, 0.0)


@wp.kernel
def start_residual(
    x: wp.array(dtype=Any),
    b: wp.array(dtype=Any),
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    rows: Neighbors,
    inverse: wp.array(dtype=float),
    # outputs
    r: wp.array(dtype=Any),
    z: wp.array(dtype=Any),
    p: wp.array(dtype=Any),
):
    """r = b - A x, z = r/A_ii, p = z."""
    i = rows.first + wp.tid()
    ri = b[i] - apply_row(i, x, diag, pair, scale[0], rows)
    r[i] = ri
    zi = inverse[i] * ri
    z[i] = zi
    p[i] = zi


@wp.kernel
def apply_operator(
    x: wp.array(dtype=Any),
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    rows: Neighbors,
    # outputs
    y: wp.array(dtype=Any),
):
    """y = A x. [n]."""
    i = rows.first + wp.tid()
    y[i] = apply_row(i, x, diag, pair, scale[0], rows)


@wp.kernel
def dot_chunks(a: wp.array(dtype=Any), b: wp.array(dtype=Any), n: int, partial: wp.array(dtype=float)):
    """Dot product of the first n entries in as many parts as there are threads."""
    c = wp.tid()
    size = (n + partial.shape[0] - 1) // partial.shape[0]
    partial[c] = products(a, b, c * size, wp.min(n, (c + 1) * size))


@wp.kernel
def weighted_chunks(
    a: wp.array(dtype=Any), b: wp.array(dtype=Any), w: wp.array(dtype=float), n: int, partial: wp.array(dtype=float)
):
    """As `dot_chunks`, with a weight an entry."""
    c = wp.tid()
    size = (n + partial.shape[0] - 1) // partial.shape[0]
    total = float(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        total += inner(w[i] * a[i], b[i])
    partial[c] = total


@wp.func
def total_of(partial: wp.array(dtype=float)) -> float:
    """Sum of the parts."""
    total = float(0.0)
    for c in range(partial.shape[0]):
        total += partial[c]
    return total


@wp.kernel
def start_scalars(
    rz: wp.array(dtype=float),
    bz: wp.array(dtype=float),
    control: wp.array(dtype=float),
    change: float,
    # outputs
    scalar: wp.array(dtype=float),
    go: wp.array(dtype=int),
):
    """Set the stopping limit and whether to iterate at all. control = (tolerance, iterations).

    The limit is tol^2 (b, b/A_ii) or, where `change` is above 0, tol^2 of the first residual (r, z) and `change` times
    that: what the solve changes is then found to the tolerance, unless it is lost in rounding.
    """
    value = total_of(rz)
    reference = wp.max(total_of(bz), LEAST_NORM)
    if change > 0.0:
        reference = value + change * reference
    scalar[RZ] = value
    scalar[ERROR] = value
    scalar[START] = reference
    scalar[LIMIT] = control[0] * control[0] * reference
    scalar[COUNT] = 0.0
    scalar[ALPHA] = 1.0
    scalar[BETA] = 0.0
    go[0] = wp.where(value > scalar[LIMIT] and control[1] >= 1.0, 1, 0)


@wp.kernel
def set_alpha(pq: wp.array(dtype=float), go: wp.array(dtype=int), scalar: wp.array(dtype=float)):
    """alpha = (r, z)/(p, A p); 0, so that nothing changes, where iterations are counted off and `go` is 0 already."""
    value = total_of(pq)
    scalar[ALPHA_OLD] = scalar[ALPHA]
    scalar[ALPHA] = wp.where(value > 0.0 and go[0] != 0, scalar[RZ] / value, 0.0)


@wp.kernel
def set_beta(
    rz: wp.array(dtype=float),
    control: wp.array(dtype=float),
    slack: float,
    # outputs
    scalar: wp.array(dtype=float),
    go: wp.array(dtype=int),
):
    """beta = (r, z)_new/(r, z)_old and whether to go on. control = (tolerance, iterations).

    The limit is taken `slack` times; 0 leaves the decision to another kernel. Where `go` is 0 already beta is 0.
    """
    if go[0] == 0:
        scalar[BETA] = 0.0
        return
    value = total_of(rz)
    scalar[BETA] = wp.where(scalar[RZ] > 0.0, value / scalar[RZ], 0.0)
    scalar[RZ] = value
    scalar[ERROR] = value
    scalar[COUNT] = scalar[COUNT] + 1.0
    if not (value > slack * scalar[LIMIT]) or scalar[COUNT] >= control[1] or scalar[ALPHA] == 0.0:
        go[0] = 0


@wp.kernel
def set_product(rz: wp.array(dtype=float), scalar: wp.array(dtype=float)):
    """Set (r, z) where it is not what the residual is measured by."""
    scalar[RZ] = total_of(rz)


@wp.kernel
def stop_at_limit(
    measured: wp.array(dtype=float),
    # outputs
    scalar: wp.array(dtype=float),
    go: wp.array(dtype=int),
):
    """Stop where the residual is within the limit by another measure than (r, z); follows `set_beta`."""
    error = total_of(measured)
    scalar[ERROR] = error
    if not (error > scalar[LIMIT]):
        go[0] = 0


@wp.kernel
def advance_solution(
    scalar: wp.array(dtype=float),
    p: wp.array(dtype=Any),
    q: wp.array(dtype=Any),
    inverse: wp.array(dtype=float),
    size: int,
    # outputs
    x: wp.array(dtype=Any),
    r: wp.array(dtype=Any),
    z: wp.array(dtype=Any),
):
    """x += alpha p, r -= alpha A p, z = r/A_ii for `size` entries."""
    begin = size * wp.tid()
    step(begin, wp.min(r.shape[0], begin + size), scalar[ALPHA], p, q, inverse, x, r, z)


@wp.kernel
def advance_direction(scalar: wp.array(dtype=float), z: wp.array(dtype=Any), size: int, p: wp.array(dtype=Any)):
    """p = z + beta p for `size` entries."""
    begin = size * wp.tid()
    turn(begin, wp.min(z.shape[0], begin + size), scalar[BETA], z, p)


@wp.kernel
def sweep_jacobi(
    x: wp.array(dtype=Any),
    b: wp.array(dtype=Any),
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    rows: Neighbors,
    inverse: wp.array(dtype=float),
    omega: float,
    # outputs
    r: wp.array(dtype=Any),
    z: wp.array(dtype=Any),
    next_x: wp.array(dtype=Any),
):
    """One relaxed Jacobi sweep (Appendix B), with the residual it started from."""
    i = rows.first + wp.tid()
    ri = b[i] - apply_row(i, x, diag, pair, scale[0], rows)
    r[i] = ri
    z[i] = inverse[i] * ri
    next_x[i] = x[i] + omega * inverse[i] * ri


@wp.func
def c_mul(a: wp.vec2, b: wp.vec2) -> wp.vec2:
    """Product of complex numbers."""
    return wp.vec2(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.func
def c_div(a: wp.vec2, b: wp.vec2) -> wp.vec2:
    """Quotient of complex numbers; 0 where the divisor has died away."""
    size = wp.length_sq(b)
    if size < 1.0e-30:
        return wp.vec2()
    return c_mul(a, wp.vec2(b[0], -b[1])) / size


@wp.struct
class Poles:
    """f(lambda) = Re sum_k g_k/(lambda + p_k), with complex numbers as wp.vec2. p_0 is real and above 0.

    `weight` bounds the share of each pole in the error of the sum.
    """

    p: wp.array(dtype=wp.vec2)
    g: wp.array(dtype=wp.vec2)
    weight: wp.array(dtype=float)


@wp.kernel
def start_shifted(
    b: wp.array(dtype=float),
    area: wp.array(dtype=float),
    # outputs
    r: wp.array(dtype=float),
    p: wp.array(dtype=float),
    real: wp.array(dtype=vec8),
    imag: wp.array(dtype=vec8),
    x: wp.array(dtype=float),
):
    """Start multi-shift conjugate gradients from x = 0 with b scaled by sqrt(area)."""
    i = wp.tid()
    value = b[i] * wp.sqrt(area[i])
    r[i] = value
    p[i] = value
    x[i] = 0.0
    d = vec8()
    for k in range(8):
        d[k] = value
    real[i] = d
    imag[i] = vec8()


@wp.kernel
def start_zeta(zeta: wp.array2d(dtype=wp.vec2)):
    """zeta[0] = zeta[1] = 1: collinearity factors now and before.

    zeta[2] holds the steps times the residues, zeta[3] the factors of the directions.
    """
    k = wp.tid()
    zeta[0, k] = wp.vec2(1.0, 0.0)
    zeta[1, k] = wp.vec2(1.0, 0.0)


@wp.kernel
def scale_pairs(
    area: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    rows: Neighbors,
    # outputs
    scaled: wp.array(dtype=float),
    diag: wp.array(dtype=float),
):
    """D = -area^-1/2 (a_i a_j K_ij Laplacian) area^-1/2, the negative surface Laplacian, as pairs and a rest.

    (D p)_i = diag_i p_i + sum_j scaled_ij (p_i - p_j). Entries beyond the unknowns hold p = 0: their pair goes to the
    diagonal.
    """
    i = rows.first + wp.tid()
    si = 1.0 / wp.sqrt(area[i])
    rest = float(0.0)
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        full = si * si * pair[k]
        c = float(0.0)
        if j < area.shape[0]:
            c = si / wp.sqrt(area[j]) * pair[k]
        scaled[k] = c
        rest += full - c
    diag[i] = rest


@wp.kernel
def apply_shifted(
    p: wp.array(dtype=float),
    diag: wp.array(dtype=float),
    scaled: wp.array(dtype=float),
    poles: Poles,
    rows: Neighbors,
    # outputs
    q: wp.array(dtype=float),
):
    """q = (D + p_0) p with the matrix of `scale_pairs`."""
    i = rows.first + wp.tid()
    q[i] = (poles.p[0][0] + diag[i]) * p[i] + sum_differences(i, p, scaled, rows)


@wp.kernel
def set_zeta(scalar: wp.array(dtype=float), poles: Poles, zeta: wp.array2d(dtype=wp.vec2)):
    """Next collinearity factor and step of each shifted system."""
    k = wp.tid()
    alpha = scalar[ALPHA]
    alpha_old = scalar[ALPHA_OLD]
    now = zeta[0, k]
    old = zeta[1, k]
    shift = poles.p[k] - poles.p[0]
    below = alpha * scalar[BETA] * (old - now) + alpha_old * c_mul(old, wp.vec2(1.0, 0.0) + alpha * shift)
    following = alpha_old * c_div(c_mul(now, old), below)
    zeta[2, k] = c_mul(poles.g[k], alpha * c_div(following, now))
    zeta[1, k] = now
    zeta[0, k] = following


@wp.kernel
def advance_shifted(
    scalar: wp.array(dtype=float),
    zeta: wp.array2d(dtype=wp.vec2),
    q: wp.array(dtype=float),
    real: wp.array(dtype=vec8),
    imag: wp.array(dtype=vec8),
    # outputs
    x: wp.array(dtype=float),
    r: wp.array(dtype=float),
):
    """x += Re sum_k g_k alpha_k p_k, r -= alpha q."""
    i = wp.tid()
    dr = real[i]
    di = imag[i]
    total = float(0.0)
    for k in range(8):
        step = zeta[2, k]
        total += step[0] * dr[k] - step[1] * di[k]
    x[i] = x[i] + total
    r[i] = r[i] - scalar[ALPHA] * q[i]


@wp.kernel
def set_turns(scalar: wp.array(dtype=float), zeta: wp.array2d(dtype=wp.vec2)):
    """zeta[3] = beta (zeta_k/zeta_k^old)^2."""
    k = wp.tid()
    ratio = c_div(zeta[0, k], zeta[1, k])
    zeta[3, k] = scalar[BETA] * c_mul(ratio, ratio)


@wp.kernel
def direct_shifted(
    scalar: wp.array(dtype=float),
    zeta: wp.array2d(dtype=wp.vec2),
    r: wp.array(dtype=float),
    # outputs
    p: wp.array(dtype=float),
    real: wp.array(dtype=vec8),
    imag: wp.array(dtype=vec8),
):
    """p_k = zeta_k r + beta (zeta_k/zeta_k^old)^2 p_k for every shift."""
    i = wp.tid()
    beta = scalar[BETA]
    dr = real[i]
    di = imag[i]
    for k in range(8):
        d = r[i] * zeta[0, k] + c_mul(zeta[3, k], wp.vec2(dr[k], di[k]))
        dr[k] = d[0]
        di[k] = d[1]
    real[i] = dr
    imag[i] = di
    p[i] = r[i] + beta * p[i]


@wp.kernel
def stop_shifted(
    zeta: wp.array2d(dtype=wp.vec2),
    poles: Poles,
    # outputs
    scalar: wp.array(dtype=float),
    go: wp.array(dtype=int),
):
    """Stop when the poles' residuals no longer matter to the sum."""
    bound = float(0.0)
    for k in range(8):
        bound += poles.weight[k] * wp.length(zeta[0, k])
    error = scalar[RZ] * bound * bound
    scalar[ERROR] = error
    if error <= scalar[LIMIT]:
        go[0] = 0


@wp.kernel
def watch_solve(scalar: wp.array(dtype=float), watch: wp.array(dtype=float)):
    """Take a solve that has ended into the account of those since the account was last cleared.

    Args:
        scalar: of the solve.
        watch: the worst relative residual, solves that ended above their limit, solves, most iterations.
    """
    squared = scalar[ERROR] / scalar[START]
    worst = wp.where(wp.isfinite(squared), wp.sqrt(wp.max(squared, 0.0)), wp.float32(wp.inf))
    watch[WORST] = wp.max(watch[WORST], worst)
    if not (scalar[ERROR] <= scalar[LIMIT]):
        watch[LATE] = watch[LATE] + 1.0
    watch[SOLVES] = watch[SOLVES] + 1.0
    watch[MOST] = wp.max(watch[MOST], scalar[COUNT])


@wp.kernel
def unscale(x: wp.array(dtype=float), area: wp.array(dtype=float), y: wp.array(dtype=float)):
    """y = x/sqrt(area). [n]."""
    i = wp.tid()
    y[i] = x[i] / wp.sqrt(area[i])


SCALARS, VECTORS = {}, {}
"""Kernels for either kind of unknowns, by the one for any. Those for vectors have names of their own: a graph on the
CPU tells kernels apart by their names alone."""

# The unknowns that the solver is used with: declared here, the module is compiled once, and can be ahead of time.
for _kernel, _names in (
    (start_residual, ("x", "b", "r", "z", "p")),
    (apply_operator, ("x", "y")),
    (dot_chunks, ("a", "b")),
    (weighted_chunks, ("a", "b")),
    (advance_solution, ("p", "q", "x", "r", "z")),
    (advance_direction, ("z", "p")),
    (sweep_jacobi, ("x", "b", "r", "z", "next_x")),
):
    _any = wp.Kernel(_kernel.func, key=f"{_kernel.key}_vec3")
    SCALARS[_kernel] = wp.overload(_kernel, {_name: wp.array(dtype=wp.float32) for _name in _names})
    VECTORS[_kernel] = wp.overload(_any, {_name: wp.array(dtype=wp.vec3) for _name in _names})


@wp.kernel
def region_dot_chunks(
    a: wp.array(dtype=float), b: wp.array(dtype=float), first: wp.array(dtype=wp.int32), partial: wp.array(dtype=float)
):
    """Parts of each region's sum of a_i b_i."""
    c = wp.tid()
    start, stop = part_range(c, first, partial.shape[0])
    partial[c] = sum_products(a, b, start, stop)


@wp.kernel
def weigh_gas_r(partial: wp.array(dtype=float), stiff: wp.array(dtype=float), weight: wp.array(dtype=float)):
    """weight = stiff times each region's sum. [regions]."""
    g = wp.tid()
    weight[g] = stiff[g] * region_total(partial, g, stiff.shape[0])


@wp.kernel
def add_gas_e(
    weight: wp.array(dtype=float),
    sweep: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    # outputs
    y: wp.array(dtype=float),
):
    """y += sweep_i weight of the region. [n]."""
    i = wp.tid()
    y[i] = y[i] + sweep[i] * weight[region[i]]


@wp.kernel
def region_moment_chunks(
    sweep: wp.array(dtype=float),
    carried: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    partial: wp.array(dtype=wp.vec4),
):
    """Parts of each region's sums of s_i x_i and of p_i x_i: the volume it sweeps and its momentum."""
    c = wp.tid()
    start, stop = part_range(c, first, partial.shape[0])
    volume = float(0.0)
    momentum = wp.vec3()
    for i in range(start, stop):
        volume += sweep[i] * x[i]
        momentum += carried[i] * x[i]
    partial[c] = wp.vec4(volume, momentum[0], momentum[1], momentum[2])


@wp.kernel
def weigh_moments_r(
    partial: wp.array(dtype=wp.vec4),
    stiff: wp.array(dtype=float),
    rigid: wp.array(dtype=wp.mat33),
    # outputs
    weight: wp.array(dtype=wp.vec4),
):
    """(k s.x, K p.x) of each region. [regions]."""
    g = wp.tid()
    total = region_total(partial, g, stiff.shape[0])
    moved = rigid[g] * wp.vec3(total[1], total[2], total[3])
    weight[g] = wp.vec4(stiff[g] * total[0], moved[0], moved[1], moved[2])


@wp.kernel
def add_moments_e(
    weight: wp.array(dtype=wp.vec4),
    sweep: wp.array(dtype=float),
    carried: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    # outputs
    y: wp.array(dtype=float),
):
    """y += s_i k s.x + p_i.K p.x: the parts of A x of the gas and of the motion of each region as a whole. [n]."""
    i = wp.tid()
    w = weight[region[i]]
    y[i] = y[i] + sweep[i] * w[0] + wp.dot(carried[i], wp.vec3(w[1], w[2], w[3]))


@wp.kernel
def scale_sweep_e(sweep: wp.array(dtype=float), inverse: wp.array(dtype=float), scaled: wp.array(dtype=float)):
    """s_i/A_ii. [n]."""
    i = wp.tid()
    scaled[i] = sweep[i] * inverse[i]


@wp.kernel
def soften_gas_r(partial: wp.array(dtype=float), stiff: wp.array(dtype=float), soft: wp.array(dtype=float)):
    """-k/(1 + k s^T D^-1 s) of the Sherman-Morrison inverse of D + k s s^T. [regions]."""
    g = wp.tid()
    soft[g] = -stiff[g] / (1.0 + stiff[g] * region_total(partial, g, stiff.shape[0]))
