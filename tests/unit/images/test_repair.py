"""Repair of images: what is found, what is left alone, and the scale that follows."""

import numpy as np
import pytest

from sabench.images.gaussians import gaussian_shares
from sabench.images.levels import bright_dn, normalise
from sabench.images.repair import find_points, find_reflections, repair
from sabench.utils.arrays import U16

_BLACK, _WHITE, _PEAK = 64, 4095, 100.0
_SHAPE = (90, 120)


def particles(sigma_px: float, per_pixel: float, seed: int = 0, noise: float = 3.0) -> U16:
    """Make an image of Gaussian particles of various brightness, with noise."""
    rng = np.random.default_rng(seed)
    count = round(per_pixel * _SHAPE[0] * _SHAPE[1])
    peak = gaussian_shares(np.array([[-0.5, 0.5]]), sigma_px)[0, 0] ** 2
    places = rng.uniform(0.0, 1.0, (count, 2)) * _SHAPE
    rows, columns = (
        gaussian_shares(np.arange(size + 1)[None] - 0.5 - places[:, axis, None], sigma_px)
        for axis, size in enumerate(_SHAPE)
    )
    light = _PEAK / peak * np.exp(0.4 * rng.standard_normal(count))
    image = np.einsum("n,nr,nc->rc", light, rows, columns) + _BLACK
    image += noise * rng.standard_normal(_SHAPE)
    return np.asarray(np.clip(np.rint(image), 0, _WHITE), dtype=np.uint16)


@pytest.mark.parametrize("sigma_px", [0.2, 0.6, 2.0])
@pytest.mark.parametrize("per_pixel", [0.005, 0.05])
def test_particles_of_any_width_are_not_taken_for_flaws(sigma_px: float, per_pixel: float) -> None:
    image = particles(sigma_px, per_pixel)
    assert find_points(image, _BLACK).sum() <= 1
    assert not find_reflections(image, _WHITE).any()


@pytest.mark.parametrize("sigma_px", [0.48, 0.75, 1.5])
@pytest.mark.parametrize("light", [3.0, 40.0])
def test_hot_pixels_are_found(sigma_px: float, light: float) -> None:
    image = particles(sigma_px, 0.01)
    hot = np.random.default_rng(1).random(_SHAPE) < 2e-3
    hot[40, 60] = hot[40, 61] = True  # two that touch
    image[hot] = np.minimum(_BLACK + light * _PEAK, _WHITE)
    found = find_points(image, _BLACK)
    assert found[40, 60]
    assert found[40, 61]
    assert (found & hot).sum() >= 0.8 * hot.sum()  # a dimmer one beside a particle does no harm
    assert (found & ~hot).sum() <= 1


def test_dead_pixels_in_particles_are_found() -> None:
    image = particles(0.75, 0.02)
    clean = image.astype(np.float64) - _BLACK
    peaks = np.argwhere(clean > 1.2 * _PEAK)
    dead = np.zeros(_SHAPE, dtype=bool)
    dead[tuple(peaks[::3].T)] = True
    image[dead] = _BLACK
    found = find_points(image, _BLACK)
    assert (found & dead).sum() >= 0.7 * dead.sum() > 5
    assert (found & ~dead).sum() <= 3


def test_flaws_become_their_neighbours_mean_and_black() -> None:
    image = particles(0.75, 0.01)
    image[50, 30] = _WHITE
    image[10:30, 70:90] = _WHITE
    repaired = repair(image[None], _BLACK, _WHITE)
    assert repaired.flaws.points[0, 50, 30]
    around = [image[49, 30], image[51, 30], image[50, 29], image[50, 31]]
    assert repaired.images[0, 50, 30] == np.rint(np.mean(around))
    assert repaired.flaws.covered[0, 9:31, 69:91].all()
    assert (repaired.images[0, 10:30, 70:90] == _BLACK).all()
    assert image[50, 30] == _WHITE  # the images that were given stay


def test_images_without_flaws_are_the_same_array() -> None:
    images = particles(0.75, 0.03)[None]
    assert repair(images, _BLACK, _WHITE).images is images


def test_skirts_of_glints_are_covered() -> None:
    image = particles(0.75, 0.02).astype(np.float64)
    row, column = np.indices(_SHAPE)
    light = 60.0 * _PEAK * np.exp(-((row - 40) ** 2 + (column - 50) ** 2) / (2.0 * 2.5**2))
    image = np.minimum(image + light, _WHITE)
    covered = find_reflections(np.asarray(np.rint(image), dtype=np.uint16), _WHITE)
    assert covered[light > 0.5 * _PEAK].all()
    assert covered.sum() < 3.0 * (light > 0.5 * _PEAK).sum()


@pytest.mark.parametrize("flaw", ["hot", "particle", "reflection"])
def test_the_scale_does_not_follow_one_bright_thing(flaw: str) -> None:
    clean = particles(0.75, 0.03)
    image = clean.copy()
    if flaw == "hot":
        image[40, 50] = _WHITE
    elif flaw == "particle":
        image[39:42, 49:52] = _BLACK + 9 * _PEAK
    else:
        image[20:40, 20:60] = _WHITE
    repaired = repair(np.stack([clean, image]), _BLACK, _WHITE)
    scales = [
        bright_dn(one, _BLACK, unknown)
        for one, unknown in zip(repaired.images, repaired.flaws.unknown, strict=True)
    ]
    assert scales[1] == pytest.approx(scales[0], rel=0.15)
    assert normalise(repaired.images, _BLACK, repaired.flaws.unknown)[0].max() < 6.0
