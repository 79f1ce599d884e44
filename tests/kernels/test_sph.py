"""The quintic spline and the weights made from it."""

import numpy as np
import pytest
import warp as wp

from melp_warp.kernels.sph import kernel_w, laplacian_weight, tangent_basis, tangential


@wp.kernel
def evaluate_weights(d: wp.array[float], r: float, w: wp.array[float], k: wp.array[float]):
    i = wp.tid()
    w[i] = kernel_w(d[i], r)
    k[i] = laplacian_weight(d[i], r)


@wp.kernel
def evaluate_frames(n: wp.array[wp.vec3], v: wp.array[wp.vec3], out: wp.array2d[wp.vec3]):
    i = wp.tid()
    e1, e2 = tangent_basis(n[i])
    out[i, 0] = e1
    out[i, 1] = e2
    out[i, 2] = tangential(v[i], n[i])


def weights(d, r, device):
    """W(d), 2|W'|/d at distances d."""
    d = wp.array(np.asarray(d, dtype=np.float32), device=device)
    w, k = (wp.zeros(d.shape, dtype=float, device=device) for _ in range(2))
    wp.launch(evaluate_weights, d.shape, [d, r], [w, k], device=device)
    return w.numpy().astype(np.float64), k.numpy().astype(np.float64)


RADII = [0.004, 1.0]


@pytest.mark.parametrize("r", RADII)
def test_integrates_to_one(r, device):
    """int W dA = 2 pi int W d dd = 1.

    The trapezoid rule on a function that vanishes with its derivatives at both ends is exact far below float32's 1e-7;
    a mean of 4,000 rounded values stays below 1e-6.
    """
    d = np.linspace(0.0, r, 4001)
    w, _ = weights(d, r, device)
    assert 2.0 * np.pi * np.sum(w * d) * d[1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("r", RADII)
def test_second_moment_of_laplacian_weight(r, device):
    """int (2|W'|/d) x^2 dA = 2 int W dA = 2 by parts, which makes sum a (f_j - f_i) 2|W'|/d the Laplacian of f."""
    d = np.linspace(0.0, r, 4001)
    _, k = weights(d, r, device)
    assert np.pi * np.sum(k * d**3) * d[1] == pytest.approx(2.0, abs=2e-6)


@pytest.mark.parametrize("r", RADII)
def test_support_sign_and_monotony(r, device):
    """W and 2|W'|/d are positive inside the support, fall with d, and vanish from d = r on."""
    d = np.linspace(0.0, 0.98 * r, 400)
    for values in weights(d, r, device):
        assert np.all(values > 0.0)
        assert np.all(np.diff(values[1:]) < 0.0)
    for values in weights(np.linspace(r, 3.0 * r, 50), r, device):
        assert np.all(values <= 1e-12 * weights([0.0], r, device)[0])


def test_laplacian_weight_is_slope_of_kernel(device):
    """2|W'|/d = -(W(d + e) - W(d - e))/(e d) to O(e^2): W''' e^2/6 + rounding/e, in units of W(0)/r^2.

    Measured 3.1e-3, 7.8e-4 and 1.7e-4 for e = 0.02, 0.01 and 0.005 r; the bound is W(0)/r^2 e^2 times 10.
    """
    r = 1.0
    e = 1e-2
    d = np.linspace(0.05, 0.95, 60)
    up, _ = weights(d + e, r, device)
    down, _ = weights(d - e, r, device)
    _, k = weights(d, r, device)
    _, top = weights([0.0], r, device)
    assert np.abs((down - up) / (e * d) - k).max() < 10.0 * e**2 * top[0]


def test_laplacian_weight_is_finite_at_zero(device):
    """Particles on top of each other: 2|W'|/d tends to 2|W''(0)|, not to infinity."""
    _, k = weights([0.0, 1e-6, 0.01], 1.0, device)
    assert np.all(np.isfinite(k))
    assert k[0] == pytest.approx(k[2], rel=5e-3)


def test_tangent_basis(device):
    """(e1, e2, n) is right-handed and orthonormal, v_t = v - (v.n) n, to rounding for any n."""
    rng = np.random.default_rng(0)
    n = np.concatenate([rng.normal(size=(200, 3)), np.eye(3), -np.eye(3), [[0.714, 0.0, 0.7], [0.0, 0.7, -0.714]]])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    v = rng.normal(size=n.shape)
    out = wp.zeros((len(n), 3), dtype=wp.vec3, device=device)
    arrays = [wp.array(a.astype(np.float32), dtype=wp.vec3, device=device) for a in (n, v)]
    wp.launch(evaluate_frames, len(n), arrays, [out], device=device)
    e1, e2, vt = np.moveaxis(out.numpy().astype(np.float64), 1, 0)
    frame = np.stack([e1, e2, n], axis=1)
    assert np.abs(frame @ np.swapaxes(frame, 1, 2) - np.eye(3)).max() < 1e-6
    assert np.abs(np.linalg.det(frame) - 1.0).max() < 1e-6
    assert np.abs(vt - (v - np.sum(v * n, axis=1, keepdims=True) * n)).max() < 2e-6
