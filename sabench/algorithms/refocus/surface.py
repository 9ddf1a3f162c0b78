"""Refocusing on surfaces of any shape, and a check for edge-on views of planes.

Every point of the surface is projected into every camera, through the wall, and the images' values
there are joined.
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import FLATTEST_DEGREES
from sabench.geometry.grid import AT_ONCE, Grid
from sabench.geometry.surfaces import normals_of
from sabench.utils.arrays import F32, F64, I64, Bool
from sabench.utils.progress import progress_bar


def find_edge_on(cameras: Sequence[CameraModel], grid: Grid) -> str | None:
    """Say which camera sees a grid's planes edge-on; None if none does.

    In the middle of the grid, the ratio of the singular values of pixels' derivatives by X and Y is
    the sine of the angle: that of a distant camera that shortens directions as much.
    """
    middle = np.array([(axis[0] + axis[-1]) / 2.0 for axis in grid.axes_mm])
    step = 0.5 * float(np.min(grid.voxel_mm))
    ends = middle + step * np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    for camera in cameras:
        pixels, valid = camera.project(ends)
        if not valid.all():
            continue  # the search for light paths raises the error
        least, most = np.sort(np.linalg.svd(pixels[:2] - pixels[2:], compute_uv=False))
        angle = float(np.rad2deg(np.arcsin(min(least / max(most, 1e-300), 1.0))))
        if angle < FLATTEST_DEGREES:
            return (
                f"it refocuses planes of constant Z, which {camera.name} sees edge-on, at "
                f"{angle:.0f} degrees (at least {FLATTEST_DEGREES:.0f}): turn the world so that "
                "Z is the viewing direction"
            )
    return None


Join = Literal["additive", "multiplicative", "dark", "minimum", "maximum", "median"]
_FLOOR = 0.02  # of an image's range: one camera cannot erase a point of a product


class SurfaceImage(NamedTuple):
    """Image of a surface in its own coordinates.

    Attributes
    ----------
    values : (row, column), NaN where no camera sees the front of the surface.
    views : (row, column) cameras that see it.
    """

    values: F32
    views: I64


def refocus_on_surface(
    images: F32,
    cameras: Sequence[CameraModel],
    points_mm: F64,
    join: Join,
    covered: Bool | None = None,
) -> SurfaceImage:
    """Join the cameras' images at every point of a surface.

    A camera counts where its image shows the point and where it looks at the surface's front. A
    surface that otherwise hides parts of itself, as hills do, is taken as transparent. Source:
    thesis, section 2.2.2 ("a focal surface, planar or otherwise"); equations 3.3 and 3.4.

    Parameters
    ----------
    images : (camera, row, column), from 0 to 1; transmission for "dark".
    points_mm : (row, column, 3) world points, NaN where the surface has none.
    join : additive: the mean; multiplicative: the geometric mean; dark: one less the geometric mean
        of the darkness, so that one free view is enough; minimum, maximum and median of the views.
    covered : (camera, row, column) pixels that show nothing.
    """
    shape = points_mm.shape[:2]
    points, normals = points_mm.reshape(-1, 3), normals_of(points_mm).reshape(-1, 3)
    splines = [spline_filter(image, order=3, mode="mirror", output=np.float32) for image in images]
    hidden = [None] * len(images) if covered is None else covered
    values, views = np.full(len(points), np.nan, np.float32), np.zeros(len(points), np.int64)
    step = max(1, AT_ONCE // len(images))
    for first in progress_bar(range(0, len(points), step), f"refocus, {len(cameras)} cameras"):
        part = slice(first, first + step)
        place = points[part], normals[part]
        views_of = zip(splines, cameras, hidden, strict=True)
        samples = np.stack(
            [_sample(spline, camera, *place, mask) for spline, camera, mask in views_of]
        )
        views[part] = np.isfinite(samples).sum(axis=0)
        visible = views[part] > 0
        values[part][visible] = _JOINS[join](samples[:, visible])
    return SurfaceImage(values.reshape(shape), views.reshape(shape))


def _sample(
    spline: F32, camera: CameraModel, points: F64, normals: F64, covered: Bool | None
) -> F32:
    """Sample an image's cubic B-spline at points (n, 3); NaN where they are hidden."""
    index = np.flatnonzero(np.isfinite(points).all(axis=1))
    pixels, valid = camera.project(points[index])
    column, row = pixels.T
    valid &= (column >= 0) & (row >= 0)
    valid &= (column <= camera.columns - 1) & (row <= camera.rows - 1)
    index, pixels = index[valid], pixels[valid]
    if covered is not None:
        column, row = np.rint(pixels).astype(int).T
        shown = ~covered[row, column]
        index, pixels = index[shown], pixels[shown]
    rays = camera.back_project(pixels)
    faces = ~(np.einsum("ij,ij->i", rays.directions, normals[index]) <= 0.0) & rays.valid
    index, pixels = index[faces], pixels[faces]
    out = np.full(len(points), np.nan, dtype=np.float32)
    samples = map_coordinates(spline, pixels[:, ::-1].T, order=3, mode="mirror", prefilter=False)
    out[index] = np.maximum(samples, 0.0)  # a spline undershoots next to bright pixels
    return out


def _product(samples: F32) -> F32:
    return np.asarray(np.exp(np.nanmean(np.log(np.maximum(samples, _FLOOR)), axis=0)))


_JOINS: dict[str, Callable[[F32], F32]] = {
    "additive": lambda samples: np.nanmean(samples, axis=0),
    "multiplicative": _product,
    "dark": lambda samples: np.float32(1.0) - _product(np.float32(1.0) - samples),
    "minimum": lambda samples: np.nanmin(samples, axis=0),
    "maximum": lambda samples: np.nanmax(samples, axis=0),
    "median": lambda samples: np.nanmedian(samples, axis=0),
}
