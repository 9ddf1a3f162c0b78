"""Gaussians averaged over pixels or voxels: their shares, derivatives and width."""

import math
from typing import Any

import numpy as np

from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import numba
from sabench.utils.vector_units import fill_edges, fill_edges_and_slopes


@numba.njit(cache=True)
def fill_shares(center: float, sigma: float, first: int, pixels: int, shares: Any) -> None:
    """Fill in shares (lane,) of a Gaussian from pixel `first` on, then zeros.

    Shares are exact to 1e-8.
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
    """Fill in the second to fifth derivatives (4, n) of shares.

    They are computed by Hermite's polynomials.
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


def gaussian_shares(edges: F64, sigma: float | F64) -> F64:
    """Compute the shares (n, m - 1) of Gaussians' integrals between edges (n, m).

    Edges are distances from the Gaussians' centres, in the unit of sigma, which is one or (n, 1).
    """
    from scipy.special import erf  # takes long to load

    shares: F64 = 0.5 * np.diff(erf(edges / (sigma * np.sqrt(2.0))), axis=1)
    return shares


def gaussian_profiles(center: F64, sigma: float | F64, first: I64, pixels: int) -> tuple[F64, F64]:
    """Compute Gaussians' shares (n, pixels) from `first` (n,) on, and slopes.

    The slopes are derivatives by the centre.
    """
    edges = first[:, None] + np.arange(pixels + 1) - 0.5 - center[:, None]
    height = np.exp(-0.5 * (edges / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
    return gaussian_shares(edges, sigma), height[:, :-1] - height[:, 1:]


def effective_width(sigma: float) -> float:
    """Compute (integral)^2 / (sum of squares) of a Gaussian, mean over its positions.

    Sigma and width are in pixels: 2 sqrt(pi) sigma for a wide Gaussian, 1 for a narrow one.
    """
    edge = 1.0 / (2.0 * sigma)
    return 1.0 / (math.erf(edge) + (math.exp(-(edge**2)) - 1.0) / (edge * math.sqrt(math.pi)))
