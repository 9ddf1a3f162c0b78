"""Tables of tracks with named columns: CSV and other text, NetCDF, MATLAB.

Names are those that programs in use write; the case of letters and what follows a unit's bracket do
not matter. Other columns are left out, with a note. NetCDF is written in the classic format (NetCDF
3), which every reader takes; MATLAB loads its file with `load tracks.mat`.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from sabench.interop.foreign import Recording, TrackTable, note, number_strangers
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.tables import UnitArray, read_table
from sabench.worlds.library.array_files import length_mm, read_all_arrays, speed_mm_s

Columns = Mapping[str, UnitArray]
_FRAME = ("frame", "frameid", "frame_id", "frame_number", "image", "snapshot", "timestep", "step")
_TIME = ("time", "t", "time_s")
_TRAJECTORY = (
    "trajectory", "particle", "track", "trackid", "track_id", "id", "particle_id", "partid",
    "trajid", "traj", "traj_id", "trajectory_id", "trajectory_index",
)  # fmt: skip
_INTENSITY = ("intensity", "mass", "brightness", "i")
_AXES = "xyz"
_POSITION = ("{}", "{}_mm", "{}_m", "world{}", "pos_{}", "position_{}", "{}f")
_VELOCITY = ("velocity_{}", "velocity_{}_mm_s", "v{}", "vel_{}", "u{}")
_VELOCITY_UVW = ("{}", "{}_mm_s", "{}f")
_ACCELERATION = ("acceleration_{}", "acceleration_{}_mm_s2", "a{}", "acc_{}", "a{}f")
_UNITS = {"_mm": "mm", "_m": "m", "_mm_s": "mm/s", "_mm_s2": "mm/s2"}
_NETCDF_UNITS = {"_mm": "mm", "_mm_s": "mm s-1", "_mm_s2": "mm s-2", "time_s": "s"}
_BLOCK = 512  # bytes before the HDF5 part of a MATLAB file
_MATLAB_HEADER = (
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Thu Jan  1 00:00:00 1970 HDF5 schema"
)


@dataclass(frozen=True)
class NamedColumns:
    """Format of tables of tracks with named columns.

    Attributes
    ----------
    file : name of the file in a folder.
    read : reads the columns of a file.
    write : writes columns into a file.
    """

    file: str
    read: Callable[[Path], dict[str, UnitArray]]
    write: Callable[[Path, Mapping[str, npt.NDArray[Any]]], None]
    LOST_OF_TRACKS = ("light of each camera", "covariances", "probabilities")

    def read_tracks(self, path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
        """Read a file, or the file of a folder.

        Raises InputError for a missing file, a broken one, or one without frames and positions.
        """
        file = path / self.file if path.is_dir() else path
        return table_of_columns(str(file), self.read(file), unit)

    def write_tracks(self, folder: Path, table: TrackTable, recording: Recording) -> None:
        """Write the file of a folder."""
        times = np.asarray(recording.times_s, dtype=np.float64)
        columns: dict[str, npt.NDArray[Any]] = {"frame": table.frame, "time_s": times[table.frame]}
        if table.trajectory is not None:
            columns["trajectory"] = table.trajectory
        for name, values in (
            ("{}_mm", table.position_mm),
            ("velocity_{}_mm_s", table.velocity_mm_s),
            ("acceleration_{}_mm_s2", table.acceleration_mm_s2),
        ):
            if values is not None:
                columns |= {name.format(axis): values[:, i] for i, axis in enumerate(_AXES)}
        if table.intensity is not None:
            columns["intensity"] = table.intensity
        self.write(folder / self.file, columns)


def _read_text(file: Path) -> dict[str, UnitArray]:
    table = read_table(file, 4)
    if not table.names:
        raise InputError(f"{file}: expected a first line with the names of its columns, got none")
    return table.columns()


def _write_text(file: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read_netcdf(file: Path) -> dict[str, UnitArray]:
    variables = read_all_arrays(file, ".nc")
    shape = next((array.values.shape for name, array in variables.items() if name[:1] in "xX"), ())
    fields = {name: array for name, array in variables.items() if array.values.shape == shape}
    if len(shape) == 2:
        rows = {name: array for name, array in variables.items() if array.values.shape == shape[:1]}
        number = rows or {"trajectory": UnitArray(np.arange(shape[0], dtype=np.float64), None)}
        fields |= {
            name: UnitArray(np.repeat(array.values[:, None], shape[1], axis=1), array.unit)
            for name, array in number.items()
        }
    finite = np.ones(shape, dtype=bool)
    for array in fields.values() if len(shape) == 2 else ():
        finite &= np.isfinite(array.values)
    left = [name for name in variables if name not in fields]
    if left:
        note(f"{file}: left out the variables {', '.join(left)}, of another shape than x")
    return {
        name: UnitArray(array.values[finite].ravel(), array.unit) for name, array in fields.items()
    }


def _write_netcdf(file: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    from scipy.io import netcdf_file

    count = len(columns["frame"])
    with netcdf_file(file, "w", version=2) as netcdf:
        netcdf.createDimension("obs", count)
        for name, values in columns.items():
            kind, stored = _storable(file.name, name, values)
            variable = netcdf.createVariable(name, kind, ("obs",))
            variable[:] = stored
            unit = next((unit for end, unit in _NETCDF_UNITS.items() if name.endswith(end)), None)
            if unit:
                variable.units = unit


def _storable(
    file: str, name: str, values: npt.NDArray[Any]
) -> tuple[str, npt.NDArray[np.generic]]:
    """Choose a type of NetCDF 3; its integers have 32 bits."""
    if values.dtype.kind == "f":
        return "f8", values
    if np.abs(values).max(initial=0) > 2**31 - 1:
        note(f"{file}: {name}: numbers beyond 32 bits were numbered anew")
        values = np.unique(values, return_inverse=True)[1]
    return "i4", values.astype(np.int32)


def _read_matlab(file: Path) -> dict[str, UnitArray]:
    """Read the vectors of a file; matrices and structures are left out."""
    vectors = {
        name: UnitArray(array.values.ravel(), array.unit)
        for name, array in read_all_arrays(file, ".mat").items()
        if array.values.size == max(array.values.shape, default=0)
    }
    longest = max((array.values.size for array in vectors.values()), default=0)
    return {name: array for name, array in vectors.items() if array.values.size == longest}


def _write_matlab(path: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    with h5py.File(path, "w", userblock_size=_BLOCK) as file:
        for name, values in columns.items():
            stored = file.create_dataset(name, data=values.astype(np.float64)[None])
            stored.attrs["MATLAB_class"] = np.bytes_("double")
    head = (_MATLAB_HEADER + b" 1.00 .").ljust(116) + bytes(8) + b"\x00\x02IM"
    with path.open("r+b") as raw:
        raw.write(head)


CSV = NamedColumns("tracks.csv", _read_text, _write_text)
NETCDF = NamedColumns("tracks.nc", _read_netcdf, _write_netcdf)
MATLAB = NamedColumns("tracks.mat", _read_matlab, _write_matlab)


def table_of_columns(where: str, columns: Columns, unit: str | None) -> TrackTable:
    """Make a table of named columns (n,).

    Parameters
    ----------
    where : file, for sentences.
    unit : of lengths; None: as the columns say, else mm.

    Raises InputError for no frame or time, no positions, or values that are not finite or, where
    they are numbers of frames and trajectories, not whole.
    """
    by_name = {name.strip().lower(): name for name in columns}
    used = list[str]()

    def find(names: tuple[str, ...]) -> str | None:
        column = next((by_name[name] for name in names if name in by_name), None)
        used.extend([column] if column else [])
        return column

    position = _vector(where, columns, find, (_POSITION,), unit, "position")
    if position is None:
        raise InputError(
            f"{where}: expected columns x, y and z, found {', '.join(columns) or 'none'}"
        )
    frame = _frames(where, columns, find(_FRAME), find(_TIME))
    trajectory = find(_TRAJECTORY)
    velocity = _vector(where, columns, find, (_VELOCITY, _VELOCITY_UVW), unit, "velocity")
    acceleration = _vector(where, columns, find, (_ACCELERATION,), unit, "acceleration")
    intensity = find(_INTENSITY)
    left = [name for name in columns if name not in used]
    if left:
        note(f"{where}: left out the columns {', '.join(left)}")
    return TrackTable(
        frame,
        position,
        None
        if trajectory is None
        else number_strangers(_whole(where, trajectory, columns[trajectory].values)),
        None if intensity is None else _finite(where, intensity, columns[intensity].values),
        velocity,
        acceleration,
    ).sorted()


def _frames(where: str, columns: Columns, frame: str | None, time: str | None) -> I64:
    """Return numbers of frames; without them, the times are numbered in their order."""
    if frame is not None:
        return _whole(where, frame, columns[frame].values)
    if time is None:
        raise InputError(
            f"{where}: expected a column frame or time, found {', '.join(columns) or 'none'}"
        )
    note(f"{where}: it has no column of frames: its times are numbered in their order")
    values = _finite(where, time, columns[time].values)
    return np.asarray(np.unique(values, return_inverse=True)[1], dtype=np.int64)


def _vector(
    where: str,
    columns: Columns,
    find: Callable[[tuple[str, ...]], str | None],
    families: tuple[tuple[str, ...], ...],
    unit: str | None,
    kind: str,
) -> F64 | None:
    """Return a vector's components (n, 3) in mm, mm/s or mm/s2; None if missing."""
    for family in families:
        axes = "uvw" if family is _VELOCITY_UVW else _AXES
        names = [find(tuple(form.format(axis) for form in family)) for axis in axes]
        present = [name for name in names if name is not None]
        if len(present) == 3:
            parts = [
                _finite(where, name, columns[name].values)
                * _factor(where, name, columns[name], unit, kind)
                for name in present
            ]
            return np.stack(parts, axis=1)
    return None


def _factor(where: str, name: str, column: UnitArray, unit: str | None, kind: str) -> float:
    """Return a column's unit in mm, mm/s or mm/s2: the given one, its own, or mm."""
    ending = re.search(r"_(mm_s2|mm_s|mm|m)$", name.lower())
    stated = column.unit or (_UNITS[f"_{ending[1]}"] if ending else None)
    if kind == "velocity" and stated and unit is None:
        return speed_mm_s(None, UnitArray(column.values, stated), f"{where}: {name}", "unit")
    if kind == "acceleration" and stated and unit is None:
        length = re.sub(r"(?:/|\s+)s.*$", "", stated)
    else:
        length = unit or stated or "mm"
    return length_mm(length, column, f"{where}: {name}", "unit")


def _whole(where: str, name: str, values: npt.NDArray[Any]) -> I64:
    numbers = _finite(where, name, values)
    broken = np.flatnonzero((numbers != np.rint(numbers)) | (np.abs(numbers) > 2**53))
    if len(broken):
        raise InputError(
            f"{where}: {name}: expected whole numbers, got {numbers[broken[0]]:g} in row "
            f"{broken[0] + 1}"
        )
    return numbers.astype(np.int64)


def _finite(where: str, name: str, values: npt.NDArray[Any]) -> F64:
    numbers = np.asarray(values, dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(numbers))
    if len(bad):
        raise InputError(
            f"{where}: {name}: expected finite numbers, got {numbers[bad[0]]} in row {bad[0] + 1}"
        )
    return numbers
