"""Transmission through a bubble whose image is an ellipse, pixel by pixel.

An ellipse is its centre's column and row, and the inverse of its shape matrix as xx, xy, yy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench.algorithms.bubbles.backlit_profile import LARGEST, REACH, SMALLEST
from sabench.utils.compiled import numba

DIM = 0.02  # transmission of the darkest model
_MARGIN = 2.5  # px around a bubble that are looked at


@numba.njit(cache=True, error_model="numpy")
def _shade(table: Any, blur: float, distance: float, part: float) -> Any:
    """Interpolate transmission at a distance in px.

    The distance is a part of the radius there. The profile's table is interpolated bilinearly.
    """
    radius = distance / part if part > 1e-9 else 1e9
    radius = min(max(radius, SMALLEST), LARGEST)
    across = distance / (radius + REACH * blur) * (table.shape[1] - 1)
    if across >= table.shape[1] - 1:
        return 1.0
    position = np.log(radius / SMALLEST) / np.log(LARGEST / SMALLEST) * (table.shape[0] - 1)
    i, j = min(int(position), table.shape[0] - 2), int(across)
    u, v = position - i, across - j
    upper = table[i, j] * (1.0 - v) + table[i, j + 1] * v
    lower = table[i + 1, j] * (1.0 - v) + table[i + 1, j + 1] * v
    return upper * (1.0 - u) + lower * u


@numba.njit(cache=True, error_model="numpy")
def shade_at(ellipse: Any, column: int, row: int, middle: float, table: Any, blur: float) -> Any:
    """Compute the transmission at a pixel; `middle` is the mean radius, px."""
    x, y = column - ellipse[0], row - ellipse[1]
    distance = np.sqrt(x * x + y * y)
    part = np.sqrt(max(ellipse[2] * x * x + 2.0 * ellipse[3] * x * y + ellipse[4] * y * y, 0.0))
    if distance < 1e-6:
        return (
            _shade(table, blur, 0.0, 0.0)
            if middle <= 0.0
            else _shade(table, blur, 1e-6 * middle, 1e-6)
        )
    return _shade(table, blur, distance, part)


@numba.njit(cache=True, error_model="numpy")
def slopes_at(
    ellipse: Any, column: int, row: int, middle: float, table: Any, blur: float, out: Any
) -> Any:
    """Compute the transmission at a pixel, and its derivatives by the ellipse.

    The transmission is at least `DIM`. Derivatives of the table are those of its bilinear
    interpolation.
    """
    out[:] = 0.0
    here = shade_at(ellipse, column, row, middle, table, blur)
    x, y = column - ellipse[0], row - ellipse[1]
    distance = np.sqrt(x * x + y * y)
    part = np.sqrt(max(ellipse[2] * x * x + 2.0 * ellipse[3] * x * y + ellipse[4] * y * y, 0.0))
    if here <= DIM or distance < 1e-6 or part <= 1e-9:
        return max(here, DIM)
    free = distance / part
    radius = min(max(free, SMALLEST), LARGEST)
    reach, most = radius + REACH * blur, table.shape[1] - 1
    across = distance / reach * most
    if across >= most:
        return here
    rate = (table.shape[0] - 1) / np.log(LARGEST / SMALLEST)
    position = np.log(radius / SMALLEST) * rate
    i, j = min(int(position), table.shape[0] - 2), int(across)
    u, v = position - i, across - j
    by_across = (table[i, j + 1] - table[i, j]) * (1.0 - u) + (
        table[i + 1, j + 1] - table[i + 1, j]
    ) * u
    by_position = (table[i + 1, j] - table[i, j]) * (1.0 - v) + (
        table[i + 1, j + 1] - table[i, j + 1]
    ) * v
    by_radius = by_position * rate / radius - by_across * across / reach if radius == free else 0.0
    by_distance = by_across * most / reach + by_radius / part
    by_part = -by_radius * distance / (part * part)
    out[0] = -by_distance * x / distance - by_part * (ellipse[2] * x + ellipse[3] * y) / part
    out[1] = -by_distance * y / distance - by_part * (ellipse[3] * x + ellipse[4] * y) / part
    out[2] = by_part * x * x / (2.0 * part)
    out[3] = by_part * x * y / part
    out[4] = by_part * y * y / (2.0 * part)
    return here


@numba.njit(cache=True, error_model="numpy")
def box_of(ellipse: Any, shape: Any, blur: float) -> Any:
    """Find the rows and columns that an ellipse's image reaches, and its mean radius."""
    determinant = ellipse[2] * ellipse[4] - ellipse[3] * ellipse[3]
    width, height = np.sqrt(ellipse[4] / determinant), np.sqrt(ellipse[2] / determinant)
    margin = REACH * blur + _MARGIN
    top, bottom = (
        int(max(np.floor(ellipse[1] - height - margin), 0)),
        int(min(np.ceil(ellipse[1] + height + margin) + 1, shape[0])),
    )
    left, right = (
        int(max(np.floor(ellipse[0] - width - margin), 0)),
        int(min(np.ceil(ellipse[0] + width + margin) + 1, shape[1])),
    )
    return top, bottom, left, right, determinant**-0.25
