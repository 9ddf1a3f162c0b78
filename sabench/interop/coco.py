"""Bubbles in the COCO format: boxes and masks of what each camera sees.

https://cocodataset.org/#format-data: one category, masks as uncompressed run lengths down the
columns, boxes [left, top, width, height] in pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sabench.api.truth import Bubbles, Sight
from sabench.dataset.reader import Dataset
from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F64, U8, Bool
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json
from sabench.utils.progress import progress_bar

_CATEGORY = {"id": 1, "name": "bubble", "supercategory": "bubble"}


def write(root: Path, data: Dataset) -> None:
    """Write images of 8 bits and `annotations.json` into a folder.

    Raises InputError for a data set that shows no bubbles.
    """
    if "bubbles" not in data.shows:
        raise InputError(f"{data.root}: expected a data set with bubbles for coco, got none")
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    (root / "images").mkdir()
    for frame in progress_bar(range(data.setup.frames), "export"):
        bubbles = data.bubbles(frame)
        seen = data.observation(frame)
        for camera, image in zip(data.setup.cameras, seen.images, strict=True):
            entry = _image(len(images) + 1, frame, camera)
            light = (image - seen.black_dn) / (seen.white_dn - seen.black_dn)
            (root / entry["file_name"]).write_bytes(_png(light))
            images.append(entry)
            for one in _annotations(bubbles, data.sight(frame, camera)):
                own = {"id": len(annotations) + 1, "image_id": entry["id"]}
                annotations.append(own | one)
    values = {"images": images, "annotations": annotations, "categories": [_CATEGORY]}
    (root / "annotations.json").write_text(canonical_json(values), encoding="utf-8")


def _image(number: int, frame: int, camera: CameraModel) -> dict[str, Any]:
    name = f"images/frame_{frame:04d}-{camera.name}.png"
    return {"id": number, "file_name": name, "height": camera.rows, "width": camera.columns}


def _png(light: F64) -> bytes:
    grey: U8 = np.rint(255.0 * np.clip(light, 0.0, 1.0)).astype(np.uint8)
    return bytes(cv2.imencode(".png", grey)[1].tobytes())


def _annotations(bubbles: Bubbles, sight: Sight) -> Iterator[dict[str, Any]]:
    """Describe the bubbles that a camera sees.

    `bubble` is their id in all frames and cameras.
    """
    for row, identity in enumerate(bubbles.id.tolist()):
        mask = sight.number == row
        if mask.any():
            yield {
                "category_id": 1,
                "iscrowd": 0,
                "area": int(mask.sum()),
                "bbox": _box(mask),
                "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
                "bubble": identity,
                "visible": float(sight.visible[row]),
            }


def run_lengths(mask: Bool) -> list[int]:
    """Compute run lengths of a mask, column by column, the first one of zeros."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat.astype(np.int8))) + 1
    lengths: list[int] = np.diff([0, *changes.tolist(), len(flat)]).tolist()
    return [0, *lengths] if flat[0] else lengths


def _box(mask: Bool) -> list[int]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    return [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1]
