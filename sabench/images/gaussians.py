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
def fill_bend(center: float, sigma: float, first: int, bend: Any) -> None:
    """Fill in the second derivatives (n,) of the shares by the centre."""
    scale = -1.0 / (math.sqrt(2.0 * math.pi) * sigma**2)
    z = (first - 0.5 - center) / sigma
    before = scale * z * math.exp(-0.5 * z * z)
    for i in range(len(bend)):
        z = (first + i + 0.5 - center) / sigma
        after = scale * z * math.exp(-0.5 * z * z)
        bend[i] = after - before
        before = after


@numba.njit(cache=True)
def fill_derivatives(center: float, sigma: float, first: int, derivatives: Any) -> None:
    """Fill in the second to the fifth derivatives (4, n) of shares by the centre.

    Derivatives of a Gaussian are that times Hermite's polynomials of the distance z to the centre.
    """
    scale, pixels = -1.0 / (math.sqrt(2.0 * math.pi) * sigma**2), derivatives.shape[1]
    for i in range(pixels + 1):
        z = (first + i - 0.5 - center) / sigma
        edge, before, here = scale * math.exp(-0.5 * z * z), 1.0, z
        for n in range(4):
            if i < pixels:
                derivatives[n, i] = -edge * here
            if i:
                derivatives[n, i - 1] += edge * here
            edge, before, here = edge / sigma, here, z * here - (n + 1) * before


def effective_width(sigma: float) -> float:
    """Compute (integral)^2 / (sum of squares) of a Gaussian, mean over its positions.

    Sigma and width are in pixels: 2 sqrt(pi) sigma for a wide Gaussian, 1 for a narrow one.
    """
    edge = 1.0 / (2.0 * sigma)
    return 1.0 / (math.erf(edge) + (math.exp(-(edge**2)) - 1.0) / (edge * math.sqrt(math.pi)))
