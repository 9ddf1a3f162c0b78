"""Cameras from images alone: factorisation, and plane and parallax."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.calibration import factorisation, factorise_parallax, fit_depth_scale
from sabench.algorithms.calibration.parameters import fit_similarity
from sabench.api import CalibrationCase
from sabench.api.make import make_algorithm
from sabench.geometry.triangulation import triangulate
from sabench.utils.arrays import F64
from tests.helpers.calibration_cases import calibration_scene, case_of, true_error_px
from tests.helpers.refusals import check_sentence

IN_AIR = {"wall": None, "detection": None, "calibration": {"points": 0.0, "known": []}}


@pytest.mark.parametrize("wall", [False, True])
def test_pinholes_are_found_from_exact_images_and_a_wall_spoils_it(wall: bool) -> None:
    changes = {key: value for key, value in IN_AIR.items() if key != "wall" or not wall}
    case, _, points, exact = case_of(calibration_scene(**changes))
    solver: Any = make_algorithm("linear_autocal", {})
    found = triangulate(solver.solve(case).cameras, exact.reshape(len(exact), -1, 2))
    off = np.abs(found - points.reshape(-1, 3)).max()
    assert off > 0.3 if wall else off < 0.01


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_factors_make_the_images(missing: float) -> None:
    _, cameras, points, exact = case_of(calibration_scene(**IN_AIR))
    middle, focal_px = np.asarray(cameras[0].principal_point_px), cameras[0].focal_px
    images = (exact.reshape(9, -1, 2) - middle) / focal_px
    seen = np.random.default_rng(0).random(images.shape[:2]) >= missing
    images[~seen] = np.nan
    factors = factorisation.adjust_factors(
        factorisation.factorise(images, seen), np.nan_to_num(images), seen
    )
    projected = np.einsum("cij,nj->cni", factors.matrices, factors.points)
    errors = (projected[..., :2] / projected[..., 2:] - images)[seen] * focal_px
    assert np.abs(errors).max() < 1e-4
    upgraded = factorisation.upgrade_to_euclidean(factors)
    positions = upgraded.points[:, :3] / upgraded.points[:, 3:]
    world = fit_similarity(positions, points.reshape(-1, 3))
    assert np.abs(positions @ world[:3, :3].T + world[:3, 3] - points.reshape(-1, 3)).max() < 0.05


LEVEL = {"tilt_deg": 0.0, "roll_deg": 0.0, "wander": 0.3}
EXACT = {"points": 0.0, "known": []}


def level(noise_px: float = 0.0, **changes: Any) -> Any:
    own = {"targets": LEVEL, "frames": 7, "calibration": EXACT, "detection": {"noise_px": noise_px}}
    return case_of(calibration_scene(**own, **changes))


def air(noise_px: float = 0.0, **changes: Any) -> Any:
    return level(noise_px, wall=None, **changes)


def solved(case: CalibrationCase) -> Any:
    algorithm: Any = make_algorithm("plane_parallax", {})
    assert algorithm.skip(case) is None
    return algorithm.solve(case)


def similar_triangles(seed: int = 3) -> tuple[F64, F64, F64, float]:
    """Cut lines from cameras at Z = -D through points with the plane Z = 0, one by one."""
    rng, distance = np.random.default_rng(seed), 400.0
    centers = np.column_stack([rng.uniform(-150, 150, (6, 2)), np.full(6, -distance)])
    points = rng.uniform(-20, 20, (40, 3))
    cut = np.empty((6, 40, 2))
    for i, center in enumerate(centers):
        for j, point in enumerate(points):
            along = point - center
            cut[i, j] = (center + along * (-center[2] / along[2]))[:2]
    return cut, centers, points, distance


def test_offsets_and_depths_of_lines_through_a_plane() -> None:
    """The second derivation: lines cut with the plane, without homographies or matrices."""
    cut, centers, points, distance = similar_triangles()
    found = factorise_parallax(cut, np.ones(cut.shape[:2], dtype=np.bool_))
    scale = fit_depth_scale(found, points)
    assert 1.0 / scale.per_mm == pytest.approx(distance, rel=1e-9)
    places = (scale.center + scale.offset * found.offsets) / scale.per_mm
    assert_allclose(places, centers[:, :2], atol=1e-7)


def test_offsets_are_those_of_the_array_up_to_a_factor() -> None:
    cut, centers, _, _ = similar_triangles()
    seen = np.random.default_rng(5).random(cut.shape[:2]) > 0.2
    found = factorise_parallax(np.where(seen[..., None], cut, np.nan), seen)
    true = centers[:, :2] - centers[:, :2].mean(axis=0)
    factor = np.sum(found.offsets * true) / np.sum(found.offsets**2)
    assert_allclose(found.offsets * factor, true, atol=1e-5)


def test_exact_images_give_the_exact_cameras() -> None:
    case, cameras, points, exact = air()
    answer = solved(case)
    assert true_error_px(answer.cameras, points, exact) < 1e-4
    other = np.random.default_rng(1).uniform([-25.0, -25.0, 10.0], [25.0, 25.0, 60.0], (50, 3))
    for made, true in zip(answer.cameras, cameras, strict=True):
        assert_allclose(made.center_mm, true.center_mm, atol=1e-3)
        assert_allclose(made.project(other)[0], true.project(other)[0], atol=1e-3)


def test_nothing_of_the_nominal_cameras_is_used() -> None:
    case, *_ = air(0.1)
    turned = tuple(
        replace(one, center_mm=(0.0, 0.0, -10.0), principal_distance_mm=5.0) for one in case.cameras
    )
    assert solved(replace(case, cameras=turned)).cameras == solved(case).cameras


def test_noise_passes_without_a_warning_and_a_departure_does_not() -> None:
    case, _, points, exact = air(0.1)
    assert true_error_px(solved(case).cameras, points, exact) < 0.04
    moved, *_ = level(0.1)
    with pytest.warns(UserWarning, match="plane_parallax") as heard:
        solved(moved)
    check_sentence(str(heard[0].message), "0.1")


def test_cases_without_a_level_frame_or_with_one_camera_are_skipped() -> None:
    algorithm: Any = make_algorithm("plane_parallax", {})
    tilted, *_ = case_of(calibration_scene(wall=None))
    check_sentence(algorithm.skip(tilted))
    case, *_ = air()
    check_sentence(algorithm.skip(replace(case, cameras=case.cameras[:1], pixels=case.pixels[:1])))
    flat = np.broadcast_to(case.initial_mm[3], case.initial_mm.shape)
    check_sentence(algorithm.skip(replace(case, initial_mm=flat)))
