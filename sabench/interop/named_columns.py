"""Tables of particles or bubbles with named columns: text, NumPy, NetCDF, MATLAB.

Names are those that programs in use write; the case of letters and what follows a unit's bracket do
not matter. Other columns are left out, with a note. NetCDF is written in the classic format (NetCDF
3), which every reader takes; MATLAB loads its file with `load tracks.mat`.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np
import numpy.typing as npt

from sabench.interop.foreign import Recording, TrackTable, note, number_strangers
from sabench.interop.lenses import LARGEST_CHANGE, orthonormal
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
_POSITION = ("{}", "{}_mm", "{}_m", "world{}", "pos_{}", "position_{}", "{}f")
_VELOCITY = ("velocity_{}", "velocity_{}_mm_s", "v{}", "vel_{}", "u{}")
_COMPONENTS = ("{}", "{}_mm_s", "{}f")  # named u, v, w
_ACCELERATION = ("acceleration_{}", "acceleration_{}_mm_s2", "a{}", "acc_{}", "a{}f")
_SEMI_AXES = ("{}", "{}_mm", "{}_m", "semi_axis_{}", "semi_axis_{}_mm", "semi_axis_{}_m")
_RADIUS = ("radius", "radius_mm", "radius_m", "r", "r_mm", "r_m")  # all three semi-axes
_TURN = [(f"turn_{row}{column}",) for row in "123" for column in "123"]  # rows along semi-axes
_DIAMETER = ("diameter", "diameter_mm", "diameter_m", "d", "d_mm", "d_m", "equivalent_diameter")
_UNITS = {"_mm": "mm", "_m": "m", "_mm_s": "mm/s", "_mm_s2": "mm/s2"}
_NETCDF_UNITS = {"_mm": "mm", "_mm_s": "mm s-1", "_mm_s2": "mm s-2", "time_s": "s"}
_BLOCK = 512  # bytes before the HDF5 part of a MATLAB file
_MATLAB_HEADER = (
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Thu Jan  1 00:00:00 1970 HDF5 schema"
)


@dataclass(frozen=True)
class NamedColumns:
    """Format of tables with named columns.

    Attributes
    ----------
    file : name of the file in a folder.
    read : reads the columns of a file; those without names have numbers from 1.
    write : writes columns into a file.
    names : of the columns; empty: those of the file.
    single : whether a table without frames or times is one frame.
    bubbles : whether sizes are read.
    """

    file: str
    read: Callable[[Path], dict[str, UnitArray]]
    write: Callable[[Path, Mapping[str, npt.NDArray[Any]]], None]
    names: Sequence[str] = ()
    single: bool = False
    bubbles: bool = False
    LOST_OF_TRACKS: ClassVar[tuple[str, ...]] = ()

    def read_tracks(self, path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
        """Read a file, or the file of a folder.

        Raises InputError for a missing file, a broken one, or one without frames and positions.
        """
        file = path / self.file if path.is_dir() else path
        columns = self.read(file)
        names = list(self.names or columns)
        if len(set(names)) != len(columns) or "1" in names:
            got = ", ".join(self.names) or "none"
            raise InputError(
                f"{file}: expected names of its {len(columns)} columns, in the first line or by "
                f"--columns, as in frame,x,y,z,radius; got {got}"
            )
        named = dict(zip(names, columns.values(), strict=True))
        return table_of_columns(str(file), named, unit, self.single, self.bubbles)

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
                columns |= {name.format(axis): values[:, i] for i, axis in enumerate("xyz")}
        if table.intensity is not None:
            columns["intensity"] = table.intensity
        self.write(folder / self.file, columns)


def _read_text(file: Path) -> dict[str, UnitArray]:
    table = read_table(file, 3)
    count = table.values.shape[1]
    if table.names and len({*table.names} - {f"column_{count}"}) < count:
        raise InputError(
            f"{file}: expected different names for its {count} columns in the first line, got "
            f"{', '.join(table.names)}; decimal commas need semicolons between columns"
        )
    return table.columns()


def _write_text(file: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read_numpy(file: Path) -> dict[str, UnitArray]:
    """Read an array (rows, columns), or one of records with names."""
    try:
        array = np.load(file, allow_pickle=False)
        records = array.dtype.names
        table = {name: array[name] for name in records} if records else enumerate(array.T, 1)
        columns = {str(name): UnitArray(part.astype(float)) for name, part in dict(table).items()}
        if {one.values.ndim for one in columns.values()} == {1}:
            return columns
    except (OSError, ValueError, EOFError, TypeError, AttributeError):
        pass
    got = "another" if file.is_file() else "none"
    raise InputError(f"{file}: expected a .npy file with numbers (rows, columns), got {got}")


def _write_numpy(file: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    rows = list(zip(*columns.values(), strict=True))
    np.save(file, np.array(rows, dtype=[(name, values.dtype) for name, values in columns.items()]))


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
NUMPY = NamedColumns("tracks.npy", _read_numpy, _write_numpy)
NETCDF = NamedColumns("tracks.nc", _read_netcdf, _write_netcdf)
MATLAB = NamedColumns("tracks.mat", _read_matlab, _write_matlab)


def table_of_columns(
    where: str, columns: Columns, unit: str | None, single: bool = False, bubbles: bool = False
) -> TrackTable:
    """Make a table of named columns (n,).

    Parameters
    ----------
    where : file, for sentences.
    unit : of lengths; None: as the columns say, else mm.
    single : whether a table without frames or times is one frame.
    bubbles : whether sizes are read; rows with sizes are bubbles, others particles.

    Raises InputError for no frame or time, no positions, sizes that are not positive, axes that are
    not at right angles, or values that are not finite or, where they are numbers of frames and
    trajectories, not whole.
    """
    table = _Table(where, columns, unit)
    position = table.vector((_POSITION, "xyz"))
    if position is None:
        raise InputError(
            f"{where}: expected columns x, y and z, found {', '.join(columns) or 'none'}"
        )
    frame, trajectory = table.frames(single), table.first(_TRAJECTORY, "whole")
    velocity = acceleration = intensity = turn = None
    semi_axes = table.semi_axes() if bubbles else None
    if semi_axes is None:
        velocity = table.vector((_VELOCITY, "xyz"), (_COMPONENTS, "uvw"), kind="velocity")
        acceleration = table.vector((_ACCELERATION, "xyz"), kind="acceleration")
        intensity = table.first(_INTENSITY)
    else:
        turn = table.turn(semi_axes)
    if left := [name for name in columns if name not in table.used]:
        note(f"{where}: left out the columns {', '.join(left)}")
    number = None if trajectory is None else number_strangers(trajectory.astype(np.int64))
    both = (velocity, acceleration, semi_axes, turn)
    return TrackTable(frame, position, number, intensity, *both).sorted()


class _Table:
    """Named columns of a file, and which of them were used."""

    def __init__(self, where: str, columns: Columns, unit: str | None) -> None:
        self.where, self.columns, self.unit = where, columns, unit
        self.names, self.used = {name.strip().lower(): name for name in columns}, set[str]()

    def find(self, *each: Sequence[str]) -> list[str]:
        """Find one column for each of several quantities; none if one is missing."""
        named = [[self.names[name] for name in names if name in self.names] for names in each]
        found = [names[0] for names in named if names] if all(named) else []
        self.used.update(found)
        return found

    def values(self, name: str, expected: str = "finite") -> F64:
        """Return a column of finite, whole or positive numbers."""
        numbers = np.asarray(self.columns[name].values, dtype=np.float64)
        good = np.isfinite(numbers)
        if expected == "whole":
            good &= (numbers == np.rint(numbers)) & (np.abs(numbers) <= 2**53)
        elif expected == "positive":
            good &= numbers > 0.0
        if not good.all():
            row = int(np.argmin(good))
            raise InputError(
                f"{self.where}: {name}: expected {expected} numbers, got {numbers[row]:g} in row "
                f"{row + 1}"
            )
        return numbers

    def first(self, names: Sequence[str], expected: str = "finite") -> F64 | None:
        """Return the first column of several names; None if there is none."""
        return next((self.values(name, expected) for name in self.find(names)), None)

    def vector(
        self, *families: tuple[Sequence[str], str], kind: str = "", expected: str = "finite"
    ) -> F64 | None:
        """Return a vector's components (n, 3) in mm, mm/s or mm/s2; None if missing."""
        for forms, axes in families:
            names = self.find(*([form.format(axis) for form in forms] for axis in axes))
            if names:
                parts = [self.values(name, expected) * self._factor(name, kind) for name in names]
                return np.stack(parts, axis=1)
        return None

    def frames(self, single: bool) -> I64:
        """Return numbers of frames; without them, the times are numbered in their order."""
        frame, time = self.first(_FRAME, "whole"), self.first(_TIME)
        if frame is not None:
            return frame.astype(np.int64)
        if time is not None:
            note(f"{self.where}: it has no column of frames: its times are numbered in their order")
            return np.unique(time, return_inverse=True)[1].astype(np.int64)
        if not single:
            found = ", ".join(self.columns) or "none"
            raise InputError(f"{self.where}: expected a column frame or time, found {found}")
        return np.zeros(len(next(iter(self.columns.values())).values), dtype=np.int64)

    def semi_axes(self) -> F64 | None:
        """Return the semi-axes (n, 3) of bubbles, mm; None without sizes."""
        names = (_SEMI_AXES, "abc"), (_RADIUS, "abc")
        if (semi_axes := self.vector(*names, expected="positive")) is not None:
            return semi_axes
        diameter = self.vector((_DIAMETER, "abc"), expected="positive")
        return None if diameter is None else diameter / 2.0

    def turn(self, semi_axes: F64) -> F64 | None:
        """Return the directions of semi-axes as rows (n, 3, 3); None without."""
        names = self.find(*_TURN)
        if not names:
            if np.ptp(semi_axes, axis=1).any():
                note(f"{self.where}: no turn_11 to turn_33: the semi-axes lie along X, Y and Z")
            return None
        printed = np.stack([self.values(name) for name in names], axis=1).reshape(-1, 3, 3)
        turn = orthonormal(printed)
        wrong = np.flatnonzero(np.abs(turn - printed).max(axis=(1, 2)) > LARGEST_CHANGE)
        if len(wrong):
            raise InputError(
                f"{self.where}: turn_11 to turn_33: expected unit vectors at right angles, got "
                f"others in row {wrong[0] + 1}"
            )
        return turn

    def _factor(self, name: str, kind: str) -> float:
        """Return a column's unit in mm, mm/s or mm/s2: the given one, its own, or mm."""
        column, where = self.columns[name], f"{self.where}: {name}"
        ending = re.search(r"_(mm_s2|mm_s|mm|m)$", name.lower())
        stated = column.unit or (_UNITS[f"_{ending[1]}"] if ending else None)
        if kind == "velocity" and stated and self.unit is None:
            return speed_mm_s(None, UnitArray(column.values, stated), where, "unit")
        if kind == "acceleration" and stated and self.unit is None:
            length = re.sub(r"(?:/|\s+)s.*$", "", stated)
        else:
            length = self.unit or stated or "mm"
        return length_mm(length, column, where, "unit")
