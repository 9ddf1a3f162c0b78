"""Tracks as NetCDF: variables with units over one dimension, `obs`.

Written is the classic format (NetCDF 3), which every reader takes; read are NetCDF 3 and 4. Arrays
(trajectory, obs), padded with NaN, are read too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.interop.foreign_world import note
from sabench.interop.tracks.named_columns import columns_of_table, table_of_columns
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.errors import InputError
from sabench.worlds.library.field_formats import Array

FILE = "tracks.nc"
LOST = ("light of each camera", "covariances", "probabilities")
_UNITS = {"_mm": "mm", "_mm_s": "mm s-1", "_mm_s2": "mm s-2", "time_s": "s"}


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read the variables with one value for each observation.

    Raises
    ------
    InputError
        No such file, a broken one, or one without frames and positions.
    """
    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: expected a NetCDF file, found none")
    with file.open("rb") as handle:
        classic = handle.read(3) == b"CDF"
    variables = _read_classic(file) if classic else read_hdf5_arrays(file)
    return table_of_columns(str(file), _observations(file, variables), unit)


def _read_classic(path: Path) -> dict[str, Array]:
    from scipy.io import netcdf_file

    try:
        with netcdf_file(path, "r", mmap=False) as file:
            return {
                name: Array(np.array(one[()], dtype=np.float64), _text(getattr(one, "units", None)))
                for name, one in file.variables.items()
                if np.asarray(one[()]).dtype.kind in "fiu"
            }
    except (ValueError, TypeError, IndexError, OSError, AssertionError) as error:
        raise InputError(f"{path}: expected an intact NetCDF file, got {error}") from error


def read_hdf5_arrays(path: Path) -> dict[str, Array]:
    """Read the arrays of numbers at the root of an HDF5 file."""
    found = {}
    with open_hdf5(path) as file:
        for name in list(file):
            node = file.get(name) if isinstance(file.get(name, getlink=True), h5py.HardLink) else 0
            if isinstance(node, h5py.Dataset) and node.shape and node.dtype.kind in "fiu":
                values = read_array(file, name, (None,) * len(node.shape), "fiu")
                found[name] = Array(values.astype(np.float64), _text(node.attrs.get("units")))
    return found


def _text(value: Any) -> str | None:
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size else None
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _observations(path: Path, variables: dict[str, Array]) -> dict[str, Array]:
    """Keep the variables with the shape of x, and drop their padding."""
    shape = next((one.values.shape for name, one in variables.items() if name[:1] in "xX"), ())
    kept = {name: one for name, one in variables.items() if one.values.shape == shape}
    if len(shape) == 2:
        kept |= _spread(shape, variables)
    there = np.ones(shape, dtype=bool)
    for one in kept.values() if len(shape) == 2 else ():
        there &= np.isfinite(one.values)
    left = [name for name in variables if name not in kept]
    if left:
        note(f"{path}: left out the variables {', '.join(left)}, of another shape than x")
    return {name: Array(one.values[there].ravel(), one.unit) for name, one in kept.items()}


def _spread(shape: tuple[int, ...], variables: dict[str, Array]) -> dict[str, Array]:
    """Repeat variables of trajectories, or their numbers, over observations."""
    own = {name: one for name, one in variables.items() if one.values.shape == shape[:1]}
    number = own or {"trajectory": Array(np.arange(shape[0], dtype=np.float64), None)}
    return {
        name: Array(np.repeat(one.values[:, None], shape[1], axis=1), one.unit)
        for name, one in number.items()
    }


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write tracks.nc."""
    from scipy.io import netcdf_file

    with netcdf_file(folder / FILE, "w", version=2) as file:
        file.createDimension("obs", len(table))
        for name, values in columns_of_table(table, recording.times_s).items():
            kind, stored = _storable(name, values)
            variable = file.createVariable(name, kind, ("obs",))
            variable[:] = stored
            ending = next((unit for end, unit in _UNITS.items() if name.endswith(end)), None)
            if ending:
                variable.units = ending


def _storable(name: str, values: npt.NDArray[Any]) -> tuple[str, npt.NDArray[np.generic]]:
    """Choose a type of NetCDF 3, whose whole numbers have 32 bits."""
    if values.dtype.kind == "f":
        return "f8", values
    if np.abs(values).max(initial=0) > 2**31 - 1:
        note(f"{FILE}: {name}: numbers beyond 32 bits were numbered anew")
        values = np.unique(values, return_inverse=True)[1]
    return "i4", values.astype(np.int32)
