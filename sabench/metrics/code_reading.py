"""Reading of a code of dark and bright cells: contrast, separation, cells."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import map_coordinates

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F32, F64, U16, Bool


def reading(cells: F64, dark: Bool) -> dict[str, float]:
    """Score one image of a code.

    Parameters
    ----------
    cells : (cell,) mean brightness of each; NaN where the image does not show it: such a cell is
        not read.
    dark : (cell,) which are dark.

    Returns
    -------
    read_percent : cells on the right side of Otsu's threshold (IEEE Trans. Syst. Man Cybern. 9, 62,
        1979); guessing gives 50.
    contrast : Michelson's, of the mean bright and the mean dark cell.
    separation : difference of these means over the root mean square of the two standard deviations
        (d').
    """
    shown = np.isfinite(cells)
    bright, black = cells[shown & ~dark], cells[shown & dark]
    if not len(bright) or not len(black):
        return {"read_percent": 0.0, "contrast": float("nan"), "separation": float("nan")}
    high, low = float(bright.mean()), float(black.mean())
    spread = float(np.sqrt((bright.var() + black.var()) / 2.0))
    total = high + low
    return {
        "read_percent": 100.0 * float(read_right(cells, dark).mean()),
        "contrast": (high - low) / total if total else float("nan"),
        "separation": (high - low) / spread if spread else float("inf"),
    }


def compare_with_single_views(cells: F64, single_cells: F64, dark: Bool) -> dict[str, float]:
    """Score an estimate's image of a code, and the cameras' own images.

    Parameters
    ----------
    cells : (cell,) mean brightness of each cell in the estimate.
    single_cells : (camera, cell) mean brightness of each cell in each camera's image.
    dark : (cell,) which are dark.

    Returns the figures of `reading`, and single_percent, best_single_percent, single_separation:
    mean and largest part that one image shows, and the mean separation.
    """
    single = [reading(view, dark) for view in single_cells]
    percent = [view["read_percent"] for view in single]
    return reading(cells, dark) | {
        "single_percent": float(np.mean(percent)),
        "best_single_percent": max(percent),
        "single_separation": float(np.nanmean([view["separation"] for view in single])),
    }


def read_volume(grid: Grid, volume: F32, points_mm: F64) -> F64:
    """Average a volume (z, y, x) over cells' points (cell, point, 3), or NaN."""
    x, y, z = grid.to_voxels(points_mm.reshape(-1, 3)).T
    return _mean_of_cells(volume, [z, y, x], points_mm.shape[:2])


def single_views(
    images: Sequence[U16 | F32] | U16 | F32, cameras: Sequence[CameraModel], points_mm: F64
) -> F64:
    """Average each camera's image over each cell's points: (camera, cell).

    Parameters
    ----------
    images : (camera, row, column).
    cameras : the true cameras.
    points_mm : (cell, point, 3) points spread over each cell, world frame.

    Returns NaN for a cell that is not completely inside a camera's image.
    """
    out = np.empty((len(cameras), len(points_mm)))
    for cells, image, camera in zip(out, images, cameras, strict=True):
        column, row = camera.project(points_mm.reshape(-1, 3))[0].T
        cells[:] = _mean_of_cells(image, [row, column], points_mm.shape[:2])
    return out


def _mean_of_cells(array: F32 | U16, indices: list[F64], shape: tuple[int, ...]) -> F64:
    """Average an array at fractional indices over the points of each cell."""
    values = map_coordinates(
        array.astype(np.float64), indices, order=1, mode="constant", cval=np.nan
    )
    return np.asarray(values.reshape(shape).mean(axis=1))


def read_right(cells: F64, dark: Bool) -> Bool:
    """Mark the cells on the right side of the threshold, if two are shown."""
    shown = np.isfinite(cells)
    if shown.sum() < 2:
        return np.zeros(len(cells), dtype=np.bool_)
    return np.asarray(shown & ((cells < otsu(cells[shown])) == dark))


def otsu(values: F64) -> float:
    """Compute Otsu's threshold: the largest variance between two groups."""
    ordered = np.sort(values)
    count, low = np.arange(1, len(ordered)), np.cumsum(ordered)[:-1]
    rest = len(ordered) - count
    between = (low / count - (ordered.sum() - low) / rest) ** 2 * count * rest
    best = int(between.argmax())
    return float(ordered[best] + ordered[best + 1]) / 2.0
