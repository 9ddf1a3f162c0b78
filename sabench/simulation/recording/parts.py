"""What has been recorded of a data set so far: a file of truth for each frame, and for each camera of it one more beside its pictures.

Each appears whole or not at all, so that whoever writes them may be killed at any time, and what is
there need not be made again.
"""

from __future__ import annotations

import json
import os
import threading
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.dataset import schema
from sabench.images.tiff_exr import write_exr, write_tiff
from sabench.utils.arrays import F32, U16
from sabench.utils.errors import InputError
from sabench.utils.files import sha256

Part = dict[
    str, npt.NDArray[Any]
]  # arrays by their names in the file of truth; those in `KEPT` serve the recording only
Recall = Callable[[int], Part]  # a frame's part
KEPT = "kept/"
_FILES = f"{KEPT}files"


@dataclass(frozen=True)
class Taken:
    """What one camera records of a frame: its part of the truth, grey values and radiance."""

    truth: Part
    grey: U16
    radiance: F32


class Parts:
    """The parts of one data set in a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def has_frame(self, frame: int) -> bool:
        """Whether a frame's part is there and whole."""
        return _load(self._frame(frame)) is not None

    def frame(self, frame: int) -> Part:
        """A frame's part; InputError if it is not there."""
        return _needed(self._frame(frame))

    def put_frame(self, frame: int, part: Part) -> None:
        """Keep a frame's part."""
        self._check()
        _save(self._frame(frame), part)

    def has_view(self, frame: int, camera: str) -> bool:
        """Whether a camera's part of a frame is there and whole, its pictures bit by bit."""
        part = _load(self._view(frame, camera))
        if part is None or _FILES not in part:
            return False
        return all(
            (self.root / name).is_file() and sha256(self.root / name) == entry.sha256
            for name, entry in files_of(part).items()
        )

    def view(self, frame: int, camera: str) -> Part:
        """A camera's part of a frame; InputError if it is not there."""
        return _needed(self._view(frame, camera))

    def put_view(self, frame: int, camera: str, taken: Taken) -> None:
        """Keep a camera's part of a frame; it is there when its last file, that of the truth, is."""
        self._check()
        files = {}
        for suffix, write in {
            "tif": lambda path: write_tiff(path, taken.grey),
            "exr": lambda path: write_exr(path, taken.radiance),
        }.items():
            name = schema.image_name(camera, frame, suffix)
            _replace(self.root / name, write)
            files[name] = schema.FileEntry(
                bytes=(self.root / name).stat().st_size, sha256=sha256(self.root / name)
            ).model_dump()
        _save(
            self._view(frame, camera),
            taken.truth | {_FILES: np.frombuffer(json.dumps(files).encode(), dtype=np.uint8)},
        )

    def _check(self) -> None:
        """Nothing is written for a data set that is complete, as by a process whose scheduler was killed and started again."""
        if not self.root.is_dir():
            raise InputError(f"{self.root}: expected a data set that is being made, but it is gone")

    def empty(self) -> bool:
        """Whether no camera has recorded anything."""
        return not any(self.root.glob("views/*.npz"))

    def _frame(self, frame: int) -> Path:
        return self.root / "frames" / f"{frame:04d}.npz"

    def _view(self, frame: int, camera: str) -> Path:
        return self.root / "views" / f"{frame:04d}-{camera}.npz"


def files_of(part: Part) -> dict[str, schema.FileEntry]:
    """The pictures of a camera's part: their paths in the data set, sizes and checksums."""
    return {
        name: schema.FileEntry(**entry)
        for name, entry in json.loads(part[_FILES].tobytes()).items()
    }


def _needed(path: Path) -> Part:
    part = _load(path)
    if part is None:
        raise InputError(
            f"{path}: expected a whole part of a data set that is being made, found none"
        )
    return part


def _load(path: Path) -> Part | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return {
                name: arrays[name] for name in arrays.files
            }  # the archive's checksums are tested here
    except (OSError, EOFError, ValueError, zipfile.BadZipFile):
        return None


def _save(path: Path, part: Part) -> None:
    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez(file, allow_pickle=False, **part)

    _replace(path, write)


def _replace(path: Path, write: Callable[[Path], None]) -> None:
    """Write beside a file, then put it in its place; two who write the same at once do not disturb each other."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{os.getpid()}-{threading.get_ident()}-{path.name}")
    try:
        write(partial)
        partial.replace(path)
    except OSError as error:
        if error.errno and not error.filename:  # a refused write does not say where
            error.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)
