"""The innermost loops of a step as C++: what a compiler vectorises only when told that sums may be reordered.

Each equals the plain loop of its docstring to rounding (tests/kernels/test_rows.py). A row is summed by one thread, in
one order: the result does not depend on the number of threads. On CUDA the pragmas are left out.
"""

import warp as wp

from melp_warp.kernels.neighbors import Neighbors

wp.set_module_options({"enable_backward": False})

vec5 = wp.types.vector(length=5, dtype=wp.float32)
vec6 = wp.types.vector(length=6, dtype=wp.float32)
vec8 = wp.types.vector(length=8, dtype=wp.float32)
vec10 = wp.types.vector(length=10, dtype=wp.float32)
vec17 = wp.types.vector(length=17, dtype=wp.float32)
vec16 = wp.types.vector(length=16, dtype=wp.float32)
mat53 = wp.types.matrix(shape=(5, 3), dtype=wp.float32)
mat55 = wp.types.matrix(shape=(5, 5), dtype=wp.float32)
mat68 = wp.types.matrix(shape=(6, 8), dtype=wp.float32)

CORNERS = 16
"""Most corners of a cell."""

LOOP = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp reassociate(on) contract(fast)
#pragma clang loop vectorize(assume_safety)
#endif
    for (int k = first; k < last; ++k)
"""
"""A loop over the neighbours of row i that may be summed in any order."""


@wp.struct
class Blocks:
    """Points sorted into blocks: block h holds places start[h] to start[h + 1], all within reach[h] of its home.

    The last block has no home and holds points of any region.
    """

    start: wp.array(dtype=wp.int32)
    reach: wp.array(dtype=float)
    region: wp.array(dtype=wp.int32)


@wp.struct
class Quadric:
    """The surface near a particle at o: points o + d with d.gradient = d.(second d), over the plane with `normal`."""

    normal: wp.vec3
    gradient: wp.vec3
    second: wp.mat33


LANES = """
#if !defined(__CUDA_ARCH__)
#pragma clang loop vectorize_width(8) interleave_count(1) unroll(disable)
#endif
"""
"""Before a loop over components, eight at once."""

LOWEST = """
#if defined(__CUDA_ARCH__)
#define LOWEST(bits) (__ffs(bits) - 1)
#else
#define LOWEST(bits) __builtin_ctz(bits)
#endif
"""
"""LOWEST(bits): place of the lowest bit that is set."""

ROW = """
    const int* index = rows.index.data;
    const int first = rows.start.data[i], last = rows.stop.data[i];
"""

FAR = """
        const float dx = scale * (q[3 * j] - px), dy = scale * (q[3 * j + 1] - py), dz = scale * (q[3 * j + 2] - pz);
        const float s = sqrtf(dx * dx + dy * dy + dz * dz);
"""
"""Offset of point j and its length, in h = r/3."""

OFFSET = f"""
        const int j = index[k];{FAR}"""
"""The same for neighbour k."""

VALUE = """
        const float a = s < 3.0f ? 3.0f - s : 0.0f, b = s < 2.0f ? 2.0f - s : 0.0f, c = s < 1.0f ? 1.0f - s : 0.0f;
        const float value = a * a * a * a * a - 6.0f * b * b * b * b * b + 15.0f * c * c * c * c * c;
"""
"""The quintic spline of `sph.kernel_w` for support 3 at s, but for its constant."""

WEIGHT = f"""{VALUE}
        const float w = j < limit ? 0.004661441847f * value : 0.0f;
"""
"""The spline at (dx, dy, dz), none beyond index `limit`."""

OVER = LOOP.replace("int k = first; k < last; ++k", "int m = 0; m < count; ++m")
"""The same loop over `count` points."""

RANGE = LOOP.replace("int k = first", "int k = begin").replace("k < last", "k < end")
"""The same loop over entries of arrays."""


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    const float* values = x.data;
    const float xi = values[i];
    float total = 0.0f;
    {{{LOOP}
        total += pairs[k] * (xi - values[index[k]]);
    }}
    return total;
""")
def sum_differences(i: int, x: wp.array(dtype=float), pair: wp.array(dtype=float), rows: Neighbors) -> float:
    """sum_j pair_ij (x_i - x_j)."""
    ...


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    const float* values = x.data;
    const float xi = values[i];
    float total = 0.0f;
    {{{LOOP} {{
        const float d = xi - values[index[k]];
        total += (index[k] < limit ? 0.5f : 1.0f) * pairs[k] * d * d;
    }}}}
    return total;
""")
def sum_squares(i: int, x: wp.array(dtype=float), pair: wp.array(dtype=float), rows: Neighbors, limit: int) -> float:
    """sum_j pair_ij (x_i - x_j)^2, half of it for the neighbours j < limit, which have the other half."""
    ...


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    float total = 0.0f;
    {{{LOOP}
        total += pairs[k];
    }}
    return total;
""")
def sum_row(i: int, pair: wp.array(dtype=float), rows: Neighbors) -> float:
    """sum_j pair_ij."""
    ...


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    float total = 0.0f;
    {{{LOOP}
        total += index[k] < limit ? pairs[k] : 0.0f;
    }}
    return total;
""")
def sum_within(i: int, pair: wp.array(dtype=float), rows: Neighbors, limit: int) -> float:
    """sum_j pair_ij over the neighbours j < limit."""
    ...


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    const float* values = x.data;
    float total = 0.0f;
    {{{LOOP}
        total += pairs[k] * values[index[k]];
    }}
    return total;
""")
def sum_shares(i: int, x: wp.array(dtype=float), pair: wp.array(dtype=float), rows: Neighbors) -> float:
    """sum_j pair_ij x_j."""
    ...


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    const float* values = x.data;
    const float* times = by.data;
    float total = 0.0f;
    {{{LOOP}
        total += pairs[k] * times[index[k]] * values[index[k]];
    }}
    return total;
""")
def sum_products_of(
    i: int, x: wp.array(dtype=float), by: wp.array(dtype=float), pair: wp.array(dtype=float), rows: Neighbors
) -> float:
    """sum_j pair_ij by_j x_j."""
    ...


TAKEN = "w * other[c]"

EIGHT = f"""
    const float* values = (const float*)x.data;
    float sums[8] = {{}};
    for (int k = first; k < last; ++k)
    {{
        const float w = pair.data[k];
        const float* other = values + 8 * (size_t)index[k];
{LANES}
        for (int c = 0; c < 8; ++c)
            sums[c] += TERM;
    }}
    wp::vec_t<8, float> total;
    for (int c = 0; c < 8; ++c)
        total[c] = sums[c];
    return total;
"""
"""A sum over the neighbours of row i in each of eight lanes."""


@wp.func_native(f"""{ROW}
    const float* own = (const float*)x.data + 8 * (size_t)i;
{EIGHT.replace("TERM", "w * (own[c] - other[c])")}
""")
def sum_lane_differences(i: int, x: wp.array(dtype=vec8), pair: wp.array(dtype=float), rows: Neighbors) -> vec8:
    """sum_j pair_ij (x_i - x_j) of each lane."""
    ...


@wp.func_native(f"""{ROW}{EIGHT.replace("TERM", TAKEN)}
""")
def sum_lane_shares(i: int, x: wp.array(dtype=vec8), pair: wp.array(dtype=float), rows: Neighbors) -> vec8:
    """sum_j pair_ij x_j of each lane."""
    ...


@wp.func_native(f"""{ROW}{EIGHT.replace("= pair.data[k]", "= pair.data[k] * by.data[index[k]]").replace("TERM", TAKEN)}
""")
def sum_lane_products_of(
    i: int, x: wp.array(dtype=vec8), by: wp.array(dtype=float), pair: wp.array(dtype=float), rows: Neighbors
) -> vec8:
    """sum_j pair_ij by_j x_j of each lane."""
    ...


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    const float* tops = top.data;
    const float* bottoms = bottom.data;
    float total = 0.0f;
    {{{LOOP}
    {{
        const int j = index[k] < limit ? index[k] : i;
        total += index[k] < limit ? pairs[k] * tops[j] / bottoms[j] : 0.0f;
    }}
    }}
    return total;
""")
def sum_quotients(
    i: int,
    pair: wp.array(dtype=float),
    top: wp.array(dtype=float),
    bottom: wp.array(dtype=float),
    rows: Neighbors,
    limit: int,
) -> float:
    """sum_j pair_ij top_j/bottom_j over neighbours below index `limit`."""
    ...


@wp.func_native(f"""{ROW}
    const float* pairs = pair.data;
    const float* values = (const float*)v.data;
    float x = 0.0f, y = 0.0f, z = 0.0f;
    {{{LOOP}
    {{
        const int j = index[k] < limit ? index[k] : i;
        const float w = index[k] < limit ? pairs[k] : 0.0f;
        x += w * values[3 * j];
        y += w * values[3 * j + 1];
        z += w * values[3 * j + 2];
    }}
    }}
    return wp::vec_t<3, float>(x, y, z);
""")
def sum_vectors(
    i: int, pair: wp.array(dtype=float), v: wp.array(dtype=wp.vec3), rows: Neighbors, limit: int
) -> wp.vec3:
    """sum_j pair_ij v_j over neighbours below index `limit`."""
    ...


@wp.func_native(f"""{ROW}
    const float* g = (const float*)gradient.data;
    const float* values = f.data;
    const float fi = values[i];
    float x = 0.0f, y = 0.0f, z = 0.0f;
    {{{LOOP}
    {{
        const float d = values[index[k] < limit ? index[k] : i] - fi;
        x += d * g[3 * k];
        y += d * g[3 * k + 1];
        z += d * g[3 * k + 2];
    }}
    }}
    return wp::vec_t<3, float>(x, y, z);
""")
def gradient_row(
    i: int, f: wp.array(dtype=float), rows: Neighbors, gradient: wp.array(dtype=wp.vec3), limit: int
) -> wp.vec3:
    """sum_j (f_j - f_i) gradient_ij over neighbours below index `limit`: the surface gradient of f."""
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)x.data;
    const float* values = (const float*)u.data;
    const float* speeds = speed.data;
    const float px = q[3 * i], py = q[3 * i + 1], pz = q[3 * i + 2], scale = 3.0f / r;
    const float ax = e1[0], ay = e1[1], az = e1[2], bx = e2[0], by = e2[1], bz = e2[2];
    const float y0 = y[0], y1 = y[1], y2 = y[2], y3 = y[3], y4 = y[4];
    const float ux = values[3 * i], uy = values[3 * i + 1], uz = values[3 * i + 2], own = speeds[i];
    float sx = 0.0f, sy = 0.0f, sz = 0.0f, change = 0.0f;
    {{{LOOP}
    {{
{OFFSET}{WEIGHT}        const float a1 = dx * ax + dy * ay + dz * az, b1 = dx * bx + dy * by + dz * bz;
        const float g = w * (a1 * (y0 + y2 * a1 + y3 * b1) + b1 * (y1 + y4 * b1));
        const int k1 = j < limit ? j : i;
        sx += g * (values[3 * k1] - ux);
        sy += g * (values[3 * k1 + 1] - uy);
        sz += g * (values[3 * k1 + 2] - uz);
        change += g * (speeds[k1] - own);
    }}
    }}
    return wp::vec_t<4, float>(sx, sy, sz, change);
""")
def change_over_fit(
    i: int,
    x: wp.array(dtype=wp.vec3),
    e1: wp.vec3,
    e2: wp.vec3,
    y: vec5,
    rows: Neighbors,
    r: float,
    limit: int,
    u: wp.array(dtype=wp.vec3),
    speed: wp.array(dtype=float),
) -> wp.vec4:
    """sum_j W (y.(u, v, u^2, uv, v^2)) (f_j - f_i) over neighbours below index `limit`, f the fields u and `speed`.

    (u, v) are the components of x_j - x_i along e1 and e2, lengths in h = r/3. With y = A^-1 (s_u, s_v, s_u^2, s_u s_v,
    s_v^2), A the normal matrix of `factor_fit`, this is the change of each field's quadratic fit over the way s.
    """
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)source.data;
    float* weights = weight.data;
    const float px = p[0], py = p[1], pz = p[2], scale = 3.0f / r, unit = scale * scale;
    float mx = 0.0f, my = 0.0f, mz = 0.0f, total = 0.0f;
    {{{LOOP}
    {{
{OFFSET}{WEIGHT}        weights[k] = unit * w;
        mx += w * dx;
        my += w * dy;
        mz += w * dz;
        total += w;
    }}
    }}
    return wp::vec_t<4, float>(scale * mx, scale * my, scale * mz, unit * total);
""")
def weigh_row(
    i: int,
    p: wp.vec3,
    source: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    limit: int,
    weight: wp.array(dtype=float),
) -> wp.vec4:
    """weight_k = W(|d|, r) with d = source_j - p, 0 from index `limit` on; returns sum_k weight_k (d, 1)."""
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)x.data;
    const float px = q[3 * i], py = q[3 * i + 1], pz = q[3 * i + 2], scale = 3.0f / r;
    const float ax = e1[0], ay = e1[1], az = e1[2], bx = e2[0], by = e2[1], bz = e2[2];
    const float nx = n[0], ny = n[1], nz = n[2];
    float m20 = 0, m11 = 0, m02 = 0, m30 = 0, m21 = 0, m12 = 0, m03 = 0, m40 = 0, m31 = 0, m22 = 0, m13 = 0, m04 = 0;
    float z1 = 0, z2 = 0, z3 = 0, z4 = 0, z5 = 0;
    {{{LOOP}
    {{
{OFFSET}{WEIGHT}        const float ua = dx * ax + dy * ay + dz * az, va = dx * bx + dy * by + dz * bz;
        const float bend = chords ? s / sqrtf(ua * ua + va * va + 1.0e-30f) : 1.0f, u = bend * ua, v = bend * va;
        const float wz = w * (dx * nx + dy * ny + dz * nz);
        const float uu = u * u, uv = u * v, vv = v * v, wuu = w * uu, wuv = w * uv, wvv = w * vv;
        m20 += wuu; m11 += wuv; m02 += wvv;
        m30 += wuu * u; m21 += wuu * v; m12 += wvv * u; m03 += wvv * v;
        m40 += wuu * uu; m31 += wuu * uv; m22 += wuu * vv; m13 += wvv * uv; m04 += wvv * vv;
        z1 += wz * u; z2 += wz * v; z3 += wz * uu; z4 += wz * uv; z5 += wz * vv;
    }}
    }}
    const float sums[17] = {{m20, m11, m02, m30, m21, m12, m03, m40, m31, m22, m13, m04, z1, z2, z3, z4, z5}};
    wp::vec_t<17, float> moments;
    for (int m = 0; m < 17; ++m)
        moments[m] = sums[m];
    return moments;
""")
def fit_moments(
    i: int,
    x: wp.array(dtype=wp.vec3),
    e1: wp.vec3,
    e2: wp.vec3,
    n: wp.vec3,
    rows: Neighbors,
    r: float,
    limit: int,
    chords: bool,
) -> vec17:
    """Weighted moments of the neighbours of x_i below index `limit`, seen along e1, e2, n, lengths in h = r/3.

    With (u, v, z) the components of x_j - x_i, (u, v) lengthened to its length if `chords`: sums of W u^a v^b for
    (a, b) = 20, 11, 02, 30, 21, 12, 03, 40, 31, 22, 13, 04, then of W z times u, v, u^2, uv, v^2.
    """
    ...


@wp.func_native("""
    const int place[5][5] = {{0}, {1, 2}, {3, 4, 7}, {4, 5, 8, 9}, {5, 6, 9, 10, 11}};
    const float ridge = 1.0e-6f * (m[0] + m[2] + m[7] + m[9] + m[11]) + 1.0e-30f;
    wp::mat_t<5, 5, float> factor;
    float turned[5], pivots[5];
    for (int j = 0; j < 5; ++j)
    {
        float pivot = m[place[j][j]] + ridge;
        for (int k = 0; k < j; ++k)
        {
            turned[k] = factor.data[j][k] * pivots[k];
            pivot -= factor.data[j][k] * turned[k];
        }
        pivots[j] = pivot > 1.0e-30f ? pivot : 1.0e-30f;
        factor.data[j][j] = 1.0f / pivots[j];
        for (int i = j + 1; i < 5; ++i)
        {
            float s = m[place[i][j]];
            for (int k = 0; k < j; ++k)
                s -= factor.data[i][k] * turned[k];
            factor.data[i][j] = s * factor.data[j][j];
        }
    }
    return factor;
""")
def factor_fit(m: vec17) -> mat55:
    """Factors L D L^T of the normal matrix of a fit from its moments, the diagonal slightly raised.

    L is below the diagonal, 1/D on it.
    """
    ...


@wp.func_native("""
    float y[5];
    for (int i = 0; i < 5; ++i)
    {
        y[i] = b[i];
        for (int k = 0; k < i; ++k)
            y[i] -= factor.data[i][k] * y[k];
    }
    wp::vec_t<5, float> x;
    for (int i = 4; i >= 0; --i)
    {
        float s = y[i] * factor.data[i][i];
        for (int k = i + 1; k < 5; ++k)
            s -= factor.data[k][i] * x[k];
        x[i] = s;
    }
    return x;
""")
def solve_fit(factor: mat55, b: vec5) -> vec5:
    """Solve L D L^T x = b."""
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)x.data;
    const float px = q[3 * i], py = q[3 * i + 1], pz = q[3 * i + 2], scale = 3.0f / r;
    const int limit = x.shape[0];
    float total = 0, mx = 0, my = 0, mz = 0, xx = 0, yy = 0, zz = 0, yz = 0, zx = 0, xy = 0;
    {{{LOOP}
    {{{OFFSET}{WEIGHT}
        const float wx = w * dx, wy = w * dy, wz = w * dz;
        total += w;
        mx += wx; my += wy; mz += wz;
        xx += wx * dx; yy += wy * dy; zz += wz * dz;
        yz += wy * dz; zx += wz * dx; xy += wx * dy;
    }}
    }}
    const float sums[10] = {{total, mx, my, mz, xx, yy, zz, yz, zx, xy}};
    wp::vec_t<10, float> moments;
    for (int m = 0; m < 10; ++m)
        moments[m] = sums[m];
    return moments;
""")
def cloud_moments(i: int, x: wp.array(dtype=wp.vec3), rows: Neighbors, r: float) -> vec10:
    """Sums over neighbours of W times 1, x, y, z, xx, yy, zz, yz, zx, xy of x_j - x_i, lengths in h = r/3."""
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)x.data;
    float* out = (float*)gradient.data;
    const float px = q[3 * i], py = q[3 * i + 1], pz = q[3 * i + 2], scale = 3.0f / r;
    const float ax = e1[0], ay = e1[1], az = e1[2], bx = e2[0], by = e2[1], bz = e2[2];
    float t[5][3];
    for (int m = 0; m < 5; ++m)
        for (int c = 0; c < 3; ++c)
            t[m][c] = scale * turn.data[m][c];
    {{{LOOP}
    {{{OFFSET}{WEIGHT}
        const float u = dx * ax + dy * ay + dz * az, v = dx * bx + dy * by + dz * bz;
        const float uu = u * u, uv = u * v, vv = v * v;
        out[3 * k] = w * (u * t[0][0] + v * t[1][0] + uu * t[2][0] + uv * t[3][0] + vv * t[4][0]);
        out[3 * k + 1] = w * (u * t[0][1] + v * t[1][1] + uu * t[2][1] + uv * t[3][1] + vv * t[4][1]);
        out[3 * k + 2] = w * (u * t[0][2] + v * t[1][2] + uu * t[2][2] + uv * t[3][2] + vv * t[4][2]);
    }}
    }}
""")
def write_row_gradient(
    i: int,
    x: wp.array(dtype=wp.vec3),
    e1: wp.vec3,
    e2: wp.vec3,
    turn: mat53,
    rows: Neighbors,
    r: float,
    limit: int,
    gradient: wp.array(dtype=wp.vec3),
):
    """gradient_k = W/h times (u, v, u^2, uv, v^2) turn of each neighbour, lengths in h = r/3; 0 from `limit` on."""
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)x.data;
    float* weights = weight.data;
    const float* areas = area.data;
    const float px = q[3 * i], py = q[3 * i + 1], pz = q[3 * i + 2], scale = 3.0f / r, own = areas[i];
    const float unit = 0.04661441847f * own * scale * scale * scale * scale;
    {{{LOOP}
    {{{OFFSET}
        const float t = s > 1.0e-3f ? s : 1.0e-3f;
        const float a = t < 3.0f ? 3.0f - t : 0.0f, b = t < 2.0f ? 2.0f - t : 0.0f, c = t < 1.0f ? 1.0f - t : 0.0f;
        const float aa = a * a, bb = b * b, cc = c * c;
        const float other = j < limit ? areas[j < limit ? j : i] : rim_area;
        weights[k] = unit * other * (aa * aa - 6.0f * bb * bb + 15.0f * cc * cc) / t;
    }}
    }}
""")
def weigh_row_laplacian(
    i: int,
    x: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    limit: int,
    rim_area: float,
    weight: wp.array(dtype=float),
):
    """weight_k = a_i a_j `sph.laplacian_weight`(|x_j - x_i|, r); from index `limit` on a_j is `rim_area`."""
    ...


BLOCKS = f"""{ROW}
    const int limit = block.start.shape[0] - 2;
    const int* start = block.start.data;
    const float* homes = (const float*)home.data;
    const float* packs = pack.data;
    const float px = homes[3 * i], py = homes[3 * i + 1], pz = homes[3 * i + 2], scale = 3.0f / r;
"""
"""What `EACH_IN_BLOCKS` needs."""

EACH_IN_BLOCKS = f"""
    for (int n = first - 1; n <= last; ++n)
    {{
        const int h = n < first ? i : n < last ? index[n] : limit;
        if (h >= limit && n < last)
            continue;
        if (h < limit)
        {{
            const float hx = homes[3 * h] - px, hy = homes[3 * h + 1] - py, hz = homes[3 * h + 2] - pz;
            const float most = r + block.reach.data[h];
            if (hx * hx + hy * hy + hz * hz > most * most)
                continue;
        }}
        const int begin = start[h], end = start[h + 1];
        for (int from = begin & ~7; from < end; from += 8)
        {{
            const float* g = packs + 18 * (size_t)from;
            float w[8];
            for (int lane = 0; lane < 8; ++lane)
                w[lane] = from + lane >= begin && from + lane < end ? 1.0f : 0.0f;
            if (h == limit)
                for (int lane = 0; lane < 8; ++lane)
                    w[lane] = w[lane] > 0.0f && block.region.data[from + lane] == region ? 1.0f : 0.0f;
{LANES}
            for (int lane = 0; lane < 8; ++lane)
            {{
                const float ox = px - g[lane], oy = py - g[8 + lane], oz = pz - g[16 + lane];
                const float s = scale * sqrtf(ox * ox + oy * oy + oz * oz);
{VALUE}                const float v = w[lane] * value;
"""
"""A loop over the points of all blocks of row i, eight `lane`s at once, with the weight v; three braces stay open."""


@wp.func_native(f"""{BLOCKS}
    float sums[6][8] = {{}};
{EACH_IN_BLOCKS}                for (int m = 0; m < 3; ++m)
                {{
                    const float* t = g + 24 + 8 * m + lane;
                    sums[m][lane] += v * (t[0] + ox * t[48] + oy * t[72] + oz * t[96]);
                    sums[3 + m][lane] += v * t[24];
                }}
            }}
        }}
    }}
    wp::vec_t<6, float> total;
    for (int m = 0; m < 6; ++m)
        for (int lane = 0; lane < 8; ++lane)
            total[m] += 0.004661441847f * scale * scale * sums[m][lane];
    return total;
""")
def gather_blocks(
    i: int,
    home: wp.array(dtype=wp.vec3),
    region: int,
    pack: wp.array(dtype=float),
    block: Blocks,
    rows: Neighbors,
    r: float,
) -> vec6:
    """sum_j W(|d|, r) (m_j + S_j d, s_j) with d = home_i - x_j over blocks of points, three sums each.

    The blocks are those of i, of the entries of its row, and of the last block the points in `region`. A pack holds
    eight points, component by component: x, m, s and the columns of S, see `write_pack`.
    """
    ...


@wp.func_native(f"""{BLOCKS}
    const float* amounts = given.data;
    float sums[8] = {{}};
{EACH_IN_BLOCKS}                sums[lane] += v * amounts[from + lane];
            }}
        }}
    }}
    float total = 0.0f;
    for (int lane = 0; lane < 8; ++lane)
        total += 0.004661441847f * scale * scale * sums[lane];
    return total;
""")
def gather_amount(
    i: int,
    home: wp.array(dtype=wp.vec3),
    region: int,
    pack: wp.array(dtype=float),
    given: wp.array(dtype=float),
    block: Blocks,
    rows: Neighbors,
    r: float,
) -> float:
    """sum_j W(|d|, r) given_j over the points and blocks of `gather_blocks`, whose pack holds the positions."""
    ...


@wp.func_native(f"""{ROW}
    const int limit = block.start.shape[0] - 2;
    const float* homes = (const float*)home.data;
    const float inverse = 1.0f / (reach * reach);
    const float px = p[0], py = p[1], pz = p[2], area = held[0], rate = held[1], liquid = held[2], solute = held[3];
    float sums[5][8] = {{}};
    for (int n = first - 1; n < last; ++n)
    {{
        const int h = n < first ? i : index[n];
        if (h >= limit)
            continue;
        const float hx = homes[3 * h] - px, hy = homes[3 * h + 1] - py, hz = homes[3 * h + 2] - pz;
        const float most = reach + block.reach.data[h];
        if (hx * hx + hy * hy + hz * hz > most * most)
            continue;
        const int begin = block.start.data[h], end = block.start.data[h + 1];
        for (int from = begin & ~7; from < end; from += 8)
        {{
            const float* g = pack.data + 10 * (size_t)from;
            float w[8];
            for (int lane = 0; lane < 8; ++lane)
                w[lane] = from + lane >= begin && from + lane < end ? 1.0f : 0.0f;
{LANES}
            for (int lane = 0; lane < 8; ++lane)
            {{
                const float ox = px - g[lane], oy = py - g[8 + lane], oz = pz - g[16 + lane], other = g[24 + lane];
                const float s = (ox * ox + oy * oy + oz * oz) * inverse, v = s < 1.0f ? 1.0f - s : 0.0f;
                const float least = rate < g[32 + lane] ? rate : g[32 + lane];
                const float shared = w[lane] * least * v * v * area * other / (area + other);
                const float gain = shared * (g[40 + lane] - liquid);
                sums[0][lane] += gain;
                sums[1][lane] += shared * (g[48 + lane] - solute);
                sums[2][lane] += gain * g[56 + lane];
                sums[3][lane] += gain * g[64 + lane];
                sums[4][lane] += gain * g[72 + lane];
            }}
        }}
    }}
    wp::vec_t<5, float> total;
    for (int m = 0; m < 5; ++m)
        for (int lane = 0; lane < 8; ++lane)
            total[m] += sums[m][lane];
    return total;
""")
def exchange_blocks(
    i: int,
    p: wp.vec3,
    held: wp.vec4,
    home: wp.array(dtype=wp.vec3),
    pack: wp.array(dtype=float),
    block: Blocks,
    rows: Neighbors,
    reach: float,
) -> vec5:
    """sum_j g_j (1, u_j), g_j = s_j (q_j - q), and sum_j s_j (c_j - c), over points in blocks near p, whose home is i.

    s_j = min(rate, rate_j) (1 - |p - x_j|^2/reach^2)^2 a a_j/(a + a_j), 0 beyond `reach`. The blocks are those of i and
    of the entries of its row. `held` is (a, rate, q, c); a pack has eight points, component by component: x, a, rate,
    q, c, u, see `write_held`. The result is (g, s (c_j - c), g u).
    """
    ...


@wp.func
def write_held(place: int, x: wp.vec3, held: wp.vec4, u: wp.vec3, pack: wp.array(dtype=float)):
    """Write the ten numbers of the point at `place` for `exchange_blocks`."""
    at = 80 * (place / 8) + place % 8
    for a in range(3):
        pack[at + 8 * a] = x[a]
        pack[at + 8 * (7 + a)] = u[a]
    for a in range(4):
        pack[at + 8 * (3 + a)] = held[a]


@wp.func
def write_rate(place: int, rate: float, pack: wp.array(dtype=float)):
    """Change the rate of what `write_held` has written."""
    pack[80 * (place / 8) + place % 8 + 8 * 4] = rate


@wp.func
def write_pack(place: int, x: wp.vec3, m: wp.vec3, s: wp.vec3, slope: wp.mat33, pack: wp.array(dtype=float)):
    """Write the eighteen numbers of the point at `place` for `gather_blocks`."""
    at = 144 * (place / 8) + place % 8
    for a in range(3):
        pack[at + 8 * a] = x[a]
        pack[at + 8 * (3 + a)] = m[a]
        pack[at + 8 * (6 + a)] = s[a]
        for b in range(3):
            pack[at + 8 * (9 + 3 * b + a)] = slope[a, b]


@wp.func_native(f"""{ROW}
    const float* packs = (const float*)pack.data;
    const float* weights = weight.data;
    const float px = p[0], py = p[1], pz = p[2];
    float r0[8] = {{}}, rx[8] = {{}}, ry[8] = {{}}, rz[8] = {{}}, n[4] = {{}};
    float xx = 0.0f, xy = 0.0f, xz = 0.0f, yy = 0.0f, yz = 0.0f, zz = 0.0f;
    for (int k = first; k < last; ++k)
    {{
        const float* row = packs + 16 * (size_t)index[k];
        const float w = weights[k], dx = row[8] - px, dy = row[9] - py, dz = row[10] - pz;
        const float wx = w * dx, wy = w * dy, wz = w * dz;
{LANES}
        for (int c = 0; c < 8; ++c)
        {{
            const float q = row[c];
            r0[c] += w * q;
            rx[c] += wx * q;
            ry[c] += wy * q;
            rz[c] += wz * q;
        }}
        for (int c = 0; c < 4; ++c)
            n[c] += w * row[12 + c];
        xx += wx * dx;
        xy += wx * dy;
        xz += wx * dz;
        yy += wy * dy;
        yz += wy * dz;
        zz += wz * dz;
    }}
    wp::mat_t<6, 8, float> sums;
    for (int c = 0; c < 8; ++c)
    {{
        sums.data[0][c] = r0[c];
        sums.data[1][c] = rx[c];
        sums.data[2][c] = ry[c];
        sums.data[3][c] = rz[c];
    }}
    const float second[6] = {{xx, xy, xz, yy, yz, zz}};
    for (int c = 0; c < 6; ++c)
        sums.data[4][c] = second[c];
    for (int c = 0; c < 4; ++c)
        sums.data[5][c] = n[c];
    return sums;
""")
def moment_row(
    i: int, p: wp.vec3, pack: wp.array(dtype=vec16), weight: wp.array(dtype=float), rows: Neighbors
) -> mat68:
    """sum_k weight_k (1, d) x (a, b, c, 1) in rows 0 to 3, with d = position - p.

    In row 4 sum_k weight_k (d_x d_x, d_x d_y, d_x d_z, d_y d_y, d_y d_z, d_z d_z), in row 5 sum_k weight_k (n, e). A
    pack is (a, b, c, 1, position, -, n, e), with vectors a, b and n.
    """
    ...


@wp.func_native(f"""{LOWEST}{ROW}
    const float* q = (const float*)x.data;
    const float px = q[3 * i], py = q[3 * i + 1], pz = q[3 * i + 2];
    const float ax = e1[0], ay = e1[1], az = e1[2], bx = e2[0], by = e2[1], bz = e2[2];
    const float nx = n[0], ny = n[1], nz = n[2], near = 0.2f * r * r;
    const int room = 64, most = {CORNERS};
    float us[room], vs[room], halves[room], squares[room];
    float cu[most] = {{}}, cv[most] = {{}}, nu[most] = {{}}, nv[most] = {{}}, side[most];
    int label[most], line[most], near_by[room], corners = 4;
    for (int c = 0; c < 4; ++c)
    {{
        cu[c] = c == 1 || c == 2 ? 0.5f * r : -0.5f * r;
        cv[c] = c < 2 ? -0.5f * r : 0.5f * r;
        label[c] = -1;
    }}
    float reach = 0.5f * r * r;
    // Near neighbours first: they leave a cell so small that few of the others reach it.
    for (int far = 0; far < 2; ++far)
        for (int from = first; from < last; from += room)
        {{
            const int count = last - from < room ? last - from : room;
            if (far == 0 || last - first > room)
            {{{OVER}
            {{
                const int j = index[from + m];
                const float dx = q[3 * j] - px, dy = q[3 * j + 1] - py, dz = q[3 * j + 2] - pz;
                const float u = dx * ax + dy * ay + dz * az, v = dx * bx + dy * by + dz * bz;
                const float z = dx * nx + dy * ny + dz * nz;
                us[m] = u;
                vs[m] = v;
                const float plane = u * u + v * v;
                halves[m] = 0.5f * sqrtf(plane * (plane + 0.888f * z * z));
                squares[m] = dx * dx + dy * dy + dz * dz;
            }}
            }}
            int found = 0;
            for (int m = 0; m < count; ++m)
            {{
                near_by[found] = m;
                found += (squares[m] < 4.0f * reach) & ((squares[m] < near) == (far == 0));
            }}
            for (int f = 0; f < found; ++f)
            {{
                const int m = near_by[f];
                if (!(squares[m] < 4.0f * reach))
                    continue;
                unsigned out = 0, all = (1u << corners) - 1u;
                for (int c = 0; c < most; ++c)
                    side[c] = cu[c] * us[m] + cv[c] * vs[m] - halves[m];
                for (int c = 0; c < most; ++c)
                    out |= (unsigned)!(side[c] < 0.0f) << c;
                out &= all;
                if (out == 0)
                    continue;
                if (out == all)
                {{
                    corners = 0;
                    reach = 0.0f;
                    continue;
                }}
                // The corners that are cut off are one run: its first, and the first one after it.
                const unsigned before = ((out << 1) | (out >> (corners - 1))) & all;
                const int a = LOWEST(out & ~before);
                const unsigned turned = ((out >> a) | (out << (corners - a))) & all;
                const int run = LOWEST(~turned);
                const int p = a > 0 ? a - 1 : corners - 1;
                const int last_out = a + run - 1 < corners ? a + run - 1 : a + run - 1 - corners;
                const int e = last_out + 1 < corners ? last_out + 1 : 0;
                const float s = side[p] / (side[p] - side[a]), t = side[last_out] / (side[last_out] - side[e]);
                nu[0] = cu[p] + s * (cu[a] - cu[p]);
                nv[0] = cv[p] + s * (cv[a] - cv[p]);
                line[0] = from + m;
                nu[1] = cu[last_out] + t * (cu[e] - cu[last_out]);
                nv[1] = cv[last_out] + t * (cv[e] - cv[last_out]);
                line[1] = label[last_out];
                int kept = 2;
                for (int left = corners - run, c = e; left > 0 && kept < most; --left)
                {{
                    nu[kept] = cu[c];
                    nv[kept] = cv[c];
                    line[kept++] = label[c];
                    c = c + 1 < corners ? c + 1 : 0;
                }}
                corners = kept;
                reach = 0.0f;
                for (int c = 0; c < corners; ++c)
                {{
                    cu[c] = nu[c];
                    cv[c] = nv[c];
                    label[c] = line[c];
                    const float square = cu[c] * cu[c] + cv[c] * cv[c];
                    reach = square > reach ? square : reach;
                }}
            }}
        }}
    wp::vec_t<6, float> moments;
    int k = weight.data ? star.start.data[i] : 0;
    for (int c = 0; c < corners; ++c)
    {{
        const int next = c + 1 < corners ? c + 1 : 0;
        const float u = cu[c], v = cv[c], s = cu[next], t = cv[next], cross = u * t - v * s;
        moments[0] += cross;
        moments[1] += cross * (u + s);
        moments[2] += cross * (v + t);
        moments[3] += cross * (u * u + u * s + s * s);
        moments[4] += cross * (2.0f * u * v + u * t + s * v + 2.0f * s * t);
        moments[5] += cross * (v * v + v * t + t * t);
        if (weight.data && label[c] >= 0)
        {{
            const int j = index[label[c]];
            const float dx = q[3 * j] - px, dy = q[3 * j + 1] - py, dz = q[3 * j + 2] - pz;
            const float edge = sqrtf((s - u) * (s - u) + (t - v) * (t - v));
            star.index.data[k] = j;
            weight.data[k++] = edge / sqrtf(dx * dx + dy * dy + dz * dz);
        }}
    }}
    if (weight.data)
        star.stop.data[i] = k;
    const float parts[6] = {{2.0f, 6.0f, 6.0f, 12.0f, 24.0f, 12.0f}};
    for (int m = 0; m < 6; ++m)
        moments[m] /= parts[m];
    return moments;
""")
def cut_cell(
    i: int,
    x: wp.array(dtype=wp.vec3),
    e1: wp.vec3,
    e2: wp.vec3,
    n: wp.vec3,
    rows: Neighbors,
    r: float,
    star: Neighbors,
    weight: wp.array(dtype=float),
) -> vec6:
    """Moments 1, u, v, uu, uv, vv of the Voronoi cell of x_i in the plane of e1, e2, of at most `CORNERS` corners.

    The cell is what the lines q.(u, v) = p sqrt(p^2 + 0.888 z^2)/2, p^2 = u^2 + v^2, of the neighbours leave of a
    square of side r about x_i. Where there is a `weight`, `star` holds the neighbours whose lines are edges, in order,
    and it edge/distance.
    """
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)x.data;
    const float* normals = (const float*)normal.data;
    const float px = q[3 * i], py = q[3 * i + 1], pz = q[3 * i + 2];
    const float nx = normals[3 * i], ny = normals[3 * i + 1], nz = normals[3 * i + 2];
    float x_sum = 0.0f, y_sum = 0.0f, z_sum = 0.0f;
    {{{LOOP}
    {{
        const int j = index[k];
        const float dx = px - q[3 * j], dy = py - q[3 * j + 1], dz = pz - q[3 * j + 2];
        const float square = dx * dx + dy * dy + dz * dz;
        const float facing = nx * normals[3 * j] + ny * normals[3 * j + 1] + nz * normals[3 * j + 2];
        const bool near = square < close * close && square > 0.0f && facing > 0.0f;
        const float w = near ? close / sqrtf(near ? square : 1.0f) - 1.0f : 0.0f;
        x_sum += w * dx;
        y_sum += w * dy;
        z_sum += w * dz;
    }}
    }}
    return wp::vec_t<3, float>(x_sum, y_sum, z_sum);
""")
def away_from_near(
    i: int, x: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), rows: Neighbors, close: float
) -> wp.vec3:
    """sum_j (close/|d| - 1) d, d = x_i - x_j, over neighbours nearer than `close` whose normals are not turned away."""
    ...


@wp.func_native(f"""
    const int* index = wide.index.data;
    const int first = wide.start.data[home], last = wide.stop.data[home], room = 64;
    const float* q = (const float*)x.data;
    const float px = p[0], py = p[1], pz = p[2], most = radius * radius;
    int* row = out.data + begin;
    union {{ float value[room]; unsigned bits[room]; }} square;
    int kept[room], n = 0, nearest = home;
    const float hx = q[3 * home] - px, hy = q[3 * home + 1] - py, hz = q[3 * home + 2] - pz;
    float least = hx * hx + hy * hy + hz * hz;
    if (least <= most)
    {{
        if (stride > 0)
            row[0] = home;
        n = 1;
    }}
    for (int from = first; from < last; from += room)
    {{
        const int* candidate = index + from;
        const int count = last - from < room ? last - from : room;
        unsigned best = ~0u;
        {{{OVER}
        {{
            const int j = candidate[m];
            const float dx = q[3 * j] - px, dy = q[3 * j + 1] - py, dz = q[3 * j + 2] - pz;
            square.value[m] = dx * dx + dy * dy + dz * dz;
        }}
        }}
        for (int m = 0; m < count; ++m)
        {{
            const unsigned key = candidate[m] < limit ? (square.bits[m] & ~63u) | (unsigned)m : ~0u;
            best = key < best ? key : best;
        }}
        if (best != ~0u && square.value[best & 63u] < least)
        {{
            least = square.value[best & 63u];
            nearest = candidate[best & 63u];
        }}
        int* to = n + count <= stride ? row + n : kept;
        int found = 0;
        for (int m = 0; m < count; ++m)
        {{
            to[found] = candidate[m];
            found += square.value[m] <= most;
        }}
        if (to == kept)
            for (int m = 0; m < found && n + m < stride; ++m)
                row[n + m] = kept[m];
        n += found;
    }}
    return wp::vec_t<2, int>(n, nearest);
""")
def list_around_home(
    home: int,
    p: wp.vec3,
    x: wp.array(dtype=wp.vec3),
    wide: Neighbors,
    radius: float,
    limit: int,
    begin: int,
    stride: int,
    out: wp.array(dtype=wp.int32),
) -> wp.vec2i:
    """Write `home` and those of its wide row within `radius` of p to `out` from `begin` on, at most `stride`.

    Returns how many there are, and which of them, below index `limit`, is nearest to p, to 1e-5 of the squared
    distance: six bits of that hold the place of the candidate.
    """
    ...


@wp.func_native(f"""
    const float* x = a.data;
    const float* y = b.data;
    float total = 0.0f;
    {{{RANGE}
        total += x[k] * y[k];
    }}
    return total;
""")
def sum_products(a: wp.array(dtype=float), b: wp.array(dtype=float), begin: int, end: int) -> float:
    """sum_k a_k b_k for k from `begin` to `end`."""
    ...


@wp.func_native(f"""
    const float* ps = p.data;
    const float* qs = q.data;
    const float* scales = inverse.data;
    float* xs = x.data;
    float* rs = r.data;
    float* zs = z.data;
    {{{RANGE}
    {{
        const float left = rs[k] - alpha * qs[k];
        xs[k] += alpha * ps[k];
        rs[k] = left;
        zs[k] = scales[k] * left;
    }}
    }}
""")
def advance_entries(
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
    ...


@wp.func_native(f"""
    const float* zs = z.data;
    float* ps = p.data;
    {{{RANGE}
        ps[k] = zs[k] + beta * ps[k];
    }}
""")
def turn_entries(begin: int, end: int, beta: float, z: wp.array(dtype=float), p: wp.array(dtype=float)):
    """p = z + beta p for entries `begin` to `end`."""
    ...


@wp.func_native(f"""{ROW}
    const float* q = (const float*)x.data;
    const float* fits = (const float*)surface.data;
    const float px = p[0], py = p[1], pz = p[2], scale = 3.0f / r;
    const int room = 64;
    float ws[room], n[3] = {{}}, height = 0.0f, total = 0.0f;
    int kept[room];
    for (int from = first; from < last; from += room)
    {{
        const int count = last - from < room ? last - from : room;
        {{{OVER}
        {{
            const int j = index[from + m];{FAR}{WEIGHT}
            ws[m] = w;
        }}
        }}
        int found = 0;
        for (int m = 0; m < count; ++m)
        {{
            kept[found] = m;
            found += ws[m] > 0.0f;
        }}
        for (int f = 0; f < found; ++f)
        {{
            const int j = index[from + kept[f]];
            const float w = ws[kept[f]];
            const float dx = px - q[3 * j], dy = py - q[3 * j + 1], dz = pz - q[3 * j + 2];
            const float* fit = fits + 15 * (size_t)j;  // normal, gradient, rows of second
            const float gx = fit[3] - (fit[6] * dx + fit[7] * dy + fit[8] * dz);
            const float gy = fit[4] - (fit[9] * dx + fit[10] * dy + fit[11] * dz);
            const float gz = fit[5] - (fit[12] * dx + fit[13] * dy + fit[14] * dz);
            height += w * (dx * gx + dy * gy + dz * gz);
            total += w;
            for (int c = 0; c < 3; ++c)
                n[c] += w * fit[c];
        }}
    }}
    const float size = n[0] * n[0] + n[1] * n[1] + n[2] * n[2], least = 0.25f * total * total;
    const float move = total > 0.0f ? height / (size > least ? size : least) : 0.0f;
    return wp::vec_t<3, float>(move * n[0], move * n[1], move * n[2]);
""")
def height_over_fits(
    i: int,
    p: wp.vec3,
    x: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    rows: Neighbors,
    r: float,
    limit: int,
) -> wp.vec3:
    """F/|N|^2 N, F the mean height d.(gradient - second d) above fits and N their mean normal, d = p - x_j, weights W.

    Over the fits of row i below index `limit`; |N| is taken for at least 1/2, the result is 0 where none is within r.
    All along one direction: a point where F is 0 stays. Each height along its own normal would draw points along the
    surface into a crease, a little every time.
    """
    ...
