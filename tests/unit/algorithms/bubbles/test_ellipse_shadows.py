"""Transmission through ellipses, and its derivatives."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.bubbles.backlit_images import Profile
from sabench.algorithms.bubbles.rim_fit import DIM, shade_at, slopes_at
from sabench.utils.arrays import F64

PROFILE = Profile.tabulate(1.0 / 1.333, 0.4, 0.8)
STEPS = 1e-6 * np.array([1.0, 1.0, 0.01, 0.01, 0.01])  # px, px, and 1/px^2 of the shape


def ellipse_of(rng: np.random.Generator) -> F64:
    long, short, angle = rng.uniform(3.0, 9.0), rng.uniform(2.0, 3.0), rng.uniform(0.0, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shape = turn @ np.diag([long**-2.0, short**-2.0]) @ turn.T
    return np.array([20.3, 18.7, shape[0, 0], shape[0, 1], shape[1, 1]])


def test_derivatives_are_those_of_differences() -> None:
    """Differences that cross from one cell of the table to the next one are left out."""
    rng, table, blur = np.random.default_rng(1), PROFILE.table, PROFILE.blur_px
    errors, largest = [], 0.0
    for _ in range(2000):
        ellipse, (column, row) = ellipse_of(rng), rng.integers(10, 30, 2).tolist()
        found = np.zeros(5)
        here = slopes_at(ellipse, column, row, 4.0, table, blur, found)
        assert here == max(shade_at(ellipse, column, row, 4.0, table, blur), DIM)
        for number, step in enumerate(STEPS):
            up, down = ellipse.copy(), ellipse.copy()
            up[number] += step
            down[number] -= step
            ends = [
                max(shade_at(one, column, row, 4.0, table, blur), DIM)
                for one in (up, ellipse, down)
            ]
            one_sided = np.diff(ends)
            if abs(one_sided[0] - one_sided[1]) > 1e-4 * np.abs(one_sided).max() + 1e-13:
                continue
            slope = (ends[0] - ends[2]) / (2.0 * step)
            errors.append(abs(slope - found[number]) * step)
            largest = max(largest, abs(slope) * step)
    assert len(errors) > 8000
    assert max(errors) < 1e-4 * largest
