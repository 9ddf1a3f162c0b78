"""HDF5 reading that trusts nothing: no links out of the file, no surprises in shape or kind."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from sabench.errors import InputError


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An HDF5 file for reading; whatever goes wrong inside is an InputError that names it."""
    if not path.is_file():
        raise InputError(f"{path}: expected an HDF5 file, found none")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise InputError(f"{path}: expected a whole HDF5 file, got {type(error).__name__}: {error}") from error


def read_array(file: Any, name: str, shape: tuple[int | None, ...], kind: str) -> npt.NDArray[Any]:
    """A data set of that shape (None: any length) and numpy kind letters; it must lie inside this very file."""
    where = f"{file.filename}: {name}"
    node = file
    for part in name.split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if not isinstance(link, h5py.HardLink):
            raise InputError(f"{where}: expected a data set in this file, found {'a link' if link else 'none'}")
        node = node[part]
    if not isinstance(node, h5py.Dataset) or node.is_virtual or node.external:
        raise InputError(f"{where}: expected a data set with its values in this file")
    fits = len(node.shape) == len(shape) and all(want in (None, got) for want, got in zip(shape, node.shape, strict=True))
    if not fits or node.dtype.kind not in kind:
        expected = "(" + ", ".join("n" if want is None else str(want) for want in shape) + ")"
        raise InputError(f"{where}: expected shape {expected} of kind {kind}, got {node.shape} of {node.dtype}")
    return np.asarray(node[...])


def finite(values: npt.NDArray[Any], where: str) -> npt.NDArray[Any]:
    """`values`, or an InputError if any is NaN or infinite."""
    bad = int(values.size - np.count_nonzero(np.isfinite(values)))
    if bad:
        raise InputError(f"{where}: expected finite values, got {bad} that are NaN or infinite")
    return values
