"""Unmeasured lens numbers and tilts: their estimates and their part of the Cramer-Rao bound."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.algorithms.calibration.cramer_rao import _inverse, _mean_length, _whole
from sabench.algorithms.calibration.parameters import FreeParameters, WallFrame
from sabench.api import CalibrationCase
from sabench.api.make import make_algorithm
from sabench.geometry.camera import Camera
from sabench.geometry.lens import Distortion
from sabench.scenes import Scene
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.arrays import F64
from tests.helpers.calibration_cases import board_images, calibration_scene, case_of, true_error_px


@pytest.mark.parametrize(
    ("uu", "vv", "uv"), [(1.0, 1.0, 0.0), (4.0, 0.25, 0.0), (1.0, 2.0, 1.2), (3.0, 0.0, 0.0)]
)
def test_mean_lengths_are_those_of_normal_pairs(uu: float, vv: float, uv: float) -> None:
    pairs = np.random.default_rng(1).multivariate_normal([0.0, 0.0], [[uu, uv], [uv, vv]], 400_000)
    expected = np.linalg.norm(pairs, axis=1).mean()
    found = _mean_length(np.array([uu]), np.array([vv]), np.array([uv]))
    assert found[0] == pytest.approx(expected, rel=0.005)


_DISTORTION = {"k1": -0.5, "p1": 0.001}


def lens_scene(*unknown: str) -> Scene:
    own, calibration = {"distortion": _DISTORTION}, {"shift_px": 10.0, "points": 0.02}
    more = {"unknown": list(unknown)} if unknown else {}
    noise = {"noise_px": 0.1}
    return calibration_scene(cameras=own, detection=noise, calibration=calibration | more)


def solved(case: CalibrationCase, name: str = "refractive_autocal", **parameters: Any) -> Any:
    algorithm: Any = make_algorithm(name, parameters)
    return algorithm.solve(case)


def errors_without(case: CalibrationCase, exact: F64, name: str = "refractive_autocal") -> F64:
    """Errors, px, of a solver that has the case's unknowns, and of one that has none."""
    answers = [solved(one, name) for one in (case, replace(case, unknown=()))]
    return np.array([true_error_px(one.cameras, one.points_mm, exact) for one in answers])


def test_unknown_parameters_are_nominally_zero_and_the_rest_unchanged() -> None:
    case, true, _, _ = case_of(lens_scene("principal_point", "k1"))
    assert case.unknown == ("principal_point", "k1")
    for nominal, camera in zip(case.cameras, true, strict=True):
        assert camera.distortion == Distortion(**_DISTORTION)
        assert nominal.distortion == Distortion(p1=0.001)
        away = np.subtract(nominal.principal_point_px, camera.principal_point_px)
        assert np.hypot(*away) == pytest.approx(10.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["refractive_autocal", "refractive_autocal_alternating"])
def test_solvers_find_what_the_case_calls_unknown(name: str) -> None:
    case, _, _, exact = case_of(lens_scene("principal_point", "k1"))
    errors = errors_without(case, exact, name)
    assert errors[1] > 3.0 * errors[0]
    assert errors[0] < (0.02 if name == "refractive_autocal" else 0.1)


@pytest.mark.slow
def test_the_bound_is_that_of_the_case(tmp_path: Path) -> None:
    bounds: list[Any] = []
    for number, unknown in enumerate(((), ("principal_point", "k1"))):
        data = generate(lens_scene(*unknown), tmp_path / str(number), seed=1, backend="splat")
        assert data.calibration_case().unknown == unknown
        bounds.append(score(data, "truth")["bound_px"])
        if unknown:
            solve("refractive_autocal", data, tmp_path / "result.h5")
            ratio: Any = score(data, tmp_path / "result.h5")["true_ratio"]
            assert 0.8 < ratio < 1.2
    assert bounds[1] > 1.05 * bounds[0]


def test_unknowns_are_counted() -> None:
    assert FreeParameters.from_names(()).per_camera == 7
    free = FreeParameters.from_names(("k1", "principal_point", "k3"))
    assert free == FreeParameters(True, ("k1", "k3"))
    assert free.per_camera == 11


NOISE_PX = 0.1
UNKNOWN = ["tilt", "k1"]


def tilted_scene(unknown: list[str]) -> Scene:
    """Cameras tilted by up to 8 degrees, all but one; nominal tilts are off by half a degree."""
    tilts = [[8.0, 0.0], [0.0, -6.0], [5.0, 5.0], [-4.0, 7.0], [3.0, -8.0], [-7.0, -2.0]]
    tilts += [[2.0, 6.0], [-5.0, 1.0]]
    each = [
        {"camera": f"camera_{n:02d}", "tilt_deg": tilt, "distortion": {"k1": -0.5}}
        for n, tilt in enumerate(tilts)
    ]
    return calibration_scene(
        cameras={"each": each},
        detection={"noise_px": NOISE_PX},
        calibration={"points": 0.02, "tilt_deg": 0.5, "unknown": unknown},
    )


def tilts_of(cameras: tuple[Camera, ...]) -> Any:
    return np.array([camera.tilt_deg for camera in cameras])


def information_of(scene: Scene, free: FreeParameters, seed: int = 1) -> F64:
    """Return the information at the truth."""
    case, cameras, points, exact = case_of(scene, seed)
    seen = board_images(case, np.where(case.found[..., None], exact, np.nan))
    state = WallFrame.from_cameras(cameras, points).state(case.target.points_mm, points)
    return _whole(state, seen, free)


def expected_deg(scene: Scene, free: FreeParameters, seed: int) -> Any:
    """Return the standard deviation of every tilt (M, 2) by the Cramer-Rao bound, degrees."""
    covariance, _, _ = _inverse(information_of(scene, free, seed))
    own, size = list(free.columns(3)[0]), free.per_camera
    rows = [number * size + own.index(column) for number in range(9) for column in (14, 15)]
    return np.rad2deg(NOISE_PX * np.sqrt(np.diagonal(covariance)[rows].reshape(-1, 2)))


def test_the_tilt_is_found_as_well_as_the_noise_allows() -> None:
    scene, ratios = tilted_scene(UNKNOWN), []
    for seed in (1, 2, 3):
        case, true, _, exact = case_of(scene, seed)
        nominal = tilts_of(case.cameras) - tilts_of(true)
        assert nominal.std() > 0.3
        answer = solved(case)
        errors = tilts_of(answer.cameras) - tilts_of(true)
        bound = expected_deg(scene, FreeParameters.from_names(UNKNOWN), seed)
        assert bound.max() < 0.3
        ratios.append(errors / bound)
        assert true_error_px(answer.cameras, answer.points_mm, exact) < 0.03
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.25


def test_a_wrong_tilt_that_is_not_free_costs_accuracy() -> None:
    case, _, _, exact = case_of(tilted_scene(["tilt"]))
    errors = errors_without(case, exact)
    assert errors[1] > 2.0 * errors[0]
    asked = solved(replace(case, unknown=()), tilt=True)
    found = true_error_px(asked.cameras, asked.points_mm, exact)
    assert found == pytest.approx(errors[0], rel=1e-9)


def test_without_distortion_tilt_and_principal_point_are_one() -> None:
    """Both cannot be found; the cameras that are found project as the true ones do."""
    free = FreeParameters.from_names(["tilt", "principal_point"])
    scene = calibration_scene(
        detection={"noise_px": NOISE_PX},
        calibration={"points": 0.02, "unknown": ["tilt", "principal_point"]},
    )
    case, cameras, _, exact = case_of(scene)
    information = information_of(scene, free)
    scale = 1.0 / np.sqrt(np.diagonal(information))
    values = np.linalg.eigvalsh(information * scale * scale[:, None])
    lost = np.sum(values < 1e-10 * values[-1])
    assert lost == 2 * len(cameras) + 3  # and three motions along the wall
    answer = solved(case)
    assert true_error_px(answer.cameras, answer.points_mm, exact) < 0.03


def test_a_linear_calibration_takes_nominal_tilts_for_what_they_are() -> None:
    """In air, without distortion: as for the upright cameras that project alike."""
    each = [{"camera": f"camera_{n:02d}", "tilt_deg": [8.0 - n, 2.0 * n]} for n in range(9)]
    known, noise = {"points": 0.0}, {"noise_px": NOISE_PX}
    scene = calibration_scene(wall=None, cameras={"each": each}, detection=noise, calibration=known)
    case, _, points, exact = case_of(scene)
    upright = tuple(camera.upright() for camera in case.cameras)
    flat = tuple(replace(camera, tilt_deg=(0.0, 0.0)) for camera in case.cameras)
    errors = []
    for cameras in (case.cameras, upright, flat):
        answer = solved(replace(case, cameras=cameras), "linear_autocal")
        errors.append(true_error_px(answer.cameras, points, exact))
    assert errors[0] == pytest.approx(errors[1], rel=1e-6)
    assert errors[0] < 0.2 * errors[2]
