"""The C++ loops over a row equal the sums that their docstrings state, and launches do not depend on the cores."""

import numpy as np
import pytest
import warp as wp

from melp_warp.cluster import Bubble, Cluster, Wall
from melp_warp.device import launch as launcher
from melp_warp.device.launch import launch
from melp_warp.kernels import native as kr
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.shapes import Disc, Sphere
from melp_warp.stages.neighbors import fixed_rows
from tests.helpers import make_rows, make_stepper, spline

N, LIMIT, R = 60, 50, 1.0
UP = (0.0, 1.0, 0.0)


@wp.kernel(enable_backward=False)
def evaluate_rows(
    x: wp.array(dtype=wp.vec3),
    f: wp.array(dtype=float),
    frame: wp.array(dtype=wp.vec3),
    turn: kr.mat53,
    pack16: wp.array(dtype=kr.vec16),
    rows: Neighbors,
    r: float,
    limit: int,
    # outputs
    pair: wp.array(dtype=float),
    laplacian: wp.array(dtype=float),
    gradient: wp.array(dtype=wp.vec3),
    out: wp.array2d(dtype=float),
):
    i = rows.first + wp.tid()
    s = kr.weigh_row(i, x[i], x, rows, r, limit, pair)
    for c in range(4):
        out[i, c] = s[c]
    out[i, 4] = kr.sum_differences(i, f, pair, rows)
    m = kr.fit_moments(i, x, frame[0], frame[1], frame[2], rows, r, limit, False)
    for c in range(17):
        out[i, 5 + c] = m[c]
    q = kr.cloud_moments(i, x, rows, r)
    for c in range(10):
        out[i, 22 + c] = q[c]
    kr.write_row_gradient(i, x, frame[0], frame[1], turn, rows, r, limit, gradient)
    kr.weigh_row_laplacian(i, x, f, rows, r, limit, 0.7, laplacian)


@wp.kernel(enable_backward=False)
def evaluate_moments(
    x: wp.array(dtype=wp.vec3),
    pack: wp.array(dtype=kr.vec16),
    pair: wp.array(dtype=float),
    rows: Neighbors,
    out: wp.array(dtype=kr.mat68),
):
    i = rows.first + wp.tid()
    out[i] = kr.moment_row(i, x[i], pack, pair, rows)


def slope(s):
    """-W' for support 3."""
    a, b, c = (np.maximum(v - s, 0.0) for v in (3.0, 2.0, 1.0))
    return 5.0 * 0.004661441847 * (a**4 - 6.0 * b**4 + 15.0 * c**4)


@pytest.fixture(scope="module")
def cloud(device):
    """Random points and fields, rows of 0 to 40 neighbours that are not themselves, and all that the loops make."""
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.5, 0.5, (N, 3)).astype(np.float32)
    f = rng.uniform(0.5, 1.5, N).astype(np.float32)
    columns = [rng.permutation(np.delete(np.arange(N), i))[: i % 41] for i in range(N)]
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0].astype(np.float32)
    turn = rng.normal(size=(5, 3)).astype(np.float32)
    p16 = rng.normal(size=(N, 16)).astype(np.float32)
    p16[:, 7], p16[:, 8:11] = 1.0, x
    rows = make_rows(columns, device)
    pairs = rows.index.shape[0]
    pair, laplacian = (wp.zeros(pairs, dtype=float, device=device) for _ in range(2))
    gradient, out = wp.zeros(pairs, dtype=wp.vec3, device=device), wp.zeros((N, 64), dtype=float, device=device)
    moments = wp.zeros(N, dtype=kr.mat68, device=device)

    def array(values, dtype):
        return wp.array(values, dtype=dtype, device=device)

    wx, w16 = array(x, wp.vec3), array(p16, kr.vec16)
    inputs = [wx, array(f, float), array(frame, wp.vec3), kr.mat53(*turn.ravel().tolist()), w16]
    launch(evaluate_rows, N, [*inputs, rows, R, LIMIT], [pair, laplacian, gradient, out], device)
    launch(evaluate_moments, N, [wx, w16, pair, rows], [moments], device)
    made = {"pair": pair, "laplacian": laplacian, "gradient": gradient, "out": out, "moments": moments}
    made = {name: a.numpy() for name, a in made.items()}
    i, j = np.repeat(np.arange(N), [len(c) for c in columns]), np.concatenate(columns).astype(int)
    d = x[j].astype(float) - x[i]
    return made, i, j, d, {"x": x, "f": f, "frame": frame, "turn": turn, "p16": p16}


def by_row(i, values):
    """Sums of pair values by row, in float64."""
    total = np.zeros((N, *values.shape[1:]))
    np.add.at(total, i, values)
    return total


def agree(got, expected):
    """Equal to the rounding of float32 sums."""
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=2e-5 * max(np.abs(expected).max(), 1e-30))


def test_weights(cloud):
    """`weigh_row`: W of each pair, none beyond the limit, and sums of W (d, 1)."""
    made, i, j, d, _ = cloud
    w = 9.0 / R**2 * spline(3.0 * np.linalg.norm(d, axis=1) / R) * (j < LIMIT)
    agree(made["pair"], w)
    agree(made["out"][:, :4], by_row(i, w[:, None] * np.column_stack([d, np.ones(len(d))])))


def test_differences(cloud):
    """`sum_differences`: sum of pair (x_i - x_j)."""
    made, i, j, _, given = cloud
    f = given["f"].astype(float)
    agree(made["out"][:, 4], by_row(i, made["pair"] * (f[i] - f[j])))


def test_fit_moments(cloud):
    """`fit_moments`: seventeen sums in the frame given."""
    made, i, j, d, given = cloud
    u, v, z = (3.0 / R * d @ given["frame"].astype(float).T).T
    w = spline(3.0 * np.linalg.norm(d, axis=1) / R) * (j < LIMIT)
    powers = [(2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4)]
    heights = [z * u, z * v, z * u * u, z * u * v, z * v * v]
    agree(made["out"][:, 5:22], by_row(i, w[:, None] * np.stack([u**a * v**b for a, b in powers] + heights, axis=1)))


def test_cloud_moments(cloud):
    """`cloud_moments`: ten sums, no limit."""
    made, i, _, d, _ = cloud
    x, y, z = 3.0 / R * d.T
    w = spline(3.0 * np.linalg.norm(d, axis=1) / R)
    terms = [np.ones_like(x), x, y, z, x * x, y * y, z * z, y * z, z * x, x * y]
    agree(made["out"][:, 22:32], by_row(i, w[:, None] * np.stack(terms, axis=1)))


@wp.kernel(enable_backward=False)
def evaluate_sums(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    f: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    gradient: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    limit: int,
    close: float,
    # outputs
    out: wp.array2d(dtype=float),
):
    i = rows.first + wp.tid()
    out[i, 0] = kr.sum_row(i, pair, rows)
    out[i, 1] = kr.sum_quotients(i, pair, f, f, rows, limit)
    mean = kr.sum_vectors(i, pair, v, rows, limit)
    slope = kr.gradient_row(i, f, rows, gradient, limit)
    away = kr.away_from_near(i, x, v, rows, close)
    out[i, 11] = kr.sum_within(i, pair, rows, limit)
    out[i, 12] = kr.sum_shares(i, f, pair, rows)
    out[i, 13] = kr.sum_products_of(i, f, f, pair, rows)
    for c in range(3):
        out[i, 2 + c] = mean[c]
        out[i, 5 + c] = slope[c]
        out[i, 8 + c] = away[c]


def test_sums_with_ready_weights(device):
    """Sums over rows with weights at hand, each as its docstring says."""
    rng = np.random.default_rng(4)
    columns = [rng.permutation(np.delete(np.arange(N), i))[: i % 41] for i in range(N)]
    rows, close = make_rows(columns, device), 0.6
    x, v = rng.uniform(-0.5, 0.5, (N, 3)), rng.normal(size=(N, 3))
    x[columns[7][0]] = x[7]  # two in one place push each other nowhere
    f, pair = rng.uniform(0.5, 1.5, N), rng.normal(size=rows.index.shape[0])
    gradient, out = rng.normal(size=(len(pair), 3)), wp.zeros((N, 14), dtype=float, device=device)
    vectors = [wp.array(a, dtype=wp.vec3, device=device) for a in (x, v)]
    given = [wp.array(a, dtype=float, device=device) for a in (f, pair)]
    slopes = wp.array(gradient, dtype=wp.vec3, device=device)
    launch(evaluate_sums, N, [*vectors, *given, slopes, rows, LIMIT, close], [out], device)
    i, j = np.repeat(np.arange(N), [len(c) for c in columns]), np.concatenate(columns).astype(int)
    below, d = j < LIMIT, x[i] - x[j]
    far, facing = np.linalg.norm(d, axis=1), np.sum(v[i] * v[j], axis=1) > 0.0
    push = np.where((far < close) & (far > 0.0) & facing, close / np.where(far > 0.0, far, 1.0) - 1.0, 0.0)
    assert 20 < np.count_nonzero(push) < len(push)
    terms = [pair, pair * below, (pair * below)[:, None] * v[j], (below * (f[j] - f[i]))[:, None] * gradient]
    terms += [push[:, None] * d, pair * below, pair * f[j], pair * f[j] ** 2]
    sums = np.split(out.numpy(), (1, 2, 5, 8, 11, 12, 13), axis=1)
    for got, term in zip(sums, terms, strict=True):
        agree(got, by_row(i, term.reshape(len(i), -1)))


@wp.kernel(enable_backward=False)
def evaluate_lanes(
    x: wp.array(dtype=kr.vec8),
    f: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    rows: Neighbors,
    # outputs
    out: wp.array2d(dtype=kr.vec8),
):
    i = rows.first + wp.tid()
    out[i, 0] = kr.sum_lane_differences(i, x, pair, rows)
    out[i, 1] = kr.sum_lane_shares(i, x, pair, rows)
    out[i, 2] = kr.sum_lane_products_of(i, x, f, pair, rows)


def test_sums_of_lanes(device):
    """Sums over rows in eight lanes at once."""
    rng = np.random.default_rng(5)
    columns = [rng.permutation(np.delete(np.arange(N), i))[: i % 41] for i in range(N)]
    rows = make_rows(columns, device)
    x, f, pair = rng.normal(size=(N, 8)), rng.uniform(0.5, 1.5, N), rng.normal(size=rows.index.shape[0])
    given = [wp.array(a, dtype=float, device=device) for a in (f, pair)]
    out = wp.zeros((N, 3), dtype=kr.vec8, device=device)
    launch(evaluate_lanes, N, [wp.array(x, dtype=kr.vec8, device=device), *given, rows], [out], device)
    i, j = np.repeat(np.arange(N), [len(c) for c in columns]), np.concatenate(columns).astype(int)
    for k, term in enumerate((x[i] - x[j], x[j], f[j, None] * x[j])):
        agree(out.numpy()[:, k], by_row(i, pair[:, None] * term))


@wp.kernel(enable_backward=False)
def evaluate_ranges(
    size: int,
    scale: float,
    p: wp.array(dtype=float),
    q: wp.array(dtype=float),
    inverse: wp.array(dtype=float),
    # outputs
    x: wp.array(dtype=float),
    r: wp.array(dtype=float),
    z: wp.array(dtype=float),
    turned: wp.array(dtype=float),
):
    begin = size * wp.tid()
    end = wp.min(p.shape[0], begin + size)
    kr.advance_entries(begin, end, scale, p, q, inverse, x, r, z)
    kr.turn_entries(begin, end, scale, z, turned)


def test_ranges_of_entries(device):
    """`advance_entries` and `turn_entries`, in ranges that do not divide the arrays."""
    rng = np.random.default_rng(6)
    p, q, inverse, x, r, z, turned = (rng.normal(size=N).astype(np.float32) for _ in range(7))
    arrays = [wp.array(a, dtype=float, device=device) for a in (p, q, inverse, x, r, z, turned)]
    launch(evaluate_ranges, -(-N // 13), [13, 0.3, *arrays[:3]], arrays[3:], device)
    left = r - 0.3 * q
    expected = (x + 0.3 * p, left, inverse * left, inverse * left + 0.3 * turned)
    for got, wanted in zip(arrays[3:], expected, strict=True):
        agree(got.numpy(), wanted)


@wp.kernel(enable_backward=False)
def evaluate_fit(m: kr.vec17, b: kr.vec5, factor: wp.array(dtype=kr.mat55), x: wp.array(dtype=kr.vec5)):
    factor[0] = kr.factor_fit(m)
    x[0] = kr.solve_fit(factor[0], b)


def test_fit_is_solved(device):
    """`factor_fit` and `solve_fit`: the normal matrix of random points, in float64 and by its factors."""
    rng = np.random.default_rng(8)
    u, v = rng.uniform(-1.5, 1.5, (2, 30))
    basis = np.stack([u, v, u * u, u * v, v * v], axis=1)
    matrix, b = basis.T @ basis, rng.normal(size=5)
    powers = [(2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4)]
    moments = [np.sum(u**a * v**c) for a, c in powers] + 5 * [0.0]
    factor, x = wp.zeros(1, dtype=kr.mat55, device=device), wp.zeros(1, dtype=kr.vec5, device=device)
    launch(evaluate_fit, 1, [kr.vec17(*moments), kr.vec5(*b)], [factor, x], device)
    np.testing.assert_allclose(x.numpy()[0], np.linalg.solve(matrix, b), rtol=1e-3)
    held = factor.numpy()[0].astype(float)
    low = np.tril(held, -1) + np.eye(5)
    np.testing.assert_allclose(low @ np.diag(1.0 / np.diag(held)) @ low.T, matrix, rtol=1e-5, atol=1e-5 * matrix.max())


@wp.kernel(enable_backward=False)
def pack_points(
    x: wp.array(dtype=wp.vec3),
    m: wp.array(dtype=wp.vec3),
    s: wp.array(dtype=wp.vec3),
    slope: wp.array(dtype=wp.mat33),
    pack: wp.array(dtype=float),
):
    i = wp.tid()
    kr.write_pack(i, x[i], m[i], s[i], slope[i], pack)


@wp.kernel(enable_backward=False)
def evaluate_blocks(
    home: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    pack: wp.array(dtype=float),
    block: kr.Blocks,
    rows: Neighbors,
    r: float,
    out: wp.array2d(dtype=float),
):
    i = rows.first + wp.tid()
    g = kr.gather_blocks(i, home, region[i], pack, block, rows, r)
    for c in range(6):
        out[i, c] = g[c]


def make_blocks(rng, device):
    """N homes, points in their blocks of none to forty, the last without a home, in random columns of every row.

    An entry beyond the blocks and blocks out of reach are among them.

    Returns:
        homes [N, 3], the owner of each point, points [n, 3], columns of each row; the block and the rows on the device.
    """
    homes = rng.uniform(-0.5, 0.5, (N, 3))
    size = rng.integers(0, 14, N + 1)
    size[[3, N]] = 40, 9
    start = np.concatenate([[0], np.cumsum(size)])
    owner = np.repeat(np.arange(N + 1), size)
    x = np.concatenate([homes, [[0.0, 0.0, 0.0]]])[owner] + rng.uniform(-0.2, 0.2, (len(owner), 3))
    columns = [rng.permutation(np.delete(np.arange(N + 3), i))[: i % 41] for i in range(N)]
    distance = np.linalg.norm(x[: start[N]] - homes[owner[: start[N]]], axis=1)
    reach = np.array([distance[owner[: start[N]] == h].max(initial=0.0) for h in range(N)])
    block = kr.Blocks()
    block.start, block.reach = as_array(start, wp.int32, device), as_array(1.001 * reach, float, device)
    return homes, owner, x, columns, block, make_rows(columns, device)


def as_array(values, dtype, device):
    return wp.array(values.astype(np.int32 if dtype is wp.int32 else np.float32), dtype=dtype, device=device)


def test_gathered_blocks(device):
    """`gather_blocks`: sum of W (m + S d, s) over a row's blocks, its own, and in the last its region's points."""
    rng = np.random.default_rng(4)
    homes, owner, x, columns, block, rows = make_blocks(rng, device)
    total = len(owner)
    m, s, slope = rng.normal(size=(total, 3)), rng.normal(size=(total, 3)), rng.normal(size=(total, 3, 3))
    own, of = rng.integers(0, 2, N), np.concatenate([rng.integers(0, 2, total), np.zeros(7, dtype=int)])

    def array(values, dtype):
        return as_array(values, dtype, device)

    block.region = array(of, wp.int32)
    pack = wp.zeros(144 * -(-total // 8), dtype=float, device=device)
    out = wp.zeros((N, 6), dtype=float, device=device)
    inputs = [array(x, wp.vec3), array(m, wp.vec3), array(s, wp.vec3), array(slope, wp.mat33)]
    launch(pack_points, total, inputs, [pack], device)
    launch(evaluate_blocks, N, [array(homes, wp.vec3), array(own, wp.int32), pack, block, rows, R], [out], device)
    expected = np.zeros((N, 6))
    for i in range(N):
        among = np.isin(owner, [i, *columns[i]]) & (owner < N) | (owner == N) & (of[:total] == own[i])
        d = homes[i] - x[among]
        w = 9.0 / R**2 * spline(3.0 * np.linalg.norm(d, axis=1) / R)[:, None]
        expected[i, :3] = np.sum(w * (m[among] + np.einsum("kac,kc->ka", slope[among], d)), axis=0)
        expected[i, 3:] = np.sum(w * s[among], axis=0)
    agree(out.numpy(), expected)


@wp.kernel(enable_backward=False)
def pack_held(
    x: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=wp.vec4),
    u: wp.array(dtype=wp.vec3),
    pack: wp.array(dtype=float),
):
    i = wp.tid()
    kr.write_held(i, x[i], held[i], u[i], pack)


@wp.kernel(enable_backward=False)
def evaluate_exchange(
    home: wp.array(dtype=wp.vec3),
    p: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=wp.vec4),
    pack: wp.array(dtype=float),
    block: kr.Blocks,
    rows: Neighbors,
    reach: float,
    out: wp.array2d(dtype=float),
):
    i = rows.first + wp.tid()
    g = kr.exchange_blocks(i, p[i], held[i], home, pack, block, rows, reach)
    for c in range(5):
        out[i, c] = g[c]


def test_exchanged_blocks(device):
    """`exchange_blocks`: what a point near each home gets from those of its row's blocks, by the smaller rate."""
    rng = np.random.default_rng(5)
    homes, owner, x, columns, block, rows = make_blocks(rng, device)
    reach, total = 0.3, len(owner)
    p = homes + rng.uniform(-0.1, 0.1, (N, 3))
    mine, others, u = rng.uniform(0.1, 1.0, (N, 4)), rng.uniform(0.1, 1.0, (total, 4)), rng.normal(size=(total, 3))

    def array(values, dtype):
        return as_array(values, dtype, device)

    pack = wp.zeros(80 * -(-total // 8), dtype=float, device=device)
    launch(pack_held, total, [array(x, wp.vec3), array(others, wp.vec4), array(u, wp.vec3)], [pack], device)
    out = wp.zeros((N, 5), dtype=float, device=device)
    inputs = [array(homes, wp.vec3), array(p, wp.vec3), array(mine, wp.vec4), pack, block, rows, reach]
    launch(evaluate_exchange, N, inputs, [out], device)
    expected = np.zeros((N, 5))
    for i in range(N):
        among = np.isin(owner, [i, *columns[i]]) & (owner < N)
        near = np.maximum(1.0 - np.sum((x[among] - p[i]) ** 2, axis=1) / reach**2, 0.0) ** 2
        (a, rate, q, c), other = mine[i], others[among]
        shared = np.minimum(rate, other[:, 1]) * near * a * other[:, 0] / (a + other[:, 0])
        gain = shared * (other[:, 2] - q)
        expected[i] = gain.sum(), np.sum(shared * (other[:, 3] - c)), *(gain @ u[among])
    assert np.count_nonzero(expected[:, 0]) > N // 2
    agree(out.numpy(), expected)


def test_moments_of_pack(cloud):
    """`moment_row`: sums of weight (1, d) x (a, b, c, 1), of weight d x d, and of weight (n, e)."""
    made, i, j, d, given = cloud
    pack, w = given["p16"].astype(float)[j], made["pair"].astype(float)
    one = np.column_stack([np.ones(len(d)), d])
    agree(made["moments"][:, :4], by_row(i, w[:, None, None] * one[:, :, None] * pack[:, None, :8]))
    a, b = np.triu_indices(3)
    agree(made["moments"][:, 4, :6], by_row(i, w[:, None] * d[:, a] * d[:, b]))
    agree(made["moments"][:, 5, :4], by_row(i, w[:, None] * pack[:, 12:16]))


def test_gradient_rows(cloud):
    """`write_row_gradient`: W/h times the quadratic basis turned."""
    made, _, j, d, given = cloud
    u, v, _ = (3.0 / R * d @ given["frame"].astype(float).T).T
    w = 3.0 / R * spline(3.0 * np.linalg.norm(d, axis=1) / R) * (j < LIMIT)
    basis = np.stack([u, v, u * u, u * v, v * v], axis=1)
    agree(made["gradient"], w[:, None] * (basis @ given["turn"].astype(float)))


def test_laplacian_weights(cloud):
    """`weigh_row_laplacian`: a_i a_j 2 |W'|/d, with the rim's area beyond the limit."""
    made, i, j, d, given = cloud
    f, s = given["f"].astype(float), 3.0 * np.linalg.norm(d, axis=1) / R
    agree(made["laplacian"], f[i] * np.where(j < LIMIT, f[j], 0.7) * 2.0 * (3.0 / R) ** 4 * slope(s) / s)


@wp.kernel(enable_backward=False)
def evaluate_lists(
    x: wp.array(dtype=wp.vec3),
    home: wp.array(dtype=wp.int32),
    p: wp.array(dtype=wp.vec3),
    wide: Neighbors,
    radius: float,
    limit: int,
    stride: int,
    # outputs
    found: wp.array(dtype=wp.vec2i),
    out: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    found[i] = kr.list_around_home(home[i], p[i], x, wide, radius, limit, i * stride, stride, out)


@pytest.mark.parametrize("stride", [70, 4])
def test_list_around_home(stride, device):
    """`list_around_home`: the home and its row's points within the radius, no more than fit; the nearest one."""
    rng = np.random.default_rng(5)
    n = 150
    x = rng.uniform(-0.5, 0.5, (n, 3)).astype(np.float32)
    columns = [rng.permutation(np.delete(np.arange(n), i))[: i % 141] for i in range(n)]
    home = rng.integers(0, n, 80)
    p = (x[home] + rng.uniform(-0.3, 0.3, (80, 3))).astype(np.float32)
    found, out = wp.zeros(80, dtype=wp.vec2i, device=device), wp.full(80 * stride, -1, dtype=wp.int32, device=device)
    inputs = [wp.array(x, dtype=wp.vec3, device=device), wp.array(home.astype(np.int32), device=device)]
    inputs += [wp.array(p, dtype=wp.vec3, device=device), make_rows(columns, device), 0.4, 100, stride]
    launch(evaluate_lists, 80, inputs, [found, out], device)
    out, found = out.numpy().reshape(80, stride), found.numpy()
    for i, h in enumerate(home):
        among = np.array([h, *columns[h]])
        apart = np.linalg.norm(x[among].astype(float) - p[i].astype(float), axis=1)
        want = set(among[apart <= 0.4].tolist())
        got = out[i, : found[i, 0]].tolist()
        assert found[i, 0] == len(want)
        assert len(got) == len(set(got)) == min(len(want), stride)
        assert set(got) <= want
        allowed = (among < 100) | (among == h)
        assert found[i, 1] == among[allowed][apart[allowed].argmin()]


@wp.kernel(enable_backward=False)
def evaluate_products(a: wp.array(dtype=float), b: wp.array(dtype=float), begin: int, out: wp.array(dtype=float)):
    out[0] = kr.sum_products(a, b, begin, a.shape[0])


def test_sum_products(device):
    """`sum_products`: the sum of a_k b_k over a range."""
    a, b = np.random.default_rng(6).normal(size=(2, 1003)).astype(np.float32)
    out = wp.zeros(1, dtype=float, device=device)
    launch(evaluate_products, 1, [wp.array(a, device=device), wp.array(b, device=device), 5], [out], device)
    terms = a[5:].astype(float) * b[5:]
    assert abs(out.numpy()[0] - terms.sum()) < 1e-6 * np.abs(terms).sum()


@wp.kernel(enable_backward=False)
def evaluate_heights(
    p: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=kr.Quadric),
    rows: Neighbors,
    r: float,
    limit: int,
    # outputs
    out: wp.array(dtype=wp.vec3),
):
    i = rows.first + wp.tid()
    out[i] = kr.height_over_fits(i, p[i], x, surface, rows, r, limit)


def test_height_over_fits(device):
    """`height_over_fits`: mean height over the length of the mean normal, along it; 0 where none is near."""
    rng = np.random.default_rng(7)
    x, p = rng.uniform(-0.5, 0.5, (2, N, 3))
    p[4] = 9.0
    fits = rng.normal(size=(N, 15)).astype(np.float32)
    columns = [rng.permutation(N)[: i % 41] for i in range(N)]
    places = [wp.array(a.astype(np.float32), dtype=wp.vec3, device=device) for a in (p, x)]
    surface = wp.array(fits.view(kr.Quadric.numpy_dtype()).ravel(), dtype=kr.Quadric, device=device)
    out = wp.zeros(N, dtype=wp.vec3, device=device)
    launch(evaluate_heights, N, [*places, surface, make_rows(columns, device), R, LIMIT], [out], device)
    normal, gradient, second = fits[:, :3], fits[:, 3:6], fits[:, 6:].reshape(-1, 3, 3)
    expected = np.zeros((N, 3))
    for i, row in enumerate(columns):
        j = row[row < LIMIT]
        d = p[i] - x[j]
        w = spline(3.0 * np.linalg.norm(d, axis=1) / R)
        height = np.sum(d * (gradient[j] - np.einsum("kab,kb->ka", second[j], d)), axis=1)
        if w.sum() > 0.0:
            mean = w @ normal[j] / w.sum()
            expected[i] = w @ height / w.sum() * mean / max(mean @ mean, 0.25)
    agree(out.numpy(), expected)


@wp.kernel(enable_backward=False)
def evaluate_cells(
    x: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    star: Neighbors,
    weight: wp.array(dtype=float),
    out: wp.array(dtype=kr.vec6),
):
    i = rows.first + wp.tid()
    e1 = wp.vec3(1.0, 0.0, 0.0)
    e2 = wp.vec3(0.0, 1.0, 0.0)
    out[i] = kr.cut_cell(i, x, e1, e2, wp.vec3(0.0, 0.0, 1.0), rows, r, star, weight)


def clipped(lines, half):
    """Corners of the square of side 2 half cut by every line (u, v, offset, label), and the label of each edge."""
    corners = [half * np.array(c) for c in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    labels = [-1] * 4
    for u, v, offset, label in lines:
        kept, names = [], []
        for k, c in enumerate(corners):
            before, name = corners[k - 1], labels[k - 1]
            s, t = before @ (u, v) - offset, c @ (u, v) - offset
            if (s < 0.0) != (t < 0.0):
                kept.append(before + s / (s - t) * (c - before))
                names.append(label if s < 0.0 else name)
            if t < 0.0:
                kept.append(c)
                names.append(labels[k])
        corners, labels = kept, names
    return np.array(corners), labels


def test_cut_cell(device):
    """`cut_cell`: moments and star of a cell cut by the lines of all in its row, one after another."""
    rng = np.random.default_rng(8)
    i = np.arange(N)
    flat = np.stack([i % 8, i // 8], axis=1) + rng.uniform(-0.3, 0.3, (N, 2))
    x = (0.3 * np.column_stack([flat, 0.1 * rng.normal(size=N)])).astype(np.float32)
    columns = [rng.permutation(np.delete(i, k)) for k in i]
    out, weight = wp.zeros(N, dtype=kr.vec6, device=device), wp.zeros(kr.CORNERS * N, dtype=float, device=device)
    star = fixed_rows(N, kr.CORNERS, device)
    inputs = [wp.array(x, dtype=wp.vec3, device=device), make_rows(columns, device), R]
    launch(evaluate_cells, N, inputs, [star, weight, out], device)
    starts, stops, index, weight = star.start.numpy(), star.stop.numpy(), star.index.numpy(), weight.numpy()
    for k in i:
        d = x[columns[k]].astype(float) - x[k]
        plane = d[:, 0] ** 2 + d[:, 1] ** 2
        offset = 0.5 * np.sqrt(plane * (plane + 0.888 * d[:, 2] ** 2))
        corners, labels = clipped(zip(d[:, 0], d[:, 1], offset, columns[k], strict=True), 0.5 * R)
        after = np.roll(corners, -1, axis=0)
        (u, v), (s, t) = corners.T, after.T
        cross = u * t - v * s
        terms = [cross / 2, cross / 6 * (u + s), cross / 6 * (v + t), cross / 12 * (u * u + u * s + s * s)]
        terms += [cross / 24 * (2 * u * v + u * t + s * v + 2 * s * t), cross / 12 * (v * v + v * t + t * t)]
        np.testing.assert_allclose(out.numpy()[k], np.sum(terms, axis=1), atol=2e-7)
        got = dict(zip(index[starts[k] : stops[k]], weight[starts[k] : stops[k]], strict=True))
        apart = np.linalg.norm(x[labels] - x[k], axis=1)
        ties = np.linalg.norm(after - corners, axis=1) / np.maximum(apart, 1e-9)
        expected = {label: tie for label, tie in zip(labels, ties, strict=True) if label >= 0 and tie > 1e-3}
        assert {j: w for j, w in got.items() if w > 1e-3} == pytest.approx(expected, abs=1e-4)


def swirl(x):
    """A flow along the film, m/s."""
    return 0.05 * np.stack([np.sin(60.0 * x[:, 1]), np.cos(40.0 * x[:, 0]), 0.0 * x[:, 0]], axis=1)


FOAM = Cluster((Bubble((-0.0502, 0.0, 0.0), 0.05), Bubble((0.0502, 0.0, 0.0), 0.05)), (Wall((0.0, -0.0502, 0.0), UP),))


@pytest.mark.parametrize("shape", [Sphere(0.05), Disc(0.05), FOAM], ids=["sphere", "disc", "foam"])
def test_any_number_of_cores(shape, device, monkeypatch):
    """Three steps on one core and on three, in graphs and launch by launch, are the same bits."""

    def run(threads, graphs=True):
        monkeypatch.setattr(launcher, "THREADS", threads)
        monkeypatch.setattr(launcher, "GRAPHS", graphs)
        for name in ("ROWS_A_THREAD", "ENTRIES_A_THREAD", "ROWS_A_LANE", "ENTRIES_A_LANE"):
            monkeypatch.setattr(launcher, name, 32)
        stepper = make_stepper(shape, 420, device, l_per_e=4, velocity=swirl)[1]
        for _ in range(3):
            stepper.step(1e-3)
        return stepper.state.numpy()

    one = run(1)
    for other in (run(3), run(3, graphs=False)):
        for name, values in one.items():
            assert np.array_equal(values, other[name]), name
    assert np.abs(one["l.v"]).max() > 0.01
