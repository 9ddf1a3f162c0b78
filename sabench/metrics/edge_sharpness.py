"""Sharpness of a checkerboard's edges: width of the edge spread and MTF50."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal.windows import tukey

from sabench.utils.arrays import F64

_ALONG = 0.3  # of the pitch: half the part of an edge that is looked at, far from the corners
_ACROSS = 0.35  # of the pitch: half the width of the strip across an edge
_FLAT = 0.25  # of the pitch: from here on the strip is as dark or bright as its side
_FINE = 4  # bins of the edge spread per pixel, as in ISO 12233


@dataclass(frozen=True)
class EdgeSharpness:
    """Sharpness of an image in units of the board.

    Attributes
    ----------
    width_mm : distance over which an edge rises from 10 to 90 % of its contrast.
    mtf50 : spatial frequency (cycles / mm) that keeps half of its contrast.
    """

    width_mm: float
    mtf50: float


def measure_sharpness(values: F64, corners: F64, pitch_mm: float) -> EdgeSharpness:
    """Measure the mean edge of a checkerboard's image.

    Every edge between two neighbouring corners is brought to its own contrast and position first,
    so that uneven light and displacements of whole edges do not count as blur.

    Parameters
    ----------
    values : (rows, columns) image, linear in the light.
    corners : (m, n, 2) pixels (column, row) of the inner corners, neighbours along the first two
        axes; NaN where unknown.
    pitch_mm : distance of neighbouring corners.

    Source: ISO 12233 (slanted edge), with all edges of the board in one edge spread.

    Raises
    ------
    ValueError
        No edge lies in the image.
    """
    flipped = corners.transpose(1, 0, 2)
    samples = [*_strips(values, corners, pitch_mm), *_strips(values, flipped, pitch_mm)]
    if not samples:
        raise ValueError("expected edges of a checkerboard in the image, got none")
    distance, level = np.concatenate(samples, axis=1)
    pixel_mm = pitch_mm / float(np.nanmean(np.linalg.norm(np.diff(corners, axis=1), axis=-1)))
    return _sharpness(*_edge_spread(distance, level, pixel_mm / _FINE, _ACROSS * pitch_mm))


def _strips(values: F64, corners: F64, pitch_mm: float) -> list[F64]:
    """Collect distances (mm) and levels (2, k) of edges along the second axis."""
    rows, columns = len(corners), corners.shape[1] - 1
    found = []
    for row in range(rows):
        aside, sign = (row + 1, 1.0) if row + 1 < rows else (row - 1, -1.0)
        for column in range(columns):
            origin = corners[row, column]
            axes = np.column_stack(
                [corners[row, column + 1] - origin, sign * (corners[aside, column] - origin)]
            )
            strip = _strip(values, origin, axes)
            if strip is not None:
                found.append(strip * np.array([[pitch_mm], [1.0]]))
    return found


def _strip(values: F64, origin: F64, axes: F64) -> F64 | None:
    """Read the strip across one edge from its start along `axes` (2, 2).

    Returns distances in pitches, and levels: 0 on the dark side, 1 on the bright side. None where
    the strip leaves the image or its corners are unknown.
    """
    ends = (
        origin
        + np.array(
            [[0.5 + side * _ALONG, across * _ACROSS] for side in (-1, 1) for across in (-1, 1)]
        )
        @ axes.T
    )
    (left, top), (right, bottom) = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0))
    if (
        not np.isfinite(ends).all()
        or left < 0
        or top < 0
        or right >= values.shape[1]
        or bottom >= values.shape[0]
    ):
        return None
    x, y = np.meshgrid(np.arange(left, right + 1), np.arange(top, bottom + 1))
    along, across = np.linalg.solve(axes, np.stack([x.ravel(), y.ravel()]) - origin[:, None])
    inside = (np.abs(along - 0.5) < _ALONG) & (np.abs(across) < _ACROSS)
    across = across[inside]
    level = values[int(top) : int(bottom) + 1, int(left) : int(right) + 1].ravel()[inside]
    low, high = level[across < -_FLAT].mean(), level[across > _FLAT].mean()
    if low > high:
        low, high, across = high, low, -across
    level = (level - low) / (high - low)
    shift = _ACROSS * (1.0 - 2.0 * level.mean())  # an ideal step there has this mean level
    return np.stack([across - shift, level])


def _edge_spread(distance: F64, level: F64, step: float, reach: float) -> tuple[F64, F64]:
    """Average levels in bins of the distance; empty bins are interpolated."""
    half = int(reach / step)
    edges = step * (np.arange(-half, half + 1) - 0.5)
    count, total = (np.histogram(distance, edges, weights=weights)[0] for weights in (None, level))
    middle = (edges[1:] + edges[:-1]) / 2.0
    return middle, np.interp(middle, middle[count > 0], total[count > 0] / count[count > 0])


def _sharpness(distance: F64, spread: F64) -> EdgeSharpness:
    """Compute width and MTF50 from an edge spread that rises with the distance."""
    step = distance[1] - distance[0]
    line = np.diff(spread)
    size = 16 * len(line)
    contrast = np.abs(np.fft.rfft(line * tukey(len(line)), size))
    frequency = np.fft.rfftfreq(size, step)
    contrast /= contrast[0] * np.sinc(frequency * step) ** 2  # of the bin and of the difference
    first = int(np.argmax(contrast < 0.5))
    before, after = contrast[first - 1 : first + 1]
    part = (before - 0.5) / (before - after)
    mtf50 = frequency[first - 1] + part * (frequency[first] - frequency[first - 1])
    return EdgeSharpness(
        _cross(distance, spread, 0.9) - _cross(distance, spread, 0.1), float(mtf50)
    )


def _cross(distance: F64, spread: F64, level: float) -> float:
    """Find where the spread crosses a level, nearest to the edge."""
    above = spread >= level
    crossings = np.flatnonzero(~above[:-1] & above[1:])
    nearest = crossings[np.abs(distance[crossings]).argmin()]
    low, high = spread[nearest], spread[nearest + 1]
    step = distance[nearest + 1] - distance[nearest]
    return float(distance[nearest] + step * (level - low) / (high - low))
