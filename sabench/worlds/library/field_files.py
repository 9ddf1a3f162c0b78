"""Arrays with units from CSV, HDF5, NetCDF and VTK files."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sabench.utils.errors import InputError
from sabench.utils.files import file_series
from sabench.utils.processes.call import read_isolated
from sabench.worlds.library.field_formats import Array, load_arrays, store_arrays

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

Unit = str | float | None


def read_arrays(path: Path, names: Sequence[str], skip_lines: int = 0) -> dict[str, Array]:
    """Read arrays of a file, or of a series joined to one, by their names.

    A path whose last part has a * names a series; `file_number` is then the last number in the name
    of each value's file.

    CSV and other text (txt, dat): columns under a header line, or by their numbers from 1 without
    one; the unit may stand behind a name, as in `x [mm]`. HDF5 and
    NetCDF: datasets, with the attribute `units`. VTK (vti, vtr, vtk, vtkhdf; with the package vtk):
    `x`, `y`, `z` are the lattice's coordinates, other names its point data, (z, y, x) or (z, y, x,
    3). A limited child process reads the file, which the libraries may not survive.

    Parameters
    ----------
    skip_lines : lines at the top of each text file that are left out.

    Raises
    ------
    InputError
        No such file or array, another format, or numbers that are not finite.
    """
    files = file_series(path)
    if not files:
        raise InputError(f"{path}: expected a file, found none")
    size = sum(file.stat().st_size for file in files)
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        arguments = (tuple(names), Path(folder), tuple(files))
        read_isolated(store_arrays, path, *arguments, skip_lines, size_bytes=size)
        found = load_arrays(names, Path(folder))
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
