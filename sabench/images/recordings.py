"""Recordings of other people's cameras: folders of images, in any common format."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.images.levels import DEPTHS
from sabench.utils.arrays import U16
from sabench.utils.errors import InputError
from sabench.utils.processes.call import read_isolated
from sabench.utils.progress import progress_bar

FORMATS = (".tif", ".tiff", ".png", ".bmp")
_NUMBER = re.compile(r"\d+(?=\D*$)")  # the last one of a name
_SMALLEST = 16  # px: side of an image
_ALONE = "camera"  # name of a camera whose files do not give it one


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

    Each folder inside it with images is a camera. Of images that lie in the folder itself, those
    whose names differ in the last number alone are one camera's.

    Raises
    ------
    InputError
        No folder there, or no images in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of images, got no folder")
    cameras: dict[str, list[Path]] = {}
    for path in _images_in(folder):
        stem = _NUMBER.sub("", path.stem).strip(" ._-") or _ALONE
        cameras.setdefault(stem, []).append(path)
    for inner in sorted(one for one in folder.iterdir() if one.is_dir()):
        if files := _images_in(inner):
            cameras[inner.name] = files
    if not cameras:
        formats = ", ".join(FORMATS)
        raise InputError(f"{folder}: expected images ({formats}) in it or its folders, got none")
    return cameras


def _images_in(folder: Path) -> list[Path]:
    files = (one for one in folder.iterdir() if one.suffix.lower() in FORMATS and one.is_file())
    return sorted(files, key=_order)


def _order(path: Path) -> tuple[str, int, str]:
    """Sort by a name without its last number, and then by that number."""
    number = _NUMBER.search(path.stem)
    return _NUMBER.sub("", path.stem), int(number.group()) if number else -1, path.name


def read_recordings(folder: Path, most: int, white_dn: float | None = None) -> Iterator[Recording]:
    """Read the first images of every camera of a folder, camera by camera.

    Parameters
    ----------
    most : number of images of each camera.
    white_dn : grey value of a saturated pixel; by default that of the bit depth, which is the least
        of 8, 10, 12, 14 and 16 that all of a camera's grey values fit.

    Raises
    ------
    InputError
        No images, a file that is not an image or shows colours, images of different sizes.
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

    A limited child process reads them, which the libraries may not survive.

    Raises
    ------
    InputError
        A file that is not an image or shows colours, or images of different sizes.
    """
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        size = sum(path.stat().st_size for path in paths)
        read_isolated(_store, paths[0], tuple(paths), most, Path(folder), size_bytes=size)
        files = sorted(Path(folder).glob("*.npy"), key=lambda file: int(file.stem))
        frames = tuple(np.load(file, allow_pickle=False) for file in files)
    _check_sizes(paths[0].parent, frames)
    return frames


def _check_sizes(folder: Path, frames: Sequence[U16]) -> None:
    sizes = Counter(frame.shape for frame in frames)
    if len(sizes) > 1:
        got = " and ".join(f"{n} of {rows} x {columns}" for (rows, columns), n in sizes.items())
        raise InputError(
            f"{folder}: expected images of one size from each camera, got {got} pixels (rows x "
            "columns); put each camera's images into a folder of its own"
        )
    if min(frames[0].shape) < _SMALLEST:
        got = f"{frames[0].shape[0]} x {frames[0].shape[1]}"
        raise InputError(
            f"{folder}: expected images of {_SMALLEST} x {_SMALLEST} pixels or more, got {got}"
        )


def _store(_: Path, paths: Sequence[Path], most: int, folder: Path) -> None:
    """Save the grey values of images as files 0.npy, 1.npy, ..."""
    count = 0
    for path in paths:
        for image in _read_pages(path, most - count):
            np.save(folder / f"{count}.npy", _grey(path, image))
            count += 1


def _read_pages(path: Path, most: int) -> Sequence[Any]:
    import cv2

    try:
        done, pages = cv2.imreadmulti(str(path), 0, most, flags=cv2.IMREAD_UNCHANGED)
    except (cv2.error, MemoryError):  # too many pixels
        done, pages = False, ()
    if not done:
        raise InputError(f"{path}: expected an image, got something else")
    return tuple(pages)


def _grey(path: Path, image: Any) -> U16:
    if image.dtype.kind not in "ui" or image.dtype.itemsize > 2:
        raise InputError(f"{path}: expected 8 or 16 bits a pixel, got {image.dtype}")
    if image.ndim == 3:
        if (image[..., :3] != image[..., :1]).any():
            raise InputError(f"{path}: expected a grey image, got one with colours; convert it")
        image = image[..., 0]
    return np.asarray(image, dtype=np.uint16)
