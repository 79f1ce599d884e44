"""Added mass of air as a function of the Laplacian, and its partial fractions."""

import numpy as np
import pytest

from melp_warp.stages import air

RHO = 1.204


@pytest.mark.parametrize("radius", [0.005, 0.05, 0.5])
def test_added_mass_of_sphere_modes(radius):
    """A(n(n+1)/R^2) = rho R (2n+1)/(n(n+1)) for every n: rho sqrt(4/lambda + 1/(R lambda)^2) is that identity."""
    n = np.arange(1, 200)
    lam = n * (n + 1) / radius**2
    exact = RHO * radius * (2 * n + 1) / (n * (n + 1))
    assert air.added_mass(lam, RHO, radius) == pytest.approx(exact, rel=1e-12)


def test_added_mass_is_inside_plus_outside():
    """Potential flow of mode n: r^n inside gives rho R/n, r^-(n+1) outside rho R/(n+1); together (2n+1)/(n(n+1))."""
    n = np.arange(1, 50)
    lam = n * (n + 1) / 0.03**2
    assert air.added_mass(lam, RHO, 0.03) == pytest.approx(RHO * 0.03 * (1.0 / n + 1.0 / (n + 1)), rel=1e-12)


def test_added_mass_of_plane_film():
    """Both half-spaces over a wave of number k: 2 rho/k."""
    k = np.geomspace(1.0, 1e4, 20)
    assert air.added_mass(k * k, RHO, np.inf) == pytest.approx(2.0 * RHO / k, rel=1e-12)


def test_rigid_added_mass():
    """Translation is n = 1: rho R 3/2 (inside rho R, outside rho R/2); an open film has none."""
    assert air.rigid_added_mass(RHO, 0.1) == pytest.approx(air.added_mass(np.array(200.0), RHO, 0.1), rel=1e-12)
    assert air.rigid_added_mass(RHO, np.inf) == 0.0


@pytest.mark.parametrize("radius", [0.01, 0.1, np.inf])
@pytest.mark.parametrize("support", [2.0, 3.0, 6.0])
@pytest.mark.parametrize("count", [60, 300, 5000, 20000])
def test_poles_fit_the_added_mass(radius, count, support):
    """sum w_k/(lambda + s_k) = A on the range of the film's discrete Laplacian, within 0.25 % up to 20,000 E.

    1 % of frequency would be 2 % of mass.
    """
    longest = radius if np.isfinite(radius) else 0.05
    area = 4.0 * np.pi * radius**2 if np.isfinite(radius) else np.pi * longest**2
    low, high = 2.0 / longest**2, 4.0 * np.pi**2 * count / area
    blur = 0.12077 * support**2 / 9.0 * area / count
    poles, weights = air.fit_poles(low, high, RHO, radius, blur)
    lam = np.geomspace(low, high, 1777)
    exact = air.added_mass(lam * (1.0 + blur * (lam - 2.0 / radius**2)), RHO, radius)
    error = np.abs((weights / (lam[:, None] + poles)).sum(axis=1) / exact - 1.0).max()
    print(f"R {radius:g}, {count} E: {error:.1e}")
    assert np.all(poles > 0.0) and np.all(weights > 0.0)
    assert error < 2.5e-3


@pytest.mark.parametrize("mass", [1e-5, 4e-4, 1e-2])
@pytest.mark.parametrize("dt", [1e-6, 1e-4, 1e-3, 1.0 / 60.0])
def test_response_is_its_partial_fractions(mass, dt):
    """sum g_k/(lambda + p_k) = 1/((m + sum w_k/(lambda + s_k)) (1 - b lambda) + c lambda) to rounding.

    The poles are those of a real rational function: real, or in conjugate pairs; one is real and above 0. None lies
    among the eigenvalues, which end below 0.6/b.
    """
    radius = 0.1
    low, high = 2.0 / radius**2, 4.0 * np.pi * 5000 / (4.0 * radius**2)
    spread, blur = 0.12077 * 4.0 * np.pi * radius**2 / 5000, 0.1577 * 4.0 * np.pi * radius**2 / 5000
    s, w = air.fit_poles(low, high, RHO, radius, spread)
    c = 2.0 * 0.0725 * dt**2
    p, g = air.response(mass, c, s, w, blur)
    lam = np.geomspace(0.1 * low, 0.65 / blur, 300)
    exact = 1.0 / ((mass + (w / (lam[:, None] + s)).sum(axis=1)) * (1.0 - blur * lam) + c * lam)
    assert np.all(exact > 0.0)
    got = (g / (lam[:, None] + p)).sum(axis=1)
    print(f"m {mass:g}, dt {dt:g}: error {np.abs(got / exact - 1.0).max():.1e}")
    assert np.abs(got / exact - 1.0).max() < 1e-7
    assert np.isclose(np.sum(p.imag), 0.0, atol=1e-6 * np.abs(p).max())
    assert np.any((np.abs(p.imag) < 1e-9 * np.abs(p)) & (p.real > 0.0))
