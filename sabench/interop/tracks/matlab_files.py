"""Tracks as MATLAB 7.3 files: one column vector for each quantity.

MATLAB loads them with `load tracks.mat`. Files of versions 4 to 7 are read too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sabench.interop.tracks.named_columns import columns_of_table, table_of_columns
from sabench.interop.tracks.netcdf_files import read_hdf5_arrays
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.errors import InputError
from sabench.worlds.library.field_formats import Array

FILE = "tracks.mat"
LOST = ("light of each camera", "covariances", "probabilities")
_BLOCK = 512  # bytes before the HDF5 part
_HEADER = (
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Thu Jan  1 00:00:00 1970 HDF5 schema"
)


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read the vectors of a file; matrices and structures are left out.

    Raises
    ------
    InputError
        No such file, a broken one, or one without frames and positions.
    """
    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: expected a .mat file, found none")
    arrays = read_hdf5_arrays(file) if h5py.is_hdf5(file) else _read_old(file)
    vectors = {
        name: Array(one.values.ravel(), one.unit)
        for name, one in arrays.items()
        if one.values.size == max(one.values.shape, default=0)
    }
    longest = max((one.values.size for one in vectors.values()), default=0)
    kept = {name: one for name, one in vectors.items() if one.values.size == longest}
    return table_of_columns(str(file), kept, unit)


def _read_old(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content: dict[str, Any] = loadmat(path)
    except (MatReadError, ValueError, TypeError, NotImplementedError, OSError) as error:
        raise InputError(f"{path}: expected an intact MATLAB file, got {error}") from error
    arrays = {name: one for name, one in content.items() if isinstance(one, np.ndarray)}
    return {
        name: Array(one.astype(np.float64), None)
        for name, one in arrays.items()
        if one.dtype.kind in "fiu"
    }


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write tracks.mat; all numbers are double."""
    path = folder / FILE
    with h5py.File(path, "w", userblock_size=_BLOCK) as file:
        for name, values in columns_of_table(table, recording.times_s).items():
            stored = file.create_dataset(name, data=values.astype(np.float64)[None])
            stored.attrs["MATLAB_class"] = np.bytes_("double")
    head = (_HEADER + b" 1.00 .").ljust(116) + bytes(8) + b"\x00\x02IM"
    with path.open("r+b") as raw:
        raw.write(head)
