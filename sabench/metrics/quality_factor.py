"""Reconstruction quality Q."""

import numpy as np

from sabench.utils.arrays import F32


def quality(estimate: F32, truth: F32) -> float:
    """Compute the quality factor Q of a reconstructed volume (z, y, x).

    Q = sum(E_r E_s) / sqrt(sum E_r^2 sum E_s^2), thesis equation 2.13 (Elsinga et al. 2006), with
    the reconstructed field E_r and the synthesised field E_s. It is 1 for equal volumes, 0 if
    either is empty, and does not depend on their scales. Sums are in double precision, plane by
    plane.
    """
    if estimate.shape != truth.shape:
        raise ValueError(
            f"quality: expected two volumes of one shape, got {estimate.shape} and {truth.shape}"
        )
    sums = np.zeros(3)
    for a, b in zip(estimate, truth, strict=True):
        a64, b64 = a.astype(np.float64), b.astype(np.float64)
        sums += [np.vdot(a64, b64), np.vdot(a64, a64), np.vdot(b64, b64)]
    norm = np.sqrt(sums[1]) * np.sqrt(sums[2])
    return min(1.0, float(sums[0] / norm)) if norm > 0.0 else 0.0
