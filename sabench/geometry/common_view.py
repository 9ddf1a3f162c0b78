"""Visibility of points in cameras: common box, grid, frusta through the wall."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.polynomial_cameras import fitted_box
from sabench.geometry.refraction import Rays
from sabench.geometry.triangulation import DELTA_MM, intersect
from sabench.utils.arrays import F64, Bool, triple
from sabench.utils.errors import InputError

FLATTEST_DEGREES = 15.0  # least angle between a line of sight and a plane that is looked at
NODES = 49  # of the lattice along each axis; an odd number has a middle
_MOST_VOXELS = 1_000_000  # along an axis


def pixel_size_mm(cameras: Sequence[CameraModel], point_mm: F64) -> float:
    """Compute the size of a pixel at a point (3,), averaged over cameras.

    The cameras are those that have a pixel of the point. It is 1 / sqrt(s1 s2), with the two
    singular values of the slope of pixels by position.

    Raises InputError: no camera has a pixel of the point.
    """
    around = point_mm + np.concatenate([np.eye(3), -np.eye(3)]) * DELTA_MM
    sizes = []
    for camera in cameras:
        pixels, valid = camera.project(around)
        if valid.all():
            slope = (pixels[:3] - pixels[3:]).T / (2.0 * DELTA_MM)
            sizes.append(1.0 / np.sqrt(np.linalg.svd(slope, compute_uv=False).prod()))
    if not sizes:
        raise InputError(f"volume: expected a middle that a camera sees, got {_words(point_mm)} mm")
    return float(np.mean(sizes))


def propose_box(cameras: Sequence[CameraModel]) -> tuple[F64, F64]:
    """Propose the corners (3,) of a box along the world's axes that all cameras see.

    It grows around the point nearest to the lines of sight of the images' middles, in all
    directions by the same length until a camera sees a face no longer, and at most to the size of
    an image in each direction.

    Raises InputError: lines of sight that do not meet, or no point that all cameras see.
    """
    middles = np.array([[[0.5 * (c.columns - 1), 0.5 * (c.rows - 1)]] for c in cameras])
    middle = intersect(cameras, middles)[0]
    if not np.isfinite(middle).all():
        raise InputError(
            "volume: expected cameras whose lines of sight meet, got parallel ones or a single "
            "camera; give the volume"
        )
    reach = pixel_size_mm(cameras, middle) * max(max(c.rows, c.columns) for c in cameras)
    steps = reach * np.linspace(-1.0, 1.0, NODES)
    points = np.stack(np.meshgrid(*(steps + at for at in middle), indexing="ij"), axis=-1)
    visible = seen_by_all(cameras, points.reshape(-1, 3)).reshape((NODES,) * 3)
    if not visible[(NODES // 2,) * 3]:
        raise InputError(
            f"volume: expected all cameras to see {_words(middle)} mm, where the middles of their "
            "images meet, but some do not; give the volume, or check the calibration"
        )
    first, last = _grow(visible)
    return points[tuple(first)], points[tuple(last)]


def seen_by_all(cameras: Sequence[CameraModel], points_mm: F64) -> Bool:
    """Mark the points (n, 3) that lie on every camera's image."""
    visible = np.ones(len(points_mm), dtype=np.bool_)
    for camera in cameras:
        visible &= seen_by(camera, points_mm)
    return visible


def seen_by(camera: CameraModel, points_mm: F64) -> Bool:
    """Mark the points (n, 3) that lie on a camera's image, and in the box of its fit."""
    pixels, valid = camera.project(points_mm)
    visible = np.asarray(valid & camera.contains(pixels))
    box = fitted_box(camera)
    if box is not None:
        visible &= ((points_mm >= box[0]) & (points_mm <= box[1])).all(axis=1)
    return visible


def _grow(visible: Bool) -> tuple[list[int], list[int]]:
    first, last = [NODES // 2] * 3, [NODES // 2] * 3
    growing = list(itertools.product(range(3), (False, True)))
    while growing:
        for axis, upwards in list(growing):
            low, high = list(first), list(last)
            at = (last[axis] + 1) if upwards else (first[axis] - 1)
            low[axis] = high[axis] = at
            face = tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))
            if not 0 <= at < NODES or not visible[face].all():
                growing.remove((axis, upwards))
            elif upwards:
                last[axis] = at
            else:
                first[axis] = at
    return first, last


def grid_of_box(low_mm: F64, high_mm: F64, voxel_mm: float) -> Grid:
    """Make the grid of voxels that fill a box, cubes as nearly as they can be.

    Parameters
    ----------
    low_mm, high_mm : (3,) corners of the box.
    voxel_mm : edge of a voxel, which changes until a whole number of them fits along each axis.

    Raises InputError: corners in the wrong order, or a size of voxels that makes none or too many.
    """
    size = np.asarray(high_mm) - np.asarray(low_mm)
    if not (size > 0.0).all() or not voxel_mm > 0.0:
        raise InputError(
            "volume: expected x0,x1,y0,y1,z0,z1 with x0 < x1, y0 < y1, z0 < z1 and positive "
            f"voxels, got {_words(low_mm)} to {_words(high_mm)} mm and {voxel_mm:g} mm"
        )
    counts = np.maximum(np.rint(size / voxel_mm), 1.0)
    if counts.max() > _MOST_VOXELS:
        raise InputError(
            f"voxel: expected at most {_MOST_VOXELS} along an axis, got {counts.max():.0f}"
        )
    x, y, z = (int(count) for count in counts)
    edges = size / counts
    return Grid(triple(np.asarray(low_mm) + 0.5 * edges), triple(edges), (z, y, x))


def share_in_view(camera: CameraModel, grid: Grid) -> tuple[float, float]:
    """Compute the shares of a grid with a light path to a camera, and in its view."""
    points = lattice_of(grid)
    return float(camera.project(points)[1].mean()), float(seen_by(camera, points).mean())


def lattice_of(grid: Grid, nodes: int = 17) -> F64:
    """Make a lattice of points (n, 3) over the voxels' centres."""
    counts = np.array(grid.shape[::-1]) - 1
    axes = [
        low + step * np.linspace(0.0, count, nodes)
        for low, step, count in zip(grid.low_mm, grid.voxel_mm, counts, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _words(point_mm: F64) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in point_mm) + ")"


SIDE = 6  # paths along each side of an image
_STEEPEST = 0.05  # cosine to the middle path below which a path is left out


def border_pixels(camera: CameraModel) -> F64:
    """List pixels (4 SIDE, 2) along the image's edge, each corner first of its side."""
    low, right, down = -0.5, camera.columns - 0.5, camera.rows - 0.5
    corners = np.array([[low, low], [right, low], [right, down], [low, down]])
    share = np.arange(SIDE)[:, None] / SIDE
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return np.concatenate([start + share * (end - start) for start, end in sides])


def light_paths(camera: CameraModel, pixels: F64, low_mm: F64, high_mm: F64) -> F64:
    """Follow the light paths of pixels (n, 2) from the camera through a box.

    Parameters
    ----------
    low_mm, high_mm : (3,) corners of the box. Paths end on the plane behind it that is at right
        angles to the path of the image's middle.

    Returns points (n, corners, 3) where paths begin, bend and end: the pinhole, all faces of the
    wall and the end. A camera without a pinhole has a point in front of the box in place of the
    faces. NaN for pixels without a path.
    """
    middle = np.array([[(camera.columns - 1) / 2.0, (camera.rows - 1) / 2.0]])
    axis = camera.back_project(middle).directions[0]
    steps = np.stack(np.meshgrid(*np.stack([low_mm, high_mm], axis=1)), axis=-1).reshape(-1, 3)
    depths = steps @ axis
    rays = camera.back_project(pixels)
    start = np.broadcast_to(np.asarray(camera.center_mm), rays.origins_mm.shape)
    if isinstance(camera, Camera):
        between = _faces(camera, pixels)
    else:
        between = [_reach(rays, axis, float(depths.min()))]
    paths = np.stack([start, *between, _reach(rays, axis, float(depths.max()))], axis=1)
    paths[~(rays.valid & np.isfinite(paths).all(axis=(1, 2)))] = np.nan
    return paths


def _faces(camera: Camera, pixels: F64) -> list[F64]:
    """Find where light crosses each face of the wall: (n, 3) each."""
    if camera.wall is None:
        return []
    directions, _ = camera.directions(pixels)
    center = np.asarray(camera.center_mm)
    return [
        replace(camera.wall, layers=camera.wall.layers[:count]).rays(center, directions).origins_mm
        for count in range(len(camera.wall.layers) + 1)
    ]


def _reach(rays: Rays, axis: F64, depth_mm: float) -> F64:
    """Follow rays to the plane at a depth along an axis: (n, 3)."""
    ahead = rays.directions @ axis
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = np.where(ahead > _STEEPEST, (depth_mm - rays.origins_mm @ axis) / ahead, np.nan)
    return np.asarray(rays.origins_mm + steps[:, None] * rays.directions)
