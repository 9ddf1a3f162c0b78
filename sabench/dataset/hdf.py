"""HDF5 that trusts nothing: no links out of a file, no surprises in shape or kind, no crash on a full disk."""

from __future__ import annotations

import contextlib
import io
import signal
import threading
from collections.abc import Callable, Iterator
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


class NewFile(io.RawIOBase):
    """A file that HDF5 writes through; the first write that the system refuses is kept, and HDF5 told that all is well.

    HDF5 does not survive a refused write: it crashes the process when it closes. `check` raises the refusal where Python can handle it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._file = path.open("w+b", buffering=0)
        self._fault: OSError | None = None

    def check(self) -> None:
        """Raise what the system refused so far."""
        if self._fault:
            raise self._fault

    def write(self, data: Any) -> int:
        """Write all of `data`, or keep the fault."""
        view = memoryview(data).cast("B")
        done = 0
        while not self._fault and done < len(view):
            try:
                done += self._file.write(view[done:])
            except OSError as error:
                self._fault = OSError(error.errno, error.strerror, self._file.name)
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Read back; what was refused reads as zeros."""
        view = memoryview(buffer).cast("B")
        count = self._file.readinto(view) or 0
        view[count:] = bytes(len(view) - count)
        return len(view)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Where."""
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """Set the length, or keep the fault."""
        try:
            return self._file.truncate(size)
        except OSError as error:
            self._fault = self._fault or OSError(error.errno, error.strerror, self._file.name)
            return size or 0

    def close(self) -> None:
        """Close the file below."""
        self._file.close()
        super().close()


@contextlib.contextmanager
def created(path: Path) -> Iterator[tuple[Any, Callable[[], None]]]:
    """A new HDF5 file, and a function that raises if the disk has refused a write; it is called at the end in any case.

    Whoever writes into the file does so `uninterrupted`.
    """
    sink = NewFile(path)
    try:
        with uninterrupted():
            file = h5py.File(sink, "w")
        try:
            yield file, sink.check
        finally:
            with uninterrupted():
                file.close()
        sink.check()
    finally:
        sink.close()


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C back until the block has ended: raised inside HDF5's calls to `NewFile` it would be lost, or leave the file in pieces."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: caught.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if caught:
        raise KeyboardInterrupt


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
