"""Size distributions of bubbles: scores against the truth, and counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.confidence import Mean, mean_of


def sauter_mm(radius_mm: F64) -> float:
    """Compute the Sauter mean diameter d32 = sum of d^3 / sum of d^2 from radii (n,).

    It is the diameter of the ball with the ratio of volume to surface of all bubbles together. NaN
    without bubbles.
    """
    square = float(np.sum(radius_mm**2))
    return 2.0 * float(np.sum(radius_mm**3)) / square if square else float("nan")


def size_scores(own_mm: F64, true_mm: F64) -> dict[str, float]:
    """Score radii (n,) as a distribution against true radii (m,).

    NaN where either has none.
    `sizes_mm` is the first Wasserstein distance: the mean difference of radii of equal rank, which
    moves one distribution onto the other. `sizes_percent` is the same over the true mean radius.
    `mean_percent` and `sauter_percent` are errors, regardless of sign, of mean radius and d32.
    """
    from scipy.stats import wasserstein_distance  # takes long to load

    keys = ("sizes_mm", "sizes_percent", "mean_percent", "sauter_percent")
    if not len(own_mm) or not len(true_mm):
        return dict.fromkeys(keys, float("nan"))
    distance, mean = float(wasserstein_distance(own_mm, true_mm)), float(true_mm.mean())
    return {
        "sizes_mm": distance,
        "sizes_percent": 100.0 * distance / mean,
        "mean_percent": 100.0 * abs(float(own_mm.mean()) / mean - 1.0),
        "sauter_percent": 100.0 * abs(sauter_mm(own_mm) / sauter_mm(true_mm) - 1.0),
    }


def counts_per_frame(radii_mm: Sequence[F64], edges_mm: F64) -> list[Mean]:
    """Count bubbles per bin of radius and frame.

    The 95 % confidence intervals are over the frames.

    Parameters
    ----------
    radii_mm : radii (n,) of each frame.
    edges_mm : (bins + 1,) edges of the bins, rising.

    Raises
    ------
    ValueError
        No frame.
    """
    if not len(radii_mm):
        raise ValueError("radii_mm: expected those of one frame or more, got none")
    counts = np.array([np.histogram(frame, edges_mm)[0] for frame in radii_mm], dtype=np.float64)
    means = [mean_of(list(column)) for column in counts.T]
    return [mean for mean in means if mean is not None]
