"""Reconstruction quality Q."""

import numpy as np

from sabench.utils.arrays import F32


def quality(reconstructed: F32, synthesised: F32) -> float:
    """Q = sum(E_r E_s) / sqrt(sum E_r^2 sum E_s^2), thesis equation 2.13 (Elsinga et al. 2006); 0 if either volume is empty.

    Any scale of either volume gives the same Q; 1 for equal volumes. Both are (z, y, x); sums are
    in double precision, plane by plane.
    """
    if reconstructed.shape != synthesised.shape:
        raise ValueError(
            f"quality: expected two volumes of one shape, got {reconstructed.shape} and {synthesised.shape}"
        )
    sums = np.zeros(3)
    for a, b in zip(reconstructed, synthesised, strict=True):
        a64, b64 = a.astype(np.float64), b.astype(np.float64)
        sums += [np.vdot(a64, b64), np.vdot(a64, a64), np.vdot(b64, b64)]
    norm = np.sqrt(sums[1]) * np.sqrt(sums[2])
    return min(1.0, float(sums[0] / norm)) if norm > 0.0 else 0.0
