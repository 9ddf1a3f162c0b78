"""Gaussians averaged over pixels or voxels.

Their shares, in numpy and in kernels, and their width.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from sabench.utils.arrays import F64

_TABLE_STEP, _TABLE_END = 1.0 / 32.0, 6.0  # of half the error function, in the unit of its argument


def _half_erf_table() -> F64:
    """Tabulate half the error function and its derivative times the step."""
    nodes = np.arange(-_TABLE_END, _TABLE_END + 1.5 * _TABLE_STEP, _TABLE_STEP)
    halves = [0.5 * math.erf(node) for node in nodes]
    slopes = _TABLE_STEP / math.sqrt(math.pi) * np.exp(-(nodes**2))
    return np.stack([np.array(halves), slopes], axis=1)


_HALF_ERF = _half_erf_table()


def gaussian_shares(edges: F64, sigma: float) -> F64:
    """Compute the shares (n, m - 1) of Gaussians' integrals between edges (n, m).

    Edges are distances from the Gaussians' centres, in the unit of sigma.
    """
    from scipy.special import erf  # takes long to load

    shares: F64 = 0.5 * np.diff(erf(edges / (sigma * np.sqrt(2.0))), axis=1)
    return shares


@numba.njit(cache=True)
def fill_shares(center: float, sigma: float, first: int, shares: Any) -> None:
    """Fill in shares (n,) of a Gaussian's integral from pixel `first` on, to 1e-8."""
    scale = 1.0 / (sigma * math.sqrt(2.0))
    before = _half_erf((first - 0.5 - center) * scale)
    for i in range(len(shares)):
        after = _half_erf((first + i + 0.5 - center) * scale)
        shares[i] = after - before
        before = after


@numba.njit(cache=True)
def fill_slopes(center: float, sigma: float, first: int, slopes: Any) -> None:
    """Fill in the derivatives (n,) of the shares by the Gaussian's centre."""
    scale, peak = 1.0 / (sigma * math.sqrt(2.0)), 1.0 / (math.sqrt(2.0 * math.pi) * sigma)
    before = peak * math.exp(-(((first - 0.5 - center) * scale) ** 2))
    for i in range(len(slopes)):
        after = peak * math.exp(-(((first + i + 0.5 - center) * scale) ** 2))
        slopes[i] = before - after
        before = after


@numba.njit(cache=True)
def _half_erf(t: float) -> float:
    """Interpolate half the error function by cubics (Hermite): exact to 1e-8."""
    at = (min(max(t, -_TABLE_END), _TABLE_END) + _TABLE_END) / _TABLE_STEP
    whole = int(at)
    k, part = np.uintp(whole), at - whole
    left, right = _HALF_ERF[k, 1], _HALF_ERF[k + np.uintp(1), 1]
    rise = _HALF_ERF[k + np.uintp(1), 0] - _HALF_ERF[k, 0]
    bend = part * (left + right - 2.0 * rise) + 3.0 * rise - 2.0 * left - right
    return float(_HALF_ERF[k, 0] + part * (left + part * bend))


@numba.njit(cache=True)
def fill_profile(center: float, sigma: float, first: int, shares: Any, slopes: Any) -> None:
    """Fill in `fill_shares` and `fill_slopes` to 1e-8, several times as fast.

    Gaussians at pixels' edges, which are equally far apart, have ratios with a constant ratio.
    """
    step = 1.0 / (sigma * math.sqrt(2.0))
    t = (first - 0.5 - center) * step
    before, edge = _half_erf(t), math.exp(-t * t) * step / math.sqrt(math.pi)
    ratio, change = math.exp(-step * (2.0 * t + step)), math.exp(-2.0 * step * step)
    for i in range(len(shares)):
        t += step
        after, next_edge = _half_erf(t), edge * ratio
        shares[i], slopes[i] = after - before, edge - next_edge
        before, edge, ratio = after, next_edge, ratio * change


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


def effective_width(sigma: float) -> float:
    """Compute (integral)^2 / (sum of squares) of a Gaussian, mean over its positions.

    Sigma and width are in pixels: 2 sqrt(pi) sigma for a wide Gaussian, 1 for a narrow one.
    """
    edge = 1.0 / (2.0 * sigma)
    return 1.0 / (math.erf(edge) + (math.exp(-(edge**2)) - 1.0) / (edge * math.sqrt(math.pi)))
