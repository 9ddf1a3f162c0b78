"""Tables of tracks whose columns have names: CSV, NetCDF, MATLAB and others.

Names are those that programs in use write; the case of letters and what follows a unit's bracket do
not matter. Other columns are left out, and said.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.interop.foreign_world import note
from sabench.interop.tracks.track_table import TrackTable, number_strangers
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.worlds.library.field_files import length_mm, speed_mm_s
from sabench.worlds.library.field_formats import Array

Columns = Mapping[str, Array]
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


def table_of_columns(where: str, columns: Columns, unit: str | None) -> TrackTable:
    """Make a table of named columns (n,).

    Parameters
    ----------
    where : file, for sentences.
    unit : of lengths; None: as the columns say, else mm.

    Raises
    ------
    InputError
        No frame or time, no positions, or values that are not finite or, where they are numbers of
        frames and trajectories, not whole.
    """
    known = {name.strip().lower(): name for name in columns}
    used = list[str]()

    def find(names: tuple[str, ...]) -> str | None:
        found = next((known[name] for name in names if name in known), None)
        used.extend([found] if found else [])
        return found

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


def _factor(where: str, name: str, column: Array, unit: str | None, kind: str) -> float:
    """Return a column's unit in mm, mm/s or mm/s2: the given one, its own, or mm."""
    ending = re.search(r"_(mm_s2|mm_s|mm|m)$", name.lower())
    own = column.unit or (_UNITS[f"_{ending[1]}"] if ending else None)
    if kind == "velocity" and own and unit is None:
        return speed_mm_s(None, Array(column.values, own), f"{where}: {name}", "unit")
    if kind == "acceleration" and own and unit is None:
        length = re.sub(r"(?:/|\s+)s.*$", "", own)
    else:
        length = unit or own or "mm"
    return length_mm(length, column, f"{where}: {name}", "unit")


def _whole(where: str, name: str, values: npt.NDArray[Any]) -> I64:
    """Return whole numbers."""
    found = _finite(where, name, values)
    broken = np.flatnonzero((found != np.rint(found)) | (np.abs(found) > 2**53))
    if len(broken):
        raise InputError(
            f"{where}: {name}: expected whole numbers, got {found[broken[0]]:g} in row "
            f"{broken[0] + 1}"
        )
    return found.astype(np.int64)


def _finite(where: str, name: str, values: npt.NDArray[Any]) -> F64:
    found = np.asarray(values, dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(found))
    if len(bad):
        raise InputError(
            f"{where}: {name}: expected finite numbers, got {found[bad[0]]} in row {bad[0] + 1}"
        )
    return found


def columns_of_table(table: TrackTable, times_s: tuple[float, ...]) -> dict[str, npt.NDArray[Any]]:
    """List the columns of a table, and times, by the names that are read."""
    times = np.asarray(times_s, dtype=np.float64)
    found: dict[str, npt.NDArray[Any]] = {"frame": table.frame, "time_s": times[table.frame]}
    if table.trajectory is not None:
        found["trajectory"] = table.trajectory
    for name, values in (
        ("{}_mm", table.position_mm),
        ("velocity_{}_mm_s", table.velocity_mm_s),
        ("acceleration_{}_mm_s2", table.acceleration_mm_s2),
    ):
        if values is not None:
            found |= {name.format(axis): values[:, i] for i, axis in enumerate(_AXES)}
    if table.intensity is not None:
        found["intensity"] = table.intensity
    return found
