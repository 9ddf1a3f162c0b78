"""Scores of detections in images, as COCO defines them but for any number."""

import numpy as np

from sabench.metrics.averages import ratio, root_mean_square
from sabench.utils.arrays import F64, I64, Bool

OVERLAPS = np.linspace(0.5, 0.95, 10)  # least intersection over union of a match
_RECALLS = np.linspace(0.0, 1.0, 101)


def match_detections(confidence: F64, overlap: F64) -> I64:
    """Match the detections (n,) of an image, the most confident ones first.

    `overlap` (n, m) is the intersection over union with true objects, each of which has one match.
    Returns their rows (n, 10) for each of `OVERLAPS`; -1 without a match.
    """
    match = np.full((len(confidence), len(OVERLAPS)), -1)
    taken = np.zeros((len(OVERLAPS), overlap.shape[1]), dtype=np.bool_)
    for row in np.argsort(-confidence, kind="stable") if overlap.size else ():
        left = np.where(taken, -1.0, overlap[row])[:, ::-1]  # of equal ones the last, as in COCO
        best = left.shape[1] - 1 - left.argmax(axis=1)
        hit = np.flatnonzero(left.max(axis=1) >= OVERLAPS)
        match[row, hit] = best[hit]
        taken[hit, best[hit]] = True
    return match


def image_detection_scores(
    confidence: F64, hits: Bool, error_px: F64, true: int
) -> dict[str, float]:
    """Score detections (n,) of all images; NaN where there is nothing to count.

    `hits` (n, 10) says which of them match one of the `true` objects at `OVERLAPS`, and `error_px`
    has the errors of the diameters of those that match at the first of these.
    """
    order = np.argsort(-confidence, kind="stable")
    count, found = len(order), np.cumsum(hits[order], axis=0)
    rising = np.maximum.accumulate((found.T / np.arange(1, count + 1))[:, ::-1], axis=1)
    curves = zip(np.pad(rising[:, ::-1], ((0, 0), (0, 1))), found.T / max(true, 1), strict=True)
    ap = [float(curve[np.searchsorted(recall, _RECALLS)].mean()) for curve, recall in curves]
    limits, matched = np.append(np.inf, confidence[order]), len(error_px)
    f1 = 2.0 * np.append(0, found[:, 0]) / (np.arange(count + 1) + max(true, 1))
    f1[:-1][np.diff(limits) == 0.0] = 0.0  # no limit is between equal ones
    return {
        "ap": float(np.mean(ap)) if true else float("nan"),
        "ap_50": ap[0] if true else float("nan"),
        "precision": ratio(matched, count),
        "recall": ratio(matched, true),
        "f1": ratio(2 * matched, count + true),
        "f1_best": float(f1.max()),
        "confidence_best": float(limits[f1.argmax()]),
        "count_percent": 100.0 * (ratio(count, true) - 1.0),
        "diameter_bias_px": float(error_px.mean()) if matched else float("nan"),
        "diameter_rms_px": root_mean_square(error_px),
    }
