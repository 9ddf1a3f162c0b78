"""Untrusted HDF5 files: no outside links; shapes, kinds and chunks checked.

HDF5 inflates a deflate stream to its end, even beyond the size of its chunk: a file of some MB
fills gigabytes. A stream that ends early leaves a part of the chunk undefined.
"""

import contextlib
import io
import math
import signal
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.files import LARGEST_DATA, LARGEST_TEXT

# filters that a data set may have, in this order, and the bit of each
_FILTERS = ((), (h5py.h5z.FILTER_DEFLATE,), (h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE))
_SPARE = 1024  # bytes by which a deflate stream may exceed 9/8 of what it holds


def check_storage(node: Any, where: str) -> None:
    """Check filters, and the stored size of every chunk; nothing is decoded.

    Raises InputError for another filter than deflate, or a chunk that cannot hold what its shape
    says.
    """
    filters, names = _filters(node)
    if filters not in _FILTERS:
        got = ", ".join(name.decode("utf-8", "replace") for name in names)
        raise InputError(f"{where}: expected no filter but deflate, got {got}")
    if not node.chunks:
        return
    file_bytes = Path(node.file.filename).stat().st_size
    pieces = (-(-length // part) for length, part in zip(node.shape, node.chunks, strict=True))
    size, most = chunk_bytes(node), math.prod(pieces)
    chunks = _chunks(node)
    if len(chunks) > most:
        raise InputError(f"{where}: expected at most {most} chunks, got {len(chunks)}")
    for chunk in chunks:
        largest = size + size // 8 + _SPARE if _deflated(filters, chunk) else size
        fits = chunk.byte_offset is not None and chunk.byte_offset + chunk.size <= file_bytes
        if not fits or chunk.size > largest or (largest == size and chunk.size != size):
            raise InputError(
                f"{where}: expected chunks of {size} bytes in this file, got one of {chunk.size} "
                f"stored bytes at {list(chunk.chunk_offset)}"
            )


def check_streams(node: Any, where: str) -> None:
    """Check that every deflate stream holds one chunk, neither more nor less.

    It takes the memory of one chunk. `check_storage` comes before.

    Raises InputError for a damaged stream, or one of another length than its chunk.
    """
    if not node.chunks:
        return
    filters, size = _filters(node)[0], chunk_bytes(node)
    for chunk in _chunks(node):
        if not _deflated(filters, chunk):
            continue
        stream = zlib.decompressobj()
        try:
            stored = node.id.read_direct_chunk(chunk.chunk_offset)[1]
            intact = len(stream.decompress(stored, size + 1)) == size and stream.eof
        except zlib.error:
            intact = False
        if not intact:
            raise InputError(
                f"{where}: expected a deflate stream of {size} bytes in every chunk, got another "
                f"at {list(chunk.chunk_offset)}"
            )


def chunk_bytes(node: Any) -> int:
    """Compute the size of a decoded chunk."""
    return int(math.prod(node.chunks) * node.id.get_type().get_size())


def _filters(node: Any) -> tuple[tuple[int, ...], tuple[bytes, ...]]:
    """List the numbers and the names of filters."""
    plan = node.id.get_create_plist()
    every = [plan.get_filter(number) for number in range(plan.get_nfilters())]
    return tuple(one[0] for one in every), tuple(one[3] for one in every)


def _chunks(node: Any) -> list[Any]:
    found: list[Any] = []
    node.id.chunk_iter(found.append)
    return found


def _deflated(filters: tuple[int, ...], chunk: Any) -> bool:
    """Return whether a chunk is compressed: a writer leaves out what does not help."""
    return bool(filters) and not chunk.filter_mask >> (len(filters) - 1) & 1


_DENSEST = 1100  # deflate makes at best 1 byte of 1032


@contextlib.contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """Open an HDF5 file for reading; faults inside are InputErrors that name it."""
    if not path.is_file():
        raise InputError(f"{path}: expected an HDF5 file, found none")
    with name_faults(path), h5py.File(path, "r") as file:
        yield file


@contextlib.contextmanager
def name_faults(path: Path) -> Iterator[None]:
    """Turn any fault of the HDF5 library into an InputError that names the file."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        other = "file signature not found" in str(error)
        known = "another kind of file (sabench import-result makes results of tables)"
        got = known if other else f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: expected an intact HDF5 file, got {got}") from error


class NewFile(io.RawIOBase):
    """File that HDF5 writes through, which keeps the first refused write.

    HDF5 does not survive a refused write: it crashes the process when it closes. So every write
    reports success to HDF5, and `check` raises the refusal where Python can handle it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._file = path.open("w+b", buffering=0)
        self._fault: OSError | None = None

    def check(self) -> None:
        """Raise the first write that the system has refused, if any."""
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
        """Read back; bytes of refused writes read as zeros."""
        view = memoryview(buffer).cast("B")
        count = self._file.readinto(view) or 0
        view[count:] = bytes(len(view) - count)
        return len(view)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move the position in the file."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the position in the file."""
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
def create_hdf5(path: Path) -> Iterator[tuple[Any, Callable[[], None]]]:
    """Create an HDF5 file; also give a function that raises refused writes.

    The function is called at the end in any case. Write into the file in `delay_interrupts` blocks
    only.
    """
    sink = NewFile(path)
    try:
        with delay_interrupts():
            file = h5py.File(sink, "w")
        try:
            yield file, sink.check
        finally:
            with delay_interrupts():
                file.close()
        sink.check()
    finally:
        sink.close()


@contextlib.contextmanager
def delay_interrupts() -> Iterator[None]:
    """Delay Ctrl-C until the block has ended.

    An interrupt inside HDF5's calls to `NewFile` would be lost, or damage the file.
    """
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
    """Read a data set of that shape (None: any length) and numpy kind letters.

    It must lie inside this file, not behind a link to another one.

    Shape, type and size are checked before a value is read: a small file can claim to hold more
    than any memory.
    """
    where = f"{file.filename}: {name}"
    node = find_array(file, name, shape, kind)
    is_open = None in shape
    size, stored = int(node.nbytes), int(node.id.get_storage_size())
    available = memory.available_mb()
    if available is not None and 2.0 * size / 1e6 > available:
        raise InputError(
            f"{where}: expected values that fit into memory, but {node.shape} of {node.dtype} need "
            f"{2.0 * size / 1e6:.0f} MB"
        )
    if is_open and size > LARGEST_DATA:
        raise InputError(
            f"{where}: expected at most {LARGEST_DATA / 1e6:.0f} MB of values, got {node.shape} of "
            f"{node.dtype}"
        )
    if is_open and size > LARGEST_TEXT and size > _DENSEST * stored:
        raise InputError(
            f"{where}: expected values that the file stores, got {node.shape} of {node.dtype} in "
            f"{stored} bytes"
        )
    piece = chunk_bytes(node) if node.chunks else 0
    if piece > max(LARGEST_TEXT, 2 * size):
        raise InputError(
            f"{where}: expected chunks no larger than the data set, got {node.chunks} of "
            f"{node.dtype} for shape {node.shape}"
        )
    check_streams(node, where)
    return np.asarray(node[...])


def find_array(file: Any, name: str, shape: tuple[int | None, ...], kind: str) -> Any:
    """Find a data set as `read_array` does, to read parts of it; cost is not checked."""
    where = f"{file.filename}: {name}"
    node = _node(file, name, where)
    if not isinstance(node, h5py.Dataset) or node.is_virtual or node.external:
        raise InputError(f"{where}: expected a data set with its values in this file")
    got, dtype = node.shape, _dtype(node, where)
    fits = (
        got is not None
        and len(got) == len(shape)
        and all(want in (None, have) for want, have in zip(shape, got, strict=True))
    )
    if not fits or dtype.kind not in kind or dtype.itemsize > 8:
        expected = "(" + ", ".join("n" if want is None else str(want) for want in shape) + ")"
        raise InputError(f"{where}: expected shape {expected} of kind {kind}, got {got} of {dtype}")
    check_storage(node, where)
    return node


def walk(path: Path) -> None:
    """Read all names, shapes, chunks and attributes of a file, but no values.

    It finds damaged files on which the library loops for ever.
    """

    def look(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and node.shape is not None:
            check_storage(node, f"{path}: {name}")

    with open_hdf5(path) as file:
        for name in file.attrs:
            identity = file.attrs.get_id(name)
            if identity.shape == () and identity.get_storage_size() <= LARGEST_TEXT:
                file.attrs[name]
        file.visititems(look)


def names_in(file: Any, group: str) -> set[str]:
    """List the members of a group of this file; nothing without such a group."""
    node = file
    for part in group.split("/"):
        link = node.get(part, getlink=True)
        node = node[part] if isinstance(link, h5py.HardLink) else None
        if not isinstance(node, h5py.Group):
            return set()
    return set(node)


def read_attributes(file: Any, names: Iterable[str]) -> dict[str, Any]:
    """Read attributes of the file's root as single strings and numbers.

    Other languages write strings of fixed length, and arrays of one element for single values; both
    are accepted.
    """
    return {name: _attribute(file, name) for name in names if name in file.attrs}


def _attribute(file: Any, name: str) -> Any:
    where = f"{file.filename}: attribute {name}"
    identity = file.attrs.get_id(name)
    dtype = _dtype(identity, where)
    single = identity.shape is not None and math.prod(identity.shape) == 1
    if not single or dtype.kind not in "iufbSO" or dtype.itemsize > LARGEST_TEXT:
        raise InputError(
            f"{where}: expected one string or number, got {dtype} of shape {identity.shape}"
        )
    value = file.attrs[name]
    value = np.asarray(value).reshape(-1)[0] if isinstance(value, np.ndarray) else value
    value = value.item() if isinstance(value, np.generic) else value
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    if not isinstance(value, str | int | float) or len(str(value)) > LARGEST_TEXT:
        raise InputError(
            f"{where}: expected one string or number of at most {LARGEST_TEXT} characters, got "
            f"{type(value).__name__}"
        )
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value


def _node(file: Any, name: str, where: str) -> Any:
    """Find the object of that name, reached by hard links alone."""
    node = file
    for part in name.split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if not isinstance(link, h5py.HardLink):
            raise InputError(
                f"{where}: expected a data set in this file, found {'a link' if link else 'none'}"
            )
        node = node[part]
    return node


def _dtype(node: Any, where: str) -> np.dtype[Any]:
    try:
        dtype: np.dtype[Any] = np.dtype(node.dtype)
    except TypeError as error:  # HDF5 has types that numpy does not have
        raise InputError(
            f"{where}: expected numbers or text, got a type that numpy does not have: {error}"
        ) from error
    return dtype
