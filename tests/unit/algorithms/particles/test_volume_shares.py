"""Pixels show as much of the volume as their lines of sight are long in it."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.particles.volume_shares import volume_shares
from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from tests.unit.algorithms.particles.test_triangulation import COLUMNS, ROWS, maps

__all__ = ["maps"]
_BLOCK = 20  # px


def test_shares_are_those_of_random_points(maps: VolumePolynomials) -> None:
    shares = volume_shares(maps, (ROWS, COLUMNS))
    count = 1_000_000
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (count, 3))
    for camera, share in enumerate(shares):
        column, row = project_points(maps, camera, points).T
        edges = np.arange(0, ROWS + 1, _BLOCK) - 0.5, np.arange(0, COLUMNS + 1, _BLOCK) - 0.5
        expected = np.histogram2d(row, column, edges)[0]
        blocks = share.reshape(ROWS // _BLOCK, _BLOCK, COLUMNS // _BLOCK, _BLOCK).sum(axis=(1, 3))
        off = blocks * count - expected
        assert np.abs(off).max() < 6.0 * np.sqrt(expected.max())
