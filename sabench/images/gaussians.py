"""Gaussians averaged over pixels or voxels.

Their shares, in numpy and in kernels, and their width.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from sabench.images.gaussian_units import fill_edges, fill_edges_and_slopes
from sabench.utils.arrays import F64


def gaussian_shares(edges: F64, sigma: float) -> F64:
    """Compute the shares (n, m - 1) of Gaussians' integrals between edges (n, m).

    Edges are distances from the Gaussians' centres, in the unit of sigma.
    """
    from scipy.special import erf  # takes long to load

    shares: F64 = 0.5 * np.diff(erf(edges / (sigma * np.sqrt(2.0))), axis=1)
    return shares


@numba.njit(cache=True)
def fill_shares(center: float, sigma: float, first: int, pixels: int, shares: Any) -> None:
    """Fill in shares of a Gaussian's integral from pixel `first` on, to 1e-8.

    They are (lane,), as `gaussian_units.whole_lanes` says, and 0 after so many pixels.
    """
    step = 1.0 / (sigma * math.sqrt(2.0))
    fill_edges(shares, (first - 0.5 - center) * step, step, pixels)


@numba.njit(cache=True)
def fill_profile(
    center: float, sigma: float, first: int, pixels: int, shares: Any, slopes: Any
) -> None:
    """Fill in `fill_shares` and their derivatives by the centre, to 4e-8 of a step."""
    step = 1.0 / (sigma * math.sqrt(2.0))
    fill_edges_and_slopes(shares, slopes, (first - 0.5 - center) * step, step, pixels)


@numba.njit(cache=True)
def fill_growth(center: float, sigma: float, first: int, growth: Any) -> None:
    """Fill in the derivatives (n,) of the shares by sigma."""
    scale, peak = 1.0 / (sigma * math.sqrt(2.0)), 1.0 / (math.sqrt(2.0 * math.pi) * sigma**2)
    edge = first - 0.5 - center
    before = edge * peak * math.exp(-((edge * scale) ** 2))
    for i in range(len(growth)):
        edge = first + i + 0.5 - center
        after = edge * peak * math.exp(-((edge * scale) ** 2))
        growth[i] = before - after
        before = after


@numba.njit(cache=True)
def fill_bend(center: float, sigma: float, first: int, bend: Any) -> None:
    """Fill in the second derivatives (n,) of the shares by the centre.

    They are those by sigma, over sigma: Gaussians spread as heat does.
    """
    fill_growth(center, sigma, first, bend)
    for i in range(len(bend)):
        bend[i] /= sigma


def effective_width(sigma: float) -> float:
    """Compute (integral)^2 / (sum of squares) of a Gaussian, mean over its positions.

    Sigma and width are in pixels: 2 sqrt(pi) sigma for a wide Gaussian, 1 for a narrow one.
    """
    edge = 1.0 / (2.0 * sigma)
    return 1.0 / (math.erf(edge) + (math.exp(-(edge**2)) - 1.0) / (edge * math.sqrt(math.pi)))
