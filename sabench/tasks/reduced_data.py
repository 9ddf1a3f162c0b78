"""Copies of a data set's observation side with a camera taken out or scrambled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sabench.dataset import schema
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.recorded import RecordedWriter, recorded_writer
from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import U16
from sabench.utils.files import inside, read_json

_SHARE = (0.37, 0.41)  # of an image's rows and columns, by which a scrambled one is shifted


def without_camera(data: Dataset, number: int, frames: int, out: Path) -> Dataset:
    """Copy the first frames of all cameras but one."""
    return _copy(data, [n for n in range(len(data.setup.cameras)) if n != number], frames, out)


def with_scrambled_camera(data: Dataset, number: int, frames: int, out: Path) -> Dataset:
    """Copy the first frames with one camera's images shifted by many pixels.

    They are shifted by .37 of the rows and .41 of the columns, and what leaves the image enters on
    the other side.
    """
    return _copy(data, range(len(data.setup.cameras)), frames, out, scrambled=number)


def scramble_shift(camera: CameraModel) -> tuple[int, int]:
    """Compute the rows and columns by which a camera's images are shifted."""
    return round(_SHARE[0] * camera.rows), round(_SHARE[1] * camera.columns)


def _copy(
    data: Dataset, kept: Any, frames: int, out: Path, scrambled: int | None = None
) -> Dataset:
    setup = data.setup
    keys = read_json(inside(data.root, schema.CAMERAS))
    for name in ("format", "version", "cameras", "wall"):
        keys.pop(name, None)
    keys["frames"] = frames
    if "times_s" in keys:
        keys["times_s"] = keys["times_s"][:frames]
    if levels := keys["sensor"].get("by_camera"):
        keys["sensor"]["by_camera"] = [levels[number] for number in kept]
    with recorded_writer(out, data.root.name) as writer:
        for number in kept:
            camera = setup.cameras[number]
            shift = scramble_shift(camera) if number == scrambled else (0, 0)
            _copy_images(writer, data, number, frames, shift)
        writer.set_cameras([setup.cameras[number] for number in kept], **keys)
    return open_dataset(out)


def _copy_images(
    writer: RecordedWriter, data: Dataset, number: int, frames: int, shift: tuple[int, int]
) -> None:
    name = data.setup.cameras[number].name
    for frame in range(frames):
        image: U16 = np.roll(data.raw_image(number, frame), shift, axis=(0, 1))
        writer.add_image(name, frame, image)
    if data.masked is not None and data.masked[number].any():
        writer.add_mask(name, ~data.masked[number])
