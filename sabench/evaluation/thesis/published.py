"""Map-shift-average in the thesis's own voxels.

Planes are one pixel of shift apart, as the central camera sees them.

On such planes whole-pixel shifts are exact and nothing is resampled after the first mapping. Voxels
are pixels of the middle plane along x and y and numbers of shifts along z (thesis section 2.2.4),
so particles are carried into that space before they are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sabench.algorithms.refocus import cpu_kernels
from sabench.algorithms.refocus.rectification import LINEAR, coefficients_of, resample
from sabench.algorithms.refocus.slabs import Slab, make_slab, rectifying_maps
from sabench.algorithms.refocus.synthetic_aperture import shift_maps
from sabench.api.truth import Particles
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.simulation.in_memory import Shot
from sabench.utils.arrays import F32, F64

_LOOKUPS = 2001  # depths between which the number of shifts is interpolated


def published_volume(shot: Shot) -> tuple[Grid, Particles, F32]:
    """Average shifted images of a shot: volume (z, y, x), voxels, particles.

    Particles are in the space of these voxels.

    Equations 2.1 to 2.3. Cameras whose shifts are no whole numbers, as in unevenly spaced arrays,
    are interpolated bilinearly, as the thesis says. Mapped images are as large as the images, so
    that a shifted one adds zeros to one side of a plane (section 2.2.4): what a tilted camera sees
    beyond is lost.
    """
    seen, cameras = shot.observation, shot.observation.cameras
    grid, (center, neighbour) = seen.grid, _two_innermost(cameras)
    depths, shift = _shift_of_depth(center, neighbour, grid)
    numbers = np.arange(np.ceil(shift.min()), np.floor(shift.max()) + 1)
    planes = np.column_stack([np.zeros((len(numbers), 2)), np.interp(numbers, shift, depths)])
    space = _space(grid, numbers)
    slab = _as_large_as_images(make_slab(cameras, grid, 0, grid.shape[0]), center, grid)
    mapped = np.empty((len(cameras), *slab.shape), dtype=np.float32)
    resample(
        coefficients_of(seen.normalised_images(), LINEAR),
        LINEAR,
        *rectifying_maps(slab, cameras, grid),
        0.0,
        mapped,
    )
    across = np.asarray(grid.voxel_mm)[:2]
    shifts = np.stack(
        [
            (_on_middle(camera, planes, grid) - _on_middle(center, planes, grid)) / across
            for camera in cameras
        ],
        axis=1,
    )
    volume = np.empty(space.shape, dtype=np.float32)
    cpu_kernels.sum_planes(
        mapped, LINEAR, shift_maps(space, shifts.round(6) - slab.corners), 0.0, volume
    )
    volume /= np.float32(len(cameras))
    position = shot.particles.position_mm
    carried = np.column_stack(
        [
            _on_middle(center, position, grid),
            np.interp(position[:, 2], depths, shift) * grid.voxel_mm[2],
        ]
    )
    return space, replace(shot.particles, position_mm=carried), volume


def _as_large_as_images(slab: Slab, camera: CameraModel, grid: Grid) -> Slab:
    size = np.array([camera.columns, camera.rows])
    corner = (np.asarray(grid.shape[:0:-1]) - size) / 2.0
    return replace(
        slab, corners=np.tile(corner, (len(slab.corners), 1)), shape=(camera.rows, camera.columns)
    )


def _space(grid: Grid, numbers: F64) -> Grid:
    low = (grid.low_mm[0], grid.low_mm[1], float(numbers[0]) * grid.voxel_mm[2])
    return Grid(low, grid.voxel_mm, (len(numbers), *grid.shape[1:]), grid.crop)


def _two_innermost(cameras: Sequence[CameraModel]) -> tuple[CameraModel, CameraModel]:
    """Find the camera nearest to the array's centre, and its neighbour."""
    positions = np.array([camera.center_mm for camera in cameras])
    center = int(np.linalg.norm(positions - positions.mean(axis=0), axis=1).argmin())
    order = np.argsort(np.linalg.norm(positions - positions[center], axis=1), kind="stable")
    return cameras[center], cameras[int(order[1])]


def _shift_of_depth(center: CameraModel, neighbour: CameraModel, grid: Grid) -> tuple[F64, F64]:
    """Compute the disparity of two cameras over the grid's depths, in voxels.

    It is that of a point on the axis at each depth, on the middle plane. Returns depths and
    disparities.
    """
    x, y, z = grid.axes_mm
    depths = np.linspace(z[0] - grid.voxel_mm[2] / 2.0, z[-1] + grid.voxel_mm[2] / 2.0, _LOOKUPS)
    axis = np.column_stack([np.full(_LOOKUPS, x.mean()), np.full(_LOOKUPS, y.mean()), depths])
    apart = (_on_middle(neighbour, axis, grid) - _on_middle(center, axis, grid)) / np.asarray(
        grid.voxel_mm
    )[:2]
    along = apart[-1] - apart[0]
    return depths, np.asarray(apart @ (along / np.linalg.norm(along)))


def _on_middle(camera: CameraModel, points: F64, grid: Grid) -> F64:
    """Intersect lines of sight through points (n, 3) with the grid's middle plane.

    Returns x, y in mm (n, 2).
    """
    z = grid.axes_mm[2]
    return camera.carry(points, (z[0] + z[-1]) / 2.0)
