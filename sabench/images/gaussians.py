"""Gaussians averaged over pixels or voxels: their shares and width."""

import math

import numpy as np

from sabench.utils.arrays import F64, I64


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
