"""Particles and tracks in the formats of other programs.

docs/formats/foreign.md lists what each format carries.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Literal, get_args

from sabench.interop.foreign_world import note
from sabench.interop.tracks import (
    challenge_files,
    myptv_files,
    openlpt_files,
    openptv_files,
)
from sabench.interop.tracks.named_columns import CSV, MATLAB, NETCDF, NamedColumns
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.errors import InputError

TrackFormat = Literal["openptv", "myptv", "openlpt", "lpt-challenge", "netcdf", "mat", "csv"]
_MODULES: dict[str, ModuleType | NamedColumns] = {
    "openptv": openptv_files,
    "myptv": myptv_files,
    "openlpt": openlpt_files,
    "lpt-challenge": challenge_files,
    "netcdf": NETCDF,
    "mat": MATLAB,
    "csv": CSV,
}


def check_form(form: str) -> None:
    """Raise an InputError for a format of tracks that is not known."""
    if form not in get_args(TrackFormat):
        known = ", ".join(get_args(TrackFormat))
        raise InputError(f"tracks: expected a format of {known}, got {form!r}")


def read_tracks(
    path: str | Path,
    form: TrackFormat,
    *,
    unit: str | None = None,
    interval_s: float | None = None,
) -> TrackTable:
    """Read the particles of all frames, in the world of the files.

    Parameters
    ----------
    path : file, or folder of a result.
    unit : of lengths; None: as the file says, else mm.
    interval_s : time between frames, for velocities per frame.

    Raises
    ------
    InputError
        An unknown format or unit, or a file that is missing or broken.
    """
    check_form(form)
    file = Path(path)
    if not file.exists():
        raise InputError(f"{file}: expected a file or folder with particles, found none")
    table: TrackTable = _MODULES[form].read_tracks(file, unit, interval_s)
    return table


def write_tracks(folder: Path, table: TrackTable, form: TrackFormat, recording: Recording) -> None:
    """Write particles into a folder, and say what the format cannot carry.

    The particles are in the world of the files.
    """
    check_form(form)
    note(f"{form}: its files of particles do not carry {'; '.join(_MODULES[form].LOST)}")
    _MODULES[form].write_tracks(folder, table, recording)
