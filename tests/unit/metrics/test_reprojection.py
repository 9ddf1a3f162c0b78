"""Particles against images that are drawn here."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.metrics.reprojection import (
    cut_patches,
    draw_reprojection,
    explained_share,
    fit_light,
    matched_light,
)
from sabench.utils.arrays import F64, Bool

SHAPE = (70, 90)
SIGMA = np.array([0.9, 0.7])
KNOWN: Bool = np.ones(SHAPE, dtype=np.bool_)


def particles(count: int = 60) -> tuple[F64, F64]:
    rng = np.random.default_rng(3)
    pixels = rng.uniform([0.0, 0.0], [SHAPE[1] - 1.0, SHAPE[0] - 1.0], (count, 2))
    return pixels, rng.uniform(200.0, 900.0, count)


def image_of(pixels: F64, light: F64, known: Bool = KNOWN) -> F64:
    patches = cut_patches(SHAPE, pixels, SIGMA, known)
    return draw_reprojection(SHAPE, patches, light[patches.rows])


def test_light_is_found_again() -> None:
    pixels, light = particles()
    image = image_of(pixels, light)
    assert image.sum() == pytest.approx(light.sum(), rel=0.05)
    fit = fit_light(image, cut_patches(SHAPE, pixels, SIGMA, KNOWN), len(pixels))
    assert (np.abs(fit.light / light - 1.0) < 0.03).mean() > 0.95  # two nearly coincide
    assert explained_share(image, fit.left, KNOWN, 0.0) > 0.999
    assert np.nanmedian(np.abs(fit.shift_px)) < 1e-3


@pytest.mark.parametrize("shift", [(0.1, 0.0), (0.1, -0.15)])
def test_shifts_are_found(shift: tuple[float, float]) -> None:
    pixels, light = particles(12)
    image = image_of(pixels + np.array(shift), light)
    fit = fit_light(image, cut_patches(SHAPE, pixels, SIGMA, KNOWN), len(pixels))
    assert_allclose(np.nanmedian(fit.shift_px, axis=0), shift, atol=0.02)


def test_missing_particles_leave_light() -> None:
    pixels, light = particles()
    image = image_of(pixels, light)
    shares = []
    for count in (60, 40, 20, 0):
        fit = fit_light(image, cut_patches(SHAPE, pixels[:count], SIGMA, KNOWN), count)
        shares.append(explained_share(image, fit.left, KNOWN, 0.0))
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == 0.0


def test_noise_is_no_light_that_could_be_explained() -> None:
    pixels, light = particles()
    noise = 5.0 * np.random.default_rng(1).standard_normal(SHAPE)
    image = image_of(pixels, light) + noise
    fit = fit_light(image, cut_patches(SHAPE, pixels, SIGMA, KNOWN), len(pixels))
    assert explained_share(image, fit.left, KNOWN, 5.0) > 0.99
    assert not np.isfinite(explained_share(0.1 * noise, 0.1 * noise, KNOWN, 5.0))


def test_unknown_pixels_and_particles_outside_do_not_count() -> None:
    pixels, light = particles()
    known = KNOWN.copy()
    known[:, :30] = False
    image = np.where(known, image_of(pixels, light), 1e4)
    every = np.concatenate([pixels, np.array([[np.nan, np.nan], [-3.0, 5.0], [200.0, 5.0]])])
    patches = cut_patches(SHAPE, every, SIGMA, known)
    fit = fit_light(image, patches, len(every))
    assert np.isnan(fit.light[-3:]).all()
    right = pixels[:, 0] > 34.0
    assert (np.abs(fit.light[:-3][right] / light[right] - 1.0) < 0.05).mean() > 0.95
    assert explained_share(image, fit.left, known, 0.0) > 0.999
    assert np.isnan(matched_light(image, patches)).any()
