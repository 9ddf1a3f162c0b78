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
    """Return the mean of a normal variable rounded to whole numbers. By the Fourier series of the
    saw tooth: narrow images are drawn to their pixel's centre."""
    k = np.arange(1, 30)[:, None]
    return np.asarray(
        place
        - np.sum(
            (-1.0) ** (k + 1)
            * np.sin(2 * np.pi * k * place)
            * np.exp(-2 * (np.pi * k * sigma) ** 2)
            / (np.pi * k),
            axis=0,
        )
    )


@pytest.mark.parametrize("sigma", [0.15, 0.5, 1.0, 2.3])
def test_splat_keeps_light_and_place(sigma: float) -> None:
    for place in np.random.default_rng(4).uniform([15.0, 15.0], [45.0, 25.0], (20, 2)):
        image = particles_splatted.render(
            SMALL, spots(place[None], np.array([1000.0]), np.array([sigma]))
        )
        assert image.sum() == pytest.approx(1000.0, rel=2e-5)
        centroid = [
            (image.sum(axis=0) @ np.arange(60)) / image.sum(),
            (image.sum(axis=1) @ np.arange(40)) / image.sum(),
        ]
        np.testing.assert_allclose(centroid, centre_of_rounded(place, sigma), rtol=0, atol=1e-4)
        if sigma >= 1.0:
            np.testing.assert_allclose(centroid, place, rtol=0, atol=1e-4)


def test_splat_pixel_is_the_integral_of_a_gaussian_over_it() -> None:
    place, sigma = np.array([20.37, 11.81]), 0.8
    image = particles_splatted.render(
        SMALL, spots(place[None], np.array([500.0]), np.array([sigma]))
    )
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    for row, column in ((12, 20), (11, 22), (10, 19)):
        x, y = np.meshgrid(column + fine, row + fine)
        value = (
            np.mean(np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * sigma**2)))
            * 500.0
            / (2 * np.pi * sigma**2)
        )
        assert image[row, column] == pytest.approx(value, rel=1e-5)


def test_splat_moves_with_its_particle() -> None:
    sigma, photons = np.array([0.7]), np.array([300.0])
    first = particles_splatted.render(SMALL, spots(np.array([[20.3, 14.6]]), photons, sigma))
    moved = particles_splatted.render(SMALL, spots(np.array([[27.3, 18.6]]), photons, sigma))
    np.testing.assert_allclose(moved[8:36, 12:50], first[4:32, 5:43], rtol=0, atol=1e-9)
    mirrored = particles_splatted.render(
        SMALL, spots(np.array([[59.0 - 20.3, 39.0 - 14.6]]), photons, sigma)
    )
    np.testing.assert_allclose(mirrored[::-1, ::-1], first, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_splat_is_additive_and_cut_at_the_border() -> None:
    rng = np.random.default_rng(5)
    places, photons, sigma = (
        rng.uniform(-6.0, 66.0, (400, 2)),
        rng.uniform(0.0, 9.0, 400),
        rng.uniform(0.3, 2.0, 400),
    )
    whole = particles_splatted.render(SMALL, spots(places, photons, sigma))
    parts = [
        particles_splatted.render(SMALL, spots(places[i::3], photons[i::3], sigma[i::3]))
        for i in range(3)
    ]
    np.testing.assert_allclose(sum(parts), whole, rtol=0, atol=1e-9)
    larger = particles_splatted.render(
        replace(SMALL, rows=80, columns=110), spots(places + np.array([20.0, 30.0]), photons, sigma)
    )
    np.testing.assert_allclose(whole, larger[30:70, 20:80], rtol=0, atol=1e-9)


def test_splat_of_nothing_is_dark() -> None:
    nowhere = spots(
        np.array([[math.nan, math.nan], [500.0, 3.0]]),
        np.array([0.0, 9.0]),
        np.array([math.nan, 0.5]),
    )
    assert not particles_splatted.render(SMALL, nowhere).any()
    assert not particles_splatted.render(
        SMALL, spots(np.empty((0, 2)), np.empty(0), np.empty(0))
    ).any()


def slanted(pixels: F64, photons: float, spread: tuple[float, float, float]) -> ParticleImages:
    count = len(pixels)
    images = spots(pixels, np.full(count, photons), np.ones(count))
    return replace(images, spread_px2=np.tile(spread, (count, 1)))


@pytest.mark.parametrize(
    "spread", [(0.7, 0.4, 0.3), (0.25, 2.0, -0.5), (2.0, 0.25, 0.01), (0.667, 0.667, 0.65)]
)
def test_a_pixel_of_an_ellipse_is_the_integral_over_it(spread: tuple[float, float, float]) -> None:
    place, fine = np.array([20.37, 11.81]), (np.arange(300) + 0.5) / 300 - 0.5
    image = particles_splatted.render(SMALL, slanted(place[None], 500.0, spread))
    inverse = np.linalg.inv([[spread[0], spread[2]], [spread[2], spread[1]]])
    scale = 500.0 * math.sqrt(np.linalg.det(inverse)) / (2.0 * np.pi)
    for row, column in ((12, 20), (11, 21), (13, 21), (10, 20)):
        x, y = np.meshgrid(column + fine - place[0], row + fine - place[1])
        form = inverse[0, 0] * x**2 + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y**2
        expected = scale * np.exp(-form / 2.0).mean()
        assert image[row, column] == pytest.approx(expected, rel=2e-3, abs=2e-3)
    assert image.sum() == pytest.approx(500.0, rel=2e-5)


@pytest.mark.parametrize(
    ("across", "down", "tilt"),
    [(0.75, 0.75, 0.0), (0.75, 0.75, 0.0019), (0.2, 0.1, 0.5), (1.5, 2.0, -0.95), (3.0, 2.0, 0.99)],
)
def test_windows_are_integrals_of_a_normal_density(across: float, down: float, tilt: float) -> None:
    """Against differences of SciPy's distribution function of two correlated variables."""
    center, covariance = np.array([30.3, 18.1]), tilt * across * down
    spread = np.array([[across**2, down**2, covariance]])
    one, zero = np.ones(1), np.zeros((1, 3))
    images = ParticleImages(center[None], one, one, one > 0.0, one, zero, spread)
    found = particles_splatted.render(SMALL, images)
    matrix = [[across**2, covariance], [covariance, down**2]]
    columns, rows = np.meshgrid(np.arange(SMALL.columns + 1), np.arange(SMALL.rows + 1))
    corners = np.stack([columns, rows], axis=-1) - 0.5
    share = multivariate_normal(center, matrix).cdf(corners)
    exact = np.diff(np.diff(share, axis=0), axis=1)
    left_out = 2e-5 * found.max()  # beyond the window
    np.testing.assert_allclose(found, exact, rtol=0, atol=2e-8 + left_out)


@pytest.mark.slow
def test_images_do_not_depend_on_the_number_of_threads_or_order() -> None:
    """Bytes of one thread and of two; and the sum of two halves, as light adds up."""
    rng, count = np.random.default_rng(3), 300
    pixel = rng.uniform(-6.0, [66.0, 46.0], (count, 2))
    sigma, tilt = rng.uniform(0.3, 3.0, (count, 2)), rng.uniform(-0.5, 0.5, count)
    spread = np.column_stack([sigma**2, tilt * sigma.prod(axis=1)])
    one, zero = np.ones(count), np.zeros((count, 3))
    images = ParticleImages(pixel, one, one, one > 0.0, one, zero, spread)
    numba.set_num_threads(1)
    try:
        alone = particles_splatted.render(SMALL, images)
    finally:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    np.testing.assert_array_equal(particles_splatted.render(SMALL, images), alone)
    halves = []
    for half in (slice(None, None, 2), slice(1, None, 2)):
        part = ParticleImages(
            pixel[half], one[half], one[half], one[half] > 0, one[half], zero[half], spread[half]
        )
        halves.append(particles_splatted.render(SMALL, part))
    np.testing.assert_allclose(sum(halves), alone, rtol=1e-12, atol=1e-15)
