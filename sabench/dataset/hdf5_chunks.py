"""Rules of the chunks of HDF5 data sets, checked before the library decodes them.

HDF5 inflates a deflate stream to its end, whatever its chunk should hold: a file of some MB fills
gigabytes. A stream that ends early leaves a part of the chunk undefined.
"""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import Any

import h5py

from sabench.utils.errors import InputError

# filters that a data set may have, in this order, and the bit of each
_FILTERS = ((), (h5py.h5z.FILTER_DEFLATE,), (h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE))
_SPARE = 1024  # bytes by which a deflate stream may exceed 9/8 of what it holds


def check_storage(node: Any, where: str) -> None:
    """Check filters, and the stored size of every chunk; nothing is decoded.

    Raises
    ------
    InputError
        Another filter than deflate, or a chunk that cannot hold what its shape says.
    """
    plan = node.id.get_create_plist()
    filters = tuple(plan.get_filter(number)[0] for number in range(plan.get_nfilters()))
    if filters not in _FILTERS:
        names = [plan.get_filter(number)[3] for number in range(plan.get_nfilters())]
        got = ", ".join(name.decode("utf-8", "replace") for name in names)
        raise InputError(f"{where}: expected no filter but deflate, got {got}")
    if not node.chunks:
        return
    file_bytes = Path(node.file.filename).stat().st_size
    size, most = chunk_bytes(node), math.prod(map(_pieces, node.shape, node.chunks))
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

    Raises
    ------
    InputError
        A stream that is damaged, or whose length is not that of its chunk.
    """
    if not node.chunks:
        return
    plan = node.id.get_create_plist()
    filters = tuple(plan.get_filter(number)[0] for number in range(plan.get_nfilters()))
    size = chunk_bytes(node)
    for chunk in _chunks(node):
        if _deflated(filters, chunk) and not _holds(node, chunk.chunk_offset, size):
            raise InputError(
                f"{where}: expected a deflate stream of {size} bytes in every chunk, got another "
                f"at {list(chunk.chunk_offset)}"
            )


def chunk_bytes(node: Any) -> int:
    """Compute the size of a decoded chunk."""
    return int(math.prod(node.chunks) * node.id.get_type().get_size())


def _holds(node: Any, offset: tuple[int, ...], size: int) -> bool:
    _, stored = node.id.read_direct_chunk(offset)
    stream = zlib.decompressobj()
    try:
        made = len(stream.decompress(stored, size + 1))
    except zlib.error:
        return False
    return made == size and stream.eof


def _chunks(node: Any) -> list[Any]:
    found: list[Any] = []
    node.id.chunk_iter(found.append)
    return found


def _deflated(filters: tuple[int, ...], chunk: Any) -> bool:
    """Say whether a chunk is compressed: a writer leaves out what does not help."""
    return bool(filters) and not chunk.filter_mask >> (len(filters) - 1) & 1


def _pieces(size: int, piece: int) -> int:
    return -(-size // piece)
