"""Scores of calibrations, from estimates with known errors."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.api import Calibration
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.rigid_motion import RigidMotion
from sabench.metrics import calibration_error
from sabench.metrics.calibration_error import (
    calibration_scores,
    lower_bound,
    point_scores,
    target_points,
    wall_scores,
)
from tests.helpers.calibration_cases import calibration_scene, case_of


def moved(cameras: tuple[Camera, ...], *shifts_px: tuple[float, float]) -> tuple[Camera, ...]:
    return tuple(
        replace(one, principal_point_px=tuple(np.add(one.principal_point_px, shift)))
        for one, shift in zip(cameras, itertools.cycle(shifts_px), strict=False)
    )


NOISE = {"noise_px": 0.1, "missing": 0.1}


@pytest.mark.slow
def test_the_true_calibration_has_no_error_but_that_of_detection() -> None:
    case, cameras, points, exact = case_of(calibration_scene(detection=NOISE))
    answer = Calibration(cameras, points)
    scores: Any = calibration_scores(answer, case, cameras, points, exact, case.found)
    assert scores["true_px"] == pytest.approx(0.0, abs=1e-9)
    # lengths of errors that are normal along both axes
    assert scores["measured_px"] == pytest.approx(0.1 * np.sqrt(np.pi / 2.0), rel=0.05)
    assert scores["used_percent"] == pytest.approx(100.0)
    assert scores["found_std_px"] == pytest.approx(0.1, rel=0.05)
    assert 0.0 < scores["bound_px"] < 0.1
    assert scores["true_ratio"] == pytest.approx(0.0, abs=1e-6)


def test_a_principal_point_aside_is_the_mean_reprojection_error() -> None:
    case, cameras, points, exact = case_of(calibration_scene(detection=NOISE))
    estimate = Calibration(moved(cameras, (0.3, -0.4)), points)
    scores: Any = calibration_scores(estimate, case, cameras, points, exact, case.found)
    assert scores["true_px"] == pytest.approx(0.5, rel=1e-6)
    assert scores["true_ratio"] * scores["bound_px"] == pytest.approx(0.5, rel=1e-6)


def test_efficiency_is_relative_to_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    bounds: list[Any] = []

    def spy(*arguments: Any) -> Any:
        bounds.append(lower_bound(*arguments))
        return bounds[-1]

    monkeypatch.setattr(calibration_error, "lower_bound", spy)
    case, cameras, points, exact = case_of(calibration_scene(detection=NOISE))
    estimate = Calibration(cameras, points + np.array([0.02, 0.0, 0.0]))
    scores: Any = calibration_scores(estimate, case, cameras, points, exact, case.found)
    (bound,) = bounds
    assert 0.0 < bound.efficiency < 1.0
    ratio = scores["true_px"] / scores["measured_px"]
    assert scores["efficiency_ratio"] * bound.efficiency == pytest.approx(ratio)
    for number, axis in enumerate("xyz"):
        std, over = scores[f"{axis}_std_mm"], scores[f"{axis}_std_ratio"]
        assert over * bound.point_std_mm[number] == pytest.approx(std)


def test_alignments_take_away_their_motion_and_leave_the_scatter_of_each_axis() -> None:
    rng = np.random.default_rng(4)
    truth, seen = rng.normal(0.0, 10.0, (3, 20, 3)), np.ones((3, 20), dtype=np.bool_)
    still, shift = RigidMotion(np.eye(3), np.zeros(3)), np.array([0.1, -0.2, 0.3])
    scores: Any = point_scores(truth + shift, truth, seen, still)
    along_z = [0.0, 0.0, 0.3]  # no prefix: lateral, in the plane of the wall
    means: dict[str, Any] = {"raw_": shift, "": along_z, "shift_": along_z, "rigid_": [0.0] * 3}
    for how, expected in means.items():
        assert_allclose([scores[f"{how}{axis}_mean_mm"] for axis in "xyz"], expected, atol=1e-9)
    errors = rng.normal(0.0, 0.1, (3, 20, 3)) * [1.0, 2.0, 3.0]
    scores = point_scores(truth + errors, truth, seen, still)
    std = [scores[f"raw_{axis}_std_mm"] for axis in "xyz"]
    assert_allclose(std, errors.reshape(-1, 3).std(axis=0))
    mean = [scores[f"shift_{axis}_mean_mm"] for axis in "xyz"]
    assert_allclose(mean, [0.0, 0.0, errors[..., 2].mean()], atol=1e-9)


def test_points_are_triangulated_from_the_observations_that_were_used() -> None:
    case, cameras, points, _ = case_of(calibration_scene(detection=None))
    assert_allclose(target_points(Calibration(cameras), case), points, atol=1e-6)
    assert_array_equal(target_points(Calibration(cameras, points + 1.0), case), points + 1.0)
    used = np.ones(case.found.shape, dtype=np.bool_)
    used[1:, 0, 3] = False  # one camera alone sees no depth
    case.pixels[1:, 0, 3] += 5.0  # rejected, but there is nothing else to triangulate
    case.pixels[1, 0, 4] += 5.0
    used[1, 0, 4] = False
    kept = target_points(Calibration(cameras, None, used), case)
    assert np.abs(kept[0, 3] - points[0, 3]).max() > 1e-3
    assert_allclose(np.delete(kept, 3, axis=1)[0], np.delete(points, 3, axis=1)[0], atol=1e-6)


def test_observations_that_are_not_used_are_scored() -> None:
    case, cameras, points, exact = case_of(calibration_scene())
    off = moved(cameras, *((float(n), 0.0) for n in range(len(cameras))))
    none = np.zeros(case.found.shape, dtype=np.bool_)
    few = none.copy()
    few[:2, 0, 0] = True
    scores: list[Any] = [
        calibration_scores(Calibration(off, None, used), case, cameras, points, exact, case.found)
        for used in (None, none, few)
    ]
    every, without, one = (own["true_px"] for own in scores)
    assert every == without
    assert one == pytest.approx(every, rel=0.01)


def wall(*layers: Layer, fluid_index: float = 1.333) -> Wall:
    return Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, layers, fluid_index)


def test_errors_of_the_wall() -> None:
    truth = wall(Layer("glass", 1.52, 5.0))
    estimate = wall(Layer("glass", 1.50, 5.4), fluid_index=1.34)
    tilted = (0.0, np.sin(0.01), np.cos(0.01))
    estimate = replace(estimate, point_mm=(0.0, 0.0, truth.point_mm[2] - 0.3), normal=tilted)
    assert wall_scores(estimate, truth) == {
        "index_error": pytest.approx(0.02),
        "thickness_error_mm": pytest.approx(0.4),
        "wall_place_error_mm": pytest.approx(0.3),
        "wall_tilt_error_deg": pytest.approx(np.rad2deg(0.01)),
    }
    assert wall_scores(None, truth)["index_error"] is None
    assert wall_scores(wall(), truth)["thickness_error_mm"] is None
