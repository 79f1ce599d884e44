"""Interference colours of a free soap film under daylight.

The reflectance is the exact Airy sum of a film of one index in air, both polarisations averaged. Colours are
linear sRGB (Rec. 709 primaries, D65 white): a surface that reflects everything is (1, 1, 1). A soap film reflects
less than 8 percent at normal incidence, so pictures need a gain.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from melp_warp.errors import require

WATER_INDEX = 1.33
"""Refractive index of soap water."""

DISPLAY_GAIN = 13.0
"""Factor that brings the brightest interference colour at normal incidence to about white."""

_FALSE = ((0.01, 0.01, 0.09), (0.03, 0.08, 0.22), (0.04, 0.25, 0.23), (0.28, 0.52, 0.1), (0.95, 0.83, 0.06))
"""Colours of `false_colors`, evenly spaced, linear sRGB."""

DISPLAY_MAX_THICKNESS = 4000.0
"""nm; above it `display_color` gives the colour of this thickness (fringes have washed out to grey)."""

_DISPLAY_STEP = 0.25

# CIE 1931 2-degree colour matching functions x, y, z and the CIE standard illuminant D65 at the wavelength (nm)
# of the first column.
_CIE_1931_D65 = np.array(
    [
        [380, 0.001368, 0.000039, 0.006450, 49.9755],
        [390, 0.004243, 0.000120, 0.020050, 54.6482],
        [400, 0.014310, 0.000396, 0.067850, 82.7549],
        [410, 0.043510, 0.001210, 0.207400, 91.4860],
        [420, 0.134380, 0.004000, 0.645600, 93.4318],
        [430, 0.283900, 0.011600, 1.385600, 86.6823],
        [440, 0.348280, 0.023000, 1.747060, 104.8650],
        [450, 0.336200, 0.038000, 1.772110, 117.0080],
        [460, 0.290800, 0.060000, 1.669200, 117.8120],
        [470, 0.195360, 0.090980, 1.287640, 114.8610],
        [480, 0.095640, 0.139020, 0.812950, 115.9230],
        [490, 0.032010, 0.208020, 0.465180, 108.8110],
        [500, 0.004900, 0.323000, 0.272000, 109.3540],
        [510, 0.009300, 0.503000, 0.158200, 107.8020],
        [520, 0.063270, 0.710000, 0.078250, 104.7900],
        [530, 0.165500, 0.862000, 0.042160, 107.6890],
        [540, 0.290400, 0.954000, 0.020300, 104.4050],
        [550, 0.433450, 0.994950, 0.008750, 104.0460],
        [560, 0.594500, 0.995000, 0.003900, 100.0000],
        [570, 0.762100, 0.952000, 0.002100, 96.3342],
        [580, 0.916300, 0.870000, 0.001650, 95.7880],
        [590, 1.026300, 0.757000, 0.001100, 88.6856],
        [600, 1.062200, 0.631000, 0.000800, 90.0062],
        [610, 1.002600, 0.503000, 0.000340, 89.5991],
        [620, 0.854450, 0.381000, 0.000190, 87.6987],
        [630, 0.642400, 0.265000, 0.000050, 83.2886],
        [640, 0.447900, 0.175000, 0.000020, 83.6992],
        [650, 0.283500, 0.107000, 0.000000, 80.0268],
        [660, 0.164900, 0.061000, 0.000000, 80.2146],
        [670, 0.087400, 0.032000, 0.000000, 82.2778],
        [680, 0.046770, 0.017000, 0.000000, 78.2842],
        [690, 0.022700, 0.008210, 0.000000, 69.7213],
        [700, 0.011359, 0.004102, 0.000000, 71.6091],
        [710, 0.005790, 0.002091, 0.000000, 74.3490],
        [720, 0.002899, 0.001047, 0.000000, 61.6040],
        [730, 0.001440, 0.000520, 0.000000, 69.8856],
        [740, 0.000690, 0.000249, 0.000000, 75.0870],
        [750, 0.000332, 0.000120, 0.000000, 63.5927],
        [760, 0.000166, 0.000060, 0.000000, 46.4182],
        [770, 0.000083, 0.000030, 0.000000, 66.8054],
        [780, 0.000042, 0.000015, 0.000000, 63.3828],
    ]
)

_XYZ_TO_SRGB = np.array(
    [
        [3.2406, -1.5372, -0.4986],
        [-0.9689, 1.8758, 0.0415],
        [0.0557, -0.2040, 1.0570],
    ]
)

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def _spectral_weights() -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths [41] in nm and the linear sRGB of a unit reflectance in each of their bands, [41, 3]."""
    xyz = _CIE_1931_D65[:, 1:4] * _CIE_1931_D65[:, 4:5]
    return _CIE_1931_D65[:, 0], (xyz / xyz[:, 1].sum()) @ _XYZ_TO_SRGB.T


def _checked(field: str, value: object, allowed: str, low: float, high: float = np.inf) -> np.ndarray:
    """`value` as float64 array; `InputError` naming the first entry that is not finite or not in [low, high]."""
    array = np.asarray(value, dtype=np.float64)
    bad = ~(np.isfinite(array) & (array >= low) & (array <= high))
    if bad.any():
        require(False, field, float(array[bad].flat[0]), allowed)
    return array


def _checked_index(index: float) -> float:
    require(np.isscalar(index) and np.isfinite(index) and index > 1.0, "index", index, "a number above 1")
    return float(index)


def _reflectance(thickness: np.ndarray, wavelength: np.ndarray, cos_i: np.ndarray, index: float) -> np.ndarray:
    """`film_reflectance` without checks."""
    cos_t = np.sqrt(1.0 - (1.0 - cos_i**2) / index**2)
    sin2 = np.sin(2.0 * np.pi * index * thickness * cos_t / wavelength) ** 2
    total = 0.0
    for r in (
        (cos_i - index * cos_t) / (cos_i + index * cos_t),  # s polarised
        (index * cos_i - cos_t) / (index * cos_i + cos_t),  # p polarised
    ):
        numerator = 4.0 * r**2 * sin2
        denominator = (1.0 - r**2) ** 2 + numerator
        # Both vanish only for a film of no phase at grazing incidence; no film reflects nothing.
        total = total + numerator / np.where(denominator > 0.0, denominator, 1.0)
    return 0.5 * total


def film_reflectance(thickness_nm, wavelength_nm, cos_theta=1.0, index: float = WATER_INDEX) -> np.ndarray:
    """Return the power reflectance of a free film in air for unpolarised light.

    For each polarisation R = F s^2/(1 + F s^2), F = 4 r^2/(1 - r^2)^2, s = sin(delta/2),
    delta = (4 pi/lambda) n d cos(theta_t), with Fresnel's r at the first face. The arguments broadcast.

    Args:
        thickness_nm: film thickness d, nm, at least 0.
        wavelength_nm: vacuum wavelength lambda, nm, above 0.
        cos_theta: cosine of the angle of incidence in air, 0 to 1.
        index: refractive index n, above 1.

    Returns:
        Reflectance, 0 to 1, float64 in the broadcast shape.

    Raises:
        InputError: an argument is not finite or out of range.
    """
    thickness = _checked("thickness_nm", thickness_nm, "at least 0", 0.0)
    wavelength = _checked("wavelength_nm", wavelength_nm, "above 0", np.nextafter(0.0, 1.0))
    cos_i = _checked("cos_theta", cos_theta, "from 0 to 1", 0.0, 1.0)
    return _reflectance(thickness, wavelength, cos_i, _checked_index(index))


def interference_color(thickness_nm, cos_theta=1.0, index: float = WATER_INDEX) -> np.ndarray:
    """Return the colour of white daylight (D65) reflected by a free film.

    CIE 1931 2-degree observer, wavelengths 380 to 780 nm in steps of 10 nm. The colour is unclipped: saturated
    hues have slightly negative channels. The arguments broadcast. The sampling holds up to about 5000 nm.

    Args:
        thickness_nm: film thickness, nm, at least 0.
        cos_theta: cosine of the angle of incidence in air, 0 to 1.
        index: refractive index, above 1.

    Returns:
        Linear sRGB of gain 1, float64 [..., 3].

    Raises:
        InputError: an argument is not finite or out of range.
    """
    thickness = _checked("thickness_nm", thickness_nm, "at least 0", 0.0)
    cos_i = _checked("cos_theta", cos_theta, "from 0 to 1", 0.0, 1.0)
    index = _checked_index(index)
    thickness, cos_i = np.broadcast_arrays(thickness, cos_i)
    color = np.zeros((*thickness.shape, 3))
    for wavelength, weight in zip(*_spectral_weights(), strict=True):
        color += _reflectance(thickness, wavelength, cos_i, index)[..., None] * weight
    return color


def color_table(
    max_thickness_nm: float = 2000.0, n_thickness: int = 1024, n_cos: int = 64, index: float = WATER_INDEX
) -> np.ndarray:
    """Return `interference_color` on a grid, for bilinear look-up (`melp_warp.kernels.color.film_color`).

    Row i is the thickness i/(n_thickness - 1) max_thickness_nm, column j the cosine j/(n_cos - 1). A look-up above
    the largest thickness must hold the last row, never wrap: colours do not repeat, they wash out to grey. At
    2000 nm a pale tint is left; take a larger table for thicker films.

    Args:
        max_thickness_nm: thickness of the last row, nm, above 0.
        n_thickness: number of rows, at least 2.
        n_cos: number of columns, at least 2.
        index: refractive index, above 1.

    Returns:
        Unclipped linear sRGB of gain 1, [n_thickness, n_cos, 3] float32.

    Raises:
        InputError: an argument is not finite or out of range.
    """
    top = np.isscalar(max_thickness_nm) and np.isfinite(max_thickness_nm) and max_thickness_nm > 0.0
    require(top, "max_thickness_nm", max_thickness_nm, "a number above 0")
    for field, count in (("n_thickness", n_thickness), ("n_cos", n_cos)):
        require(isinstance(count, (int, np.integer)) and count >= 2, field, count, "a whole number of at least 2")
    thickness = np.linspace(0.0, max_thickness_nm, n_thickness)
    return interference_color(thickness[:, None], np.linspace(0.0, 1.0, n_cos), index).astype(np.float32)


def false_colors(count: int = 256) -> np.ndarray:
    """Return colours for a quantity from its least to its largest value: dark blue, green, yellow, ever lighter.

    Returns:
        Linear sRGB, [count, 3] float32.
    """
    at, stops = np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(_FALSE))
    return np.stack([np.interp(at, stops, channel) for channel in np.array(_FALSE).T], axis=1).astype(np.float32)


def clip_to_gamut(color: np.ndarray) -> np.ndarray:
    """Bring linear sRGB [..., 3] into 0..1 in two steps; no channel is cut by itself.

    1. A colour with a negative channel is moved towards the grey of its luminance until that channel is 0: it
       becomes a little paler, its luminance stays.
    2. A colour with a channel above 1 is divided by its largest channel: it becomes a little darker, its
       chromaticity stays.
    """
    color = np.asarray(color, dtype=np.float64)
    luminance = np.maximum((color @ _LUMINANCE)[..., None], 0.0)
    lowest = np.minimum(color.min(axis=-1, keepdims=True), 0.0)
    keep = np.divide(luminance, luminance - lowest, out=np.ones_like(lowest), where=lowest < 0.0)
    color = luminance + keep * (color - luminance)
    return np.clip(color / np.maximum(color.max(axis=-1, keepdims=True), 1.0), 0.0, 1.0)  # the clip removes rounding


@lru_cache(maxsize=8)
def _display_table(gain: float, index: float) -> np.ndarray:
    """Clipped colours at normal incidence every `_DISPLAY_STEP` nm, [m, 3] float32."""
    thickness = np.arange(0.0, DISPLAY_MAX_THICKNESS + 0.5 * _DISPLAY_STEP, _DISPLAY_STEP)
    return clip_to_gamut(gain * interference_color(thickness, 1.0, index)).astype(np.float32)


def display_color(thickness_nm, gain: float = DISPLAY_GAIN, index: float = WATER_INDEX) -> np.ndarray:
    """Return the colours to bake into a cache: normal incidence, times a gain, inside the sRGB gamut.

    The gamut is met by `clip_to_gamut`. Above `DISPLAY_MAX_THICKNESS` the colour of that thickness is used.

    Args:
        thickness_nm: film thickness, nm, [n], at least 0.
        gain: factor on the reflectance, above 0.
        index: refractive index, above 1.

    Returns:
        Linear sRGB in 0..1, [n, 3] float32.

    Raises:
        InputError: an argument is not finite or out of range.
    """
    require(np.isscalar(gain) and np.isfinite(gain) and gain > 0.0, "gain", gain, "a number above 0")
    table = _display_table(float(gain), _checked_index(index))
    position = np.asarray(thickness_nm, dtype=np.float32) / np.float32(_DISPLAY_STEP)
    if not (np.isfinite(position) & (position >= 0.0)).all():
        _checked("thickness_nm", thickness_nm, "at least 0", 0.0)
    position = np.minimum(position, np.float32(len(table) - 1))
    row = np.minimum(position.astype(np.int32), len(table) - 2)
    fraction = (position - row.astype(np.float32))[..., None]
    below = table[row]
    return below + fraction * (table[row + 1] - below)
