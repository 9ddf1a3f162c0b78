"""Flatness of particle images, from products of pixels.

Images of particles out of focus are discs. Products of their pixels fall with distance in another
way than a Gaussian's.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sabench.utils.arrays import F64

PIXEL = 1.0 / 12.0  # variance of a pixel's extent, px2
_FLATNESS = np.linspace(0.0, 0.08, 33)  # tried
_SQUARES = np.geomspace(1.0, 9.0, 120)  # px2: tried; narrower images hardly differ from Gaussians
_LEAST = 0.012  # as little does not


def measure_flatness(products: F64, near: Iterable[int], far: Iterable[int]) -> F64:
    """Measure (3,) the widths, px, and the flatness of images.

    They are those of `image_model`, and 0 where images are no flatter than Gaussians, or too
    narrow to tell. Those found have the least squared error of the products.

    Parameters
    ----------
    products : (axis, distance) of pixels along columns and rows, less those far apart.
    near, far : distances, px, of the products, and those that are far apart.
    """
    if not np.isfinite(products).all():
        return np.zeros(3)
    shape = _FLATNESS[:, None, None], _SQUARES[:, None]
    apart = [_falloff(*shape, np.array(list(one), dtype=float)) for one in (near, far)]
    shown = apart[0] - apart[1].mean(axis=2, keepdims=True)
    # of each flatness (first), axis and width
    height = products @ shown.transpose(0, 2, 1) / (shown**2).sum(axis=2)[:, None]
    height = np.maximum(height, 0.0)
    left = products[:, None] - height[..., None] * shown[:, None]
    squares = (left**2).sum(axis=3)
    which = int(squares.min(axis=2).sum(axis=1).argmin())
    best = squares[which].argmin(axis=1)
    if best.min() == 0 or _FLATNESS[which] < _LEAST:
        return np.zeros(3)
    widths = np.sqrt(_SQUARES[best] - PIXEL)
    flatness = _FLATNESS[which] * np.sqrt(_SQUARES[best]).prod() ** 2 / widths.prod() ** 2
    return np.array([*widths, flatness])


def _falloff(flatness: F64, square: F64, apart: F64) -> F64:
    """Compute products of pixels of images over those of Gaussians at distance 0.

    An image is a Gaussian less its flatness times the square of the Laplace operator on it, in
    units of widths. Powers of the operator on a Gaussian are Laguerre's polynomials times it.
    """
    w = apart**2 / (4.0 * square)
    second = 1.0 - 2.0 * w + w**2 / 2.0
    fourth = 1.0 - 4.0 * w + 3.0 * w**2 - 2.0 / 3.0 * w**3 + w**4 / 24.0
    return np.asarray(np.exp(-w) * (1.0 - 4.0 * flatness * second + 24.0 * flatness**2 * fourth))
