"""Background of images, and bright things that are no particles."""

from typing import Any

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


@pytest.mark.slow
@pytest.mark.parametrize("per_pixel", [0.0, 0.005, 0.05])
def test_a_background_is_found_to_the_noise(per_pixel: float) -> None:
    ramp = np.linspace(20.0, 60.0, COLUMNS, dtype=np.float32)[None, :] * np.ones((ROWS, 1))
    shown = (image(per_pixel, 1) + ramp).astype(np.float32)
    found: Any = background.estimate_background(shown, np.ones(shown.shape, dtype=np.bool_))
    apart = (found - ramp)[24:-24, 24:-24]
    assert np.abs(np.median(apart)) < NOISE
    assert np.percentile(np.abs(apart), 95) < 2.0 * NOISE


@pytest.mark.slow
@pytest.mark.parametrize("per_pixel", [0.005, 0.05, 0.2])
def test_where_it_is_black_nothing_is_taken_and_particles_are_no_glints(per_pixel: float) -> None:
    shown = image(per_pixel, 2, spread=0.6)[None]
    cleared, flaws = background.clear_images(shown, Flaws.none(shown.shape))
    assert_array_equal(cleared, shown)
    assert not flaws.unknown.any()


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("per_pixel", [0.0, 0.005, 0.05])
def test_patches_with_sharp_edges_are_found_to_the_noise(per_pixel: float) -> None:
    shown, patches = image(per_pixel, 5), np.zeros((ROWS, COLUMNS))
    patches[40:80, 60:100] = patches[150:190, 201:241] = 12.0
    patches[70:110, 85:125] = 16.0  # over the first one's corner
    found = background.find_patches(
        (shown + patches).astype(np.float32), np.ones(shown.shape, dtype=bool)
    )
    inside = patches > 0.0
    apart = (found - patches)[inside]
    assert np.abs(np.median(apart)) < NOISE
    assert np.mean(np.abs(apart) < 2.0 * NOISE) > 0.9
    assert np.mean(found[~inside] > 0.0) < 0.02  # a pixel or two around them


@pytest.mark.slow
def test_dense_particles_are_no_patches() -> None:
    for per_pixel in (0.1, 0.2):
        shown = image(per_pixel, 6)
        found = background.find_patches(shown, np.ones(shown.shape, dtype=bool))
        assert np.mean(found > 0.0) < 0.01
    shown = image(0.12, 8)  # a volume that fills a part of the image
    shown[:, : COLUMNS // 2] = image(0.0, 9)[:, : COLUMNS // 2]
    assert np.mean(background.find_patches(shown, np.ones(shown.shape, dtype=bool)) > 0.0) < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 13))
def test_particles_that_leave_nothing_dark_are_no_patches(seed: int) -> None:
    """They are denser in the middle, as before a camera whose view passes the volume's edges."""
    across = np.random.default_rng(seed).triangular(-60.0, COLUMNS / 2, COLUMNS + 60.0, 60_000)
    shown = image(0.6, seed, across=across)
    assert not background.find_patches(shown, np.ones(shown.shape, dtype=bool)).any()


def test_spots_of_nothing_are_none() -> None:
    none = np.zeros((ROWS, COLUMNS), dtype=np.float32)
    assert not background.find_bright_spots(none, np.ones(none.shape, dtype=np.bool_)).any()
    assert not background.find_bright_spots(none, np.zeros(none.shape, dtype=np.bool_)).any()


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
