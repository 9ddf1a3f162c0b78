"""Detection of a calibration target's points in an image, by OpenCV's detectors."""

from typing import Any

import cv2
import numpy as np

from sabench.api.truth import Target
from sabench.utils.arrays import F64, U8, U16

_BLUR_PX = 1.5  # against noise, where lights are few
_FAINT = 0.05  # of a blob's peak: below there is none
_FULL = 0.15  # cuts a ball's light, whose shading would shift the centroid to the lit side
_LIT = 0.35  # of the brightest ball: least light of a ball's pixel
_DARKEST = 0.5  # percent of the pixels become black for the detectors, and as many white


def detect_target(image: U16, target: Target, expected: F64 | None = None) -> F64:
    """Detect the pixels (point, 2) of a target's points as (column, row).

    NaN where one was not found.

    Parameters
    ----------
    image : (rows, columns) grey values.
    expected : initial guess of the pixels (point, 2). It determines the direction of a board that
        looks the same after a half or a quarter rotation; by default the board is upright. Shift,
        scale and a rotation of less than half of that do not matter.
    """
    if target.pattern == "wand":  # lights may be too small for percentiles
        low = float(np.median(image))
        high = float(cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR_PX).max())
    else:
        low, high = np.percentile(image, [_DARKEST, 100.0 - _DARKEST])
    scaled = (image - low) * (255.0 / max(high - low, 1.0))
    grey: U8 = np.clip(scaled, 0.0, 255.0).astype(np.uint8)
    detectors = {"checkerboard": _corners, "circles": _circles, "charuco": _charuco, "wand": _balls}
    pixels = detectors[target.pattern](grey, target)
    if pixels is None:
        return np.full((len(target.points_mm), 2), np.nan)
    return pixels if target.pattern == "charuco" else _choose_order(pixels, target, expected)


def _corners(grey: U8, target: Target) -> F64 | None:
    """Find saddle points of the intensity (A. Duda and U. Frese, BMVC 2018)."""
    success, corners = cv2.findChessboardCornersSB(
        grey, (target.columns, target.rows), flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    return corners.reshape(-1, 2).astype(np.float64) if success else None


def _circles(grey: U8, target: Target) -> F64 | None:
    """Find centres of the dark ellipses that are images of circles."""
    success, centers = cv2.findCirclesGrid(
        grey, (target.columns, target.rows), flags=cv2.CALIB_CB_SYMMETRIC_GRID
    )
    return _centroids(255 - grey, centers.reshape(-1, 2).astype(np.float64)) if success else None


def _charuco(grey: U8, target: Target) -> F64 | None:
    """Find corners, each identified by its markers, even of part of a board."""
    dictionary: Any = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    board = cv2.aruco.CharucoBoard(
        (target.columns + 1, target.rows + 1), target.pitch_mm, target.mark_mm, dictionary
    )
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    if numbers is None or not len(numbers):
        return None
    detected = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    order = np.asarray(numbers).ravel()
    scale = 0.0  # px per mm
    if len(order) > 1:
        width = np.std(target.points_mm[order, :2], axis=0).sum()
        scale = float(np.std(detected[:, 0], axis=0).sum() / max(width, 1e-9))
    # no marker may lie in the window around a corner, since it would shift the corner
    side = max(2, int(0.7 * scale * (target.pitch_mm - target.mark_mm) / 2.0))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    pixels = np.full((len(target.points_mm), 2), np.nan)
    pixels[order] = cv2.cornerSubPix(smooth, detected, (side, side), (-1, -1), stop).reshape(-1, 2)
    return pixels


def _balls(grey: U8, target: Target) -> F64 | None:
    """Find centroids of as many bright balls as the wand has, in order along it."""
    smooth = cv2.GaussianBlur(grey, (0, 0), _BLUR_PX)
    count, _, stats, centers = cv2.connectedComponentsWithStats(
        (smooth > 255.0 * _LIT).astype(np.uint8)
    )
    largest = 1 + np.argsort(stats[1:, cv2.CC_STAT_AREA])[::-1][: target.columns]
    if count - 1 < target.columns:
        return None
    balls = _centroids(grey, centers[largest], _FULL)
    axis = np.linalg.svd(balls - balls.mean(axis=0))[2][0]
    return np.asarray(balls[np.argsort(balls @ axis)])


def _centroids(light: U8, centers: F64, full: float = 1.0) -> F64:
    """Compute centroids of blobs; light above `full` of the peak is cut."""
    gaps = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    out = centers.copy()
    for number, (center, gap) in enumerate(zip(centers, gaps.min(axis=1), strict=True)):
        radius = max(3, int(min(0.45 * gap, 60.0)))
        left, top = np.maximum(np.rint(center).astype(int) - radius, 0)
        patch = light[top : top + 2 * radius + 1, left : left + 2 * radius + 1].astype(np.float64)
        dark, peak = np.median(patch), patch.max() - np.median(patch)
        patch = np.clip(patch - dark - _FAINT * peak, 0.0, (full - _FAINT) * peak)
        rows, columns = np.mgrid[: patch.shape[0], : patch.shape[1]]
        total = patch.sum()
        if total > 0.0:
            out[number] = left + (patch * columns).sum() / total, top + (patch * rows).sum() / total
    return out


def _choose_order(points: F64, target: Target, expected: F64 | None) -> F64:
    """Choose the possible order of points nearest to the expected directions."""
    plan = target.points_mm[:, :2] if expected is None else expected
    finite = np.isfinite(plan).all(axis=1)
    goal = plan[finite] - plan[finite].mean(axis=0)
    grid = np.arange(len(points)).reshape(target.rows, target.columns)
    rotated = [np.rot90(grid, quarter) for quarter in range(4)]
    if target.rows > 1:
        rotated += [order.T for order in rotated]
    orders = [order.ravel() for order in rotated if order.shape == grid.shape]
    return max(
        (points[order] for order in orders),
        key=lambda ordered: float(np.sum((ordered[finite] - ordered[finite].mean(axis=0)) * goal)),
    )
