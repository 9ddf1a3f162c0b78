"""Light sheets: a plane of the world as the image of one camera shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from sabench.algorithms.velocimetry.multipass import Field
from sabench.api import Observation, Velocity
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import FLATTEST_DEGREES, NODES
from sabench.geometry.grid import Grid, cut_box
from sabench.geometry.rigid_motion import cross, frame_of_normal
from sabench.utils.arrays import F32, F64, Bool, triple
from sabench.utils.errors import DeclinedError, InputError

_SHORTEST = 0.1  # projection on the plane of a unit vector that can be an axis of it


@dataclass(frozen=True)
class Sheet:
    """Square pixels in the plane of a light sheet, and where a camera sees them.

    Attributes
    ----------
    camera : number of the camera in an observation.
    origin_mm : (3,) centre of the first pixel, in the world.
    axes : (3, 3) unit vectors along columns and rows, and the normal that points away from the
        camera.
    pixel_mm : edge of a pixel.
    depth_mm : extent of the grid's voxels along the normal.
    pixels : (row, column, 2) columns and rows in the camera's image.
    seen : (row, column) which pixels lie in the grid and in the camera's image.
    """

    camera: int
    origin_mm: F64
    axes: F64
    pixel_mm: float
    depth_mm: float
    pixels: F64
    seen: Bool

    def velocity(self, field: Field, interval_s: float) -> Velocity:
        """Convert displacements of windows of the sheet to velocities in the world."""
        _, row, column = field.windows.origin
        _, down, across = field.windows.step
        _, rows, columns = field.windows.counts
        low = self.origin_mm + self.pixel_mm * (np.array([column, row]) @ self.axes[:2])
        axes = (row, down, rows), (column, across, columns)
        middles = [np.rint(first + step * np.arange(n)).astype(np.int64) for first, step, n in axes]
        spacing = across * self.pixel_mm, down * self.pixel_mm, self.depth_mm
        velocity = field.shift[..., :2] @ self.axes[:2] * self.pixel_mm / interval_s
        valid = field.valid & self.seen[np.ix_(*middles)]
        return Velocity(triple(low), spacing, velocity, valid, self.axes[:2].copy())


def find_sheet(
    cameras: Sequence[CameraModel],
    grid: Grid,
    point_mm: tuple[float, float, float] | None = None,
    normal: tuple[float, float, float] | None = None,
    camera: str | None = None,
) -> Sheet:
    """Lay pixels into the part of a plane in the grid that a camera sees.

    They are as large as the camera's own pixels are there. Their columns lie along the edge of the
    grid's box, projected on the plane, that is nearest to a row of the camera's image.

    Parameters
    ----------
    point_mm : a point of the plane; None: the middle of the grid.
    normal : of the plane, of any length; None: across the grid's only plane of voxels, or along its
        shortest edge.
    camera : name; None: the camera that looks most squarely at the plane.

    Raises
    ------
    InputError
        A plane outside the grid, a grid without a shortest edge, or an unknown camera.
    DeclinedError
        No camera, or not the named one, sees the plane, or only edge-on.
    """
    middle = np.array([(axis[0] + axis[-1]) / 2.0 for axis in grid.axes_mm])
    through = middle if point_mm is None else np.asarray(point_mm, dtype=np.float64)
    across = _thinnest(grid) if normal is None else np.asarray(normal) / np.linalg.norm(normal)
    points = _probe(grid, through, across)
    names = [model.name for model in cameras]
    if camera is not None and camera not in names:
        raise InputError(f"camera: expected one of {', '.join(names)}, got {camera}")
    numbers = range(len(cameras)) if camera is None else [names.index(camera)]
    views = [_View.of(number, cameras[number], points, across) for number in numbers]
    best = max(views, key=lambda view: view.angle)
    best.check(len(views))
    return _lay(best, cameras[best.camera], grid, points, across)


def _thinnest(grid: Grid) -> F64:
    """Return the unit vector across a grid of one plane, or along its shortest edge."""
    single = np.asarray(grid.shape[::-1]) == 1
    if single.sum() == 1:
        return np.asarray(single, dtype=np.float64)
    edges = np.asarray(grid.voxel_mm) * grid.shape[::-1]
    shortest, second = np.sort(edges)[:2]
    if second - shortest < 1e-6 * shortest:
        raise InputError(
            "normal: expected that of the light sheet, since the grid of "
            f"{edges[0]:g} x {edges[1]:g} x {edges[2]:g} mm has no shortest edge, got none"
        )
    return np.asarray(np.eye(3)[int(edges.argmin())])


def _in_box(grid: Grid, points_mm: F64) -> Bool:
    low, high = grid.box_mm
    spare = 1e-9 * (high - low)
    inside = (points_mm >= low - spare) & (points_mm <= high + spare)
    return np.asarray(inside.all(axis=-1))


def _probe(grid: Grid, point_mm: F64, normal: F64) -> F64:
    """Spread points (n, 3) over the part of a plane that lies in the grid's box."""
    outline = cut_box(*grid.box_mm, point_mm, normal)
    if not len(outline):
        raise InputError(
            f"point_mm and normal: expected a plane through the grid, got one beside it, through "
            f"{np.round(point_mm, 3).tolist()} across {np.round(normal, 4).tolist()}"
        )
    u, v, _ = frame_of_normal(normal)
    flat = (outline - point_mm) @ np.stack([u, v]).T
    sides = np.linspace(flat.min(axis=0), flat.max(axis=0), NODES)
    across, down = (part.ravel() for part in np.meshgrid(*sides.T))
    points = point_mm + across[:, None] * u + down[:, None] * v
    return np.asarray(points[_in_box(grid, points)])


@dataclass(frozen=True)
class _View:
    """A camera's view of a plane.

    Attributes
    ----------
    points_mm : (n, 3) points of the plane that it sees.
    slopes : (2, 3) derivatives of column and row by directions in the plane, px / mm.
    angle : between line of sight and plane, degrees; negative for a camera that does not see it.
    """

    camera: int
    name: str
    points_mm: F64
    slopes: F64
    angle: float

    @classmethod
    def of(cls, number: int, camera: CameraModel, points_mm: F64, normal: F64) -> _View:
        """Find which points a camera sees, and how it sees the plane at their middle.

        The angle is that of a distant camera that shortens directions in the plane as much: its
        sine is the ratio of the singular values of the derivatives.
        """
        pixels, valid = camera.project(points_mm)
        visible = points_mm[valid & camera.contains(pixels)]
        if not len(visible):
            return cls(number, camera.name, visible, np.zeros((2, 3)), -1.0)
        middle = visible[((visible - visible.mean(axis=0)) ** 2).sum(axis=1).argmin()]
        step = 1e-3 * float(np.linalg.norm(np.ptp(points_mm, axis=0)))
        basis = frame_of_normal(normal)[:2]
        ends, _ = camera.project(middle + step * np.concatenate([basis, -basis]))
        slopes = ((ends[:2] - ends[2:]) / (2.0 * step)).T
        least, most = np.sort(np.linalg.svd(slopes, compute_uv=False))
        angle = float(np.rad2deg(np.arcsin(min(least / most, 1.0))))
        return cls(number, camera.name, visible, slopes @ basis, round(angle, 6))

    def check(self, count: int) -> None:
        if self.angle < 0.0:
            who = self.name if count == 1 else f"none of {count} cameras"
            what = "no point" if count == 1 else "a point"
            raise DeclinedError(f"{who} sees {what} of the light sheet in the grid")
        if self.angle < FLATTEST_DEGREES:
            who = self.name if count == 1 else f"even the best camera, {self.name},"
            raise DeclinedError(
                f"{who} sees the light sheet edge-on, at {self.angle:.0f} degrees (at least "
                f"{FLATTEST_DEGREES:.0f})"
            )

    def axes(self, normal: F64) -> F64:
        """Choose the plane's columns, rows and normal (3, 3) as the image shows them."""
        along = np.eye(3) - np.outer(normal, normal)
        edges = np.concatenate([along, -along])
        edges = edges[np.linalg.norm(edges, axis=1) > _SHORTEST]
        edges /= np.linalg.norm(edges, axis=1)[:, None]
        images = edges @ self.slopes.T
        first = edges[(images[:, 0] / np.linalg.norm(images, axis=1)).argmax()]
        second = cross(normal, first)
        right, down = self.slopes @ first, self.slopes @ second
        sign = np.sign(right[0] * down[1] - right[1] * down[0])
        return np.stack([first, sign * second, sign * normal])


def _lay(view: _View, camera: CameraModel, grid: Grid, points_mm: F64, normal: F64) -> Sheet:
    """Lay pixels over all that a camera sees of a plane; `points_mm` fill it."""
    axes = view.axes(normal)
    # of a square in the plane as large as one pixel
    edge = float(np.prod(np.linalg.svd(view.slopes, compute_uv=False)) ** -0.5)
    every, some = points_mm @ axes.T, view.points_mm @ axes.T
    spacing = np.ptp(every, axis=0).max() / (NODES - 1)
    low = np.maximum(every.min(axis=0), some.min(axis=0) - spacing)
    high = np.minimum(every.max(axis=0), some.max(axis=0) + spacing)
    columns, rows = np.floor((high - low)[:2] / edge).astype(int) + 1
    spare = (high - low)[:2] - (np.array([columns, rows]) - 1) * edge
    start = low + np.array([*(spare / 2.0), 0.0])
    across, down = np.meshgrid(np.arange(columns) * edge, np.arange(rows) * edge)
    steps = np.stack([across, down, np.zeros_like(across)], axis=-1)
    points = (start + steps).reshape(-1, 3) @ axes
    pixels, valid = camera.project(points)
    visible = valid & camera.contains(pixels) & _in_box(grid, points)
    depth = float(np.abs(normal) @ np.asarray(grid.voxel_mm))
    images = pixels.reshape(rows, columns, 2), visible.reshape(rows, columns)
    return Sheet(view.camera, start @ axes, axes, edge, depth, *images)


def light_in_sheet(case: Observation, sheet: Sheet, around_px: int) -> F32:
    """Resample the camera's image at the sheet's pixels: (1, row, column).

    The mean of the `around_px` x `around_px` pixels around is subtracted, because a background that
    does not move would correlate with itself. Pixels that are not seen are zero. An image that
    shows nothing in the sheet is an InputError.
    """
    image, visible = case.normalised_images()[sheet.camera], sheet.seen
    places = np.where(visible[..., None], sheet.pixels, 0.0)
    light = map_coordinates(image, [places[..., 1], places[..., 0]], order=3, mode="mirror")
    light = np.where(visible, light, 0.0).astype(np.float32)
    if light[visible].min() == light[visible].max():
        raise InputError(
            f"{case.cameras[sheet.camera].name}: expected an image that shows something in the "
            "light sheet, got none"
        )
    share = uniform_filter(visible.astype(np.float32), around_px, mode="constant")
    mean = uniform_filter(light, around_px, mode="constant") / np.maximum(share, 1e-6)
    return np.asarray(np.where(visible, light - mean, 0.0), dtype=np.float32)[None]
