"""Arrays with units from CSV, HDF5, NetCDF and VTK files."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_LENGTHS = {
    "km": 1e6,
    "m": 1e3,
    "dm": 1e2,
    "cm": 10.0,
    "mm": 1.0,
    "um": 1e-3,
    "µm": 1e-3,
    "μm": 1e-3,
    "micron": 1e-3,
    "nm": 1e-6,
}
_TIMES = {"min": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
_WORDS = {
    "meter": "m",
    "metre": "m",
    "meters": "m",
    "metres": "m",
    "millimeter": "mm",
    "millimetre": "mm",
    "second": "s",
    "seconds": "s",
    "sec": "s",
}
_HEADER = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]$")  # x [mm], x (mm)

Unit = str | float | None


@dataclass(frozen=True)
class Array:
    """Array with the unit that its file names."""

    values: F64
    unit: str | None


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Read arrays of a file by their names.

    CSV: columns under a header line; the unit may stand behind a name, as in `x [mm]`. HDF5 and
    NetCDF: datasets, with the attribute `units`. VTK (vti, vtr, vtk, vtkhdf; with the package vtk):
    `x`, `y`, `z` are the lattice's coordinates, other names its point data, (z, y, x) or (z, y, x,
    3).

    Raises
    ------
    InputError
        No such file or array, another format, or numbers that are not finite.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a file, found none")
    suffix = path.suffix.lower()
    readers = (
        dict.fromkeys((".csv", ".txt"), _from_csv)
        | dict.fromkeys((".vti", ".vtr", ".vtk", ".vtkhdf"), _from_vtk)
        | {".nc": _from_netcdf}
    )
    readers |= dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc4", ".mat"), _from_hdf5)
    if suffix not in readers:
        raise InputError(
            f"{path}: expected a file that ends in {', '.join(sorted(readers))}, got "
            f"{suffix or 'no ending'}"
        )
    found = readers[suffix](path, names)
    for name in names:
        values = found[name].values
        wrong = int(values.size - np.isfinite(values).sum())
        if wrong:
            raise InputError(
                f"{path}: {name}: expected finite numbers, but {wrong} of {values.size} are NaN or "
                "infinite"
            )
    return found


def length_mm(given: Unit, array: Array, where: str, key: str) -> float:
    """Return an array's unit in millimetres.

    It is taken from what is given (a name or a number), else from the file.

    Raises
    ------
    InputError
        Nothing says it, or a name that is not known.
    """
    return _factor(given, array, _LENGTHS, where, key, "mm")


def time_s(given: Unit, array: Array, where: str, key: str) -> float:
    """Return an array's unit in seconds; raises as `length_mm` does."""
    return _factor(given, array, _TIMES, where, key, "seconds")


def speed_mm_s(given: Unit, array: Array, where: str, key: str) -> float:
    """Return an array's unit in millimetres a second; raises as `length_mm` does."""
    speeds = {
        f"{one}/{other}": mm / s for one, mm in _LENGTHS.items() for other, s in _TIMES.items()
    }
    return _factor(given, array, speeds, where, key, "mm/s")


def _factor(
    given: Unit, array: Array, known: dict[str, float], where: str, key: str, base: str
) -> float:
    if isinstance(given, int | float):
        return float(given)
    word = given if given is not None else array.unit
    if word is None:
        raise InputError(
            f"{where}: expected a unit, but the file names none: give {key} as one of "
            f"{', '.join(list(known)[:8])} ... or in {base}"
        )
    plain = _normalise(word)
    if plain not in known:
        raise InputError(
            f"{where}: expected a unit like {', '.join(list(known)[:8])}, got {word!r}: give {key} "
            f"as one of them or in {base}"
        )
    return known[plain]


def _normalise(word: str) -> str:
    """Write m s-1, m.s^-1, m*s**-1 and metres per second as m/s."""
    text = re.sub(r"\s*(?:per|/)\s*", "/", word.strip())
    text = re.sub(r"(?<=[a-zµμ])[\s.*]*\b([a-zµμ]+)\s*(?:\^|\*\*)?\s*-1$", r"/\1", text)
    return "/".join(_WORDS.get(part, part) for part in text.split("/"))


def _from_csv(path: Path, names: Sequence[str]) -> dict[str, Array]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        header = file.readline().strip().lstrip("#").strip()
    separator = next((mark for mark in (",", ";", "\t") if mark in header), None)
    columns = [_split_header(part.strip().strip('"')) for part in header.split(separator)]
    columns_of = _column_indices(path, names, [name for name, _ in columns])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", UserWarning
            )  # of a file without data, which is said below
            values = np.loadtxt(
                path,
                delimiter=separator,
                skiprows=1,
                usecols=list(columns_of.values()),
                ndmin=2,
                encoding="utf-8-sig",
            )
    except ValueError as error:
        raise InputError(
            f"{path}: expected numbers below a line of names, got {str(error).split(';')[0]}"
        ) from error
    if not len(values):
        raise InputError(f"{path}: expected numbers below a line of names, got none")
    return {
        name: Array(values[:, number], columns[columns_of[name]][1])
        for number, name in enumerate(columns_of)
    }


def _split_header(text: str) -> tuple[str, str | None]:
    match = _HEADER.match(text)
    return (match["name"], match["unit"]) if match else (text, None)


def _column_indices(path: Path, names: Sequence[str], there: Sequence[str]) -> dict[str, int]:
    for name in names:
        if name not in there:
            raise InputError(
                f"{path}: expected {name!r} in it, got {', '.join(map(repr, there)) or 'nothing'}"
            )
    return {name: list(there).index(name) for name in names}


def _from_hdf5(path: Path, names: Sequence[str]) -> dict[str, Array]:
    import h5py

    try:
        with h5py.File(path) as file:
            there: list[str] = []
            file.visititems(
                lambda name, item: there.append(name) if isinstance(item, h5py.Dataset) else None
            )
            _column_indices(path, names, there)
            return {
                name: Array(
                    _numbers(path, name, file[name][()]), _text(file[name].attrs.get("units"))
                )
                for name in names
            }
    except OSError as error:
        raise InputError(f"{path}: expected an HDF5 file, got {error}") from error


def _from_netcdf(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Read NetCDF: version 4 is HDF5, the classic kinds are scipy's."""
    from scipy.io import netcdf_file

    with path.open("rb") as file:
        if file.read(3) != b"CDF":
            return _from_hdf5(path, names)
    try:
        with netcdf_file(path, "r", mmap=False) as file:
            _column_indices(path, names, list(file.variables))
            return {name: _classic(path, name, file.variables[name]) for name in names}
    except (ValueError, TypeError, IndexError) as error:
        raise InputError(f"{path}: expected a NetCDF file, got a broken one ({error})") from error


def _classic(path: Path, name: str, variable: Any) -> Array:
    return Array(
        _numbers(path, name, np.array(variable[()])), _text(getattr(variable, "units", None))
    )


def _numbers(path: Path, name: str, values: Any) -> F64:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: {name}: expected numbers, got {array.dtype}")
    return array.astype(np.float64)


def _text(value: Any) -> str | None:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    return (
        value.decode("utf-8", "replace")
        if isinstance(value, bytes)
        else None
        if value is None
        else str(value)
    )


def _from_vtk(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Read the point data of a lattice along the axes."""
    try:
        from vtkmodules.util.numpy_support import vtk_to_numpy
    except ImportError as error:
        raise InputError(
            f"{path}: expected the package vtk to read it: pip install 'sabench[vtk]'"
        ) from error
    data = _vtk_lattice(path)
    counts = data.GetDimensions()
    axes = {
        axis: np.array([_vtk_coordinate(data, number, index) for index in range(counts[number])])
        for number, axis in enumerate("xyz")
    }
    points = data.GetPointData()
    there = [points.GetArrayName(number) for number in range(points.GetNumberOfArrays())]
    _column_indices(path, names, [*axes, *there])
    out = {name: Array(axes[name], None) for name in names if name in axes}
    for name in set(names) - set(axes):
        values = vtk_to_numpy(points.GetArray(name))
        out[name] = Array(
            _numbers(path, name, values.reshape(*counts[::-1], *values.shape[1:])), None
        )
    return out


def _vtk_coordinate(data: Any, axis: int, index: int) -> float:
    where = [0, 0, 0]
    where[axis] = index
    return float(data.GetPoint(data.ComputePointId(where))[axis])


def _vtk_lattice(path: Path) -> Any:
    from vtkmodules.vtkCommonDataModel import vtkImageData, vtkRectilinearGrid
    from vtkmodules.vtkIOHDF import vtkHDFReader
    from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader
    from vtkmodules.vtkIOXML import vtkXMLGenericDataObjectReader

    makers = {".vtk": vtkGenericDataObjectReader, ".vtkhdf": vtkHDFReader}
    reader: Any = makers.get(path.suffix.lower(), vtkXMLGenericDataObjectReader)()
    errors: list[str] = []
    reader.AddObserver("ErrorEvent", lambda *_: errors.append("error"))
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutputDataObject(0)
    if (
        errors
        or not isinstance(data, vtkImageData | vtkRectilinearGrid)
        or not data.GetNumberOfPoints()
    ):
        got = (
            data.GetClassName()
            if data is not None and not errors
            else "something that VTK cannot read"
        )
        raise InputError(f"{path}: expected image data or a rectilinear grid, got {got}")
    return data
