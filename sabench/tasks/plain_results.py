"""Results without HDF5: volumes as `.npy`, or particles as a table of text.

The first bytes of the file say what it is; docs/developing/participate.md says what it holds.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sabench.api import FoundParticles, Reconstruction
from sabench.api.solvers import TaskName
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import result_writer
from sabench.utils.errors import LISTED, InputError, one_line
from sabench.utils.tables import read_table

_HDF5, _NUMPY = b"\x89HDF\r\n\x1a\n", b"\x93NUMPY"
_NEEDED, _POSSIBLE = ("x_mm", "y_mm", "z_mm"), ("frame", "intensity", "track")


def is_plain(path: Path) -> bool:
    """Decide whether a file is there, can be read, and is no HDF5."""
    if path.is_symlink() or not path.is_file() or not os.access(path, os.R_OK):
        return False
    return _begins(path) != _HDF5


def write_plain(path: Path, root: Path, out: Path, name: str) -> None:
    """Write the result `out` of a data set from a program's plain file.

    Raises InputError for a file of another kind or shape, or values that a result cannot hold.
    """
    data = open_dataset(root)
    volumes = _begins(path).startswith(_NUMPY)
    estimates = _volumes(path, data) if volumes else _particles(path, data)
    task: TaskName = "reconstruction" if volumes else "particles"
    with result_writer(out, data, name, task, {}) as writer:
        for frame, estimate in enumerate(estimates):
            writer.add(estimate, frame)


def _begins(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(len(_HDF5))


def _volumes(path: Path, data: Dataset) -> Iterator[Reconstruction]:
    frames, grid = data.setup.frames, data.setup.grid.shape
    try:
        volumes = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise InputError(f"{path}: expected an array in a .npy result: {error}") from error
    if volumes.shape == grid and frames == 1:
        volumes = volumes[None]
    if volumes.shape != (frames, *grid) or volumes.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: expected volumes (frame, z, y, x) of the shape {(frames, *grid)} in a .npy "
            f"result, got {volumes.shape} of {volumes.dtype}"
        )
    for volume in volumes:
        yield Reconstruction(np.ascontiguousarray(volume, dtype=np.float32))


def _particles(path: Path, data: Dataset) -> Iterator[FoundParticles]:
    columns = {key: each.values for key, each in read_table(path, 3).columns().items()}
    if missing := [key for key in _NEEDED if key not in columns]:
        raise InputError(
            f"{path}: expected a result as HDF5, .npy or a table with the columns x_mm, y_mm and "
            f"z_mm, got no {', '.join(missing)}"
        )
    if strange := [key for key in columns if key not in _NEEDED + _POSSIBLE]:
        known, got = ", ".join(_NEEDED + _POSSIBLE), one_line(", ".join(strange), LISTED)
        raise InputError(f"{path}: expected no columns but {known} in a table, got {got}")
    position, frames = np.column_stack([columns[key] for key in _NEEDED]), data.setup.frames
    if frames > 1 and "frame" not in columns:
        raise InputError(f"{path}: expected the column frame in a table of {frames} frames")
    frame = columns.get("frame", np.zeros(len(position)))
    wrong = frame[~np.isin(frame, np.arange(frames))]
    if len(wrong):
        raise InputError(
            f"{path}: frame: expected whole numbers from 0 to {frames - 1} in a table, got "
            f"{wrong[0]:g}"
        )
    intensity, track = columns.get("intensity"), columns.get("track")
    if track is not None and (track != np.rint(track)).any():
        raise InputError(f"{path}: track: expected whole numbers in a table")
    for number in range(frames):
        now = frame == number
        yield FoundParticles(
            position[now],
            None if intensity is None else intensity[now],
            trajectory=None if track is None else track[now].astype(np.int64),
        )
