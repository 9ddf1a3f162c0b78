"""Refocusing in Dr.Jit, for GPUs.

Each sample is a gather. Slabs and rectified images are those of the CPU, and so are the volumes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sabench.algorithms.refocus.slabs import Slab
from sabench.geometry.grid import Grid
from sabench.utils import backend
from sabench.utils.arrays import F32
from sabench.utils.compiled import numba

_AT_ONCE = 1 << 24  # voxels computed at once: bounds the device's memory
# (drjit, one array of samples per camera) -> the plane's voxels
Fold = Callable[[Any, Sequence[Any]], Any]


def sum_planes(rectified: F32, slab: Slab, grid: Grid, outside: float, out: F32) -> None:
    """Sum images as `cpu_kernels.sum_planes`, with exact maps, not affine ones."""
    _sweep(rectified, slab, grid, outside, lambda dr, samples: sum(samples), out)


def multiply_planes(
    rectified: F32, slab: Slab, grid: Grid, outside: float, floor: float, out: F32
) -> None:
    """Multiply images as `cpu_kernels.multiply_planes`, with exact maps."""

    def fold(dr: Any, samples: Sequence[Any]) -> Any:
        return sum(dr.log2(dr.maximum(sample, floor)) for sample in samples)

    _sweep(rectified, slab, grid, outside, fold, out)


def _sweep(rectified: F32, slab: Slab, grid: Grid, outside: float, fold: Fold, out: F32) -> None:
    dr, types = backend.drjit()
    flat = [types.Float(image.ravel()) for image in rectified]
    maps = np.ascontiguousarray(slab.positions(grid), dtype=np.float32)
    table = types.Float(maps.ravel())  # (camera, plane, column or row, term)
    height, width = out.shape[1:]
    some = max(1, _AT_ONCE // (height * width))
    for first in range(0, len(out), some):
        part = out[first : first + some]
        index = dr.arange(types.UInt32, part.size)
        line = index // width
        plane = line // height
        u = _unit(types.Float(index - line * width), width)
        v = _unit(types.Float(line - plane * height), height)
        plane += dr.opaque(types.UInt32, first)
        samples = []
        for camera, image in enumerate(flat):
            start = (plane + camera * len(out)) * (2 * maps.shape[-1])
            position = [
                _polynomial(dr, types, table, start + axis * maps.shape[-1], slab.degree, u, v)
                for axis in (0, 1)
            ]
            samples.append(_sample(dr, types, image, slab.shape, position, outside))
        found = np.asarray(fold(dr, samples))
        _keep(found.reshape(-1, width), part.reshape(-1, width))


@numba.njit(parallel=True, cache=True)
def _keep(values: Any, out: Any) -> None:  # pragma: no cover
    """Copy rows with all cores: one core takes longer for a volume than the device."""
    for row in numba.prange(len(out)):
        for column in range(out.shape[1]):
            out[row, column] = values[row, column]


def _unit(index: Any, count: int) -> Any:
    return index * (2.0 / max(count - 1, 1)) - (1.0 if count > 1 else 0.0)


def _sample(
    dr: Any, types: Any, image: Any, shape: tuple[int, int], position: Sequence[Any], outside: float
) -> Any:
    """Sample an image bilinearly at positions (column, row).

    Beyond the centres of the border's pixels, the value is `outside`.
    """
    rows, columns = shape
    column, row = position
    inside = (column >= 0.0) & (row >= 0.0) & (column <= columns - 1.0) & (row <= rows - 1.0)
    left = dr.minimum(types.Int32(dr.floor(column)), columns - 2)
    top = dr.minimum(types.Int32(dr.floor(row)), rows - 2)
    right_share, bottom_share = column - types.Float(left), row - types.Float(top)
    corner = types.UInt32(top * columns + left)
    values = [
        dr.gather(types.Float, image, corner + offset, inside)
        for offset in (0, 1, columns, columns + 1)
    ]
    upper = dr.fma(right_share, values[1] - values[0], values[0])
    lower = dr.fma(right_share, values[3] - values[2], values[2])
    return dr.select(inside, dr.fma(bottom_share, lower - upper, upper), outside)


def _polynomial(dr: Any, types: Any, table: Any, start: Any, degree: int, u: Any, v: Any) -> Any:
    """Evaluate bivariate polynomials whose terms start at places (n,) of a table."""
    result, place = None, (degree + 1) * (degree + 2) // 2
    for power_v in range(degree, -1, -1):
        line = None
        for _ in range(degree - power_v + 1):
            place -= 1
            value = dr.gather(types.Float, table, start + place)
            line = value if line is None else dr.fma(line, u, value)
        result = line if result is None else dr.fma(result, v, line)
    return result
