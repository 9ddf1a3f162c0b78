"""Analytic renderer: windows, ellipses, borders, and order."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import ParticleImages
from sabench.utils.arrays import F64
from tests.helpers.particle_scenes import SMALL, spots


def centre_of_rounded(place: F64, sigma: float) -> F64:
    """Return the mean of a normal variable rounded to whole numbers, by a Fourier series."""
    k = np.arange(1, 30)[:, None]
    waves = (-1.0) ** (k + 1) * np.sin(2 * np.pi * k * place) / (np.pi * k)
    return np.asarray(place - np.sum(waves * np.exp(-2 * (np.pi * k * sigma) ** 2), axis=0))


@pytest.mark.parametrize("sigma", [0.15, 0.5, 1.0, 2.3])
def test_splat_keeps_light_and_place(sigma: float) -> None:
    for place in np.random.default_rng(4).uniform([15.0, 15.0], [45.0, 25.0], (20, 2)):
        spot = spots(place[None], np.array([1000.0]), np.array([sigma]))
        image = particles_splatted.render(SMALL, spot)
        assert image.sum() == pytest.approx(1000.0, rel=2e-5)
        centroid = [image.sum(axis=0) @ np.arange(60), image.sum(axis=1) @ np.arange(40)]
        expected = centre_of_rounded(place, sigma)
        np.testing.assert_allclose(centroid / image.sum(), expected, rtol=0, atol=1e-4)
        if sigma >= 1.0:
            np.testing.assert_allclose(centroid / image.sum(), place, rtol=0, atol=1e-4)


def test_splat_of_nothing_is_dark() -> None:
    places = np.array([[math.nan, math.nan], [500.0, 3.0]])
    nowhere = spots(places, np.array([0.0, 9.0]), np.array([math.nan, 0.5]))
    for images in (nowhere, spots(np.empty((0, 2)), np.empty(0), np.empty(0))):
        assert not particles_splatted.render(SMALL, images).any()


@pytest.mark.parametrize(
    ("across", "down", "tilt"),
    [
        *[(0.75, 0.75, 0.0), (0.75, 0.75, 0.0019), (0.2, 0.1, 0.5), (1.5, 2.0, -0.95)],
        *[(3.0, 2.0, 0.99), (0.5, 1.4, -0.7), (400.0, 300.0, 0.5)],
    ],
)
@pytest.mark.parametrize("center", [(30.3, 18.1), (28.7, 20.9)])
def test_windows_are_integrals_of_a_normal_density(
    center: tuple[float, float], across: float, down: float, tilt: float
) -> None:
    """Against differences of SciPy's distribution function of two correlated variables."""
    covariance = tilt * across * down
    spread = np.array([[across**2, down**2, covariance]])
    one, zero = np.ones(1), np.zeros((1, 3))
    images = ParticleImages(np.array([center]), one, one, one > 0.0, one, zero, spread)
    found = particles_splatted.render(SMALL, images)
    matrix = [[across**2, covariance], [covariance, down**2]]
    columns, rows = np.meshgrid(np.arange(SMALL.columns + 1), np.arange(SMALL.rows + 1))
    corners = np.stack([columns, rows], axis=-1) - 0.5
    exact = np.diff(np.diff(multivariate_normal(center, matrix).cdf(corners), axis=0), axis=1)
    left_out = 2e-5 * found.max()  # beyond the window
    np.testing.assert_allclose(found, exact, rtol=0, atol=2e-8 + left_out)


@pytest.mark.slow
def test_images_add_up_and_end_at_the_border_in_any_order_and_number_of_threads() -> None:
    rng, count = np.random.default_rng(3), 400
    pixel, photons = rng.uniform(-6.0, 66.0, (count, 2)), rng.uniform(0.0, 9.0, count)
    sigma, tilt = rng.uniform(0.3, 3.0, (count, 2)), rng.uniform(-0.5, 0.5, count)
    spread = np.column_stack([sigma**2, tilt * sigma.prod(axis=1)])
    images = replace(spots(pixel, photons, np.ones(count)), spread_px2=spread)
    whole = particles_splatted.render(SMALL, images)
    numba.set_num_threads(1)
    try:
        np.testing.assert_array_equal(particles_splatted.render(SMALL, images), whole)
    finally:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    parts = []
    for i in range(3):
        part = spots(pixel[i::3], photons[i::3], np.ones(len(pixel[i::3])))
        parts.append(particles_splatted.render(SMALL, replace(part, spread_px2=spread[i::3])))
    np.testing.assert_allclose(sum(parts), whole, rtol=0, atol=1e-9)
    moved = replace(images, pixel=pixel + np.array([20.0, 30.0]))
    larger = particles_splatted.render(replace(SMALL, rows=80, columns=110), moved)
    np.testing.assert_allclose(whole, larger[30:70, 20:80], rtol=0, atol=1e-9)
