"""Regression by a Gaussian process.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.2 and
5.4.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sabench.utils.arrays import F64

_JITTER = 1e-8  # variance on the diagonal, for rounding


@dataclass(frozen=True)
class Kernel:
    """Squared exponential of its own length along each feature, plus a linear part.

    Attributes
    ----------
    lengths : (feature,).
    amplitude, slope, noise : standard deviations of the two parts, and of the values' noise.
    """

    lengths: F64
    amplitude: float
    slope: float
    noise: float

    def __call__(self, one: F64, other: F64) -> F64:
        """Compute covariances (n, m) of points (n, feature) and (m, feature)."""
        apart = (one[:, None] - other[None]) / self.lengths
        near = self.amplitude**2 * np.exp(-0.5 * np.sum(apart**2, axis=2))
        return np.asarray(near + self.slope**2 * (1.0 + one @ other.T))


@dataclass(frozen=True)
class GaussianProcess:
    """Values (n,) measured at points (n, feature), and the kernel that joins them."""

    points: F64
    values: F64
    kernel: Kernel

    @cached_property
    def _inverse(self) -> F64:
        """Inverse covariance (n, n) of the measured values."""
        own = self.kernel(self.points, self.points)
        own[np.diag_indices_from(own)] += self.kernel.noise**2 + _JITTER
        return np.asarray(np.linalg.inv(own))

    @cached_property
    def _weights(self) -> F64:
        return np.asarray(self._inverse @ (self.values - self.values.mean()))

    def predict(self, points: F64) -> tuple[F64, F64]:
        """Predict means and deviations (m,) of new values at points (m, feature).

        Equations 2.25 and 2.26.
        """
        across = self.kernel(points, self.points)
        own = np.array([self.kernel(one[None], one[None])[0, 0] for one in points])
        known = np.einsum("ij,jk,ik->i", across, self._inverse, across)
        variance = np.maximum(own + self.kernel.noise**2 - known, 0.0)
        return self.values.mean() + across @ self._weights, np.sqrt(variance)

    def left_out(self) -> F64:
        """Predict each value (n,) from all others.

        Equation 5.12.
        """
        return np.asarray(self.values - self._weights / np.diag(self._inverse))

    def surprise(self) -> float:
        """Compute the negative logarithm of the values' likelihood, without its constant.

        Equation 2.30.
        """
        sign, determinant = np.linalg.slogdet(self._inverse)
        if sign <= 0.0 or not np.isfinite(determinant):
            return float("inf")
        centred = self.values - self.values.mean()
        return float(0.5 * centred @ self._weights - 0.5 * determinant)
