"""Scores of bubbles detected in camera images, as COCO defines them.

There may be any number of detections in an image.

Source: https://cocodataset.org/#detection-eval
"""

import itertools
import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, NonNegativeFloat, RootModel
from skimage.draw import polygon

from sabench.dataset.reader import Dataset, open_dataset
from sabench.interop.coco import boxes_of, image_names
from sabench.metrics.averages import finite_or_none, ratio, root_mean_square
from sabench.utils.arrays import F64, I32, I64, Bool
from sabench.utils.errors import InputError
from sabench.utils.files import read_json
from sabench.utils.progress import progress_bar
from sabench.utils.validation import printable, validate

OVERLAPS = np.linspace(0.5, 0.95, 10)  # least intersection over union of a match


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
    wanted = np.linspace(0.0, 1.0, 101)
    ap = [float(curve[np.searchsorted(recall, wanted)].mean()) for curve, recall in curves]
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


class _Detection(BaseModel, allow_inf_nan=False):
    image_id: int | str
    category_id: Literal[1]
    score: float
    bbox: tuple[float, float, NonNegativeFloat, NonNegativeFloat] | None = None
    segmentation: Any = None


_Detections = RootModel[list[_Detection]]


def score_detections(dataset: Dataset | str | Path, detections: str | Path) -> dict[str, Any]:
    """Score bubbles detected in camera images; None where there is no value.

    The file is one of COCO's results: image_id (as in `annotations.json`, or the image's name
    without .png), category_id, score, and a segmentation (polygons or run lengths) or, if no
    detection has one, a bbox.

    Raises InputError for a data set without true bubbles, or a file that is broken or not of it.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    names, path = image_names(data), Path(detections)
    found = validate(_Detections, read_json(path), str(path)).root
    key = "segmentation" if any(one.segmentation is not None for one in found) else "bbox"
    rows = {key: row for row, name in enumerate(names) for key in (row + 1, name)}
    by_image: list[list[_Detection]] = [[] for _ in names]
    for number, one in enumerate(found):
        if one.image_id not in rows or getattr(one, key) is None:
            raise InputError(
                f"{path}: {number}: expected a {key} and an image_id of 1 to {len(names)}, or "
                f"{names[0]} to {names[-1]}, of {data.root}, got "
                f"{printable(repr(one.model_dump(include={'image_id', key})))}"
            )
        by_image[rows[one.image_id]].append(one)
    places = itertools.product(range(data.setup.frames), data.setup.cameras)
    parts, true = [], 0
    for name, place, own in zip(names, places, progress_bar(by_image, "score"), strict=True):
        image, shapes = data.sight(*place).number, [getattr(one, key) for one in own]
        if key == "bbox":
            overlap, found_px, true_px = _compare_boxes(shapes, image)
        else:
            masks = [mask_pixels(f"{path}: {name}", shape, *image.shape) for shape in shapes]
            overlap, found_px, true_px = _compare_masks(masks, image)
        confidence = np.array([one.score for one in own])
        match = match_detections(confidence, overlap)
        hit = match[:, 0] >= 0
        parts.append((confidence, match >= 0, found_px[hit] - true_px[match[hit, 0]]))
        true += len(true_px)
    confidence, hits, error_px = map(np.concatenate, zip(*parts, strict=True))
    figures = image_detection_scores(confidence, hits, error_px, true)
    return {"compared": key} | {name: finite_or_none(value) for name, value in figures.items()}


def _compare_boxes(boxes: list[Any], number: I32) -> tuple[F64, F64, F64]:
    """Compute overlaps (n, m), and diameters of ellipses in found and true boxes."""
    both = boxes, list(boxes_of(number).values())
    found, true = (np.array(part, np.float64).reshape(-1, 2, 2) for part in both)
    low = np.maximum(found[:, None, 0], true[:, 0])
    high = np.minimum(found.sum(axis=1)[:, None], true.sum(axis=1))
    shared = np.maximum(high - low, 0.0).prod(axis=2)
    area, true_area = found[:, 1].prod(axis=1), true[:, 1].prod(axis=1)
    return shared / (area[:, None] + true_area - shared), np.sqrt(area), np.sqrt(true_area)


def _compare_masks(masks: list[I64], number: I32) -> tuple[F64, F64, F64]:
    """Compute the same of masks, each its pixels, and circles of their areas."""
    label = np.maximum(number.ravel(order="F"), -1) + 1
    parts = (label, *(label[mask] for mask in masks))
    counts = np.stack([np.bincount(part, minlength=label.max() + 1)[1:] for part in parts])
    true, shared = counts[0, counts[0] > 0], counts[1:, counts[0] > 0]
    area = np.array([len(mask) for mask in masks], np.float64)
    overlap = shared / (area[:, None] + true - shared)
    return overlap, np.sqrt(4.0 / np.pi * area), np.sqrt(4.0 / np.pi * true)


def mask_pixels(where: str, shape: Any, rows: int, columns: int) -> I64:
    """List a mask's pixels down the columns; the first one's middle is 0.5, 0.5."""
    try:
        if isinstance(shape, list):
            corners = [np.reshape(one, (-1, 2)).astype(np.float64) - 0.5 for one in shape]
            parts = [polygon(one[:, 1], one[:, 0], (rows, columns)) for one in corners]
            return np.unique(np.concatenate([column * rows + row for row, column in parts]))
        counts = shape["counts"]
        lengths = _decode(counts) if isinstance(counts, str) else np.array(counts, np.int64)
        ends = np.cumsum(lengths)
        if (*shape["size"], ends[-1]) != (rows, columns, rows * columns) or min(lengths) < 0:
            raise ValueError("size")
        return np.concatenate([ends[:0], *map(np.arange, ends[:-1:2], ends[1::2])])
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{where}: segmentation: expected polygons, or size and counts of {rows} x {columns} "
            f"pixels, got {printable(repr(shape))}"
        ) from error


def _decode(text: str) -> I64:
    """Decode run lengths, 5 bits in a character, as differences to the last but one."""
    words = [[ord(mark) - 48 for mark in word] for word in re.findall("[P-o]*[0-O]", text)]
    lengths = np.array([sum((bits & 31) << 5 * i for i, bits in enumerate(word)) for word in words])
    lengths -= [(word[-1] >> 4 & 1) << 5 * len(word) for word in words]
    lengths[1::2], lengths[2::2] = np.cumsum(lengths[1::2]), np.cumsum(lengths[2::2])
    return lengths
