"""Finer grid for following lines of sight, from and to the requested grid.

The footprint of a voxel is that of a point. Along an axis where one step moves the projection by
more than about a pixel, voxels are split. In the result, each fine voxel is a blob of light that
projects to the footprint, and the volume holds the light of all blobs in each voxel.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.tomography.projection_operator import Support
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.images.gaussians import gaussian_shares
from sabench.images.levels import ILLUMINATED, PERCENTILE
from sabench.utils.arrays import F32, F64, triple
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import on_cores

_TRAVEL_PX = 1.25  # largest distance between the projections of two neighbouring voxels
_REACH = 3.0  # radius of a blob, standard deviations
_FAINTEST = 0.01
_MOST = 20.0  # typical voxels that the brightest one counts at most
_BITS = 18  # of a float32 that are left out of its class: 32 classes an octave


Splits = tuple[int, int, int]  # fine voxels per voxel along x, y and z


@dataclass(frozen=True)
class Scale:
    """Size of a grid's steps in the cameras.

    Attributes
    ----------
    travel_px : along x, y and z, by how much one step of the grid moves the projection, in the
        camera that sees it move most.
    px_per_mm : magnification, mean over cameras.
    """

    travel_px: tuple[float, float, float]
    px_per_mm: float


def scale_of(cameras: Sequence[CameraModel], grid: Grid) -> Scale:
    """Measure the scale in the middle of the grid.

    Raises
    ------
    ValueError
        A camera has no light path to it.
    """
    middle = np.array([(axis[0] + axis[-1]) / 2.0 for axis in grid.axes_mm])
    ends = middle + np.concatenate([np.eye(3), -np.eye(3)]) * np.asarray(grid.voxel_mm) / 2.0
    projections = [camera.project(ends) for camera in cameras]
    for camera, (_, valid) in zip(cameras, projections, strict=True):
        if not valid.all():
            raise ValueError(
                f"{camera.name}: expected a light path to every voxel, but the middle of the grid "
                "has none"
            )
    pixels = np.stack([pixels for pixels, _ in projections])
    steps = pixels[:, :3] - pixels[:, 3:]
    by_mm = steps / np.asarray(grid.voxel_mm)[:, None]
    magnification = float(np.linalg.svd(by_mm, compute_uv=False)[:, 0].mean())
    return Scale(triple(np.linalg.norm(steps, axis=2).max(axis=0)), magnification)


def splits(scale: Scale) -> Splits:
    """Choose into how many fine voxels a voxel is split along each axis."""
    x, y, z = (max(1, int(np.ceil(travel / _TRAVEL_PX))) for travel in scale.travel_px)
    return x, y, z


def split(grid: Grid, count: Splits) -> Grid:
    """Make the grid of the fine voxels, which fills the same box."""
    step, parts = np.asarray(grid.voxel_mm), np.asarray(count)
    low = np.asarray(grid.low_mm) - step / 2.0 + step / parts / 2.0
    z, y, x = (int(n * k) for n, k in zip(grid.shape, count[::-1], strict=True))
    return Grid(triple(low), triple(step / parts), (z, y, x))


def gather(support: Support, values: F32, grid: Grid, count: Splits, sigma_mm: float) -> F32:
    """Return the volume (z, y, x) of Gaussian blobs of `sigma_mm`, points if it is 0."""
    x, y, z = (_profile(k, sigma_mm / step) for k, step in zip(count, grid.voxel_mm, strict=True))
    volume = np.zeros(grid.shape, dtype=np.float32)
    fine = support.start, support.x, values, *support.shape[1:]
    on_cores(_gather, math.prod(grid.shape[:2]), fine, (x, y, z), volume)
    return volume


def _profile(count: int, sigma: float) -> F32:
    """Compute shares (count, 2 radius + 1) of a blob in the voxels around its own.

    They are shares of its light.

    The rows are its positions among the fine voxels there; `sigma` is in voxels of the grid.
    """
    centre = (np.arange(count) + 0.5) / count - 0.5
    if sigma == 0.0:
        return np.ones((count, 1), dtype=np.float32)
    radius = int(np.ceil(_REACH * sigma))
    edges: F64 = np.arange(-radius, radius + 2)[None] - 0.5 - centre[:, None]
    share = gaussian_shares(edges, sigma)
    return np.asarray(share / share.sum(axis=1, keepdims=True), dtype=np.float32)


@numba.njit(cache=True, nogil=True)
def _gather(jobs: slice, fine: Any, shares: Any, volume: Any) -> None:
    """Sum fine rows within the radius, and spread the sum's fine voxels along x."""
    (start, x, values, height, width), (along_x, along_y, along_z) = fine, shares
    planes, rows, _ = volume.shape
    (count_y, width_y), (count_z, width_z) = along_y.shape, along_z.shape
    for task in range(jobs.start, jobs.stop):
        plane, row = task // rows, task % rows
        total = np.zeros(width, dtype=np.float32)
        for a in range(width_z * count_z):
            z = (plane + width_z // 2) * count_z - a + count_z - 1
            for b in range(width_y * count_y):
                y = (row + width_y // 2) * count_y - b + count_y - 1
                if 0 <= z < planes * count_z and 0 <= y < height:
                    share = (
                        along_z[z % count_z, plane - z // count_z + width_z // 2]
                        * along_y[y % count_y, row - y // count_y + width_y // 2]
                    )
                    for k in range(start[z * height + y], start[z * height + y + 1]):
                        total[x[k]] += share * values[k]
        _spread(total, along_x, volume[plane, row])


@inner_kernel(fastmath=True)
def _spread(total: Any, along: Any, out: Any) -> None:
    count, width = along.shape
    for x in range(len(total)):
        if total[x] > 0.0:
            middle = x // count - width // 2
            for k in range(width):
                if 0 <= middle + k < len(out):
                    out[middle + k] += total[x] * along[x % count, k]


def clear_dark(volume: F32, floor: float) -> F32:
    """Zero, in place, voxels darker than `floor` times a bright voxel.

    A bright voxel is the 95th percentile of those that reach a tenth of the brightest, where
    the brightest count as `_MOST` typical ones. It is at least `_FAINTEST`: a bright particle's
    peak in the images is 1, and its light fills dozens of voxels.
    """
    brightest = min(float(volume.max(initial=0.0)), _MOST * _typical(volume))
    bright_voxels = volume[volume > ILLUMINATED * brightest]
    level = float(np.percentile(bright_voxels, PERCENTILE)) if len(bright_voxels) else 0.0
    bright = max(level, _FAINTEST)
    volume[volume < floor * bright] = 0.0
    return volume


def _typical(volume: F32) -> float:
    """Compute the level that half of a volume's light lies above, within 3 %."""
    light = np.zeros((np.iinfo(np.int32).max >> _BITS) + 1)
    for plane in volume:
        bright = plane[plane > 0.0]
        light += np.bincount(bright.view(np.int32) >> _BITS, bright, len(light))
    above = np.cumsum(light[::-1])[::-1]
    level = int(np.flatnonzero(above >= 0.5 * above[0])[-1])
    return float(np.array([level << _BITS], dtype=np.int32).view(np.float32)[0])
