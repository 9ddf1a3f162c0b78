"""Image files: 16-bit TIFF as a camera gives them, EXR for radiance."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from sabench.utils.arrays import F32, U16
from sabench.utils.errors import InputError


def write_tiff(path: Path, image: U16) -> None:
    """Encode grey values (rows, columns) as an uncompressed 16-bit TIFF.

    The bytes are the same for the same image.
    """
    import tifffile

    memory = (
        io.BytesIO()
    )  # written in one piece: a full disk is then the system's own error, with its reason
    tifffile.imwrite(memory, image, photometric="minisblack", metadata=None, software=False)
    path.write_bytes(memory.getvalue())


def read_tiff(path: Path, shape: tuple[int, int]) -> U16:
    """Read the grey values of a 16-bit TIFF of that shape.

    Otherwise raises InputError that names the file.
    """
    import tifffile

    if not path.is_file():
        raise InputError(f"{path}: expected an image, found no such file")
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            image = (
                page.asarray() if _fits(page, np.uint16, shape) and len(file.pages) == 1 else None
            )
            got = f"{page.dtype} of shape {page.shape}" + (
                f" and {len(file.pages) - 1} more" if len(file.pages) > 1 else ""
            )
    except (
        Exception
    ) as error:  # tifffile raises what its parsers raise: struct, index, zlib, value errors
        raise InputError(
            f"{path}: expected an intact TIFF file, got {type(error).__name__}: {error}"
        ) from error
    if image is None or not _fits(image, np.uint16, shape):
        raise InputError(f"{path}: expected 16-bit grey values of shape {shape}, got {got}")
    return np.asarray(image)


def _fits(values: Any, kind: Any, shape: tuple[int, int]) -> bool:
    return bool(values.dtype == kind and values.shape == shape)


def write_exr(path: Path, radiance: F32) -> None:
    """Write photon radiance (rows, columns) as an EXR with one 32-bit channel Y."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        with OpenEXR.File(header, {"Y": np.ascontiguousarray(radiance, dtype=np.float32)}) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(f"{path}: {error}") from error


def read_exr(path: Path, shape: tuple[int, int]) -> F32:
    """Read the photon radiance of an EXR of that shape.

    Otherwise raises InputError that names the file.
    """
    import OpenEXR

    if not path.is_file():
        raise InputError(f"{path}: expected an image, found no such file")
    try:
        with OpenEXR.File(
            str(path), header_only=True
        ) as file:  # what the file says of its size comes before what it costs to believe it
            low, high = file.header()["dataWindow"]
            size = (int(high[1]) - int(low[1]) + 1, int(high[0]) - int(low[0]) + 1)
        if size != shape:
            raise InputError(
                f"{path}: expected 32-bit values of shape {shape}, got an image of shape {size}"
            )
        with OpenEXR.File(str(path)) as file:
            image = file.channels()["Y"].pixels
    except InputError:
        raise
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
    return np.asarray(image)
