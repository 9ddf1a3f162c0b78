"""First guesses of the voxels that can hold light, and of their light."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.algorithms.tomography.kernels import KernelGeometry, locate, sample, scratch
from sabench.algorithms.tomography.projection_operator import Support
from sabench.utils.arrays import F32, I64
from sabench.utils.compiled import numba
from sabench.utils.progress import progress_bar

_SLAB = 8_000_000  # voxels whose memory is taken at a time
# of voxels, in which one camera after the other is looked up: its part of the image stays in the
# cache
_ROWS = 32


def product_guess(geometry: KernelGeometry, images: F32, threshold: float) -> tuple[Support, F32]:
    """Find the voxels where every camera that sees them has light, and their product.

    The product of these cameras' values is raised to one over their number.

    Parameters
    ----------
    geometry : its interpolation samples the images: linear gives MLOS, the nearest pixel MFG.
    images : (camera, row, column).
    threshold : darker pixels are black.

    Sources: Atkinson and Soria (2009) for MLOS, Worth and Nickels (2008) for MFG; thesis section
    3.2. Voxels that no camera sees are left out.
    """
    planes, shape = geometry.maps.shape[1], (geometry.height, geometry.width)
    step = max(1, _SLAB // (shape[0] * shape[1]))
    flat = images.reshape(len(images), -1)
    kept = [
        _slab(geometry, flat, threshold, first, min(step, planes - first))
        for first in progress_bar(range(0, planes, step), "first guess")
    ]
    counts, x, values = (np.concatenate(part) for part in zip(*kept, strict=True))
    return Support((planes, *shape), np.concatenate([[0], np.cumsum(counts)]), x), values


def every_voxel(geometry: KernelGeometry) -> tuple[Support, F32]:
    """Return all voxels, all equally bright."""
    rows = geometry.maps.shape[1] * geometry.height
    x = np.tile(np.arange(geometry.width, dtype=_index_type(geometry.width)), rows)
    return Support(
        (geometry.maps.shape[1], geometry.height, geometry.width),
        np.arange(rows + 1) * geometry.width,
        x,
    ), np.ones(len(x), dtype=np.float32)


def _index_type(width: int) -> type[np.signedinteger]:
    return np.int16 if width < 1 << 15 else np.int32


def _slab(
    geometry: KernelGeometry, images: F32, threshold: float, first: int, planes: int
) -> tuple[I64, npt.NDArray[np.signedinteger], F32]:
    """List the voxels of some planes.

    Returns their number in each row, their x indices and their values.
    """
    rows = planes * geometry.height
    x, values = (
        np.empty((rows, geometry.width), dtype=_index_type(geometry.width)),
        np.empty((rows, geometry.width), dtype=np.float32),
    )
    counts = np.empty(rows, dtype=np.int64)
    _multiply_rows(geometry, images, threshold, first * geometry.height, x, values, counts)
    start = np.concatenate([[0], np.cumsum(counts)])
    packed = np.empty(start[-1], dtype=x.dtype), np.empty(start[-1], dtype=np.float32)
    _pack(start, x, values, *packed)
    return counts, *packed


@numba.njit(cache=True, parallel=True)
def _pack(start: Any, x: Any, values: Any, packed_x: Any, packed_values: Any) -> None:
    for row in numba.prange(len(start) - 1):
        for i in range(start[row + 1] - start[row]):
            packed_x[start[row] + i] = x[row, i]
            packed_values[start[row] + i] = values[row, i]


@numba.njit(cache=True, parallel=True)
def _multiply_rows(
    geometry: Any, images: Any, threshold: float, first: int, x: Any, values: Any, counts: Any
) -> None:
    """Multiply rows, and move survivors to the beginning.

    Also fills in the survivors' number in every row.
    """
    for block in numba.prange((len(x) + _ROWS - 1) // _ROWS):
        top, end = block * _ROWS, min((block + 1) * _ROWS, len(x))
        _multiply_block(
            geometry, images, threshold, first + top, x[top:end], values[top:end], counts[top:end]
        )


@numba.njit(cache=True)
def _multiply_block(
    geometry: Any, images: Any, threshold: float, first: int, x: Any, values: Any, counts: Any
) -> None:
    """Multiply rows of voxels by the images of one camera after the other."""
    work, product, seen = scratch(geometry), np.ones(x.shape), np.zeros(x.shape, dtype=np.int32)
    for row in range(len(x)):
        counts[row] = geometry.width
        for i in range(geometry.width):
            x[row, i] = i
    for camera in range(len(images)):
        for row in range(len(x)):
            left = counts[row]
            counts[row] = _multiply_camera(
                geometry,
                images[camera],
                threshold,
                camera,
                first + row,
                left,
                work,
                x[row],
                product[row],
                seen[row],
            )
    for row in range(len(x)):
        counts[row] = _take_root(counts[row], x[row], product[row], seen[row], values[row])


@numba.njit(cache=True)
def _multiply_camera(
    geometry: Any,
    image: Any,
    threshold: float,
    camera: int,
    row: int,
    left: int,
    work: Any,
    x: Any,
    product: Any,
    seen: Any,
) -> int:
    """Multiply one camera's samples to the first `left` voxels.

    Voxels that the camera sees black are removed. Returns the number of the others.
    """
    base, across, down = locate(geometry, camera, row, x[:left], work)
    kept = 0
    for i in range(left):
        light, counts = np.float32(1.0), 0
        if base[i] >= 0:
            light, counts = sample(image, geometry.columns, base[i], across[i], down[i]), 1
        x[kept], product[kept], seen[kept] = x[i], product[i] * light, seen[i] + counts
        kept += int(
            light >= threshold
            # whatever comes next is written over what was black: cheaper than a branch that cannot
            # be
            # foreseen
        )
    return kept


@numba.njit(cache=True)
def _take_root(left: int, x: Any, product: Any, seen: Any, values: Any) -> int:
    """Take the root of the product for the voxels that any camera sees.

    Returns their number.
    """
    kept = 0
    for i in range(left):
        if seen[i] > 0:
            x[kept], values[kept] = x[i], product[i] ** (1.0 / seen[i])
            kept += 1
    return kept
