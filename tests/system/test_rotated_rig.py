"""A rig that is rotated as a whole finds the same particles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sabench.algorithms.particles import (
    BayesianIprSettings,
    fit_cameras,
    reconstruct_most_probable,
)
from sabench.algorithms.particles.candidate_search import rig_axes, turn_maps
from sabench.api import FoundParticles, Observation
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.geometry.volume_polynomials import project_points
from sabench.utils.arrays import F64
from tests.helpers.small_particles import make_small, rotate_rig

PIXEL_MM = 0.05


def find_in(case: Observation) -> FoundParticles:
    return reconstruct_most_probable(case, fit_cameras(case), BayesianIprSettings())


def nearest_mm(positions: F64, others: F64) -> F64:
    return np.asarray(cKDTree(others).query(positions)[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "rotation",
    [
        [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    ],
)
def test_rotations_of_axes_onto_axes_change_nothing_but_rounding(rotation: list[list[int]]) -> None:
    """Residual images are float32; their last digits decide on the last steps of some fits."""
    turn = np.array(rotation, dtype=np.float64)
    # with 3, 6 or 7, rounding tips one cluster of some 400, and others move by 0.002 px
    case = make_small(9, 0.08).observation
    found, turned = find_in(case), find_in(rotate_rig(case, turn))
    assert len(found.position_mm) == len(turned.position_mm) > 350
    distances, nearest = cKDTree(turned.position_mm @ turn).query(found.position_mm)
    assert len(np.unique(nearest)) == len(nearest)
    assert np.median(distances) < 1e-3 * PIXEL_MM
    assert np.quantile(distances, 0.9) < 3e-3 * PIXEL_MM
    assert found.covariance_mm2 is not None
    assert turned.covariance_mm2 is not None
    back = turn.T @ turned.covariance_mm2[nearest] @ turn
    scale = np.abs(found.covariance_mm2).max(axis=(1, 2))
    errors = np.abs(back - found.covariance_mm2).max(axis=(1, 2)) / scale
    assert np.median(errors) < 1e-2


@pytest.mark.slow
def test_any_rotation_finds_nearly_the_same_particles() -> None:
    axis = np.array([1.0, 2.0, -1.5])
    turn = rotation_matrices(np.deg2rad(33.0) * axis / np.linalg.norm(axis))
    case = make_small(3, 0.05).observation
    found, turned = find_in(case).position_mm, find_in(rotate_rig(case, turn)).position_mm @ turn
    low, voxel = np.asarray(case.grid.low_mm), np.asarray(case.grid.voxel_mm)
    last = np.asarray(case.grid.shape[::-1]) - 1
    inside = ((turned > low) & (turned < low + voxel * last)).all(axis=1)
    assert len(found) > 200
    assert np.mean(nearest_mm(found, turned) < 0.2 * PIXEL_MM) > 0.97
    assert np.mean(nearest_mm(turned[inside], found) < 0.2 * PIXEL_MM) > 0.97


def test_axes_of_a_rig_follow_its_images() -> None:
    """Columns grow along x and rows along y, whatever the world's axes; pixels stay."""
    case = make_small(3).observation
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3))
    maps = fit_cameras(case)
    np.testing.assert_array_equal(rig_axes(maps), np.eye(3))
    turn = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    other = fit_cameras(rotate_rig(case, turn))
    axes = rig_axes(other)
    np.testing.assert_array_equal(axes, turn.T)
    turned = turn_maps(other, axes)
    np.testing.assert_allclose(turned.half_mm, maps.half_mm, atol=1e-12)
    np.testing.assert_allclose(turned.middle_mm, maps.middle_mm, atol=1e-12)
    for camera in range(len(case.cameras)):
        expected = project_points(maps, camera, points)
        np.testing.assert_allclose(project_points(turned, camera, points), expected, atol=1e-9)
        unturned = project_points(other, camera, points @ axes)
        np.testing.assert_allclose(unturned, expected, atol=1e-9)
