"""Arrays of a page: joined, compressed and written as text."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

_ALIGNMENT = 8  # bytes: where arrays may begin
_NAMES = {"u1": "Uint8", "i2": "Int16", "u2": "Uint16", "i4": "Int32", "u4": "Uint32"}
_NAMES |= {"f4": "Float32"}


class Packer:
    """Collector of arrays; equal ones are stored once."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._known: dict[bytes, int] = {}
        self.index: list[list[Any]] = []

    def add(self, array: npt.NDArray[Any]) -> int:
        """Store an array; return its place in the index."""
        data = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        kind = _NAMES[data.dtype.str[1:]]
        content = data.tobytes()
        key = kind.encode() + content
        if key not in self._known:
            self._known[key] = len(self.index)
            self.index.append([kind, self._size, data.size])
            padded = content + bytes(-len(content) % _ALIGNMENT)
            self._parts.append(padded)
            self._size += len(padded)
        return self._known[key]

    def text(self) -> str:
        """Compress everything by deflate, and write it in base 64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode()
