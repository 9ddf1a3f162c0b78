"""Grey values of images: levels and near duplicates."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sabench.images.levels import GreyLevels, GreyValues
from sabench.images.near_images import near_images
from sabench.utils.arrays import F64


def levels(image: F64, *, backlit: bool = False) -> GreyLevels:
    values = GreyValues()
    values.add(np.asarray(image, dtype=np.uint16))
    return values.levels(values.bit_depth, backlit=backlit)


def recording(noise: float, per_pixel: float, black: float = 64.0) -> F64:
    """Gaussian images of particles with random light."""
    rng = np.random.default_rng(7)
    shape = (200, 220)
    y, x = np.mgrid[-4:5, -4:5]
    spot = np.exp(-0.5 * (x**2 + y**2) / 0.8**2)
    light = np.zeros((shape[0] + 8, shape[1] + 8))
    for _ in range(int(per_pixel * shape[0] * shape[1])):
        row, column = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        light[row : row + 9, column : column + 9] += rng.exponential(400.0) * spot
    return np.clip(np.rint(light[4:-4, 4:-4] + black + noise * rng.standard_normal(shape)), 0, 4095)


@pytest.mark.parametrize(("noise", "per_pixel"), [(0.3, 0.001), (1.5, 0.02), (6.0, 0.05)])
def test_black(noise: float, per_pixel: float) -> None:
    assert levels(recording(noise, per_pixel)).black_dn == pytest.approx(64.0, abs=0.5 + noise)


def test_black_of_8_bits_that_is_cut_off() -> None:
    assert levels(np.maximum(recording(1.5, 0.02, 0.0) / 16.0, 0.0)).black_dn < 0.5


def test_white_is_where_pixels_pile_up() -> None:
    sharp = np.minimum(recording(1.5, 0.02), 700.0)
    found = levels(sharp)
    assert (found.white_dn, found.bit_depth) == (700.0, 10)
    assert found.saturated == (sharp >= 700.0).mean()
    assert levels(recording(1.5, 0.02)).white_dn == 4095.0
    noise = np.random.default_rng(2).normal(0.0, 2.0, sharp.shape)
    full = np.where(sharp >= 700.0, 690.0 + np.rint(noise), sharp)
    assert levels(full).white_dn == pytest.approx(690.0, abs=1.0)


def test_backlit_images_have_their_black_in_the_shadows() -> None:
    image = np.full((100, 100), 200.0)
    image[40:60, 40:60] = 12.0
    assert levels(image, backlit=True).black_dn == 12.0


@pytest.mark.parametrize("value", [0.0, 255.0, 65535.0])
def test_images_without_contrast(value: float) -> None:
    found = levels(np.full((30, 40), value))
    assert 0.0 <= found.black_dn < found.white_dn


def test_neighbours_are_those_of_all_pairs() -> None:
    pixels = np.random.default_rng(3).uniform(0.0, 60.0, (3, 400, 2))
    pixels[0, 5], pixels[1, 7], pixels[2, :, 1] = np.nan, [1e7, -1e9], 4.0
    reach = np.array([1.5, 3.0, 0.2])
    starts, near = near_images(pixels, reach)
    apart = np.linalg.norm(pixels[:, :, None] - pixels[:, None], axis=3)
    both = (apart <= reach[:, None, None]).any(axis=0)
    np.fill_diagonal(both, False)
    assert both.sum() > 1000
    found = np.zeros_like(both)
    found[np.repeat(np.arange(400), np.diff(starts)), near] = True
    assert_array_equal(found, both)
    assert all((np.diff(near[a:b]) > 0).all() for a, b in itertools.pairwise(starts))


@pytest.mark.parametrize("count", [0, 3])
def test_no_images_have_no_neighbours(count: int) -> None:
    starts, near = near_images(np.full((2, count, 2), np.nan), np.ones(2))
    assert starts.tolist() == [0] * (count + 1)
    assert not len(near)
