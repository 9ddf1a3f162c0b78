"""Compiled kernels of shares of Gaussians, and of their derivatives."""

import math
from typing import Any

from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.vector_units import fill_edges, fill_edges_and_slopes


@inner_kernel()
def fill_shares(center: float, sigma: float, first: int, pixels: int, shares: Any) -> None:
    """Fill in shares (lane,) of a Gaussian from pixel `first` on, then zeros.

    Shares are exact to 1e-8.
    """
    step = 1.0 / (sigma * math.sqrt(2.0))
    fill_edges(shares, (first - 0.5 - center) * step, step, pixels)


@inner_kernel()
def fill_profile(
    center: float, sigma: float, first: int, pixels: int, shares: Any, slopes: Any
) -> None:
    """Fill in `fill_shares` and their derivatives by the centre, to 4e-8 of a step."""
    step = 1.0 / (sigma * math.sqrt(2.0))
    fill_edges_and_slopes(shares, slopes, (first - 0.5 - center) * step, step, pixels)


@numba.njit(inline="always")
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


@inner_kernel()
def fill_derivatives(center: float, sigma: float, first: int, derivatives: Any) -> None:
    """Fill in second to fifth derivatives (4, n) of shares by Hermite's polynomials."""
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
