"""Results of MyPTV: particles, trajectories, smoothed trajectories and blobs.

Columns, apart by tabs: of particles x y z, a blob of each camera (-1: none), error, frame; of
trajectories the same behind the number (-1: none); of smoothed ones number, x y z, velocity,
acceleration (both per frame), frame; of blobs column, row, size along both, area, frame. Newer
versions keep the same columns in the data set `dataset` of an HDF5 file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.geometry.camera_model import CameraModel
from sabench.interop.foreign_world import note, unit_mm
from sabench.interop.tracks.track_table import Recording, TrackTable, number_strangers
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.tables import read_table

LOST = (
    "intensities of particles",
    "light of each camera, covariances and probabilities",
    "sizes of blobs (they are 3 x 3 pixels)",
)
_NAMES = ("smoothed_trajectories", "trajectories", "particles")
_SMOOTHED = 11  # columns
_SIDE = 3.0  # of blobs, whose size is not known


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read particles, trajectories or smoothed trajectories of a file or folder.

    Raises
    ------
    InputError
        No such file, or a broken one; velocities without the time between frames.
    """
    file = _file(path)
    values = _values(file)
    factor = 1.0 if unit is None else unit_mm(unit)
    frame = _whole(file, values[:, -1], "frame")
    if not _is_whole(values[:, 0]):
        note(f"{file}: its particles have no trajectories")
        return TrackTable(frame, values[:, :3] * factor).sorted()
    number = number_strangers(values[:, 0].astype(np.int64))
    rates: dict[str, F64] = {}
    if _is_smoothed(values):
        if interval_s is None:
            raise InputError(f"{file}: velocities are per frame: give the time between frames")
        rates["velocity_mm_s"] = values[:, 4:7] * factor / interval_s
        rates["acceleration_mm_s2"] = values[:, 7:10] * factor / interval_s**2
    return TrackTable(frame, values[:, 1:4] * factor, number, **rates).sorted()


def _file(path: Path) -> Path:
    names = [name + ending for name in _NAMES for ending in ("", ".txt", ".hdf5")]
    file = next((path / name for name in names if (path / name).is_file()), path)
    if not file.is_file():
        raise InputError(
            f"{path}: expected a file smoothed_trajectories, trajectories or particles, found none"
        )
    return file


def _values(file: Path) -> F64:
    if h5py.is_hdf5(file):
        with open_hdf5(file) as opened:
            values = read_array(opened, "dataset", (None, None), "fiu").astype(np.float64)
        if values.shape[1] < 5 or not np.isfinite(values).all():
            raise InputError(f"{file}: dataset: expected 5 or more columns of finite numbers")
        return np.asarray(values)
    return read_table(file, 5).values


def _is_smoothed(values: F64) -> bool:
    """Tell velocities from blobs of cameras, which are whole numbers."""
    return values.shape[1] == _SMOOTHED and not _is_whole(values[:, 4:9])


def _is_whole(values: F64) -> bool:
    return bool((values == np.rint(values)).all())


def _whole(file: Path, values: F64, what: str) -> I64:
    if not _is_whole(values):
        wrong = values[values != np.rint(values)][0]
        raise InputError(f"{file}: last column: expected numbers of a {what}, got {wrong:g}")
    return values.astype(np.int64)


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write blobs, particles and trajectories; smoothed ones with velocities."""
    interval_s = recording.interval_s
    blobs = _write_blobs(folder, table, recording.cameras)
    tail = np.column_stack([blobs, np.zeros(len(table)), table.frame])
    _write(folder / "particles", np.column_stack([table.position_mm, tail]))
    if table.trajectory is None:
        return
    head = np.column_stack([table.trajectory, table.position_mm])
    _write(folder / "trajectories", np.column_stack([head, tail]))
    if table.velocity_mm_s is not None:
        rates = table.velocity_mm_s * interval_s
        bend = table.acceleration_mm_s2
        change = np.zeros_like(rates) if bend is None else bend * interval_s**2
        columns = np.column_stack([head, rates, change, table.frame])
        _write(folder / "smoothed_trajectories", columns)


def _write(path: Path, rows: F64) -> None:
    """Write numbers, whole ones without a point."""
    lines = (
        "\t".join(str(int(value)) if value.is_integer() else repr(value) for value in row)
        for row in rows.tolist()
    )
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _write_blobs(folder: Path, table: TrackTable, cameras: Sequence[CameraModel]) -> F64:
    """Write projections of particles as blobs; return each one's (n, camera).

    Blobs count from 0 in each frame; -1 where a camera does not see the particle.
    """
    found = np.full((len(table), len(cameras)), -1.0)
    for column, camera in enumerate(cameras):
        pixels, valid = camera.project(table.position_mm)
        seen = np.flatnonzero(valid & camera.contains(pixels))
        frame = table.frame[seen]
        first = np.searchsorted(frame, frame)
        found[seen, column] = np.arange(len(seen)) - first
        size = np.tile([_SIDE, _SIDE, _SIDE**2], (len(seen), 1))
        _write(folder / f"blobs_cam{column + 1}", np.column_stack([pixels[seen], size, frame]))
    return found
