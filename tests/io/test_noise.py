"""Perlin noise: range, zeros, smoothness, seeds."""

import numpy as np
import pytest

from melp_warp.errors import InputError
from melp_warp.noise import Perlin


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-20.0, 20.0, size=(20000, 3))


def test_range_and_mean(points):
    values = Perlin(seed=3)(points)
    assert np.abs(values).max() <= 1.0
    assert np.abs(values).max() > 0.6
    assert abs(values.mean()) < 0.01


@pytest.mark.parametrize("frequency", [1.0, 5.0])
def test_zero_at_lattice_points_and_nowhere_else(frequency):
    lattice = (np.indices((5, 5, 5)).reshape(3, -1).T - 2.5) / frequency
    noise = Perlin(seed=1, frequency=frequency)
    assert np.abs(noise(lattice)).max() < 1e-12
    assert np.abs(noise(lattice + 0.3 / frequency)).max() > 0.2


def test_continuous_with_continuous_slope_across_cell_faces():
    noise, step = Perlin(seed=2, octaves=2), 1e-5
    y, z = np.random.default_rng(1).uniform(-3, 3, size=(2, 500))

    def at(x):
        return noise(np.stack([np.full(500, x), y, z], axis=1))

    face = 0.5
    below = (at(face) - at(face - step)) / step
    above = (at(face + step) - at(face)) / step
    assert np.abs(at(face + 1e-9) - at(face - 1e-9)).max() < 1e-7
    assert np.abs(above - below).max() < 1e-2
    assert np.abs(above).max() > 0.3


def test_seed_decides(points):
    same, other = Perlin(seed=5, octaves=3), Perlin(seed=6, octaves=3)
    np.testing.assert_array_equal(same(points), Perlin(seed=5, octaves=3)(points))
    assert np.corrcoef(same(points), other(points))[0, 1] == pytest.approx(0.0, abs=0.03)


def test_octaves_add_detail(points):
    def roughness(octaves):
        noise = Perlin(seed=4, octaves=octaves)
        return np.linalg.norm(noise.gradient(points[:2000]), axis=1).mean() / noise(points).std()

    assert 1.1 * roughness(1) < roughness(2)
    assert 1.1 * roughness(2) < roughness(3)


def test_gradient_matches_finite_difference_along_a_line():
    noise = Perlin(seed=7, frequency=3.0)
    t = np.linspace(0.0, 1.0, 2001)
    line = np.outer(t, [0.3, -0.8, 0.5])
    slope = noise.gradient(line) @ [0.3, -0.8, 0.5]
    np.testing.assert_allclose(np.gradient(noise(line), t)[1:-1], slope[1:-1], atol=2e-4)


def test_even_spreads_over_its_range(points):
    values = Perlin(seed=8, octaves=2).even(points)
    assert np.abs(values).max() < 1.0
    assert values.std() > 0.3


@pytest.mark.parametrize("arguments", [{"frequency": 0.0}, {"frequency": np.nan}, {"octaves": 0}])
def test_refuses(arguments):
    with pytest.raises(InputError, match=next(iter(arguments))):
        Perlin(0, **arguments)
