"""Pixels show as much of the volume as their lines of sight are long in it."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.particles.candidate_search import shared_views, volume_shares
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


def test_shared_views_are_what_enough_cameras_see_all_of(maps: VolumePolynomials) -> None:
    shape = (ROWS // 2, COLUMNS)  # half of the images: some points have left some cameras
    count = len(maps.coefficients)
    points = np.random.default_rng(4).uniform(-1.0, 1.0, (200_000, 3))
    pixels = [project_points(maps, camera, points) for camera in range(count)]
    last = np.array(shape[::-1]) - 1.0
    inside = [np.all((one >= 0.0) & (one <= last), axis=1) for one in pixels]
    for fewest in (1, count):
        marked = shared_views(maps, shape, fewest)
        enough = np.sum(inside, axis=0) >= fewest
        for camera in range(count):
            column, row = np.rint(pixels[camera][inside[camera]]).astype(int).T
            here = marked[camera, row, column]
            assert np.mean(enough[inside[camera]][here]) > 0.97
            assert 0.0 < here.mean() <= 1.0
        assert fewest > 1 or here.mean() > 0.999
