"""Refinement of particles by a fit to the images.

Positions and brightnesses leave the least light unexplained. The original method moves particles by
fixed amounts and keeps the best position ("shaking": Wieneke, Iterative reconstruction of
volumetric particle distribution, Meas. Sci. Technol. 24, 024008, 2013). Here, particles take
Gauss-Newton steps one after the other, against the images less those of all others. A particle's
image is a Gaussian that pixels average; its brightness is free in every camera.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from sabench.geometry.volume_polynomials import VolumePolynomials, project_point
from sabench.images.gaussians import fill_shares, fill_slopes
from sabench.utils.arrays import F32, F64

_HALF = 3  # pixels from the middle of a particle's image to the border of its window
_WINDOW = 2 * _HALF + 1
_KNOWN = 0.01  # of a particle's image: from less, its light would be mostly noise
_FARTHEST_PX = 0.5  # that a particle moves in one step


def image_widths(images: F32, pixels: list[F64]) -> F64:
    """Estimate standard deviations (camera,) of lone particles' images, px.

    Each estimate uses three values along either axis, about pixels that are not on the border; a
    peak half a pixel from one is rounded away from it. The lower quartile is returned, since
    overlaps widen images.
    """
    out = []
    for image, positions in zip(images, pixels, strict=True):
        inner = np.array(image.shape[::-1]) - 2
        column, row = np.clip(np.rint(positions), 1, inner).astype(np.int64).T
        high = np.log(np.maximum(image, 1e-6))
        bends = np.concatenate(
            [
                2.0 * high[row, column] - high[row, column - 1] - high[row, column + 1],
                2.0 * high[row, column] - high[row - 1, column] - high[row + 1, column],
            ]
        )
        bends = bends[(bends > 0.05) & (bends < 20.0)]
        square = float(np.quantile(1.0 / bends, 0.25)) - 1.0 / 12.0 if len(bends) else 0.0
        out.append(math.sqrt(max(square, 0.09)))
    return np.array(out)


@numba.njit(cache=True)
def _paint(image: Any, column: int, row: int, x: Any, y: Any, amount: float) -> None:
    """Add a particle's image, from its first column and row on."""
    rows, columns = image.shape
    for i in range(max(0, -row), min(_WINDOW, rows - row)):
        for j in range(max(0, -column), min(_WINDOW, columns - column)):
            image[row + i, column + j] += np.float32(amount * y[i] * x[j])


@numba.njit(cache=True)
def refine_particles(
    maps: Any, sigma: Any, left: Any, unknown: Any, positions: Any, light: Any, rounds: int
) -> None:
    """Fit particles one after the other, in several rounds.

    Parameters
    ----------
    sigma : (camera,) widths of particle images, px.
    left : (camera, row, column) float32, the images less all particles; kept up to date.
    unknown : the same shape, pixels that are not fitted.
    positions : (n, 3) in the box of the maps.
    light : (n, camera) of each particle, in units of the images times px2; not negative.
    """
    cameras = len(sigma)
    x, y, dx, dy = (
        np.zeros((cameras, _WINDOW)),
        np.zeros((cameras, _WINDOW)),
        np.zeros((cameras, _WINDOW)),
        np.zeros((cameras, _WINDOW)),
    )
    corner, here, slope = np.zeros((cameras, 2), dtype=np.int64), np.zeros(2), np.zeros((2, 3))
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for _ in range(rounds):
        for n in range(len(positions)):
            position = positions[n]
            matrix[:], right[:], steepest = 0.0, 0.0, 0.0
            for c in range(cameras):
                _set(maps, c, position, sigma[c], here, slope, corner[c], x[c], y[c], dx[c], dy[c])
                _paint(left[c], corner[c, 0], corner[c, 1], x[c], y[c], light[n, c])
                _pull(
                    left[c],
                    unknown[c],
                    corner[c],
                    x[c],
                    y[c],
                    dx[c],
                    dy[c],
                    light[n, c],
                    slope,
                    matrix,
                    right,
                )
                steepest = max(steepest, np.abs(slope).max())
            _move(position, matrix, right, _FARTHEST_PX / steepest)
            for c in range(cameras):
                _set(maps, c, position, sigma[c], here, slope, corner[c], x[c], y[c], dx[c], dy[c])
                light[n, c] = _brightness(left[c], unknown[c], corner[c], x[c], y[c])
                _paint(left[c], corner[c, 0], corner[c, 1], x[c], y[c], -light[n, c])


@numba.njit(cache=True)
def _set(
    maps: Any,
    c: int,
    position: Any,
    sigma: float,
    here: Any,
    slope: Any,
    corner: Any,
    x: Any,
    y: Any,
    dx: Any,
    dy: Any,
) -> None:
    """Project a position to a camera and fill in the profiles of its image there."""
    project_point(maps, c, position, here, slope)
    corner[0], corner[1] = round(here[0]) - _HALF, round(here[1]) - _HALF
    fill_shares(here[0], sigma, corner[0], x)
    fill_shares(here[1], sigma, corner[1], y)
    fill_slopes(here[0], sigma, corner[0], dx)
    fill_slopes(here[1], sigma, corner[1], dy)


@numba.njit(cache=True)
def _pull(
    image: Any,
    unknown: Any,
    corner: Any,
    x: Any,
    y: Any,
    dx: Any,
    dy: Any,
    light: float,
    slope: Any,
    matrix: Any,
    right: Any,
) -> None:
    """Add a camera's part to the normal equations of a particle's position."""
    rows, columns = image.shape
    for i in range(max(0, -corner[1]), min(_WINDOW, rows - corner[1])):
        for j in range(max(0, -corner[0]), min(_WINDOW, columns - corner[0])):
            if unknown[corner[1] + i, corner[0] + j]:
                continue
            by_column, by_row = light * y[i] * dx[j], light * dy[i] * x[j]
            off = image[corner[1] + i, corner[0] + j] - light * y[i] * x[j]
            for p in range(3):
                first = by_column * slope[0, p] + by_row * slope[1, p]
                right[p] += first * off
                for q in range(3):
                    matrix[p, q] += first * (by_column * slope[0, q] + by_row * slope[1, q])


@numba.njit(cache=True)
def _move(position: Any, matrix: Any, right: Any, farthest: float) -> None:
    if np.linalg.det(matrix) > 1e-9 * matrix[0, 0] * matrix[1, 1] * matrix[2, 2] > 0.0:
        step = np.linalg.solve(matrix, right)
        position += step * min(1.0, farthest / max(np.abs(step).max(), 1e-300))
        for p in range(3):
            position[p] = min(max(position[p], -1.0), 1.0)


@numba.njit(cache=True)
def _brightness(image: Any, unknown: Any, corner: Any, x: Any, y: Any) -> float:
    """Compute the light that leaves the least of a window unexplained.

    0 where less than `_KNOWN` of the image's squares is known and on the sensor.
    """
    rows, columns = image.shape
    both, own, whole = 0.0, 0.0, (x * x).sum() * (y * y).sum()
    for i in range(max(0, -corner[1]), min(_WINDOW, rows - corner[1])):
        for j in range(max(0, -corner[0]), min(_WINDOW, columns - corner[0])):
            if unknown[corner[1] + i, corner[0] + j]:
                continue
            both += image[corner[1] + i, corner[0] + j] * y[i] * x[j]
            own += (y[i] * x[j]) ** 2
    return max(both / own, 0.0) if own > _KNOWN * whole else 0.0


@numba.njit(cache=True)
def subtract_images(maps: Any, sigma: Any, left: Any, positions: Any, light: Any) -> None:
    """Give the light of particles back to the images less all particles."""
    x, y, d, corner, here, slope = (
        np.zeros(_WINDOW),
        np.zeros(_WINDOW),
        np.zeros(_WINDOW),
        np.zeros(2, dtype=np.int64),
        np.zeros(2),
        np.zeros((2, 3)),
    )
    for n in range(len(positions)):
        for c in range(len(sigma)):
            _set(maps, c, positions[n], sigma[c], here, slope, corner, x, y, d, d)
            _paint(left[c], corner[0], corner[1], x, y, light[n, c])


def peak_brightness(light: F64, sigma: F64) -> F64:
    """Compute the brightest pixel (n, camera) of particles centred on a pixel."""
    share = np.array([math.erf(0.5 / (math.sqrt(2.0) * one)) ** 2 for one in sigma])
    return np.asarray(light * share)


def in_mm(maps: VolumePolynomials, positions: F64) -> F64:
    """Convert positions in the box of the maps to world points (n, 3)."""
    return np.asarray(maps.middle_mm + positions * maps.half_mm)
