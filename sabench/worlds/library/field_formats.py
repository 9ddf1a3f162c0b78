"""Readers of CSV, HDF5, NetCDF and VTK files, which run in a child process."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.files import last_number
from sabench.utils.text_tables import read_table

_UNITS = "units.json"
_TEXT = (".csv", ".txt", ".dat")
FILE_NUMBER = "file_number"  # array of the number in the name of each value's file


@dataclass(frozen=True)
class Array:
    """Array with the unit that its file names."""

    values: F64
    unit: str | None


def store_arrays(
    path: Path, names: Sequence[str], folder: Path, files: Sequence[Path], skip_lines: int
) -> None:
    """Read arrays of a file or a series and store them in a folder for `load_arrays`.

    Raises InputError as `read_arrays` does; `path` is that of the series.
    """
    parts = [_read_one(file, names, skip_lines) for file in files]
    for number, name in enumerate(names):
        arrays = [part[name].values for part in parts]
        joined = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
        np.save(folder / f"{number}.npy", joined)
    units = [parts[0][name].unit for name in names]
    (folder / _UNITS).write_text(json.dumps(units), encoding="utf-8")


def _read_one(file: Path, names: Sequence[str], skip_lines: int) -> dict[str, Array]:
    """Read arrays of one file, with the number in its name."""
    found = _read(file, [name for name in names if name != FILE_NUMBER], skip_lines)
    if FILE_NUMBER in names:
        count = max((array.values.size for array in found.values()), default=0)
        found[FILE_NUMBER] = Array(np.full(count, float(last_number(file))), None)
    return found


def load_arrays(names: Sequence[str], folder: Path) -> dict[str, Array]:
    """Load the arrays that `store_arrays` has stored in a folder."""
    units = json.loads((folder / _UNITS).read_text(encoding="utf-8"))
    return {
        name: Array(np.load(folder / f"{number}.npy", allow_pickle=False), unit)
        for number, (name, unit) in enumerate(zip(names, units, strict=True))
    }


def _read(path: Path, names: Sequence[str], skip_lines: int) -> dict[str, Array]:
    suffix = path.suffix.lower()
    readers = dict.fromkeys((".vti", ".vtr", ".vtk", ".vtkhdf"), _from_vtk) | {".nc": _from_netcdf}
    readers |= dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc4", ".mat"), _from_hdf5)
    if suffix in _TEXT:
        return _from_text(path, names, skip_lines)
    if suffix not in readers:
        raise InputError(
            f"{path}: expected a file that ends in {', '.join(sorted({*readers, *_TEXT}))}, got "
            f"{suffix or 'no ending'}"
        )
    return readers[suffix](path, names)


def _from_text(path: Path, names: Sequence[str], skip_lines: int) -> dict[str, Array]:
    table = read_table(path, 1, missing=True, skip_lines=skip_lines)
    if not len(table.values):
        raise InputError(f"{path}: expected numbers below a line of names, got none")
    there = table.names or tuple(str(number + 1) for number in range(table.values.shape[1]))
    units = table.units or ("",) * len(there)
    columns = _column_indices(path, names, there)
    return {name: Array(table.values[:, i], units[i] or None) for name, i in columns.items()}


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
