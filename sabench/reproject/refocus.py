"""Synthetic aperture refocusing: all cameras' views of every voxel, added or multiplied; by numba on the CPU, by Dr.Jit on a GPU."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import numpy as np

from sabench import backend
from sabench.arrays import F32, F64
from sabench.optics.camera import Camera
from sabench.progress import track
from sabench.reproject import device, kernels
from sabench.reproject.rectify import resample, spline_coefficients
from sabench.reproject.slabs import Slab, rectifying_maps, slabs
from sabench.volume import Grid


def refocus_sum(images: F32, cameras: Sequence[Camera], grid: Grid, *, outside: float = 0.0) -> F32:
    """The sum over cameras of their images at every voxel: (z, y, x).

    Parameters
    ----------
    images : (camera, row, column).
    outside : value of a camera's image at voxels that it does not see.

    Source: thesis, equation 3.3, times N. Images are resampled once per slab by cubic B-splines, then bilinearly: at most
    `slabs.DEVIATION_PX` from exact positions.

    Raises
    ------
    ValueError
        Some of the grid has no light path to a camera.
    """
    volume = np.empty(grid.shape, dtype=np.float32)
    for slab, rectified, part in _parts(images, cameras, grid, outside, volume):
        if _on_device():
            device.sum_planes(rectified, slab, grid, outside, part)
        else:
            kernels.sum_planes(rectified, slab.tiles(grid), outside, part)
    return volume


def refocus_log2(images: F32, cameras: Sequence[Camera], grid: Grid, floor: float, *, outside: float = 0.0) -> F32:
    """The sum over cameras of log2 of their images, raised to `floor` at least, at every voxel: (z, y, x); arguments as for `refocus_sum`.

    Two to the power of n times it is the product of equation 3.4 of the thesis.
    """
    volume, largest = np.empty(grid.shape, dtype=np.float32), float(max(images.max(initial=0.0), outside, 1.0))
    for slab, rectified, part in _parts(images, cameras, grid, outside, volume):
        if _on_device():
            device.multiply_planes(rectified, slab, grid, outside, floor, part)
        else:
            kernels.multiply_planes(rectified, slab.tiles(grid), outside, floor, 2.0 * largest, part)
    return volume


def _parts(images: F32, cameras: Sequence[Camera], grid: Grid, outside: float, volume: F32) -> Iterator[tuple[Slab, F32, F32]]:
    """Every slab with its rectified images (camera, height, width) and its part of the volume."""
    coefficients = spline_coefficients(images)
    for slab, maps, degree in track(_geometry(tuple(cameras), grid), f"refocus, {len(cameras)} cameras"):
        rectified = np.empty((len(images), *slab.shape), dtype=np.float32)
        resample(coefficients, maps, degree, outside, rectified)
        yield slab, rectified, volume[slab.first : slab.first + slab.count]


@functools.lru_cache(maxsize=2)
def _geometry(cameras: tuple[Camera, ...], grid: Grid) -> list[tuple[Slab, F64, int]]:
    """Slabs and the maps that rectify for them: the same for all frames of an array."""
    return [(slab, *rectifying_maps(slab, cameras, grid)) for slab in slabs(cameras, grid)]


def _on_device() -> bool:
    return backend.choose().kind == "cuda"
