"""Expected scores: the fitted model, its range, and what it says of scenes."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from benchmarks import planner
from sabench.evaluation.planning.expected_scores import (
    FEATURES,
    MODEL,
    SCORES,
    link,
    load_model,
    quadratic_terms,
    unlink,
)
from sabench.evaluation.planning.plan import plan
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


@pytest.mark.parametrize("score", ["q", "f1", "ghosts"])
def test_links_are_inverted(score: str) -> None:
    values = np.array([0.01, 0.3, 0.99])
    np.testing.assert_allclose(unlink(score, link(score, values)), values, rtol=1e-12)


def test_quadratic_terms_are_all_products() -> None:
    terms = quadratic_terms(np.array([2.0, 3.0]))
    np.testing.assert_array_equal(terms, [1.0, 2.0, 3.0, 4.0, 6.0, 9.0])


def test_the_model_is_what_the_record_gives() -> None:
    made, kept = planner.fit(RECORD), json.loads(MODEL.read_text(encoding="utf-8"))
    assert made["features"] == kept["features"] == list(FEATURES)
    for key, weights in kept["weights"].items():
        np.testing.assert_allclose(made["weights"][key], weights, rtol=1e-3, atol=1e-4)
    for key in ("low", "high", "mean", "scale"):
        np.testing.assert_allclose(made[key], kept[key], rtol=1e-5)


def test_ridge_finds_a_quadratic_function() -> None:
    rng = np.random.default_rng(1)
    terms = quadratic_terms(rng.standard_normal((300, len(FEATURES))))
    true = rng.standard_normal(terms.shape[1])
    np.testing.assert_allclose(planner._ridge(terms, terms @ true), true, atol=1e-3)


@pytest.mark.parametrize("key", ["q_synthetic_aperture", "q_mart"])
def test_scores_change_in_the_right_direction(key: str) -> None:
    model, middle = load_model(), typical()

    def score(**changes: float) -> float:
        return float(model.predict(key, typical(**changes)))

    assert score(cameras=4.0) < score(cameras=9.0)
    assert score(source_density=0.1) > score(source_density=0.8)
    assert 0.0 < model.allowed_error_px(key, middle, 2.0) < 2.0


def test_more_particles_make_more_ghosts() -> None:
    ghosts = [
        float(load_model().predict("ghosts_synthetic_aperture", typical(source_density=density)))
        for density in (0.1, 0.3, 1.0)
    ]
    assert ghosts == sorted(ghosts)


def test_the_model_stops_at_the_edge_of_its_range() -> None:
    model = load_model()
    edge, outside = typical(cameras=float(model.high[0])), typical(cameras=100.0)
    for key in SCORES:
        assert model.predict(key, outside) == model.predict(key, edge)


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


def test_expected_scores_are_those_of_solved_scenes() -> None:
    """Of one scene of each end, which was not fitted, solved anew."""
    number = planner.FITTED
    scene = planner.draw_scene(number)
    figures = planner.figures_of(scene)
    features = RECORD[str(number)]["features"]
    expected = list(planner.model.features_of(figures))
    np.testing.assert_allclose(expected, features, rtol=1e-4, atol=1e-6)


def test_the_errors_on_scenes_that_were_not_fitted_are_as_documented() -> None:
    model = load_model()
    others = [one for number, one in RECORD.items() if int(number) >= planner.FITTED]
    assert len(others) == 20
    features = np.array([one["features"] for one in others])
    for key, most in (("q_synthetic_aperture", 0.04), ("q_mart", 0.05)):
        measured = [one["scores"][SCORES[key].solver]["q"] for one in others]
        error = model.predict(key, features) - np.array(measured)
        assert np.sqrt(np.mean(error**2)) < most
