"""Quintic spline kernel (support r = 3 h) and the SPH weights made from it."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def fourth_up(a: float) -> float:
    """max(a, 0)^4."""
    b = wp.max(a, 0.0)
    return b * b * b * b


@wp.func
def kernel_w(d: float, r: float) -> float:
    """Two-dimensional quintic spline W(d) with support r; integrates to one over the plane. 1/m^2."""
    h = r / 3.0
    s = d / h
    a = wp.max(3.0 - s, 0.0)
    b = wp.max(2.0 - s, 0.0)
    c = wp.max(1.0 - s, 0.0)
    value = a * a * a * a * a - 6.0 * b * b * b * b * b + 15.0 * c * c * c * c * c
    return 0.004661441847 / (h * h) * value


@wp.func
def laplacian_weight(d: float, r: float) -> float:
    """2 |W'(d)|/d of the SPH Laplacian, (21) last line. 1/m^4."""
    h = r / 3.0
    s = wp.max(d / h, 1.0e-3)
    value = fourth_up(3.0 - s) - 6.0 * fourth_up(2.0 - s) + 15.0 * fourth_up(1.0 - s)
    return 0.004661441847 * 10.0 / (h * h * h * h * s) * value


@wp.func
def tangent_basis(n: wp.vec3):
    """Two unit vectors e1, e2 that make (e1, e2, n) a right-handed frame."""
    axis = wp.vec3(0.0, 0.0, 1.0)
    if wp.abs(n[2]) > 0.7:
        axis = wp.vec3(1.0, 0.0, 0.0)
    e1 = wp.normalize(wp.cross(axis, n))
    return e1, wp.cross(n, e1)


@wp.func
def tangential(v: wp.vec3, n: wp.vec3) -> wp.vec3:
    """The part of v in the plane with unit normal n."""
    return v - wp.dot(v, n) * n
