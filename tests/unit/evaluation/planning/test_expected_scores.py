"""Expected scores: the fitted model, its range, and what it says of scenes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import planner
from sabench.apps.planning.expected_scores import (
    FEATURES,
    MODEL,
    SCORES,
    GaussianProcess,
    Kernel,
    features_of,
    load_model,
)
from sabench.apps.planning.plan import plan
from sabench.evaluation.suite_loading import override
from sabench.scenes import load_scene
from sabench.utils.arrays import F64

RECORD = json.loads(planner.RECORD.read_text(encoding="utf-8"))


def typical(**changes: float) -> F64:
    """Features in the middle of the fitted range, with some of them changed."""
    features = np.median([one["features"] for one in RECORD.values()], axis=0)
    for name, value in changes.items():
        features[list(FEATURES).index(name)] = value
    return np.asarray(features)


def test_the_model_holds_the_scenes_of_the_record() -> None:
    kept = json.loads(MODEL.read_text(encoding="utf-8"))
    fitted = [one for number, one in RECORD.items() if int(number) not in planner.NOT_FITTED]
    assert kept["names"] == list(FEATURES)
    assert kept["features"] == [one["features"] for one in fitted]
    for key in ("q_mart", "ghosts_synthetic_aperture"):
        measured = planner._scores(fitted, SCORES[key])
        np.testing.assert_allclose(kept["scores"][key], measured, rtol=0.0, atol=6e-6)


def test_ghosts_of_draws_have_a_geometric_mean() -> None:
    """One draw of many times as many ghosts does not count for all others."""
    scene = {"scores": {"msa": {"ghosts": [9.0, 99.0], "q": [0.7, 0.8]}}}
    ghosts, q = (
        planner._scores([scene], SCORES[f"{name}_synthetic_aperture"]) for name in ("ghosts", "q")
    )
    assert ghosts[0] == pytest.approx(math.sqrt(0.1 * 1.0) - 0.01)
    assert q[0] == pytest.approx(0.75)


def test_a_process_without_noise_goes_through_its_points() -> None:
    process = smooth_process(count=16)  # of more, the kernel has no inverse in double precision
    value, error = process.predict(process.points)
    np.testing.assert_allclose(value, process.values, atol=1e-4)
    assert (error < 1e-3).all()
    between, _ = process.predict(np.array([[0.33, -0.41]]))
    assert between[0] == pytest.approx(np.sin(0.33) - 0.41, abs=0.01)
    _, far = process.predict(np.array([[30.0, 0.0]]))
    assert far[0] > 0.5


def test_values_left_out_are_those_of_a_process_without_them() -> None:
    process = smooth_process(noise=0.1)
    without = GaussianProcess(process.points[1:], process.values[1:], process.kernel)
    shift = process.values.mean() - without.values.mean()  # means are of the values that are left
    expected, _ = without.predict(process.points[:1])
    assert process.left_out()[0] == pytest.approx(expected[0], abs=0.1 * abs(shift) + 0.01)


def smooth_process(noise: float = 0.0, count: int = 60) -> GaussianProcess:
    """Make a process of sin x + y at random points."""
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (count, 2))
    kernel = Kernel(np.array([1.5, 3.0]), 1.0, 1.0, noise)
    return GaussianProcess(points, np.sin(points[:, 0]) + points[:, 1], kernel)


@pytest.mark.slow
def test_the_fit_finds_the_likeliest_lengths() -> None:
    process = load_model().processes["q_mart"]
    started = replace(process, kernel=planner._as_kernel(planner._START))
    assert process.surprise() < started.surprise()


@pytest.mark.slow
@pytest.mark.parametrize("key", ["q_synthetic_aperture", "q_mart"])
def test_scores_change_in_the_right_direction(key: str) -> None:
    model, middle = load_model(), typical()

    def score(**changes: float) -> float:
        return float(model.predict(key, typical(**changes)[None])[0][0])

    assert score(cameras=4.0) < score(cameras=9.0)
    assert score(source_density=0.1) > score(source_density=0.8)
    assert 0.0 < model.allowed_error_px(key, middle, 2.0) < 2.0


def test_the_model_stops_at_the_edge_of_its_range() -> None:
    model = load_model()
    edge, outside = typical(cameras=float(model.high[0])), typical(cameras=100.0)
    for key in SCORES:
        assert model.predict(key, outside[None]) == model.predict(key, edge[None])


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"cameras.layout.columns": 8, "cameras.layout.rows": 8}, "cameras.layout"),
        ({"grid.voxel_mm": [0.05, 0.05, 0.5]}, "grid.voxel_mm"),
        ({"particles.per_pixel": 0.001}, "particles.per_pixel"),
        ({"calibration": {"shift_px": 3.0}}, "calibration"),
    ],
)
def test_a_plan_outside_the_range_says_so_and_by_how_much(
    changes: dict[str, Any], key: str
) -> None:
    scene = override(load_scene("standard-particles"), changes, "standard-particles")
    sentences = [
        one.sentence
        for one in plan(scene).advice
        if one.key == key and "measured scenes" in one.sentence
    ]
    assert sentences
    assert " times the " in sentences[0]


def test_the_record_is_of_the_scenes_that_the_benchmark_draws() -> None:
    number = planner.NOT_FITTED[0]
    scene = planner.draw_scene(number)
    figures = planner.figures_of(scene)
    features = RECORD[str(number)]["features"]
    expected = list(features_of(figures))
    np.testing.assert_allclose(expected, features, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_the_errors_on_scenes_that_were_not_fitted_are_as_documented() -> None:
    model = load_model()
    others = [RECORD[str(number)] for number in planner.TESTED]
    features = np.array([one["features"] for one in others])
    for key, most in (("q_synthetic_aperture", 0.025), ("q_mart", 0.025)):
        error = model.predict(key, features)[0] - planner._scores(others, SCORES[key])
        assert np.sqrt(np.mean(error**2)) < most
