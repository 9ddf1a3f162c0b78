"""Recordings in folders of image files, in the formats that laboratories use."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.images.image_files import camera_name, last_number_order
from sabench.images.image_reading import read_pages
from sabench.images.levels import DEPTHS
from sabench.utils.arrays import U16
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

FORMATS = (".tif", ".tiff", ".png", ".bmp")
_SMALLEST = 16  # px: side of an image


@dataclass(frozen=True)
class Recording:
    """Images that one camera took one after the other.

    Attributes
    ----------
    name : of the camera: that of its folder, or what its files' names have in common.
    frames : (row, column) grey values of each.
    white_dn : largest grey value of the bit depth.
    """

    name: str
    frames: tuple[U16, ...]
    white_dn: float


def list_cameras(folder: Path) -> dict[str, list[Path]]:
    """List the image files of each camera in a folder, in the order of their numbers.

    Each folder inside it with images is a camera. Of images in the folder itself, those whose names
    differ in the last number alone are one camera's. No folder or no images is an InputError.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of images, got no folder")
    cameras: dict[str, list[Path]] = {}
    for path in _images_in(folder):
        cameras.setdefault(camera_name(path), []).append(path)
    for inner in sorted(path for path in folder.iterdir() if path.is_dir()):
        if files := _images_in(inner):
            cameras[inner.name] = files
    if not cameras:
        formats = ", ".join(FORMATS)
        raise InputError(f"{folder}: expected images ({formats}) in it or its folders, got none")
    return cameras


def _images_in(folder: Path) -> list[Path]:
    images = (path for path in folder.iterdir() if path.suffix.lower() in FORMATS)
    return sorted((path for path in images if path.is_file()), key=last_number_order)


def read_recordings(folder: Path, most: int, white_dn: float | None = None) -> Iterator[Recording]:
    """Read the first images of every camera of a folder, camera by camera.

    Faults are as in `read_frames`.

    Parameters
    ----------
    most : number of images of each camera.
    white_dn : grey value of a saturated pixel; by default that of the least bit depth of 8, 10, 12,
        14 and 16 that all of a camera's grey values fit.
    """
    for name, paths in progress_bar(list(list_cameras(folder).items()), "measure recordings"):
        frames = read_frames(paths[:most], most)
        yield Recording(name, frames, white_dn or guess_white(frames))


def guess_white(frames: Sequence[U16]) -> float:
    """Return the largest grey value of the least bit depth that holds all values.

    Values that are all multiples of 4, 16 or 64 fill the upper bits of 16.
    """
    highest = max(int(frame.max()) for frame in frames)
    step = int(np.bitwise_or.reduce([np.bitwise_or.reduce(one, axis=None) for one in frames]))
    low_bits = (step & -step).bit_length() - 1 if step else 0
    if highest >= 1 << 12 and low_bits in (2, 4, 6, 8):
        return float((1 << 16) - (1 << low_bits))
    return float(next((1 << depth) - 1 for depth in DEPTHS if highest < 1 << depth))


def read_frames(paths: Sequence[Path], most: int) -> tuple[U16, ...]:
    """Read up to so many grey images (row, column) of one size.

    A file may hold several.

    Other files, colours and different sizes are InputErrors.
    """
    folder = paths[0].parent
    frames = tuple(image for _, image in itertools.islice(read_pages(paths, 0, most), most))
    sizes = Counter(frame.shape for frame in frames)
    if len(sizes) > 1:
        got = " and ".join(f"{n} of {rows} x {columns}" for (rows, columns), n in sizes.items())
        raise InputError(
            f"{folder}: expected images of one size from each camera, got {got} pixels (rows x "
            "columns); put each camera's images into a folder of its own"
        )
    rows, columns = frames[0].shape
    if min(rows, columns) < _SMALLEST:
        raise InputError(
            f"{folder}: expected images of {_SMALLEST} x {_SMALLEST} pixels or more, got "
            f"{rows} x {columns}"
        )
    return frames
