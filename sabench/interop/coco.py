"""Bubbles in camera images in the COCO format, and their masks.

They are one category. Masks are written as uncompressed run lengths down the columns, boxes as
[left, top, width, height] in pixels. Source: https://cocodataset.org/#format-data
"""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sabench.api.truth import Bubbles, Sight
from sabench.dataset.reader import Dataset
from sabench.utils.arrays import I32, Bool
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json
from sabench.utils.progress import progress_bar


def image_names(data: Dataset) -> list[str]:
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
    names = image_names(data)
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
    category = {"id": 1, "name": "bubble", "supercategory": "bubble"}
    values = {"images": images, "annotations": annotations, "categories": [category]}
    (root / "annotations.json").write_text(canonical_json(values), encoding="utf-8")


def _annotations(bubbles: Bubbles, sight: Sight) -> Iterator[dict[str, Any]]:
    """Describe a camera's bubbles; `bubble` is their id in all frames and cameras."""
    for row, box in boxes_of(sight.number).items():
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


def boxes_of(number: I32) -> dict[int, list[int]]:
    """Find the boxes of the bubbles in an image of `Sight`, by their rows."""
    rows = np.unique(number[number >= 0]).tolist()
    return {row: list(cv2.boundingRect((number == row).astype(np.uint8))) for row in rows}


def run_lengths(mask: Bool) -> list[int]:
    """Compute run lengths of a mask, column by column, the first one of zeros."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat, prepend=np.False_)).tolist()
    return [b - a for a, b in itertools.pairwise([0, *changes, len(flat)])]
