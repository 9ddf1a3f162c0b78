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
from sabench.utils.arrays import F32, F64

Fold = Callable[
    [Any, Sequence[Any]], Any
]  # (drjit, one array of samples per camera) -> the plane's voxels


def sum_planes(rectified: F32, slab: Slab, grid: Grid, outside: float, out: F32) -> None:
    """Sum images as `cpu_kernels.sum_planes`, with exact maps.

    The exact maps replace the tiles' affine ones.
    """
    _sweep(rectified, slab, grid, outside, lambda dr, samples: sum(samples), out)


def multiply_planes(
    rectified: F32, slab: Slab, grid: Grid, outside: float, floor: float, out: F32
) -> None:
    """Multiply images as `cpu_kernels.multiply_planes`, with exact maps.

    The exact maps replace the tiles' affine ones.
    """
    _sweep(
        rectified,
        slab,
        grid,
        outside,
        lambda dr, samples: sum(dr.log2(dr.maximum(sample, floor)) for sample in samples),
        out,
    )


def _sweep(rectified: F32, slab: Slab, grid: Grid, outside: float, fold: Fold, out: F32) -> None:
    dr, types = backend.drjit()
    flat = [types.Float(image.ravel()) for image in rectified]
    height, width = out.shape[1:]
    index = dr.arange(types.UInt32, height * width)
    row = index // width
    u, v = _unit(types.Float(index - row * width), width), _unit(types.Float(row), height)
    dr.eval(u, v)
    maps = slab.positions(grid)
    for plane, target in enumerate(out):
        samples = [
            _sample(
                dr,
                types,
                image,
                slab.shape,
                [_horner(dr, types, c, slab.degree, u, v) for c in maps[camera, plane]],
                outside,
            )
            for camera, image in enumerate(flat)
        ]
        target[:] = np.asarray(fold(dr, samples)).reshape(height, width)


def _unit(index: Any, count: int) -> Any:
    return index * (2.0 / max(count - 1, 1)) - (1.0 if count > 1 else 0.0)


def _sample(
    dr: Any, types: Any, image: Any, shape: tuple[int, int], position: Sequence[Any], outside: float
) -> Any:
    """Sample one image bilinearly at positions (column, row).

    The result is `outside` beyond its pixel centres.
    """
    rows, columns = shape
    column, row = position
    inside = (column >= 0.0) & (row >= 0.0) & (column <= columns - 1.0) & (row <= rows - 1.0)
    left, top = (
        dr.minimum(types.Int32(dr.floor(column)), columns - 2),
        dr.minimum(types.Int32(dr.floor(row)), rows - 2),
    )
    right_share, bottom_share = column - types.Float(left), row - types.Float(top)
    corner = types.UInt32(top * columns + left)
    values = [
        dr.gather(types.Float, image, corner + offset, inside)
        for offset in (0, 1, columns, columns + 1)
    ]
    upper = dr.fma(right_share, values[1] - values[0], values[0])
    lower = dr.fma(right_share, values[3] - values[2], values[2])
    return dr.select(inside, dr.fma(bottom_share, lower - upper, upper), outside)


def _horner(dr: Any, types: Any, coefficients: F64, degree: int, u: Any, v: Any) -> Any:
    """Evaluate a bivariate polynomial of a total degree.

    Coefficients are opaque, so that all planes and cameras share one kernel.
    """
    result, start = None, len(coefficients)
    for power_v in range(degree, -1, -1):
        count = degree - power_v + 1
        start -= count
        line = None
        for c in reversed(coefficients[start : start + count]):
            value = dr.opaque(types.Float, float(c))
            line = value if line is None else dr.fma(line, u, value)
        result = line if result is None else dr.fma(result, v, line)
    return result
