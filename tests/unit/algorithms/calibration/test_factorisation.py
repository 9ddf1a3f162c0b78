"""Cameras from images alone.

Exact for pinholes, also with points missing, and useless through a wall.
"""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.calibration.factorisation import (
    adjust_factors,
    factorise,
    upgrade_to_euclidean,
)
from sabench.algorithms.calibration.parameters import fit_similarity
from sabench.api import Calibration
from sabench.geometry.triangulation import triangulate
from sabench.plugins import load
from sabench.utils.arrays import F64
from tests.helpers.calibration_cases import calibration_scene, case_of

IN_AIR = {"wall": None, "detection": None, "calibration": {"points": 0.0, "known": []}}


def points_by(answer: Calibration, exact: F64) -> F64:
    return triangulate(answer.cameras, exact.reshape(len(exact), -1, 2))


def test_pinholes_are_found_from_exact_images() -> None:
    case, _, points, exact = case_of(calibration_scene(**IN_AIR))
    plugin = load("solvers", "linear_autocal")
    found = points_by(plugin(plugin.Parameters()).solve(case), exact)
    assert np.abs(found - points.reshape(-1, 3)).max() < 0.01


def test_a_wall_spoils_it() -> None:
    case, _, points, exact = case_of(
        calibration_scene(detection=None, calibration={"points": 0.0, "known": []})
    )
    plugin = load("solvers", "linear_autocal")
    found = points_by(plugin(plugin.Parameters()).solve(case), exact)
    assert np.abs(found - points.reshape(-1, 3)).max() > 0.3


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_factors_make_the_images(missing: float) -> None:
    case, cameras, points, exact = case_of(calibration_scene(**IN_AIR))
    images = (exact.reshape(9, -1, 2) - np.asarray(cameras[0].principal_point_px)) / cameras[
        0
    ].focal_px
    seen = np.random.default_rng(0).random(images.shape[:2]) >= missing
    images[~seen] = np.nan
    factors = adjust_factors(factorise(images, seen), np.nan_to_num(images), seen)
    projected = np.einsum("cij,nj->cni", factors.matrices, factors.points)
    errors = (projected[..., :2] / projected[..., 2:] - images)[seen] * cameras[0].focal_px
    assert np.abs(errors).max() < 1e-4
    upgraded = upgrade_to_euclidean(factors)
    positions = upgraded.points[:, :3] / upgraded.points[:, 3:]
    world = fit_similarity(positions, points.reshape(-1, 3))
    assert np.abs(positions @ world[:3, :3].T + world[:3, 3] - points.reshape(-1, 3)).max() < 0.05
    assert case.pixels.shape == exact.shape
