"""Profiles of Gaussians in kernels, next to scipy's error function."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from sabench.images.gaussian_kernels import (
    fill_bend,
    fill_derivatives,
    fill_profile,
    fill_shares,
)
from sabench.images.gaussians import gaussian_shares
from sabench.utils.arrays import F64
from sabench.utils.vector_units import LANES, whole_lanes


def expected_shares(center: float, sigma: float, first: int, pixels: int) -> F64:
    edges = first - 0.5 - center + np.arange(pixels + 1)
    shares: F64 = 0.5 * np.diff(erf(edges / (sigma * np.sqrt(2.0))))
    return shares


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
        expected = expected_shares(center, sigma, first, pixels)
        np.testing.assert_allclose(shares[:pixels], expected, rtol=0.0, atol=1e-8 + rounding)
        np.testing.assert_array_equal(shares, alone)
        assert not shares[pixels:].any()
        assert not slopes[pixels:].any()
        edges = (first - 0.5 - center + np.arange(pixels + 1)) / sigma
        density = np.exp(-0.5 * edges**2) / np.sqrt(2.0 * np.pi)
        reached = np.testing.assert_allclose
        reached(slopes[:pixels] * sigma, -np.diff(density), rtol=0.0, atol=4e-8 + 2 * rounding)


@pytest.mark.parametrize("sigma", [0.3, 0.8, 2.5])
def test_derivatives_are_those_of_shares_by_the_centre(sigma: float) -> None:
    """Each against central differences of the one before it."""
    center, first, pixels, step = 3.3, -2, 11, 1e-4 * sigma
    found, before, after = np.zeros((3, 5, pixels))
    for at, each in zip(
        (center, center - step, center + step), (found, before, after), strict=True
    ):
        fill_profile(
            at, sigma, first, pixels, np.zeros(whole_lanes(pixels)), slopes := np.zeros(16)
        )
        each[0] = slopes[:pixels]
        fill_derivatives(at, sigma, first, each[1:])
    for n in range(1, 5):
        expected = (after[n - 1] - before[n - 1]) / (2.0 * step)
        np.testing.assert_allclose(found[n], expected, atol=1e-3 * np.abs(expected).max())
    fill_bend(center, sigma, first, bend := np.zeros(pixels))
    np.testing.assert_allclose(bend, found[1], atol=1e-12)


def test_shares_in_numpy_are_those_of_kernels() -> None:
    """Both compute the same integrals."""
    shares = np.zeros(whole_lanes(11))
    fill_shares(0.3, 0.8, -5, 11, shares)
    edges = np.arange(-5.0, 7.0)[None] - 0.5 - 0.3
    np.testing.assert_allclose(gaussian_shares(edges, 0.8)[0], shares[:11], atol=1e-8)


def test_profiles_fill_whole_lanes() -> None:
    """Eight pixels fill eight lanes, though they have nine edges."""
    assert [whole_lanes(pixels) for pixels in (1, 8, 9)] == [LANES, LANES, 2 * LANES]
