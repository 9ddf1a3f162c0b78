"""Bubbles in camera images, and scores of their detections, in the COCO format.

They are one category. Masks are written as uncompressed run lengths down the columns, boxes as
[left, top, width, height] in pixels. Source: https://cocodataset.org/#format-data
"""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from pydantic import BaseModel, NonNegativeFloat, RootModel
from skimage.draw import polygon

from sabench.api.truth import Bubbles, Sight
from sabench.dataset.reader import Dataset, open_dataset
from sabench.metrics.averages import finite_or_none
from sabench.metrics.image_detection import image_detection_scores, match_detections
from sabench.utils.arrays import F64, I32, I64, Bool
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, read_json
from sabench.utils.progress import progress_bar
from sabench.utils.validation import printable, validate

_CATEGORY = {"id": 1, "name": "bubble", "supercategory": "bubble"}


def _names(data: Dataset) -> list[str]:
    """Name the images, frame by frame; their ids count from 1."""
    if "bubbles" not in data.shows:
        raise InputError(f"{data.root}: expected a data set with bubbles for coco, got none")
    places = itertools.product(range(data.setup.frames), data.setup.cameras)
    return [f"frame_{frame:04d}-{camera.name}" for frame, camera in places]


def write(root: Path, data: Dataset) -> None:
    """Write images of 8 bits and `annotations.json` into a folder.

    Raises InputError for a data set that shows no bubbles.
    """
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    names = _names(data)
    (root / "images").mkdir()
    for frame in progress_bar(range(data.setup.frames), "export"):
        bubbles = data.bubbles(frame)
        observation = data.observation(frame)
        for camera, image in zip(data.setup.cameras, observation.images, strict=True):
            name = f"images/{names[len(images)]}.png"
            light = (image - observation.black_dn) / (observation.white_dn - observation.black_dn)
            grey = np.rint(255.0 * np.clip(light, 0.0, 1.0)).astype(np.uint8)
            (root / name).write_bytes(cv2.imencode(".png", grey)[1].tobytes())
            size = {"height": camera.rows, "width": camera.columns}
            images.append({"id": len(images) + 1, "file_name": name} | size)
            for one in _annotations(bubbles, data.sight(frame, camera)):
                annotations.append({"id": len(annotations) + 1, "image_id": len(images)} | one)
    values = {"images": images, "annotations": annotations, "categories": [_CATEGORY]}
    (root / "annotations.json").write_text(canonical_json(values), encoding="utf-8")


def _annotations(bubbles: Bubbles, sight: Sight) -> Iterator[dict[str, Any]]:
    """Describe a camera's bubbles; `bubble` is their id in all frames and cameras."""
    for row, box in _boxes(sight.number).items():
        mask = sight.number == row
        yield {
            "category_id": 1,
            "iscrowd": 0,
            "area": int(mask.sum()),
            "bbox": box,
            "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
            "bubble": int(bubbles.id[row]),
            "visible": float(sight.visible[row]),
        }


def _boxes(number: I32) -> dict[int, list[int]]:
    """Find the boxes of the bubbles in an image of `Sight`, by their rows."""
    rows = np.unique(number[number >= 0]).tolist()
    return {row: list(cv2.boundingRect((number == row).astype(np.uint8))) for row in rows}


def run_lengths(mask: Bool) -> list[int]:
    """Compute run lengths of a mask, column by column, the first one of zeros."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat, prepend=np.False_)).tolist()
    return [b - a for a, b in itertools.pairwise([0, *changes, len(flat)])]


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
    names, path = _names(data), Path(detections)
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
    both = boxes, list(_boxes(number).values())
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
