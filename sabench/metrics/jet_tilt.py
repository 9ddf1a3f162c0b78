"""Tilt of a plunging jet against +Y: found from its bubbles, and removed.

Source: thesis, section 5.5.3, which turns all data about the point of impact before it computes
concentrations.
"""

from __future__ import annotations

import numpy as np

from sabench.metrics.plunging_jet import DEPTH_MM
from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import rotation_from_y

_SWEEPS = 3
_FEWEST = 5  # bubbles of a bin whose spread counts


def find_tilt(center_mm: F64, impact_mm: F64) -> tuple[float, float]:
    """Find the angles between a jet's axis and +Y, towards +X and towards +Z.

    They are in degrees.
    The axis is the straight line through the point of impact from which bubbles (n, 3) lie least
    far sideways, in units of the cloud's width at their depth.

    Raises
    ------
    ValueError
        Too few bubbles below the point of impact.
    """
    position = center_mm - np.asarray(impact_mm)
    position = position[position[:, 1] > 0.0]
    if len(position) < _FEWEST:
        raise ValueError(
            f"center_mm: expected {_FEWEST} bubbles below the jet, got {len(position)}"
        )
    y = position[:, 1]
    slope = np.zeros(2)
    for _ in range(_SWEEPS):
        aside = position[:, [0, 2]] - slope * y[:, None]
        weight = 1.0 / _variance(y, aside)
        slope = np.sum(weight[:, None] * y[:, None] * position[:, [0, 2]], axis=0) / np.sum(
            weight * y**2
        )
    return tuple(np.rad2deg(np.arctan(slope)).tolist())


def _variance(y: F64, aside: F64) -> F64:
    """Compute the mean square distance (n,) from the axis in a bubble's bin of depth."""
    bins = (y // DEPTH_MM).astype(np.int64)
    count = np.bincount(bins)
    sums = np.bincount(bins, np.sum(aside**2, axis=1))
    overall = float(np.mean(np.sum(aside**2, axis=1)))
    enough = count >= _FEWEST
    return np.where(enough, sums / np.maximum(count, 1), overall)[bins]


def straighten(center_mm: F64, impact_mm: F64, tilt_deg: tuple[float, float]) -> F64:
    """Rotate bubbles (n, 3) about the point of impact so that the jet's axis is +Y."""
    impact = np.asarray(impact_mm)
    return np.asarray((center_mm - impact) @ rotation_from_y(tilt_deg) + impact)
