"""Images of other people's cameras, in any common format."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sabench.utils.arrays import U16
from sabench.utils.errors import InputError
from sabench.utils.processes.call import read_isolated


def read_photographs(paths: Sequence[Path], shape: tuple[int, int]) -> list[U16]:
    """Read the grey values (rows, columns) of images of that shape.

    A limited child process reads them, which the libraries may not survive.

    Raises
    ------
    InputError
        A file that is not an image, one of another shape, or one that takes too much memory.
    """
    if not paths:
        return []
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        size = sum(path.stat().st_size for path in paths)
        others = tuple(paths)
        read_isolated(_store, paths[0], others, shape, Path(folder), size_bytes=size)
        return [
            np.load(Path(folder) / f"{number}.npy", allow_pickle=False)
            for number in range(len(paths))
        ]


def _store(_: Path, paths: Sequence[Path], shape: tuple[int, int], folder: Path) -> None:
    import cv2

    for number, path in enumerate(paths):
        try:
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        except (cv2.error, MemoryError):  # too many pixels
            image = None
        if image is None:
            raise InputError(f"{path}: expected an image, got something else")
        if image.shape != shape:
            got = f"{image.shape[0]} x {image.shape[1]}"
            raise InputError(
                f"{path}: expected {shape[0]} x {shape[1]} pixels (rows x columns), got {got}"
            )
        if image.dtype.kind not in "ui" or image.dtype.itemsize > 2:
            raise InputError(f"{path}: expected 8 or 16 bits a pixel, got {image.dtype}")
        np.save(folder / f"{number}.npy", np.asarray(image, dtype=np.uint16))
