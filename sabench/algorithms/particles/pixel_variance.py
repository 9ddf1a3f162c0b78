"""Variance of pixels, estimated from what particles leave of the images."""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench.utils.compiled import numba

_CLIP = 30.0  # mean squares: more of one pixel says nothing of the others
_OWN_ERROR = 0.03  # of a particle's image: particles differ
_UNKNOWN = 0.25  # of light that is left: other particles' tails do not explain it
_LEAST = 1e-100  # variance of images without noise
_STEPS, _LEAST_FREE = 4, 0.2  # of fits of the variance, and least share of a pixel that is free


@numba.njit(cache=True)
def _line(total: float, x: float, y: float, xx: float, xy: float) -> tuple[float, float]:
    """Fit a line to sums of weights, x, y, x^2, x y; returns value at 0 and slope."""
    if not total > 0.0:
        return 0.0, 0.0
    bend = xx - x * x / total
    slope = (xy - x * y / total) / bend if bend > 1e-12 * xx else 0.0
    return (y - slope * x) / total, slope


@numba.njit(cache=True)
def _miss(left: float, saturated: bool) -> float:
    """Return what is left of a pixel; 0 where a saturated one has enough."""
    return 0.0 if saturated and left < 0.0 else left


@numba.njit(cache=True)
def _modelled(image: float, left: float) -> float:
    """Return the particles' light in a pixel.

    It is no more than the image shows, or particles that are too bright would hide it.
    """
    return min(max(image - left, 0.0), max(image, 0.0))


@numba.njit(cache=True, nogil=True)
def fill_variance(
    image: Any, left: Any, known: Any, saturated: Any, dark: float, most: float, variance: Any
) -> None:
    """Fill in the variance of a camera's pixels for the fit of particles.

    A line over the model's light, of which the part above the dark noise is at most `most`, and
    shares of the model and of what is left. All arrays are (row, column), `dark` is a variance.
    """
    rows, columns = image.shape
    squares, count = 0.0, 0
    for i in range(rows):
        for j in range(columns):
            if known[i, j]:
                squares += _miss(left[i, j], saturated[i, j]) ** 2
                count += 1
    clip = _CLIP * squares / max(count, 1)
    x = y = xx = xy = 0.0
    for i in range(rows):
        for j in range(columns):
            if known[i, j]:
                light = _modelled(image[i, j], left[i, j])
                square = min(_miss(left[i, j], saturated[i, j]) ** 2, clip)
                x, y, xx, xy = x + light, y + square, xx + light * light, xy + light * square
    even, slope = _line(float(count), x, y, xx, xy)
    even, slope = max(even, dark), max(slope, 0.0)
    for i in range(rows):
        for j in range(columns):
            light, miss = _modelled(image[i, j], left[i, j]), _miss(left[i, j], saturated[i, j])
            least = (_OWN_ERROR * light) ** 2 + (_UNKNOWN * miss) ** 2
            variance[i, j] = max(min(even + slope * light, dark + most), dark + least)


@numba.njit(cache=True, nogil=True)
def fill_noise(
    shown: Any, left: Any, weight: Any, leverage: Any, noise: float, variance: Any
) -> None:
    """Fill in the variance of a camera's pixels around particles.

    It is estimated from what is left there, and grows with the light. What fits have taken from it,
    the leverage, is given back. Unknown and saturated pixels tell nothing, and have an infinite
    variance. All arrays are (row, column).
    """
    rows, columns = shown.shape
    even, slope = noise * noise, 0.0
    for _ in range(_STEPS):
        total = x = y = xx = xy = 0.0
        for i in range(rows):
            for j in range(columns):
                light = shown[i, j] - left[i, j]
                if weight[i, j] > 0.0 and light > noise:
                    square = left[i, j] ** 2 / max(1.0 - leverage[i, j], _LEAST_FREE)
                    each = 1.0 / max(even + slope * light, _LEAST) ** 2
                    total, x, y = total + each, x + each * light, y + each * square
                    xx, xy = xx + each * light * light, xy + each * light * square
        even, slope = _line(total, x, y, xx, xy)
        even, slope = max(even, noise * noise), max(slope, 0.0)
    for i in range(rows):
        for j in range(columns):
            light = max(shown[i, j] - left[i, j], 0.0)
            variance[i, j] = even + slope * light if weight[i, j] > 0.0 else np.inf
