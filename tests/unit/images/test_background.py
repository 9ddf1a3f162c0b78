"""Background of images, and bright things that are no particles."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sabench.algorithms.particles.obstacles import find_dark_areas
from sabench.images import background
from sabench.images.flaws import Flaws
from sabench.utils.arrays import F32, F64
from tests.unit.images import test_widths

ROWS, COLUMNS = 240, 320
NOISE = 2.0


def image(per_pixel: float, seed: int, spread: float = 0.3, across: F64 | None = None) -> F32:
    """An image of particles of mean light 200 with noise, on black."""
    shown = test_widths.image(per_pixel, (0.7, 0.7), seed, spread, across, (ROWS, COLUMNS))
    return np.asarray(shown, dtype=np.float32)


def background_of(shown: F64 | F32) -> F64:
    whole = np.ones(shown.shape, dtype=np.bool_)
    return background.estimate_background(shown.astype(np.float32), whole)[0].astype(np.float64)


@pytest.mark.parametrize("per_pixel", [0.0, 0.005, 0.05])
def test_a_background_is_found_to_the_noise(per_pixel: float) -> None:
    ramp = np.linspace(20.0, 60.0, COLUMNS)[None, :] * np.ones((ROWS, 1))
    apart = (background_of(image(per_pixel, 1) + ramp) - ramp)[24:-24, 24:-24]
    assert np.abs(np.median(apart)) < NOISE
    assert np.percentile(np.abs(apart), 95) < 2.0 * NOISE


@pytest.mark.parametrize("per_pixel", [0.0, 0.005, 0.02])
def test_bright_areas_with_sharp_edges_are_found_to_the_noise(per_pixel: float) -> None:
    shown, patches = image(per_pixel, 5), np.zeros((ROWS, COLUMNS))
    patches[40:80, 60:100] = patches[150:190, 201:241] = 12.0
    patches[70:110, 85:125] = 16.0  # over the first one's corner
    patches[:, 270:290] = 20.0  # a bar that is wider than particles
    found, inside = background_of(shown + patches), patches > 0.0
    apart = (found - patches)[inside]
    assert np.abs(np.median(apart)) < NOISE
    assert np.mean(np.abs(apart) < 2.0 * NOISE) > 0.85
    assert np.mean(found[~inside] > 0.0) < 0.02  # a pixel or two around them


def test_what_is_unknown_hides_no_background_around_it() -> None:
    shown, valid = image(0.005, 7) + np.float32(30.0), np.ones((ROWS, COLUMNS), dtype=np.bool_)
    valid[60:160, 80:200] = False
    shown[~valid] = 4000.0
    found = background.estimate_background(shown, valid)[0]
    assert np.abs(found[valid] - 30.0).max() < 3.0 * NOISE
    assert not found[~valid].any()


@pytest.mark.parametrize("width", [11, 31, 87])
def test_noise_lies_above_its_opening_as_stated(width: int) -> None:
    drawn = np.random.default_rng(width).standard_normal((600, 600)).astype(np.float32)
    opened = background._open(cv2.GaussianBlur(drawn, (0, 0), background._SMOOTH), width)
    assert opened[90:-90, 90:-90].mean() == pytest.approx(-background.lift(width), abs=0.1)


def test_a_background_clearly_above_dark_pixels_is_lowered_and_no_other_is() -> None:
    true = np.linspace(20.0, 60.0, COLUMNS, dtype=np.float32) * np.ones((ROWS, 1), dtype=np.float32)
    too_high, area = true.copy(), (slice(80, 160), slice(100, 200))
    too_high[area] += 2.5 * NOISE
    lowered = background._lower(too_high, image(0.0, 9) + true, true > 0.0, NOISE)
    assert np.abs(lowered - true)[area].mean() < 0.5 * NOISE
    assert np.abs(lowered - true)[100:140, 120:180].max() < NOISE
    far = np.ones(true.shape, dtype=np.bool_)
    far[60:180, 80:220] = False
    assert_array_equal(lowered[far], true[far])


@pytest.mark.parametrize("per_pixel", [0.005, 0.05, 0.2])
def test_where_it_is_black_nothing_is_taken_and_particles_are_no_glints(per_pixel: float) -> None:
    shown = image(per_pixel, 2, spread=0.6)[None]
    cleared, flaws = background.clear_images(shown, Flaws.none(shown.shape))
    assert_array_equal(cleared, shown)
    assert not flaws.unknown.any()


def test_particles_that_fill_a_part_of_the_image_are_no_background() -> None:
    shown = image(0.12, 8)
    shown[:, : COLUMNS // 2] = image(0.0, 9)[:, : COLUMNS // 2]
    assert not background_of(shown).any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 13))
def test_particles_that_leave_nothing_dark_are_hardly_background(seed: int) -> None:
    """They are denser in the middle, as before a camera whose view passes the volume's edges."""
    across = np.random.default_rng(seed).triangular(-60.0, COLUMNS / 2, COLUMNS + 60.0, 60_000)
    shown = image(0.6, seed, across=across)
    assert background_of(shown).sum() < 0.03 * shown.sum()


@pytest.mark.parametrize("per_pixel", [0.01, 0.1])
def test_glints_are_covered_and_their_surroundings_are_not(per_pixel: float) -> None:
    centers = [(60, 70, 2.0), (150, 250, 4.0)]
    glints = [test_widths.glint(*one, (ROWS, COLUMNS)) for one in centers]
    light = 2000.0 * np.sum(glints, axis=0)  # thirty times a particle's peak
    shown = (image(per_pixel, 3) + light).astype(np.float32)[None]
    _, flaws = background.clear_images(shown, Flaws.none(shown.shape))
    covered = flaws.covered[0]
    assert covered[light > 0.02 * light.max()].all()
    assert covered.mean() < 0.02
    assert not flaws.points.any()


def test_of_nothing_there_is_no_background_and_no_glint() -> None:
    none = np.zeros((ROWS, COLUMNS), dtype=np.float32)
    for valid in (np.ones(none.shape, dtype=np.bool_), np.zeros(none.shape, dtype=np.bool_)):
        assert not background.estimate_background(none, valid)[0].any()
        assert not background.find_glints(none, valid, 0.0).any()


def test_areas_that_show_nothing_are_dark() -> None:
    images = np.stack([image(0.05, seed) for seed in (4, 5)])
    images[1, :100, :120] = NOISE * np.random.default_rng(6).standard_normal((100, 120))
    number, shares = 0.05 * ROWS * COLUMNS, np.ones(images.shape)
    dark = find_dark_areas(images, Flaws.none(images.shape), shares, number)
    assert dark[0].mean() < 0.005
    hidden = np.zeros((ROWS, COLUMNS), dtype=np.bool_)
    hidden[:100, :120] = True
    assert (dark[1] & hidden).sum() > 0.97 * hidden.sum()
    assert (dark[1] & ~hidden).mean() < 0.01
    few = find_dark_areas(images, Flaws.none(images.shape), shares, 5.0)
    assert not few.any()  # too few to tell


def test_areas_without_the_volume_are_not_dark() -> None:
    images = np.stack([image(0.05, 4)])
    images[0, :, 200:] = 0.0
    shares = np.ones(images.shape)
    assert find_dark_areas(images, Flaws.none(images.shape), shares, 3000.0)[0, :, 220:].all()
    shares[0, :, 200:] = 0.0
    assert find_dark_areas(images, Flaws.none(images.shape), shares, 2400.0).mean() < 0.005
