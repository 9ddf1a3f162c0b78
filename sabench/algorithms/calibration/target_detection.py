"""Detection of a calibration target's points in an image, by OpenCV's detectors."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.api.truth import Target
from sabench.utils.arrays import F64, U16

U8 = npt.NDArray[np.uint8]

_BLUR_PX = 1.5  # against noise, where lights are few
_FAINT = 0.1  # of a blob's peak: below there is none
_BALL = (
    0.05,
    0.15,
    # the same of a ball's, and where its light is cut: its shading would draw its centroid to the
    # lit
    # side
)
_LIT = 0.35  # of the brightest ball: what belongs to one
_DARKEST, _BRIGHTEST = 0.5, 99.5  # percentiles that become black and white for the detectors


def detect(image: U16, target: Target, expected: F64 | None = None) -> F64:
    """Detect the pixels (point, 2) of a target's points as (column, row).

    NaN where one was not found.

    Parameters
    ----------
    image : (rows, columns) grey values.
    expected : initial guess of the pixels (point, 2). It determines the direction of a board that
        looks the same after a half or a quarter rotation; by default the board is upright. Shift,
        scale and a rotation of less than half of that do not matter.
    """
    grey = _eight_bits(
        image,
        *(
            _small_lights(image)
            if target.pattern == "wand"
            else np.percentile(image, [_DARKEST, _BRIGHTEST])
        ),
    )
    found = {"checkerboard": _corners, "circles": _circles, "charuco": _charuco, "wand": _balls}[
        target.pattern
    ](grey, target)
    if found is None:
        return np.full((len(target.points_mm), 2), np.nan)
    return found if target.pattern == "charuco" else _choose_order(found, target, expected)


def _small_lights(image: U16) -> tuple[float, float]:
    """Estimate grey values of the dark around lights and of the brightest light.

    However small the lights are.
    """
    import cv2

    return float(np.median(image)), float(
        cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR_PX).max()
    )


def _eight_bits(image: U16, low: float, high: float) -> U8:
    return np.asarray(
        np.clip((image - low) * (255.0 / max(high - low, 1.0)), 0.0, 255.0), dtype=np.uint8
    )


def _corners(grey: U8, target: Target) -> F64 | None:
    """Find saddle points of the intensity.

    Source: A. Duda and U. Frese, BMVC 2018.
    """
    import cv2

    found, corners = cv2.findChessboardCornersSB(
        grey, (target.columns, target.rows), flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    return corners.reshape(-1, 2).astype(np.float64) if found else None


def _circles(grey: U8, target: Target) -> F64 | None:
    """Find centres of the dark ellipses that are images of circles."""
    import cv2

    found, centers = cv2.findCirclesGrid(
        grey, (target.columns, target.rows), flags=cv2.CALIB_CB_SYMMETRIC_GRID
    )
    return _centroids(255 - grey, centers.reshape(-1, 2).astype(np.float64)) if found else None


def _charuco(grey: U8, target: Target) -> F64 | None:
    """Find corners between markers.

    Each is identified by its markers, so that part of a board is enough.
    """
    import cv2

    dictionary: Any = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    board = cv2.aruco.CharucoBoard(
        (target.columns + 1, target.rows + 1), target.pitch_mm, target.mark_mm, dictionary
    )
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    if numbers is None or not len(numbers):
        return None
    found, order = (
        np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2),
        np.asarray(numbers).ravel(),
    )
    pixels = np.full((len(target.points_mm), 2), np.nan)
    pixels[order] = cv2.cornerSubPix(
        cv2.GaussianBlur(grey, (0, 0), 1.0), found, *_window(found[:, 0], order, target)
    ).reshape(-1, 2)
    return pixels


def _window(
    found: npt.NDArray[np.float32], order: npt.NDArray[Any], target: Target
) -> tuple[Any, ...]:
    """Choose the window of `cornerSubPix` around a corner, and its stop criterion.

    No marker lies in the window, since it would shift the corner.
    """
    import cv2

    positions = target.points_mm[order, :2]
    scale = (
        float(np.std(found, axis=0).sum() / max(np.std(positions, axis=0).sum(), 1e-9))
        if len(order) > 1
        else 0.0
    )
    side = max(2, int(0.7 * scale * (target.pitch_mm - target.mark_mm) / 2.0))
    return (side, side), (-1, -1), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)


def _balls(grey: U8, target: Target) -> F64 | None:
    """Find centroids of as many bright balls as the wand has, in order along it."""
    import cv2

    smooth = cv2.GaussianBlur(grey, (0, 0), _BLUR_PX)
    count, _, stats, centers = cv2.connectedComponentsWithStats(
        (smooth > 255.0 * _LIT).astype(np.uint8)
    )
    largest = 1 + np.argsort(stats[1:, cv2.CC_STAT_AREA])[::-1][: target.columns]
    if count - 1 < target.columns:
        return None
    balls = _centroids(grey, centers[largest], *_BALL)
    axis = np.linalg.svd(balls - balls.mean(axis=0))[2][0]
    return np.asarray(balls[np.argsort(balls @ axis)])


def _centroids(light: U8, centers: F64, faint: float = _FAINT, full: float = 1.0) -> F64:
    """Compute intensity-weighted centroids of blobs around rough centres.

    Blobs reach as far as half the distance to the next; light above `full` of the peak is cut.
    """
    gaps = np.linalg.norm(centers[:, None] - centers[None], axis=2) + np.diag(
        np.full(len(centers), np.inf)
    )
    out = centers.copy()
    for number, (center, gap) in enumerate(zip(centers, gaps.min(axis=1), strict=True)):
        radius = max(3, int(min(0.45 * gap, 60.0)))
        left, top = np.maximum(np.rint(center).astype(int) - radius, 0)
        patch = light[top : top + 2 * radius + 1, left : left + 2 * radius + 1].astype(np.float64)
        dark, peak = np.median(patch), patch.max() - np.median(patch)
        patch = np.clip(patch - dark - faint * peak, 0.0, (full - faint) * peak)
        rows, columns = np.mgrid[: patch.shape[0], : patch.shape[1]]
        total = patch.sum()
        if total > 0.0:
            out[number] = left + (patch * columns).sum() / total, top + (patch * rows).sum() / total
    return out


def _choose_order(found: F64, target: Target, expected: F64 | None) -> F64:
    """Choose the order of points whose directions fit the expected ones best.

    Only orders that the pattern allows are tried.
    """
    plan = target.points_mm[:, :2] if expected is None else expected
    known = np.isfinite(plan).all(axis=1)
    goal = plan[known] - plan[known].mean(axis=0)
    grid = np.arange(len(found)).reshape(target.rows, target.columns)
    rotated = [np.rot90(grid, quarter) for quarter in range(4)]
    orders = [order.ravel() for order in rotated if order.shape == grid.shape]
    orders += (
        [order.T.ravel() for order in rotated if order.T.shape == grid.shape]
        if target.rows > 1
        else []
    )
    return max(
        (found[order] for order in orders),
        key=lambda ordered: float(np.sum((ordered[known] - ordered[known].mean(axis=0)) * goal)),
    )
