"""Unmeasured principal points and distortion.

Their nominal values, their estimates, and their part of the Cramer-Rao bound.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.geometry.lens import Distortion
from sabench.plugins import load
from sabench.scenes import Scene
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from tests.helpers.calibration_cases import calibration_scene, case_of, true_error_px

_DISTORTION = {"k1": -0.5, "p1": 0.001}


def lens_scene(unknown: list[str] | None) -> Scene:
    values = calibration_scene().to_dict()
    return calibration_scene(
        cameras=values["cameras"] | {"distortion": _DISTORTION},
        detection={"noise_px": 0.1},
        calibration={"shift_px": 10.0, "points": 0.02}
        | ({} if unknown is None else {"unknown": unknown}),
    )


def test_unknown_parameters_are_nominally_zero_and_the_rest_unchanged() -> None:
    case, true, _, _ = case_of(lens_scene(["principal_point", "k1"]))
    assert case.unknown == ("principal_point", "k1")
    for nominal, camera in zip(case.cameras, true, strict=True):
        assert camera.distortion == Distortion(**_DISTORTION)
        assert nominal.distortion == Distortion(p1=0.001)
        away = np.subtract(nominal.principal_point_px, camera.principal_point_px)
        assert np.hypot(*away) == pytest.approx(10.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["refractive_autocal", "refractive_autocal_alternating"])
def test_solvers_find_what_the_case_calls_unknown(name: str) -> None:
    case, _, _, exact = case_of(lens_scene(["principal_point", "k1"]))
    plugin = load("solvers", name)
    errors = []
    for own in (case, replace(case, unknown=())):
        answer = plugin(plugin.Parameters()).solve(own)
        errors.append(true_error_px(answer.cameras, answer.points_mm, exact))
    assert errors[1] > 3.0 * errors[0]
    assert errors[0] < (0.02 if name == "refractive_autocal" else 0.1)


def test_the_bound_is_that_of_the_case(tmp_path: Path) -> None:
    bounds = []
    for number, unknown in enumerate((None, ["principal_point", "k1"])):
        data = generate(lens_scene(unknown), tmp_path / str(number), seed=1, backend="splat")
        assert data.calibration_case().unknown == tuple(unknown or ())
        scores = score(data, "truth")
        bounds.append(scores["bound_px"])
        if unknown:
            solve("refractive_autocal", data, tmp_path / "result.h5")
            ratio = score(data, tmp_path / "result.h5")["true_ratio"]
            assert ratio is not None
            assert 0.8 < ratio < 1.2
    assert bounds[0] is not None
    assert bounds[1] is not None
    assert bounds[1] > 1.05 * bounds[0]


def test_unknowns_are_counted() -> None:
    assert FreeParameters.from_names(()).per_camera == 7
    assert FreeParameters.from_names(("k1", "principal_point", "k3")) == FreeParameters(
        True, ("k1", "k3")
    )
    assert FreeParameters.from_names(("k1", "principal_point", "k3")).per_camera == 11
