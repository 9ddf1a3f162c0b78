"""Widths and light of particle images."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from sabench.algorithms.particles.image_model import MARGIN_PX, make_room
from sabench.images.peaks import find_peaks
from sabench.images.widths import ImageStatistics, image_widths, measure_images, noise_below_black
from sabench.utils.arrays import F64
from tests.helpers.image_model import profile

ROWS, COLUMNS = 400, 500
FINE = 5  # points to a pixel's edge


def measured(images: F64) -> ImageStatistics:
    return measure_images(images, np.ones(images.shape, dtype=bool))


def glint(row: int, column: int, sigma: float, shape: tuple[int, int] = (ROWS, COLUMNS)) -> F64:
    rows, columns = np.indices(shape)
    return np.asarray(np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / (2.0 * sigma**2)))


def image(
    per_pixel: float,
    sigma: tuple[float, float],
    seed: int,
    spread: float = 0.0,
    across: F64 | None = None,
    shape: tuple[int, int] = (ROWS, COLUMNS),
) -> F64:
    """Particles of mean light 200, in columns `across` if given, and noise of 2."""
    rng, (rows, columns) = np.random.default_rng(seed), shape
    count = int(per_pixel * (rows + 20) * (columns + 20))
    center = rng.uniform(-10.0, (columns + 10.0, rows + 10.0), (count, 2))
    if across is not None:
        center[:, 0] = across[:count]
    light = 200.0 * np.exp(spread * rng.standard_normal(count) - 0.5 * spread**2)
    x, y = profile(center[:, 0], sigma[0], columns), profile(center[:, 1], sigma[1], rows)
    return (y * light[:, None]).T @ x + 2.0 * rng.standard_normal(shape)


@pytest.mark.slow_but_first
@pytest.mark.parametrize(
    ("per_pixel", "sigma"), [(0.05, (0.9, 0.7)), (0.005, (0.5, 0.6)), (0.2, (0.5, 0.6))]
)
def test_widths_hold_at_any_density(per_pixel: float, sigma: tuple[float, float]) -> None:
    found = measured(image(per_pixel, sigma, 3)[None])
    assert_allclose(found.sigma[0], sigma, rtol=0.06)
    assert found.light[0] == pytest.approx(200.0, rel=0.06)
    assert found.number == pytest.approx(per_pixel * ROWS * COLUMNS, rel=0.08)


def drawn(kernel: F64, per_pixel: float, light: float) -> F64:
    """An image of particles that look like a kernel of `FINE` points to a pixel, with noise."""
    from scipy.signal import fftconvolve  # takes long to load

    rng, size = np.random.default_rng(9), (ROWS * FINE, COLUMNS * FINE)
    points = np.zeros(size)
    count = int(per_pixel * ROWS * COLUMNS)
    np.add.at(points, tuple(rng.integers(edge, size=count) for edge in size), light)
    shown = fftconvolve(points, kernel / kernel.sum(), mode="same")
    shown = shown.reshape(ROWS, FINE, COLUMNS, FINE).sum(axis=(1, 3))
    return np.asarray(shown + 2.0 * rng.standard_normal(shown.shape))


@pytest.mark.slow
@pytest.mark.parametrize(("per_pixel", "slope"), [(0.05, 0.0), (0.005, 1.0), (0.2, -0.5)])
def test_tilted_ellipses_are_measured_at_any_density(per_pixel: float, slope: float) -> None:
    """A tilted Gaussian is a round one, smoothed along a line."""
    covariance = 0.7**2 * np.eye(2) + 0.6**2 * np.outer([1.0, slope], [1.0, slope])
    across = np.arange(-30, 31) / FINE
    points = np.stack(np.meshgrid(across, across), axis=-1)
    kernel = multivariate_normal(np.zeros(2), covariance).pdf(points)
    found = measured(drawn(kernel, per_pixel, 100.0)[None])
    widths = np.sqrt(np.diag(covariance))
    expected = covariance[0, 1] / widths.prod()
    assert found.tilt[0] == pytest.approx(expected, abs=0.1 * abs(expected))
    assert_allclose(found.sigma[0], widths, rtol=0.06)
    assert found.light[0] == pytest.approx(100.0, rel=0.1)


@pytest.mark.slow
def test_windows_of_long_streaks_fit_in_the_margins() -> None:
    """Streaks of 20 px at 45 degrees, whose tilt hides how wide they are."""
    rng = np.random.default_rng(4)
    center = rng.uniform(0.0, (COLUMNS, ROWS), (2000, 2))
    shown = 2.0 * rng.standard_normal((ROWS, COLUMNS))
    for step in np.linspace(-7.0, 7.0, 29):
        x, y = (profile(center[:, k] + step, 1.7, n) for k, n in ((0, COLUMNS), (1, ROWS)))
        shown += 40.0 * y.T @ x
    found = measured(shown[None])
    assert found.tilt[0] > 0.7
    assert make_room(1.3 * found.sigma).profiles.shape[2] <= MARGIN_PX


@pytest.mark.slow
@pytest.mark.parametrize("per_pixel", [0.05, 0.5])
def test_widths_hold_where_particles_are_denser_in_the_middle(per_pixel: float) -> None:
    """As before a camera whose view passes the edges of the volume."""
    across = np.random.default_rng(8).triangular(0.0, COLUMNS / 2, COLUMNS, 120_000)
    images = image(per_pixel, (0.7, 0.7), 8, across=across)[None]
    assert_allclose(measured(images).sigma[0], 0.7, rtol=0.05)


def test_unequal_particles_count_by_their_light() -> None:
    found = measured(image(0.05, (0.7, 0.7), 4, spread=0.4)[None])
    assert found.light[0] == pytest.approx(200.0 * np.exp(0.4**2), rel=0.08)


def test_unknown_pixels_do_not_count() -> None:
    images = image(0.05, (0.7, 0.7), 5)[None]
    known = np.ones(images.shape, dtype=bool)
    whole = measure_images(images, known)
    known[0, 100:140, 200:260] = False
    images[0, 100:140, 200:260] = 4000.0
    found = measure_images(images, known)
    assert_allclose(found.sigma, whole.sigma, rtol=0.02)
    assert found.light[0] == pytest.approx(whole.light[0], rel=0.02)


def test_dark_noise_comes_from_below_black_and_light_does_not_change_it() -> None:
    images = image(0.02, (0.7, 0.7), 6)
    assert noise_below_black(images) == pytest.approx(2.0, rel=0.05)
    assert noise_below_black(np.abs(images)) == 0.5  # values cut at black: of rounding


def test_images_of_noise_or_of_nothing_have_finite_statistics() -> None:
    noise = np.random.default_rng(7).standard_normal((2, 60, 70))
    for images in (noise, np.zeros((2, 60, 70)), np.full((2, 60, 70), 9.0)):
        for known in (True, False):
            found = measure_images(images, np.full(images.shape, known))
            assert np.isfinite(found.sigma).all()
            assert np.isfinite(found.tilt).all()
            assert not found.light.any()
            assert not found.shown.any()
            assert np.isfinite(found.number)


@pytest.mark.slow
@pytest.mark.parametrize("per_pixel", [0.001, 0.005])
def test_a_glint_among_few_particles_is_not_their_light(per_pixel: float) -> None:
    shown = image(per_pixel, (0.7, 0.7), 8)
    shown += 4000.0 * glint(70, 90, 1.4)
    found = measured(shown[None])
    assert 100.0 < found.light[0] < 700.0  # 50,000 in the glint


def test_few_particles_before_a_background_taken_too_high_have_their_light() -> None:
    shown = image(0.001, (0.7, 0.7), 9) - 0.5  # the mean is below zero
    found = measured(shown[None])
    assert found.shown[0]
    assert 100.0 < found.light[0] < 700.0


@pytest.mark.slow
@pytest.mark.parametrize("peak", [500.0, 2000.0, 60000.0])
def test_a_small_glint_does_not_change_the_width_of_few_particles(peak: float) -> None:
    shown = image(0.001, (0.6, 0.5), 9)
    plain, with_glint = measured(np.array([shown, shown + peak * glint(70, 90, 1.1)])).sigma
    assert_allclose(plain, (0.6, 0.5), rtol=0.06)
    assert_allclose(with_glint, plain, rtol=0.08)


def test_widths_at_the_border_read_no_pixel_beyond_it() -> None:
    row, column = np.indices((105, 33), dtype=np.float64)
    image = np.exp(-((row - 103.5) ** 2 + (column - 16.0) ** 2) / (2.0 * 0.8**2))
    image[102] *= 0.9  # the vertex lies beyond 103.5, where it is cut off: rounded to the last row
    pixels = find_peaks(image.astype(np.float32), 0.1).pixels
    assert pixels[0, 1] == 103.5
    assert np.rint(pixels[0, 1]) == len(image) - 1
    widths = image_widths(image[None].astype(np.float32), [pixels])
    assert widths[0] == pytest.approx(np.sqrt(0.8**2 - 1.0 / 12.0), rel=0.1)
