"""Profiles of Gaussians and bounds of positions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.images.gaussian_kernels import fill_bend, fill_derivatives, fill_profile, fill_shares
from sabench.images.gaussians import gaussian_shares
from sabench.images.position_bounds import ParticleSpots, position_bounds
from sabench.metrics.particle_bounds import rms_over_bound
from sabench.utils.arrays import F64
from sabench.utils.vector_units import LANES, whole_lanes
from tests.helpers.image_model import profile


@pytest.mark.parametrize("kind", [np.float64, np.float32])
@pytest.mark.parametrize("pixels", [1, 7, 8, 9, 23])
def test_profiles_are_a_gaussians_integrals_and_their_slopes(pixels: int, kind: type) -> None:
    """At any place in and outside the window, from needles to spots wider than it."""
    random, rounding = np.random.default_rng(1), 4e-8 if kind is np.float32 else 0.0
    shares, slopes = (np.full(whole_lanes(pixels), 7.0, kind) for _ in range(2))
    alone = shares.copy()
    for sigma in [1e-9, 0.1, *random.uniform(0.2, 6.0, 200)]:
        center, first = random.uniform(-20.0, 20.0), int(random.integers(-20, 20))
        fill_shares(center, sigma, first, pixels, alone)
        fill_profile(center, sigma, first, pixels, shares, slopes)
        expected = profile(np.array([center - first]), sigma, pixels)[0]
        assert_allclose(shares[:pixels], expected, rtol=0.0, atol=1e-8 + rounding)
        assert_array_equal(shares, alone)
        assert not shares[pixels:].any()
        assert not slopes[pixels:].any()
        edges = (first - 0.5 - center + np.arange(pixels + 1)) / sigma
        density = np.exp(-0.5 * edges**2) / np.sqrt(2.0 * np.pi)
        assert np.abs(slopes[:pixels] * sigma + np.diff(density)).max() <= 4e-8 + 2 * rounding


@pytest.mark.parametrize("sigma", [0.3, 0.8, 2.5])
def test_derivatives_are_those_of_shares_by_the_centre(sigma: float) -> None:
    center, first, pixels, step = 3.3, -2, 11, 1e-4 * sigma
    found, before, after = np.zeros((3, 5, pixels))
    for move, each in ((0.0, found), (-step, before), (step, after)):
        at, room = center + move, np.zeros(whole_lanes(pixels))
        fill_profile(at, sigma, first, pixels, room, slopes := np.zeros(16))
        each[0] = slopes[:pixels]
        fill_derivatives(at, sigma, first, each[1:])
    for n in range(1, 5):
        expected = (after[n - 1] - before[n - 1]) / (2.0 * step)
        assert_allclose(found[n], expected, atol=1e-3 * np.abs(expected).max())
    fill_bend(center, sigma, first, bend := np.zeros(pixels))
    assert_allclose(bend, found[1], atol=1e-12)


def test_shares_in_numpy_are_those_of_kernels() -> None:
    """Eight pixels fill eight lanes, though they have nine edges."""
    assert [whole_lanes(pixels) for pixels in (1, 8, 9)] == [LANES, LANES, 2 * LANES]
    shares = np.zeros(whole_lanes(11))
    fill_shares(0.3, 0.8, -5, 11, shares)
    edges = np.arange(-5.0, 7.0)[None] - 0.5 - 0.3
    assert_allclose(gaussian_shares(edges, 0.8)[0], shares[:11], atol=1e-8)


_SHAPE = (24, 30)
_NOISE = 3.0
# px/mm of three cameras: columns and rows by x, y, z
_SLOPES = np.reshape([10, 0, 3, 0, 10, 0, 9, 0, -4, 0, 9.5, 1, 10, 1, 0.5, -1, 10, 4], (3, 2, 3))
_CENTER = np.array([15.0, 11.5])
_SIGMA = 0.8


def _cameras(position_mm: F64, light: F64) -> list[ParticleSpots]:
    """Make affine cameras that see particles (n, 3), with equal noise everywhere."""
    count = len(position_mm)
    rest = light, np.full(count, _SIGMA), np.full(_SHAPE, _NOISE**2)
    return [
        ParticleSpots(_CENTER + position_mm @ slope.T, np.tile(slope, (count, 1, 1)), *rest)
        for slope in _SLOPES
    ]


def _images(position_mm: F64, light: F64) -> F64:
    """The images of all cameras as one vector, by another formula than the kernels'."""
    pixels = [_CENTER + position_mm @ slope.T for slope in _SLOPES]
    sides = [[profile(own[:, k], _SIGMA, _SHAPE[1 - k]) for k in (0, 1)] for own in pixels]
    return np.array([np.einsum("n,nr,nc->rc", light, y, x) for x, y in sides]).ravel()


def _slopes(position_mm: F64, light: F64) -> F64:
    """Differentiate the images by positions and logarithms of the light, by differences."""
    columns = []
    for number in range(4 * len(light)):
        ends = []
        for sign in (1.0, -1.0):
            step = np.zeros((len(light), 4))
            step.flat[number] = sign * 1e-5
            ends.append(_images(position_mm + step[:, :3], light * np.exp(step[:, 3])))
        columns.append((ends[0] - ends[1]) / 2e-5)
    return np.stack(columns, axis=1)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_bound_is_the_inverse_of_the_whole_information(count: int) -> None:
    position = np.array([[0.03, 0.02, 0.0], [0.2, 0.05, 0.06], [0.1, 0.25, -0.1]])[:count]
    light = np.array([900.0, 700.0, 1100.0])[:count]
    found = position_bounds(_cameras(position, light), np.arange(count))
    slopes = _slopes(position, light) / _NOISE
    covariance = np.linalg.inv(slopes.T @ slopes).reshape(count, 4, count, 4)
    assert_allclose(found, [covariance[n, :3, n, :3] for n in range(count)], rtol=5e-3, atol=1e-8)


def test_particles_that_the_images_do_not_fix_have_no_bound() -> None:
    position, light = np.array([[0.0, 0.0, 0.0], [0.12, 0.0, 0.0]]), np.array([900.0, 900.0])
    one, *others = _cameras(position, light)
    hidden = np.array([900.0, 0.0])
    dark = [ParticleSpots(c.pixel, c.slope, hidden, c.sigma_px, c.variance) for c in others]
    found = position_bounds([one, *dark], np.array([0, 1]))
    assert np.isnan(found[1]).all()  # a single camera sees it
    assert np.isfinite(found[0]).all()
    blind = np.full(_SHAPE, np.inf)
    saturated = [
        ParticleSpots(c.pixel, c.slope, c.light, c.sigma_px, blind) for c in (one, *others)
    ]
    none = position_bounds(saturated, np.array([0, 1]))
    assert np.isnan(none).all()
    assert np.isnan(rms_over_bound(np.zeros((2, 3)), none))
    nobody = _cameras(np.zeros((0, 3)), np.zeros(0))
    assert position_bounds(nobody, np.zeros(0, dtype=np.int64)).shape == (0, 3, 3)
