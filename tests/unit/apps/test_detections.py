"""Scores of detections in images against those of pycocotools."""

import numpy as np
import pytest

from sabench.apps.detections import image_detection_scores, match_detections


def test_precision_and_recall_are_those_of_pycocotools() -> None:
    rng, parts = np.random.default_rng(5), []
    for n, m in ((30, 40), (0, 7), (25, 0), (50, 35)):  # with ties of both
        confidence, overlap = np.round(rng.random(n), 1), np.round(rng.random((n, m)), 2)
        parts.append((confidence, match_detections(confidence, overlap) >= 0))
    confidence, hits = map(np.concatenate, zip(*parts, strict=True))
    scores = image_detection_scores(confidence, hits, np.array([3.0, -4.0]), 82)
    # COCOeval of pycocotools 2.0.11 with these overlaps as its own, and maxDets of 1000
    figures = scores["ap"], scores["ap_50"], hits[:, 0].sum() / 82
    assert figures == pytest.approx((0.6210598890080208, 0.655770170380316, 65 / 82), abs=1e-9)
    assert (scores["diameter_bias_px"], scores["diameter_rms_px"]) == (-0.5, 12.5**0.5)
    kept = [hits[confidence >= limit, 0] for limit in confidence]
    best = max(2.0 * some.sum() / (len(some) + 82) for some in kept)
    assert scores["f1_best"] == pytest.approx(best)
