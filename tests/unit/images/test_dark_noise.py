"""Dark level, noise and false alarm rate, of images whose noise is drawn."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from benchmarks.false_alarms import (
    SENSORS,
    draw_particles,
    find_after,
    find_before,
    grey,
    hot_pixels,
    normal,
)
from sabench.images.dark_noise import measure_dark_noise, noise_cut_by_black
from sabench.images.gaussians import gaussian_shares
from sabench.images.peaks import detect_particle_peaks
from sabench.utils.arrays import F64, U16
from tests.helpers.refusals import refused

# what is not kept: noise that was cut and smoothed, or has longer tails
OF_PIXELS = 4 * 512**2
LOOSE = {"sliding minimum and Gaussian, cut at black": 6e-5, "double exponential noise": 1e-4}


@pytest.mark.slow_but_first
@pytest.mark.parametrize("name", SENSORS)
def test_false_alarms_are_as_rare_as_stated(name: str) -> None:
    rng, count = np.random.default_rng(3), 0
    for _ in range(4):
        count += len(find_after(SENSORS[name](rng)))
    expected = LOOSE.get(name, 1e-5) * OF_PIXELS
    assert count <= expected + 4.0 * np.sqrt(expected)


def test_the_rate_follows_what_is_stated() -> None:
    image = grey(normal(np.random.default_rng(4), 500.0, 20.0))
    for stated in (1e-3, 1e-4):
        share = (image >= measure_dark_noise(image[None]).threshold(stated)).mean()
        assert 0.6 * stated < share < 1.6 * stated


def particles(count: int, seed: int = 5) -> tuple[F64, F64]:
    place = np.random.default_rng(seed).uniform(4.0, 507.0, (count, 2))
    return place, draw_particles(place)


@pytest.mark.parametrize(
    ("black", "noise", "bits", "count"),
    [(64.0, 2.0, 12, 400), (64.0, 2.0, 12, 10_000), (0.0, 1.5, 8, 400), (0.0, 1.5, 8, 4000)],
)
def test_particles_hardly_change_the_noise(
    black: float, noise: float, bits: int, count: int
) -> None:
    image = grey(normal(np.random.default_rng(6), black, noise) + 100.0 * particles(count)[1], bits)
    found = measure_dark_noise(image[None])
    assert abs(np.median(found.level) - black) < 0.3
    assert np.median(found.noise) == pytest.approx(noise, rel=0.12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("black", "noise", "bits", "peak", "most"),
    [
        (64.0, 2.0, 12, 100.0, 1.2),
        (64.0, 2.0, 12, 1000.0, 1.2),
        (600.0, 20.0, 12, 1000.0, 1.2),
        (0.0, 1.5, 8, 40.0, 2.0),  # half of the noise is cut at black
    ],
)
def test_dense_particles_are_no_noise(
    black: float, noise: float, bits: int, peak: float, most: float
) -> None:
    light = peak * particles(512**2 // 2)[1]
    image = grey(normal(np.random.default_rng(14), black, noise) + light, bits)
    found = measure_dark_noise(image[None])
    assert abs(np.median(found.level) - black) < 0.7 * noise
    assert 0.9 * noise < np.median(found.noise) < most * noise


ROW, COLUMN = np.mgrid[:512, :512]
BESIDE_BARS = (COLUMN % 64 >= 6).astype(np.float64)  # dark bodies before a background
BACKGROUNDS = {  # light, and the grey values of an electron
    "bars": (100.0 * BESIDE_BARS, 0.22),
    "bars before bright light": (2000.0 * BESIDE_BARS, 0.22),
    "bars before few photons": (5.0 * BESIDE_BARS, 1.0),
    "a light sheet": (1000.0 * np.exp(-(((ROW - 256) / 90.0) ** 2)), 0.22),
}


@pytest.mark.parametrize("name", BACKGROUNDS)
def test_a_background_is_not_taken_for_dense_particles(name: str) -> None:
    light, gain = BACKGROUNDS[name]
    rng = np.random.default_rng(16)
    image = grey(normal(rng, 64.0, 1.0) + gain * rng.poisson(light / gain))
    assert (image > measure_dark_noise(image[None]).threshold()).mean() < 0.01


@pytest.mark.slow
def test_what_is_not_known_tells_nothing_of_dense_particles() -> None:
    light = 100.0 * particles(40_000)[1]
    image = grey(normal(np.random.default_rng(15), 64.0, 2.0) + light)
    known = np.ones((512, 512), dtype=np.bool_)
    image[:, 200:], known[:, 200:] = 0, False
    found = measure_dark_noise(image[None], known)
    assert abs(np.median(found.level[:, :200]) - 64.0) < 1.4
    assert 1.8 < np.median(found.noise[:, :200]) < 2.6


@pytest.mark.parametrize("below", [0.0, 1.5])
def test_dim_particles_are_no_noise_where_black_cuts_it(below: float) -> None:
    light = 10.0 * particles(5000)[1]
    image = grey(normal(np.random.default_rng(17), -below, 1.5) + light, 8)
    found = measure_dark_noise(image[None])
    assert abs(np.median(found.level) + below) < 0.8
    assert 1.3 < np.median(found.noise) < 2.4


def test_noise_is_found_in_small_images_of_which_black_hides_most() -> None:
    for seed in range(20, 40):
        rng = np.random.default_rng(seed)
        image = grey(normal(rng, -1.5, 1.5) + 16.0 * particles(5000, seed)[1], 8)
        assert 0.7 < np.median(measure_dark_noise(image[None, :120, :140]).noise) / 1.5 < 1.4


@pytest.mark.parametrize("below", [0.0, 1.5])
def test_noise_that_black_cuts_is_measured_and_no_other(below: float) -> None:
    dark = normal(np.random.default_rng(18), -below, 1.5) + 30.0 * particles(2000)[1]
    everywhere = np.ones(dark.shape, dtype=np.bool_)
    assert 1.3 < noise_cut_by_black(grey(dark, 8), everywhere, 0.0) < 2.0
    assert noise_cut_by_black(grey(dark + 64.0, 8), everywhere, 64.0) == 0.0  # shows below black
    assert noise_cut_by_black(grey(dark + 64.0, 8), everywhere, 0.0) == 0.0  # not subtracted


def test_forty_particles_of_a_recording_cut_at_black_are_forty_peaks() -> None:
    light = particles(40)[1]
    image = grey(normal(np.random.default_rng(7), 0.0, 0.8) + 60.0 * light, 8)
    assert len(find_before(image, 0.0)) > 200
    assert 39 <= len(detect_particle_peaks(image).pixels) <= 42


def test_level_and_noise_are_those_of_their_place() -> None:
    rng = np.random.default_rng(8)
    x = np.linspace(0.0, 1.0, 512)
    found = measure_dark_noise(grey(normal(rng, 100.0 + 300.0 * x, 3.0 + 9.0 * x))[None])
    assert np.abs(found.level - (100.0 + 300.0 * x)).max() < 6.0
    assert np.abs(found.noise / (3.0 + 9.0 * x) - 1.0).max() < 0.35


@pytest.mark.slow
def test_several_frames_tell_more_than_one() -> None:
    rng = np.random.default_rng(9)
    images = np.stack([grey(normal(rng, 100.0, 6.0)) for _ in range(6)])
    one, six = (measure_dark_noise(part).level - 100.0 for part in (images[:1], images))
    assert six.std() < 0.7 * one.std()


def test_pixels_that_do_not_count_change_nothing() -> None:
    image = grey(normal(np.random.default_rng(10), 64.0, 2.0))
    known = np.ones(image.shape, dtype=np.bool_)
    known[:200] = False
    image[:200] = 4000
    assert measure_dark_noise(image[None], known).noise[300:].max() < 2.6
    assert len(detect_particle_peaks(image, ~known).pixels) < 12


def test_hot_pixels_are_no_peaks() -> None:
    peaks = detect_particle_peaks(hot_pixels(np.random.default_rng(11))).pixels
    assert len(peaks) < 25  # of 52, those below 10 sigma remain


@pytest.mark.parametrize("sigma_px", [0.2, 0.3, 0.5])
def test_sharp_particle_images_are_no_hot_pixels(sigma_px: float) -> None:
    rng = np.random.default_rng(11)
    place = np.mgrid[20:500:20, 20:500:20].reshape(2, -1).T
    off = rng.uniform(-0.5, 0.5, (576, 2))
    edges = np.arange(-4.5, 5.0)[None]
    across, down = (gaussian_shares(edges - off[:, [k]], sigma_px) for k in (0, 1))
    light = np.zeros((512, 512))
    for (column, row), x, y in zip(place, across, down, strict=True):
        light[row - 4 : row + 5, column - 4 : column + 5] += 400.0 * y[:, None] * x
    assert len(detect_particle_peaks(grey(normal(rng, 64.0, 2.0) + light)).pixels) > 560


@pytest.mark.parametrize("value", [0, 7, 65535])
def test_images_of_one_value_have_no_peaks(value: int) -> None:
    image: U16 = np.full((40, 50), value, dtype=np.uint16)
    assert len(detect_particle_peaks(image).pixels) == 0
    assert measure_dark_noise(image[None]).threshold().min() > value


def test_small_and_unknown_images_are_measured() -> None:
    for shape in ((3, 3), (8, 200), (1, 5)):
        small = np.random.default_rng(12).integers(0, 9, shape).astype(np.uint16)
        assert np.isfinite(measure_dark_noise(small[None]).threshold()).all()
    image = grey(normal(np.random.default_rng(13), 64.0, 2.0))
    assert len(detect_particle_peaks(image, np.ones(image.shape, dtype=np.bool_)).pixels) < 20


def test_grey_values_in_steps_count_as_steps() -> None:
    image = 257 * grey(normal(np.random.default_rng(14), 12.0, 1.2), 8).astype(np.uint16)
    found = measure_dark_noise(image[None])
    assert found.step == 257.0
    assert np.median(found.noise) / 257.0 == pytest.approx(1.25, abs=0.1)


def test_smoothed_noise_is_measured_by_its_spread_not_by_its_differences() -> None:
    image = grey(100.0 + gaussian_filter(normal(np.random.default_rng(15), 0.0, 40.0), 1.0))
    assert np.median(measure_dark_noise(image[None]).noise) == pytest.approx(11.3, rel=0.1)


def test_wrong_arguments_are_named() -> None:
    image = np.zeros((4, 4), dtype=np.uint16)
    with refused("images"):
        measure_dark_noise(image)
    for wrong in (0.0, 0.5, -1.0):
        with refused("false_alarms"):
            measure_dark_noise(image[None]).threshold(wrong)
