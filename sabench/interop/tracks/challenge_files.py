"""Particle files of the challenges on Lagrangian particle tracking.

One file for each frame, whose number ends its name. Three lines of Tecplot's head (title,
variables, zone) come before X Y Z in mm and, where particles are tracked, their number. Files
without the head are read, too.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from sabench.interop.foreign_world import note, unit_mm
from sabench.interop.tracks.named_columns import table_of_columns
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.tables import Array, content_lines, numbered_files, read_table

LOST = (
    "intensities, velocities and accelerations",
    "light of each camera, covariances and probabilities",
)
_NAME = r"(?:.*?\D)?(?P<frame>\d+)\.(?:dat|txt|tec)"
_HEAD = re.compile(r"^\s*(title|variables|zone)\b", re.IGNORECASE)
_WORD = re.compile(r'"([^"]*)"|([^\s",=]+)')


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read all files of a folder, or one file as frame 0.

    Raises
    ------
    InputError
        No such file, or a broken one; tracked particles in some frames only.
    """
    files = list(numbered_files(path, _NAME)) if path.is_dir() else [(0, path)]
    if not files:
        raise InputError(f"{path}: expected files NAME_N.dat or .txt, N the frame, found none")
    read = [(file, _read_frame(file, number, unit)) for number, file in files]
    parts = [one for _, one in read if len(one)] or [read[0][1]]
    linked = [one.trajectory is not None for one in parts]
    if any(linked) and not all(linked):
        odd = next(file for file, one in read if len(one) and one.trajectory is None)
        raise InputError(f"{odd}: expected a number for each particle, as in other files, got none")
    if not any(linked):
        note(f"{path}: its particles have no numbers of tracks")
    names = ("frame", "position_mm", *(("trajectory",) if all(linked) else ()))
    return TrackTable(*(np.concatenate([getattr(one, name) for one in parts]) for name in names))


def _read_frame(file: Path, number: int, unit: str | None) -> TrackTable:
    """Read one file; its head may be missing."""
    heads = [(line, text) for line, text in content_lines(file) if _HEAD.match(text)]
    values = read_table(file, 3, skip_lines=heads[-1][0] if heads else 0).values
    variables = next((text for _, text in heads if text.lower().startswith("variables")), "")
    names = [a or b for a, b in _WORD.findall(variables.partition("=")[2])]
    if not names or not len(values):
        return _plain(number, values, unit)
    if len(names) != values.shape[1]:
        raise InputError(
            f"{file}: variables: expected as many names as columns, {values.shape[1]}, got "
            f"{len(names)}"
        )
    return _named(file, number, names, values, unit)


def _named(file: Path, number: int, names: list[str], values: F64, unit: str | None) -> TrackTable:
    columns = {name: Array(values[:, i], None) for i, name in enumerate(names)}
    frame = Array(np.full(len(values), float(number)), None)
    return table_of_columns(str(file), columns | {"frame": frame}, unit)


def _plain(number: int, values: F64, unit: str | None) -> TrackTable:
    """Take four columns as X Y Z and the number, and three as X Y Z."""
    factor = 1.0 if unit is None else unit_mm(unit)
    whole = values.shape[1] == 4 and bool((values[:, 3] == np.rint(values[:, 3])).all())
    track = values[:, 3].astype(np.int64) if whole else None
    return TrackTable(np.full(len(values), number), values[:, :3] * factor, track)


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write particles_0000.dat and so on."""
    names = '"X" "Y" "Z"' + ("" if table.trajectory is None else ' "PartID"')
    for frame in range(recording.frames):
        own = table.of_frame(frame)
        rows = [" ".join(map(repr, row)) for row in own.position_mm.tolist()]
        if own.trajectory is not None:
            rows = [f"{row} {n}" for row, n in zip(rows, own.trajectory.tolist(), strict=True)]
        head = [
            f'Title = "Snapshot {frame}"',
            f"Variables = {names}",
            f"Zone I={len(own)}, F=POINT",
        ]
        text = "\n".join([*head, *rows]) + "\n"
        (folder / f"particles_{frame:04d}.dat").write_text(text, encoding="utf-8")
