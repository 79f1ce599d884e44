"""Interference colours: exact optics, CIE daylight, look-up tables."""

import time

import numpy as np
import pytest
import warp as wp

from melp_warp.errors import InputError
from melp_warp.kernels.color import film_color
from melp_warp.optics import (
    DISPLAY_MAX_THICKNESS,
    clip_to_gamut,
    color_table,
    display_color,
    film_reflectance,
    interference_color,
)

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

# Linear sRGB at normal incidence, n = 1.33, to four digits, from an independent spectral computation.
REFERENCE = {
    0: (0.0, 0.0, 0.0),
    104: (0.0746, 0.0775, 0.0673),
    150: (0.0699, 0.0437, 0.0075),
    200: (0.0191, -0.0010, 0.0255),
    250: (-0.0071, 0.0351, 0.0790),
    300: (0.0427, 0.0783, 0.0332),
    350: (0.0926, 0.0450, 0.0031),
    400: (0.0563, 0.0009, 0.0626),
    500: (0.0083, 0.0739, 0.0091),
    600: (0.0805, 0.0099, 0.0664),
}


# Looks up [n] pairs of thickness and cosine.
@wp.kernel
def look_up(table: wp.array2d[wp.vec3], top: float, at: wp.array[wp.vec2], color: wp.array[wp.vec3]):
    i = wp.tid()
    color[i] = film_color(table, top, at[i][0], at[i][1])


def amplitude_sum(thickness, wavelength, cos_i, index, orders=400):
    """Reflectance from the partial waves of the two faces, summed one by one; mean of both polarisations."""
    cos_t = np.sqrt(1 - (1 - cos_i**2) / index**2)
    phase = np.exp(4j * np.pi * index * thickness * cos_t / wavelength)
    total = 0.0
    for a, b in ((cos_i, index * cos_t), (index * cos_i, cos_t)):
        r_in = (a - b) / (a + b)
        t_in_out = 1 - r_in**2  # product of the amplitudes in and out (Stokes)
        wave = t_in_out * phase * -r_in
        amplitude = r_in + 0j
        for _ in range(orders):
            amplitude += wave
            wave *= r_in**2 * phase
        total += abs(amplitude) ** 2
    return total / 2


@pytest.mark.parametrize("cos_i", [1.0, 0.8, 0.5, 0.2])
@pytest.mark.parametrize("index", [1.33, 1.5])
def test_reflectance_is_the_sum_of_all_partial_waves(cos_i, index):
    thickness = np.linspace(0.0, 3000.0, 61)[:, None]
    wavelength = np.array([380.0, 532.0, 780.0])
    expected = amplitude_sum(thickness, wavelength, cos_i, index)
    np.testing.assert_allclose(film_reflectance(thickness, wavelength, cos_i, index), expected, rtol=0, atol=1e-13)


def test_reflectance_at_known_points():
    r = (1 - 1.33) / (1 + 1.33)
    quarter_wave = (2 * r / (1 + r**2)) ** 2
    assert film_reflectance(550 / (4 * 1.33), 550.0) == pytest.approx(quarter_wave, abs=1e-15)
    assert film_reflectance(550 / (2 * 1.33), 550.0) == pytest.approx(0.0, abs=1e-30)
    assert film_reflectance(100.0, 550.0, 0.0) == 1.0
    assert film_reflectance(0.0, 550.0, 0.0) == 0.0
    # At Brewster's angle only the s wave is reflected, at most half of the light.
    cos_b = 1 / np.hypot(1, 1.33)
    r_s = (1 - 1.33**2) / (1 + 1.33**2)
    cos_t = np.sqrt(1 - (1 - cos_b**2) / 1.33**2)
    peak = film_reflectance(550 / (4 * 1.33 * cos_t), 550.0, cos_b)
    assert peak == pytest.approx(0.5 * (2 * r_s / (1 + r_s**2)) ** 2, abs=1e-14)


def test_energy_is_kept():
    rng = np.random.default_rng(1)
    n = 20_000
    r = film_reflectance(rng.uniform(0, 1e4, n), rng.uniform(300, 900, n), rng.uniform(0, 1, n), 1.4)
    assert r.min() >= 0.0
    assert r.max() <= 1.0


def test_colors_of_the_reference_table():
    found = interference_color(np.array(list(REFERENCE), dtype=float))
    np.testing.assert_allclose(found, np.array(list(REFERENCE.values())), rtol=0, atol=2e-4)


def test_luminance_extrema():
    luminance = interference_color(np.arange(0.0, 900.0)) @ LUMINANCE
    inner = luminance[1:-1]
    maxima = 1 + np.flatnonzero((inner > luminance[:-2]) & (inner > luminance[2:]))
    minima = 1 + np.flatnonzero((inner < luminance[:-2]) & (inner < luminance[2:]))
    assert maxima.tolist() == [104, 311, 521, 732]
    assert minima.tolist() == [207, 416, 626, 837]


def test_a_perfect_mirror_is_white():
    """At grazing incidence everything is reflected: the colour is the light's, D65, the white of sRGB."""
    np.testing.assert_allclose(interference_color(300.0, 0.0), np.ones(3), rtol=0, atol=1e-3)


def test_tilt_acts_as_a_thinner_film():
    """The phase depends on d cos(theta_t); at small angles the reflectance of the faces hardly changes."""
    cos_i = np.cos(np.radians(15))
    cos_t = np.sqrt(1 - (1 - cos_i**2) / 1.33**2)
    tilted, straight = interference_color(400 / cos_t, cos_i), interference_color(400.0)
    np.testing.assert_allclose(tilted, straight, rtol=0, atol=5e-4)
    assert np.abs(interference_color(400 / cos_t) - straight).max() > 1e-2


def test_thick_films_are_grey():
    """Beyond the range of display_color, colours differ from grey by less than 0.5 percent of white."""
    mean = 1 - 1 / np.sqrt(1 + 4 * 0.33**2 * 2.33**2 / (2.33**2 - 0.33**2) ** 2)
    color = interference_color(DISPLAY_MAX_THICKNESS)
    np.testing.assert_allclose(13 * color, 13 * mean * np.ones(3), rtol=0, atol=1e-2)


def test_color_table_holds_the_exact_colors():
    table = color_table(1500.0, 301, 21)
    assert table.shape == (301, 21, 3)
    assert table.dtype == np.float32
    for i, j in ((0, 0), (80, 20), (299, 3), (300, 20)):
        np.testing.assert_allclose(table[i, j], interference_color(i * 5.0, j / 20), rtol=0, atol=1e-7)


def test_look_up_in_a_kernel(device):
    top, table = 2000.0, color_table()
    rng = np.random.default_rng(2)
    at = np.column_stack([rng.uniform(0, top, 4000), rng.uniform(0.3, 1.0, 4000)]).astype(np.float32)
    at = np.vstack([at, [[0, 1], [top, 1], [1.5 * top, 1], [400, -1]]]).astype(np.float32)
    color = wp.zeros(len(at), dtype=wp.vec3, device=device)
    grid = wp.array(table, dtype=wp.vec3, device=device)
    assert grid.shape == (1024, 64)
    wp.launch(look_up, len(at), [grid, top, wp.array(at, dtype=wp.vec2, device=device)], [color], device=device)
    found = color.numpy()
    held = interference_color(np.minimum(at[:, 0], top).astype(float), np.abs(at[:, 1]).astype(float))
    np.testing.assert_allclose(found, held, rtol=0, atol=1e-3)
    # Grid points are exact, above the largest thickness the last row is held, the sign of the cosine is ignored.
    np.testing.assert_array_equal(found[-4], table[0, -1])
    np.testing.assert_array_equal(found[-3], table[-1, -1])
    np.testing.assert_array_equal(found[-2], table[-1, -1])
    np.testing.assert_allclose(found[-1], interference_color(400.0), rtol=0, atol=2e-5)


def test_display_color_is_the_exact_color_in_gamut():
    thickness = np.random.default_rng(3).uniform(0, 3000, 5000).astype(np.float32)
    for gain, index in ((13.0, 1.33), (5.0, 1.4)):
        found = display_color(thickness, gain, index)
        exact = clip_to_gamut(gain * interference_color(thickness, 1.0, index))
        assert found.dtype == np.float32
        assert found.min() >= 0.0
        assert found.max() <= 1.0
        np.testing.assert_allclose(found, exact, rtol=0, atol=4e-3)


def test_display_color_at_the_ends():
    found = display_color([0.0, DISPLAY_MAX_THICKNESS, 1e9])
    np.testing.assert_array_equal(found[0], np.zeros(3))
    np.testing.assert_array_equal(found[1], found[2])
    assert display_color(np.zeros(0, np.float32)).shape == (0, 3)
    # Newton black film (5 nm) is black beside the white of the first maximum.
    black, white = display_color([5.0, 104.0]) @ LUMINANCE
    assert black < 0.01 * white


def test_two_million_points_are_fast():
    thickness = np.random.default_rng(4).uniform(0, 1000, 2_000_000).astype(np.float32)
    display_color(thickness[:1])
    start = time.process_time()
    display_color(thickness)
    assert time.process_time() - start < 1.5  # an exact evaluation takes several times as long


def test_gamut_clip():
    inside = np.array([[0.2, 0.5, 0.9], [0, 0, 0], [1, 1, 1]])
    np.testing.assert_array_equal(clip_to_gamut(inside), inside)
    negative = np.array([0.4, -0.1, 0.6])
    luminance = negative @ LUMINANCE
    paler = clip_to_gamut(negative)
    assert paler[1] == 0.0
    assert paler @ LUMINANCE == pytest.approx(luminance, abs=1e-15)
    # Hue: what is left points along the same direction from grey.
    np.testing.assert_allclose(np.cross(paler - luminance, negative - luminance), 0.0, atol=1e-16)
    np.testing.assert_allclose(clip_to_gamut([2.0, 1.0, 0.5]), [1.0, 0.5, 0.25], atol=1e-15)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: film_reflectance(-1.0, 500.0), "thickness_nm must be at least 0, got -1.0"),
        (lambda: film_reflectance(np.array([1.0, np.nan]), 500.0), "thickness_nm must be at least 0, got nan"),
        (lambda: film_reflectance(1.0, 0.0), "wavelength_nm must be above 0, got 0.0"),
        (lambda: film_reflectance(1.0, 500.0, 1.1), "cos_theta must be from 0 to 1, got 1.1"),
        (lambda: film_reflectance(1.0, 500.0, 1.0, 1.0), "index must be a number above 1, got 1.0"),
        (lambda: interference_color(1.0, -0.1), "cos_theta must be from 0 to 1, got -0.1"),
        (lambda: color_table(0.0), "max_thickness_nm must be a number above 0, got 0.0"),
        (lambda: color_table(n_cos=1), "n_cos must be a whole number of at least 2, got 1"),
        (lambda: display_color([100.0, -2.0]), "thickness_nm must be at least 0, got -2.0"),
        (lambda: display_color([np.inf]), "thickness_nm must be at least 0, got inf"),
        (lambda: display_color([1.0], gain=0.0), "gain must be a number above 0, got 0.0"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(InputError) as error:
        call()
    assert str(error.value) == named
