"""Tracks of OpenLPT: CSV files, in each of which their numbers begin anew."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sabench.interop.tracks.named_columns import table_of_columns
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.arrays import I64
from sabench.utils.errors import InputError
from sabench.utils.tables import Array, read_table

# files that OpenLPT's own programs read as the result
_KINDS = ("LongTrackActive", "LongTrackInactive", "ExitTrack")
_HEAD = ("TrackID", "FrameID", "WorldX", "WorldY", "WorldZ")
_NONE = np.zeros(0, dtype=np.int64)
LOST = (
    "intensities, velocities and accelerations",
    "light of each camera, covariances and probabilities",
)


def track_files(path: Path) -> list[Path]:
    """List the files of tracks of a result folder or of the folder above it."""
    if not path.is_dir():
        return [path]
    places = (path / "results" / "ConvergeTrack", path / "ConvergeTrack", path)
    folder = next((place for place in places if place.is_dir()), path)
    return [file for kind in _KINDS for file in sorted(folder.glob(f"{kind}_*.csv"))]


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read all tracks of a result.

    Raises
    ------
    InputError
        No file of tracks, or a broken one.
    """
    files = track_files(path)
    if not files:
        raise InputError(f"{path}: expected files of tracks, ConvergeTrack/*_*.csv, found none")
    return read_files(files, unit)


def read_files(files: Sequence[Path], unit: str | None) -> TrackTable:
    """Read files of tracks; numbers of a file follow those of the file before."""
    frame, position, number = list[I64](), [np.zeros((0, 3))], list[I64]()
    before = 0
    for file in files:
        made = _read_file(file, unit)
        own = np.asarray(made.trajectory) + before
        before = int(own.max(initial=before - 1)) + 1
        frame, position, number = (
            [*frame, made.frame],
            [*position, made.position_mm],
            [*number, own],
        )
    numbers = [np.concatenate([_NONE, *one]) for one in (frame, number)]
    return TrackTable(numbers[0], np.concatenate(position), numbers[1]).sorted()


def _read_file(file: Path, unit: str | None) -> TrackTable:
    """Read columns by names; pixels of cameras, which follow, are left out."""
    table = read_table(file, 5)
    there = [name.strip() for name in table.names]
    if not len(table.values):
        return TrackTable(_NONE, np.zeros((0, 3)), _NONE)
    missing = next((name for name in _HEAD if name not in there), None)
    if missing:
        raise InputError(
            f"{file}: expected a column {missing}, got {', '.join(there) or 'no names'}"
        )
    columns = {name: Array(table.values[:, there.index(name)], None) for name in _HEAD}
    return table_of_columns(str(file), columns, unit)


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write all tracks into LongTrackActive_N.csv, N the last frame."""
    place = folder / "results" / "ConvergeTrack"
    place.mkdir(parents=True)
    number = np.arange(len(table)) if table.trajectory is None else table.trajectory
    rows = zip(number.tolist(), table.frame.tolist(), table.position_mm.tolist(), strict=True)
    lines = [",".join(_HEAD)]
    lines += [f"{track},{frame},{x!r},{y!r},{z!r}" for track, frame, (x, y, z) in rows]
    last = int(table.frame.max(initial=0))
    file = place / f"LongTrackActive_{last}.csv"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
