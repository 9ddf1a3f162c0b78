"""Ellipses among others, in noise and in part; peaks of the potential and their groups."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

from sabench.algorithms.bubbles.ellipse_detection import find_edges, find_ellipses
from sabench.algorithms.bubbles.features import (
    PLANES,
    STEP,
    FeaturePeaks,
    drop_duplicates,
    find_blots,
    find_depth,
)
from sabench.utils.arrays import F32, F64, Bool

FINE = 5


def drawn(
    *shapes: tuple[float, ...],
    size: tuple[int, int] = (44, 60),
    hollow: float = 0.0,
    noise: float = 0.0,
) -> F32:
    """Dark ellipses (column, row, semi-axes, angle), blurred, bright within a part of them."""
    y, x = ((np.mgrid[: size[0] * FINE, : size[1] * FINE] + 0.5) / FINE - 0.5).astype(np.float64)
    dark: Bool = np.zeros(y.shape, dtype=np.bool_)
    for column, row, a, b, angle in shapes:
        u = (x - column) * np.cos(angle) + (y - row) * np.sin(angle)
        w = (y - row) * np.cos(angle) - (x - column) * np.sin(angle)
        part = np.hypot(u / a, w / b)
        dark |= (part <= 1.0) & (part >= hollow)
    blurred = gaussian_filter(dark.astype(np.float64), 0.5 * FINE)
    pixels = blurred.reshape(size[0], FINE, size[1], FINE).mean(axis=(1, 3))
    pixels = 0.8 * pixels + noise * np.random.default_rng(3).standard_normal(size)
    return np.asarray(pixels, dtype=np.float32)


def found(dark: F32, least: float = 0.02) -> F64:
    return find_ellipses(find_edges(dark, least), 15.0, 0.4, 0.5)


def test_edges_lie_on_the_outline_and_look_inwards() -> None:
    points = find_edges(drawn((30.3, 21.6, 9.0, 9.0, 0.0)), 0.02)
    out = points[:, :2] - [30.3, 21.6]
    distance = np.linalg.norm(out, axis=1)
    assert len(points) > 40
    assert_allclose(distance, 9.0, atol=0.25)
    assert abs(distance.mean() - 9.0) < 0.07  # blur moves edges of small discs inwards
    assert (-(out * points[:, 2:]).sum(axis=1) / distance).min() > 0.97
    for even in (np.full((20, 20), 0.7, dtype=np.float32), np.ones((1, 9), dtype=np.float32)):
        assert find_edges(even, 0.02).shape == (0, 4)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("hollow", [0.0, 0.5])
@pytest.mark.parametrize(("a", "b", "angle"), [(9.0, 9.0, 0.0), (8.0, 4.0, 2.0), (3.0, 3.0, 0.0)])
def test_an_ellipse_is_measured(a: float, b: float, angle: float, hollow: float) -> None:
    """The outline of a bubble's bright middle has gradients of the opposite direction."""
    (one,) = found(drawn((28.3, 20.6, a, b, angle), hollow=hollow))
    assert_allclose(one[:2], [28.3, 20.6], atol=0.1)
    assert_allclose(one[2:4], [a, b], atol=0.25)
    assert one[5] > 0.8
    if b < 0.9 * a:
        assert abs(np.sin(one[4] - angle)) < 0.06


def test_touching_ones_are_separated_in_noise() -> None:
    true = [(15.0, 18.0, 8.0, 5.0, 0.3), (29.4, 19.0, 6.0, 6.0, 0.0)]
    true += [(32.0, 31.2, 6.5, 5.0, 3.0), (47.0, 24.0, 3.0, 3.0, 0.0)]
    for noise in (0.0, 0.03):
        some = found(drawn(*true, hollow=0.4, noise=noise), 0.05)
        assert len(some) == 4
        for one in np.array(true):
            nearest = some[np.linalg.norm(some[:, :2] - one[:2], axis=1).argmin()]
            assert_allclose(nearest[:4], one[:4], atol=0.6)


def test_straight_edges_and_short_arcs_are_none() -> None:
    step = np.zeros((40, 40), dtype=np.float32)
    step[:, 17:] = 0.8
    assert len(found(step)) == 0
    disc = drawn((30.0, 20.0, 9.0, 9.0, 0.0))
    most, little = disc.copy(), disc.copy()
    most[24:], little[14:] = 0.8, 0.8
    (one,) = found(most[:25])
    assert_allclose(one[:4], [30.0, 20.0, 9.0, 9.0], atol=0.6)
    assert len(found(little[:15])) == 0


def test_flat_ones_are_parts_of_outlines() -> None:
    flat = find_edges(drawn((28.0, 20.0, 12.0, 4.0, 0.2)), 0.02)
    assert len(find_ellipses(flat, 15.0, 0.2, 0.6)) == 1
    assert len(find_ellipses(flat, 15.0, 0.5, 0.6)) == 0
    assert len(find_ellipses(flat, 10.0, 0.2, 0.6)) == 0


def test_small_features_that_end_in_a_region_are_thresholded() -> None:
    """Radii are up to a pixel too large: pixels darker than a region's mean fill more."""
    dark = drawn((6.3, 5.6, 0.9, 0.9, 0.0), size=(13, 13))
    ((x, y, radius),) = find_blots(dark, 0.02, 4.5)
    assert_allclose([x, y], [6.3, 5.6], atol=0.15)
    assert 0.9 < radius < 2.1
    assert find_blots(dark, 0.02, 2.0) == []
    assert find_blots(dark[:, 6:], 0.02, 4.5) == []


def test_peaks_are_those_over_depth() -> None:
    potential = np.zeros((30, 2, 3), dtype=np.float32)
    potential[8:11, 0, 1], potential[20, 0, 1] = [3.0, 7.0, 4.0], 9.0
    potential[0, 1, 2], potential[15, 1, 0] = 6.0, 1.0
    peaks = FeaturePeaks.find(potential, 2.0)
    assert peaks.position.tolist() == [[20, 0, 1], [9, 0, 1], [0, 1, 2]]
    assert peaks.weight.tolist() == [9.0, 7.0, 6.0]
    assert len(FeaturePeaks.find(np.zeros((30, 2, 3), dtype=np.float32), 2.0).position) == 0


def test_groups_do_not_run_from_bubble_to_bubble() -> None:
    """A stair of peaks, each a window and six planes from the one before."""
    potential = np.zeros((140, 3, 20), dtype=np.float32)
    steps = np.arange(20)
    potential[6 * steps + 5, 1, steps] = 5.0 + np.cos(steps)
    peaks, free, groups = FeaturePeaks.find(potential, 1.0), np.ones(20, dtype=np.bool_), []
    for first in range(20):
        if free[first]:
            groups.append(peaks.group(first, free, 5))
            free[groups[-1]] = False
            assert groups[-1][0] >= first
            assert np.abs(peaks.position[groups[-1], 0] - peaks.position[first, 0]).max() <= PLANES
    assert sorted(np.concatenate(groups).tolist()) == steps.tolist()
    assert len(groups) > 6


def test_groups_are_connected_and_not_wider_than_allowed() -> None:
    potential = np.zeros((30, 1, 20), dtype=np.float32)
    potential[10, 0, :9], potential[14, 0, 11:14], potential[10, 0, 0] = 5.0, 6.0, 8.0
    peaks, free = FeaturePeaks.find(potential, 1.0), np.ones(12, dtype=np.bool_)
    assert sorted(peaks.position[peaks.group(0, free, 20), 2].tolist()) == list(range(9))
    assert sorted(peaks.position[peaks.group(0, free, 3), 2].tolist()) == [0, 1, 2, 3]
    assert peaks.plane(np.arange(4)) == round((10 * 8 + 14 * 18) / 26)
    bubble = np.array([12.0 * STEP + 3.0, 3.0, 4.0, 4.0, 0.0, 1.0, 12.0])
    assert sorted(peaks.position[peaks.within(bubble, 5), 2].tolist()) == [11, 12, 13]
    assert not peaks.within(bubble, 1).any()


@pytest.mark.parametrize("start", [14, 20, 26])
def test_a_depth_is_that_of_what_is_inside(start: int) -> None:
    """The outline of a ring sharp at plane 20.3 does not hold the darker one at plane 12."""
    planes, ellipse = np.arange(40)[:, None, None], (15.0, 20.0, 7.0, 5.0, 0.5)
    ring, other = drawn(ellipse, hollow=0.6), drawn((30.0, 20.0, 6.0, 6.0, 0.0))
    volume = sum(
        shape * np.exp(-0.5 * ((planes - plane) / 3.0) ** 2)
        for shape, plane in ((ring, 20.3), (other, 12.0))
    )
    found = find_depth(np.asarray(volume, dtype=np.float32), np.array(ellipse), start)
    assert found == pytest.approx(20.3, abs=0.15)
    nothing, corner = np.zeros((40, 44, 60), dtype=np.float32), [58.0, -1.0, 4.0, 4.0, 0.0]
    assert find_depth(nothing, np.array(corner), 39) == 39.0


def test_of_bubbles_at_one_place_one_is_left() -> None:
    whole, half = [10.0, 10.0, 5.0, 4.0, 0.1, 0.9, 20.0], [11.0, 10.0, 4.0, 4.0, 0.0, 0.3, 22.0]
    inside, behind = [12.0, 10.0, 2.0, 2.0, 0.0, 1.0, 20.0], [10.0, 10.0, 5.0, 4.0, 0.0, 0.7, 33.0]
    merged = [10.25, 10.0, 4.75, 4.0, 0.1, 0.9, 20.5]
    for some in ([whole, half, inside, behind], [inside, behind, half, whole]):
        left = drop_duplicates(np.array(some), 0.8)
        assert_allclose(left[left[:, 6].argsort()], [merged, behind])
    assert drop_duplicates(np.zeros((0, 7)), 0.8).shape == (0, 7)
