"""Arrays with units from text, HDF5, NetCDF, MATLAB and VTK files.

A limited child process reads the file, which the libraries may not survive.
"""

import functools
import json
import re
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.files import file_series, last_number
from sabench.utils.processes.call import read_isolated
from sabench.utils.tables import UnitArray as UnitArray, read_table

FILE_NUMBER = "file_number"  # array of the number in the name of each value's file
_CONTENTS = "contents.json"
_LENGTHS = {"km": 1e6, "m": 1e3, "dm": 1e2, "cm": 10.0, "mm": 1.0}
_LENGTHS |= {"um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3, "nm": 1e-6}
_TIMES = {"min": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
_WORDS = {
    **dict.fromkeys(("meter", "metre", "meters", "metres"), "m"),
    **dict.fromkeys(("millimeter", "millimetre"), "mm"),
    **dict.fromkeys(("second", "seconds", "sec"), "s"),
}

Unit = str | float | None
Names = Sequence[str] | None


def read_arrays(path: Path, names: Sequence[str], skip_lines: int = 0) -> dict[str, UnitArray]:
    """Read arrays of a file, or of a series joined to one, by their names.

    A path with a * in its last part is a series; `file_number` is then the last number in the name
    of each value's file.

    CSV and other text (txt, dat): columns under a header line, or by their numbers from 1 without
    one; the unit may stand behind a name, as in `x [mm]`. HDF5, NetCDF and MATLAB: datasets, with
    the attribute `units`. VTK (vti, vtr, vtk, vtkhdf; with the package vtk): `x`, `y`, `z` are the
    lattice's coordinates, other names its point data, (z, y, x) or (z, y, x, 3).

    Parameters
    ----------
    skip_lines : lines at the top of each text file that are left out.

    Raises InputError: no such file or array, another format, or numbers that are not finite.
    """
    files = file_series(path)
    if not files:
        raise InputError(f"{path}: expected a file, found none")
    arrays = _read_apart(path, files, names, path.suffix.lower(), skip_lines)
    for name in names:
        values = arrays[name].values
        wrong = int(values.size - np.isfinite(values).sum())
        if wrong:
            raise InputError(
                f"{path}: {name}: expected finite numbers, but {wrong} of {values.size} are NaN or "
                "infinite"
            )
    return arrays


def read_all_arrays(path: Path, suffix: str) -> dict[str, UnitArray]:
    """Read the arrays of numbers at the root of a file as that suffix is read.

    Raises InputError: no such file, or a broken one.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a {_KINDS[suffix]} file, found none")
    return _read_apart(path, [path], None, suffix, 0)


def _read_apart(
    path: Path, files: Sequence[Path], names: Names, suffix: str, skip_lines: int
) -> dict[str, UnitArray]:
    """Read files in a limited child process, which hands the arrays over in a folder."""
    size = sum(file.stat().st_size for file in files)
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        arguments = (names, Path(folder), tuple(files), suffix, skip_lines)
        read_isolated(_store, path, *arguments, size_bytes=size)
        contents = json.loads((Path(folder) / _CONTENTS).read_text(encoding="utf-8"))
        return {
            name: UnitArray(np.load(Path(folder) / f"{number}.npy", allow_pickle=False), unit)
            for number, (name, unit) in enumerate(contents)
        }


def _store(
    path: Path, names: Names, folder: Path, files: Sequence[Path], suffix: str, skip_lines: int
) -> None:
    parts = [_read_one(file, names, suffix, skip_lines) for file in files]
    contents = []
    for number, name in enumerate(parts[0] if names is None else names):
        arrays = [part[name].values for part in parts]
        joined = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
        np.save(folder / f"{number}.npy", joined)
        contents.append((name, parts[0][name].unit))
    (folder / _CONTENTS).write_text(json.dumps(contents), encoding="utf-8")


def _read_one(file: Path, names: Names, suffix: str, skip_lines: int) -> dict[str, UnitArray]:
    """Read arrays of one file, with the number in its name."""
    if suffix not in _READERS and suffix not in _TEXT:
        raise InputError(
            f"{file}: expected a file that ends in {', '.join(sorted({*_READERS, *_TEXT}))}, got "
            f"{suffix or 'no ending'}"
        )
    inside = None if names is None else [name for name in names if name != FILE_NUMBER]
    if suffix in _TEXT:
        arrays = _from_text(file, inside or (), skip_lines)
    else:
        arrays = _READERS[suffix](file, inside)
    if names is not None and FILE_NUMBER in names:
        count = max((array.values.size for array in arrays.values()), default=0)
        arrays[FILE_NUMBER] = UnitArray(np.full(count, float(last_number(file))))
    return arrays


def _from_text(path: Path, names: Sequence[str], skip_lines: int) -> dict[str, UnitArray]:
    table = read_table(path, 1, missing=True, skip_lines=skip_lines)
    if not len(table.values):
        raise InputError(f"{path}: expected numbers below a line of names, got none")
    columns = table.columns()
    return {name: columns[name] for name in _check_names(path, names, columns)}


def _check_names(path: Path, names: Sequence[str], available: Iterable[str]) -> Sequence[str]:
    listed = list(available)
    for name in names:
        if name not in listed:
            raise InputError(
                f"{path}: expected {name!r} in it, got {', '.join(map(repr, listed)) or 'nothing'}"
            )
    return names


def _from_hdf5(path: Path, names: Names) -> dict[str, UnitArray]:
    import h5py

    try:
        with h5py.File(path) as file:
            sets: dict[str, Any] = {}
            file.visititems(sets.__setitem__)
            for name, item in list(sets.items()):
                if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
                    del sets[name]
            return {
                name: UnitArray(_numbers(path, name, sets[name][()]), _text(sets[name].attrs))
                for name in _choose(path, names, sets)
            }
    except OSError as error:
        raise InputError(f"{path}: expected an intact HDF5 file, got {error}") from error


def _choose(path: Path, names: Names, content: dict[str, Any]) -> Sequence[str]:
    """Check the names; without names, choose the arrays of numbers at the root."""
    if names is not None:
        return _check_names(path, names, content)
    arrays = {name: item for name, item in content.items() if "/" not in name and item.shape}
    return [name for name, item in arrays.items() if item.dtype.kind in "fiu"]


def _from_netcdf(path: Path, names: Names) -> dict[str, UnitArray]:
    """Read NetCDF: version 4 is HDF5, the classic kinds are SciPy's."""
    from scipy.io import netcdf_file

    with path.open("rb") as file:
        if file.read(3) != b"CDF":
            return _from_hdf5(path, names)
    try:
        with netcdf_file(path, "r", mmap=False) as file:
            arrays = {name: np.array(variable[()]) for name, variable in file.variables.items()}
            return {
                name: UnitArray(
                    _numbers(path, name, arrays[name]), _text(vars(file.variables[name]))
                )
                for name in _choose(path, names, arrays)
            }
    except (ValueError, TypeError, IndexError, AssertionError) as error:
        raise InputError(f"{path}: expected an intact NetCDF file, got {error}") from error


def _from_matlab(path: Path, names: Names) -> dict[str, UnitArray]:
    """Read MATLAB files: version 7.3 is HDF5, versions 4 to 7 are SciPy's."""
    import h5py

    if h5py.is_hdf5(path):
        return _from_hdf5(path, names)
    content = load_old_matlab(path)
    arrays = {name: array for name, array in content.items() if isinstance(array, np.ndarray)}
    chosen = _choose(path, names, arrays)
    return {name: UnitArray(_numbers(path, name, arrays[name])) for name in chosen}


def load_old_matlab(path: Path) -> dict[str, Any]:
    """Read a MATLAB file of version 4 to 7; raises InputError for a broken one."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        return dict(loadmat(path))
    except (MatReadError, ValueError, TypeError, NotImplementedError, OSError) as error:
        raise InputError(f"{path}: expected an intact MATLAB file, got {error}") from error


def _numbers(path: Path, name: str, values: Any) -> F64:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: {name}: expected numbers, got {array.dtype}")
    return array.astype(np.float64)


def _text(attributes: Any) -> str | None:
    value = attributes.get("units")
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else None
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return None if value is None else str(value)


def _from_vtk(path: Path, names: Names) -> dict[str, UnitArray]:
    try:
        from vtkmodules.util.numpy_support import vtk_to_numpy
    except ImportError as error:
        sentence = f"{path}: expected the package vtk to read it: pip install 'sabench[vtk]'"
        raise InputError(sentence) from error
    data = _vtk_lattice(path)
    counts = data.GetDimensions()
    axes = {}
    for number, axis in enumerate("xyz"):
        nodes = np.zeros((counts[number], 3), dtype=int)
        nodes[:, number] = np.arange(counts[number])
        points = [data.GetPoint(data.ComputePointId(node)) for node in nodes.tolist()]
        axes[axis] = np.array([float(point[number]) for point in points])
    content = data.GetPointData()
    inside = [content.GetArrayName(number) for number in range(content.GetNumberOfArrays())]
    arrays = {}
    for name in _check_names(path, names or (), [*axes, *inside]):
        if name in axes:
            arrays[name] = UnitArray(axes[name])
        else:
            values = vtk_to_numpy(content.GetArray(name))
            shaped = values.reshape(*counts[::-1], *values.shape[1:])
            arrays[name] = UnitArray(_numbers(path, name, shaped))
    return arrays


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
    lattices = vtkImageData | vtkRectilinearGrid
    if errors or not isinstance(data, lattices) or not data.GetNumberOfPoints():
        strange = data is None or errors
        got = "something that VTK cannot read" if strange else data.GetClassName()
        raise InputError(f"{path}: expected image data or a rectilinear grid, got {got}")
    return data


_TEXT = (".csv", ".txt", ".dat")
_KINDS = {".nc": "NetCDF", ".mat": "MATLAB"}
_READERS = {
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc4"), _from_hdf5),
    **dict.fromkeys((".vti", ".vtr", ".vtk", ".vtkhdf"), _from_vtk),
    ".nc": _from_netcdf,
    ".mat": _from_matlab,
}


def _factor(
    units: dict[str, float], base: str, given: Unit, array: UnitArray, where: str, key: str
) -> float:
    """Return an array's unit in the base unit.

    It is taken from what is given (a name or a number), else from the file. Raises InputError: a
    unit that is missing, or an unknown name.
    """
    if isinstance(given, int | float):
        return float(given)
    word = given if given is not None else array.unit
    if word is None:
        raise InputError(
            f"{where}: expected a unit, but the file names none: give {key} as one of "
            f"{', '.join(list(units)[:8])} ... or in {base}"
        )
    plain = _normalise(word)
    if plain not in units:
        raise InputError(
            f"{where}: expected a unit like {', '.join(list(units)[:8])}, got {word!r}: give {key} "
            f"as one of them or in {base}"
        )
    return units[plain]


_SPEEDS = {f"{unit}/{time}": mm / s for unit, mm in _LENGTHS.items() for time, s in _TIMES.items()}
length_mm = functools.partial(_factor, _LENGTHS, "mm")
time_s = functools.partial(_factor, _TIMES, "seconds")
speed_mm_s = functools.partial(_factor, _SPEEDS, "mm/s")


def _normalise(word: str) -> str:
    """Write m s-1, m.s^-1, m*s**-1 and metres per second as m/s."""
    text = re.sub(r"\s*(?:per|/)\s*", "/", word.strip())
    text = re.sub(r"(?<=[a-zµμ])[\s.*]*\b([a-zµμ]+)\s*(?:\^|\*\*)?\s*-1$", r"/\1", text)
    return "/".join(_WORDS.get(part, part) for part in text.split("/"))
