"""Peaks of volumes and curves of particles."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import ndimage

from sabench.metrics.particle_detection import (
    classify,
    detect,
    detect_peaks,
    f1_over_distance,
    fitted_maxima,
    three_point,
)
from sabench.plotting.kinds import DUPLICATE, FOUND, GHOST
from sabench.utils.arrays import F32, F64, Bool


def gaussians(shape: tuple[int, int, int], places: F64, sigma: float) -> F32:
    """Spherical particles of peak 1 at places (x, y, z), in voxels."""
    z, y, x = np.indices(shape)
    volume = np.zeros(shape)
    for a, b, c in places:
        volume += np.exp(-((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / (2.0 * sigma**2))
    return volume.astype(np.float32)


def slow_maxima(volume: F32, floor: float) -> list[tuple[float, ...]]:
    """Mean positions (x, y, z) of connected equal voxels that border on lower voxels only."""
    maxima = []
    for value in np.unique(volume[volume >= floor]):
        labels, count = ndimage.label(volume == value, structure=np.ones((3, 3, 3)))
        for label in range(1, count + 1):
            voxels = np.argwhere(labels == label)
            around = ndimage.binary_dilation(labels == label, structure=np.ones((3, 3, 3)))
            if volume[around].max() == value:
                maxima.append(tuple(voxels.mean(axis=0)[::-1]))
    return maxima


@pytest.mark.parametrize("levels", [1, 2, 4])
def test_plateaus_are_maxima_once_each(levels: int) -> None:
    for seed in range(20):
        volume = np.random.default_rng(seed).integers(0, levels + 1, (4, 5, 6)).astype(np.float32)
        found, expected = fitted_maxima(volume, 1.0), slow_maxima(volume, 1.0)
        assert len(found) == len(expected)
        for place in found:
            assert min(np.abs(place - other).max() for other in expected) <= 0.5


def test_maxima_of_unequal_voxels_are_found_but_of_the_faintest_tenth() -> None:
    rng = np.random.default_rng(1)
    lit = rng.random((9, 11, 13)) < 0.4
    volume = np.where(lit, rng.exponential(size=lit.shape), 0.0).astype(np.float32)
    floor = float(np.quantile(volume[volume > 0.0], 0.1))
    expected = sorted(slow_maxima(volume, floor), key=lambda place: place[::-1])
    found = detect_peaks(volume)
    assert_allclose(found, expected, rtol=0, atol=0.5)
    assert len(found) > 20


@pytest.mark.parametrize("sigma", [0.6, 0.8, 1.5])
def test_gaussians_are_found_where_they_are(sigma: float) -> None:
    for place in np.random.default_rng(2).uniform(3.0, 5.0, (20, 3)):
        found = detect_peaks(gaussians((9, 9, 9), place[None], sigma))
        assert_allclose(found, place[None], rtol=0, atol=2e-3)
    assert detect_peaks(np.zeros((9, 9, 9), dtype=np.float32)).shape == (0, 3)
    places = np.array([[4.0, 5.0, 3.0], [7.2, 5.4, 3.0]])
    volume = gaussians((7, 11, 12), places, 0.8)
    assert len(detect(volume)) == 1  # they touch
    assert_allclose(detect_peaks(volume), places, rtol=0, atol=0.05)


def test_a_plateau_is_one_peak_in_its_middle_and_none_on_a_slope() -> None:
    volume = np.zeros((5, 7, 12), dtype=np.float32)
    volume[2, 3, 2:5] = 4.0  # a saturated particle
    volume[2, 2:5, 8] = 2.0
    volume[2, 3, 9] = 3.0  # above the middle of a step
    assert_allclose(detect_peaks(volume), [[3.0, 3.0, 2.0], [9.0 - 2.0 / 5.0, 3.0, 2.0]])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirrored_volume_has_mirrored_peaks(axis: int) -> None:
    """Also on faces, where the next value in memory is one of another row or plane."""
    volume = np.random.default_rng(5).uniform(0.1, 1.0, (5, 6, 7)).astype(np.float32)
    found = fitted_maxima(volume, 0.5)
    mirrored = fitted_maxima(np.ascontiguousarray(np.flip(volume, 2 - axis)), 0.5)
    mirrored[:, axis] = (7, 6, 5)[axis] - 1 - mirrored[:, axis]
    assert (found[:, axis] == 0.0).any()
    assert (found[:, axis] == (7, 6, 5)[axis] - 1).any()
    order, other = (np.lexsort(np.round(one, 6).T) for one in (found, mirrored))
    assert_allclose(mirrored[other], found[order], atol=1e-6)


@pytest.mark.parametrize("offset", [-0.5, 0.0, 0.37])
def test_three_points_of_a_gaussian_give_its_vertex(offset: float) -> None:
    a, b, c = (math.exp(-((x - offset) ** 2) / 0.9) for x in (-1.0, 0.0, 1.0))
    assert three_point(a, b, c) == pytest.approx(offset, abs=1e-12)


_TRUTH = np.array([[5.0, 5.0, 5.0], [15.0, 5.0, 5.0], [25.0, 5.0, 5.0], [35.0, 5.0, 5.0]])


def _all(count: int) -> Bool:
    return np.ones(count, dtype=np.bool_)


def test_the_curve_rises_where_particles_come_within_reach() -> None:
    found = _TRUTH + np.array([[0.05], [0.25], [0.65], [2.0]]) * [1.0, 0.0, 0.0]
    curve = f1_over_distance(found, _TRUTH, _all(4), _all(4), (0.1, 0.3, 0.5, 0.7, 1.0))
    assert_allclose(curve, [0.25, 0.5, 0.5, 0.75, 0.75])


def test_second_detections_of_a_particle_are_duplicates_and_ghosts_are_not() -> None:
    near, far = np.array([0.0, 0.4, 0.0]), np.array([0.0, 3.0, 0.0])
    found = np.concatenate([_TRUTH, _TRUTH[:2] + near, _TRUTH[2:3] + far])
    kind, i, j = classify(found, _TRUTH)
    assert kind.tolist() == [*[FOUND] * len(_TRUTH), DUPLICATE, DUPLICATE, GHOST]
    assert i.tolist() == j.tolist()
