"""Tracks as a table with a line of names: commas, semicolons, tabs or spaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sabench.interop.tracks.named_columns import columns_of_table, table_of_columns
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.errors import InputError
from sabench.utils.text_tables import read_table
from sabench.worlds.library.field_formats import Array

FILE = "tracks.csv"
LOST = ("light of each camera", "covariances", "probabilities")


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read a table with columns frame, x, y, z and others that `named_columns` names.

    Raises
    ------
    InputError
        No such file, no names, a line of another number of columns, or a word that is no number.
    """
    file = path / FILE if path.is_dir() else path
    table = read_table(file, 4)
    if not table.names:
        raise InputError(f"{file}: expected a first line with the names of its columns, got none")
    columns = {
        name: Array(table.values[:, i], own or None)
        for i, (name, own) in enumerate(zip(table.names, table.units, strict=True))
    }
    return table_of_columns(str(file), columns, unit)


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write tracks.csv."""
    columns = columns_of_table(table, recording.times_s)
    rows = zip(*(np.asarray(one).tolist() for one in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    (folder / FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")
