"""Sets of particle images, and errors of cameras from them."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.calibration.disparity import _by_parts, _compute_step, _gains


def test_each_part_of_the_box_has_its_own_disparity() -> None:
    """Spots that grow along x and y, with a tenth of them far from any spot."""
    rng = np.random.default_rng(8)
    positions = rng.uniform(-1.0, 1.0, (9000, 3))
    third = np.minimum(((positions[:, :2] + 1.0) * 1.5).astype(int), 2)
    true = np.column_stack([0.1 * third[:, 0], 0.07 * third[:, 1]])
    errors = true + rng.normal(0.0, 0.02, true.shape)
    errors[::10] += 3.0
    rows, spots = _by_parts(positions, errors, np.array([0.1, 0.07]))
    across, down = np.meshgrid([-2 / 3, 0.0, 2 / 3], [-2 / 3, 0.0, 2 / 3])
    middles = np.column_stack([np.ones(9), across.ravel(), down.ravel()])
    np.testing.assert_allclose(rows, middles, atol=0.06)
    expected = 0.15 * (middles[:, 1:] + 2 / 3) * [1.0, 0.7]
    np.testing.assert_allclose(spots, expected, atol=0.005)


def test_few_particles_have_one_disparity() -> None:
    positions = np.random.default_rng(8).uniform(-1.0, 1.0, (800, 3))
    rows, spots = _by_parts(positions, np.zeros((800, 2)), np.array([0.1, 0.2]))
    np.testing.assert_array_equal(rows, [[1.0]])
    np.testing.assert_array_equal(spots, [[0.1, 0.2]])


def test_a_step_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(6)
    for cameras in (2, 3, 5):
        slopes, misses = rng.normal(size=(cameras, 2, 3)), rng.normal(size=(cameras, 2))
        gains, step = np.zeros((cameras, 2, 3)), np.zeros(3)
        assert _gains(slopes, cameras, gains)
        _compute_step(gains, misses, cameras, step)
        expected = np.linalg.lstsq(slopes.reshape(-1, 3), misses.ravel(), rcond=None)[0]
        np.testing.assert_allclose(step, expected, rtol=1e-9)


def test_parallel_lines_of_sight_have_no_solution() -> None:
    slopes = np.tile(np.array([[1.0, 0.0, 0.2], [0.0, 1.0, -0.1]]), (3, 1, 1))
    assert not _gains(slopes, 3, np.zeros((3, 2, 3)))
