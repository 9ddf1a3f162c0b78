"""Image files: 16-bit TIFF as a camera gives them, EXR for radiance."""

import io
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.utils.arrays import F32, U16
from sabench.utils.errors import InputError

_MAGIC, _SCAN_LINES, _ZIP = 20000630, 2, 3  # of an EXR with one part; its compression
_LONGEST_HEADER = 1 << 16  # bytes of an EXR file
# name, type (32-bit float), linear, reserved, steps along x and y; end of the list
_CHANNEL_Y = b"Y\0" + struct.pack("<iB3xii", 2, 0, 1, 1) + b"\0"


def write_tiff(path: Path, image: U16) -> None:
    """Write grey values (rows, columns) as a reproducible uncompressed 16-bit TIFF."""
    import tifffile

    # written in one piece: a full disk is then the system's own error, with its reason
    memory = io.BytesIO()
    tifffile.imwrite(memory, image, photometric="minisblack", metadata=None, software=False)
    path.write_bytes(memory.getvalue())


def read_tiff(path: Path, shape: tuple[int, int]) -> U16:
    """Read the grey values of a 16-bit TIFF of that shape; others are an InputError.

    Nothing is decoded unless the tags are those of the format: one uncompressed page in strips.
    """
    import tifffile

    if not path.is_file():
        raise InputError(f"{path}: expected an image, found no such file")
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            _check_page(path, page, shape, len(file.pages))
            image = np.asarray(page.asarray())
    except InputError:
        raise
    except Exception as error:  # what its parsers raise: struct, index, zlib, value errors
        raise InputError(
            f"{path}: expected an intact TIFF file, got {type(error).__name__}: {error}"
        ) from error
    if image.dtype != np.uint16 or image.shape != shape:
        got = f"{image.dtype} of shape {image.shape}"
        raise InputError(f"{path}: expected 16-bit grey values of shape {shape}, got {got}")
    return image


def _check_page(path: Path, page: Any, shape: tuple[int, int], pages: int) -> None:
    if page.dtype != np.uint16 or page.shape != shape or pages != 1:
        more = f" and {pages - 1} more" if pages > 1 else ""
        got = f"{page.dtype} of shape {page.shape}{more}"
        raise InputError(f"{path}: expected 16-bit grey values of shape {shape}, got {got}")
    rules: tuple[tuple[str, int, int], ...] = (
        ("compression", int(page.compression), 1),
        ("photometric interpretation", int(page.photometric), 1),
        ("predictor", int(page.predictor), 1),
        ("bits per sample", page.bitspersample, 16),
        ("samples per pixel", page.samplesperpixel, 1),
        ("order of bits", page.fillorder, 1),
        ("tiles", int(page.is_tiled), 0),
        ("bytes of image data", sum(page.databytecounts), 2 * shape[0] * shape[1]),
    )
    for name, value, expected in rules:
        if value != expected:
            raise InputError(
                f"{path}: expected an uncompressed 16-bit TIFF in strips, 0 black: expected "
                f"{name} {expected}, got {value}"
            )


def write_exr(path: Path, radiance: F32) -> None:
    """Write photon radiance (rows, columns) as an EXR with one 32-bit channel Y."""
    write_exr_channels(path, {"Y": radiance})


def write_exr_channels(path: Path, channels: Mapping[str, npt.ArrayLike]) -> None:
    """Write images (rows, columns) as the named 32-bit channels of one EXR."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    arrays = {key: np.ascontiguousarray(image, dtype=np.float32) for key, image in channels.items()}
    try:
        with OpenEXR.File(header, arrays) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(f"{path}: {error}") from error


def read_exr(path: Path, shape: tuple[int, int]) -> F32:
    """Read the photon radiance of an EXR of that shape.

    Nothing is decoded unless the header is that of the format. Other or damaged files, and negative
    or infinite radiance, are an InputError.
    """
    import OpenEXR

    if not path.is_file():
        raise InputError(f"{path}: expected an image, found no such file")
    _check_header(path, shape)
    try:
        with OpenEXR.File(str(path)) as file:
            image = np.asarray(file.channels()["Y"].pixels)
    except Exception as error:  # OpenEXR reports every fault as a RuntimeError or a KeyError
        raise InputError(
            f"{path}: expected an intact EXR file with a channel Y, got {type(error).__name__}: "
            f"{error}"
        ) from error
    if image.dtype != np.float32 or image.shape != shape:
        raise InputError(
            f"{path}: expected 32-bit values of shape {shape}, got {image.dtype} of shape "
            f"{image.shape}"
        )
    bad = image.size - int(np.count_nonzero((image >= 0.0) & np.isfinite(image)))
    if bad:
        raise InputError(
            f"{path}: expected finite radiance, 0 or more, got {bad} pixels that are negative, NaN "
            "or infinite"
        )
    return image


def _check_header(path: Path, shape: tuple[int, int]) -> None:
    """Check that a file has one part with one 32-bit channel, of that shape."""
    try:
        header = read_exr_header(path)
    except (ValueError, struct.error) as error:
        raise InputError(f"{path}: expected an intact EXR file, got {error}") from error
    rows, columns = shape
    window = struct.pack("<4i", 0, 0, columns - 1, rows - 1)
    rules = (
        ("channels", _CHANNEL_Y, "one channel Y of 32-bit floats"),
        ("compression", bytes([_ZIP]), "ZIP compression"),
        ("dataWindow", window, f"32-bit values of shape {shape}"),
    )
    for name, value, expected in rules:
        got = header.get(name)
        if got == value:
            continue
        shown = "missing" if got is None else repr(got[:40])
        if got is not None and name == "dataWindow" and len(got) == len(window):
            left, top, right, bottom = struct.unpack("<4i", got)
            shown = f"of shape {(bottom - top + 1, right - left + 1)} from {(left, top)}"
        raise InputError(f"{path}: expected {expected}, got {name} {shown}")


def read_exr_header(path: Path) -> dict[str, bytes]:
    """Read the attributes of an EXR file with one part of scan lines, undecoded.

    Source: https://openexr.com/en/latest/OpenEXRFileLayout.html. Other and damaged files are a
    ValueError or a struct.error.
    """
    with path.open("rb") as file:
        data = file.read(_LONGEST_HEADER)
    magic, version = struct.unpack_from("<iI", data)
    if magic != _MAGIC:
        raise ValueError("another kind of file")
    if version != _SCAN_LINES:
        raise ValueError(f"version and flags {version:#x} where one part of scan lines has 0x2")
    header: dict[str, bytes] = {}
    at = 8
    while data[at : at + 1] != b"\0":
        name, kind = data.index(b"\0", at), data.index(b"\0", data.index(b"\0", at) + 1)
        (size,) = struct.unpack_from("<i", data, kind + 1)
        end = kind + 5 + size
        if not kind + 5 <= end < len(data):
            raise ValueError(f"a header beyond {len(data)} bytes")
        header[data[at:name].decode("latin-1")] = data[kind + 5 : end]
        at = end
    return header
