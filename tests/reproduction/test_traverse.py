"""Differences between tests of a traversed grid, and cameras brought to a reference plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from reproduction.chapter_4 import Board, draw, reprojection
from reproduction.chapter_4_traverse import (
    MIDDLE,
    PLANES,
    STEP_MM,
    Traversed,
    _differences,
    _refit,
    make_traverse,
)
from reproduction.chapter_6_grid import _join, _reference, _scene, _to_reference
from sabench.api import Calibration
from sabench.geometry.projective_camera import fit_projective
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.utils.arrays import F64

PAIR = ("test 1", "test 2")


@pytest.fixture(scope="module")
def given() -> Board:
    return draw(make_traverse(), 1)


def traversed(given: Board, points_mm: F64) -> Traversed:
    return Traversed(given, Calibration(given.cameras, points_mm), points_mm)


def test_the_grid_moves_by_four_millimetres(given: Board) -> None:
    depths = given.points_mm[..., 2]
    assert depths.shape[0] == PLANES
    assert np.diff(depths, axis=0) == pytest.approx(STEP_MM)


def test_alignment_undoes_a_motion_and_leaves_a_skew(given: Board) -> None:
    points = given.points_mm
    motion = rotation_matrices(np.deg2rad([2.0, 1.0, 0.0]))
    moved = points @ motion.T + np.array([0.1, -0.2, 0.3])
    skewed = points.copy()
    skewed[..., 0] += 0.01 * (points[..., 2] - points[MIDDLE, 0, 2])
    for other, rest in ((moved, 0.0), (skewed, 0.01 * STEP_MM * (PLANES // 2))):
        tests = {"test 1": traversed(given, points), "test 2": traversed(given, other)}
        before, after, _ = _differences(tests, PAIR)
        assert np.abs(before).max() > 0.1
        assert np.abs(after).max() == pytest.approx(rest, abs=1e-9)


def test_a_refit_to_the_same_points_gives_the_same_cameras(given: Board) -> None:
    same = traversed(given, given.points_mm)
    refit = _refit({"test 1": same, "test 2": same}, "test 2")
    assert refit.true.max() < 1e-6
    assert refit.measured == pytest.approx(refit.original, abs=1e-6)


def test_a_refit_to_squeezed_points_fails_in_all_but_the_central_camera(given: Board) -> None:
    squeezed = given.points_mm * np.array([1.0, 1.0, 0.9])
    tests = {
        "test 1": traversed(given, given.points_mm),
        "test 2": traversed(given, squeezed),
    }
    errors = _refit(tests, "test 2").true
    central = int(errors.argmin())
    assert given.cameras[central].center_mm[:2] == (0.0, 0.0)
    assert errors[central] < 0.01
    assert np.delete(errors, central).min() > 0.5


def test_linear_cameras_are_brought_to_the_reference_plane() -> None:
    given = _join(draw(_scene(None), 1), draw(_reference(None), 1))
    turned = given.points_mm @ rotation_matrices(np.array([0.1, 0.2, 0.3])).T * 1.1 + 5.0
    cameras = tuple(
        fit_projective(camera.name, camera.rows, camera.columns, turned[seen], own[seen])
        for camera, own in zip(given.cameras, given.exact, strict=True)
        for seen in [np.isfinite(own).all(axis=-1)]
    )
    noiseless = replace(given, case=replace(given.case, pixels=given.exact))
    found = Calibration(_to_reference(cameras, noiseless), given.points_mm)
    assert np.nanmax(reprojection(found, given, given.exact)) < 0.1
