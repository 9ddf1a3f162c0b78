"""Candidates for particles, and shares of the volume."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.particles.candidate_search import (
    BRIGHTEST,
    find_candidates,
    lattice_shape,
    pixel_mm,
    shared_views,
    volume_shares,
)
from sabench.geometry.volume_polynomials import fit_volume_polynomials, project_points
from sabench.utils.arrays import F32, F64
from tests.helpers.image_model import TYPICAL, paint
from tests.helpers.particle_box import (
    CAMERAS,
    COLUMNS,
    HIGH,
    LOW,
    ROWS,
    Maps,
    distances,
    unit_points,
)


def logs_of(images: F64) -> F32:
    """Logarithms of light over the brightest pixel's."""
    return np.asarray(np.log(np.clip(images / images.max(), 0.03, BRIGHTEST)), dtype=np.float32)


@pytest.mark.slow
def test_every_lone_particle_is_a_candidate(maps: Maps) -> None:
    points = 0.9 * unit_points(20)
    images = paint(maps, points, np.full((20, 4), TYPICAL), ROWS, COLUMNS)
    found = find_candidates(maps, logs_of(images), math.log(0.3), 0.2)
    assert distances(found, points, maps).max() < 3.0 * pixel_mm(maps)
    assert len(found) < 60


def test_one_dim_camera_is_forgiven_as_far_as_light_scatters(maps: Maps) -> None:
    points = 0.9 * unit_points(8)
    light = np.full((8, 4), TYPICAL)
    light[:4, 1] *= 0.2
    images = paint(maps, points, light, ROWS, COLUMNS)
    strict, tolerant = (
        find_candidates(maps, logs_of(images), math.log(0.25), spread) for spread in (0.1, 1.5)
    )
    near = 3.0 * pixel_mm(maps)
    assert (distances(strict, points, maps)[:4] > near).all()
    assert (distances(strict, points, maps)[4:] < near).all()
    assert (distances(tolerant, points, maps) < near).all()


def test_a_camera_that_shows_nothing_does_not_count(maps: Maps) -> None:
    points = 0.9 * unit_points(5)
    logs = logs_of(paint(maps, points, np.full((5, 4), TYPICAL), ROWS, COLUMNS))
    logs[2] = np.nan
    near = 4.0 * pixel_mm(maps)
    assert (distances(find_candidates(maps, logs, math.log(0.3), 0.2), points, maps) < near).all()
    logs[3] = np.nan  # two lines of sight meet by chance too often
    assert len(find_candidates(maps, logs, math.log(0.3), 0.2)) == 0


def test_dark_images_have_no_candidates(maps: Maps) -> None:
    dark = np.full((4, ROWS, COLUMNS), math.log(0.03), dtype=np.float32)
    assert find_candidates(maps, dark, math.log(0.1), 0.2).shape == (0, 3)


def test_the_lattice_is_coarser_along_the_view(maps: Maps) -> None:
    z, y, x = lattice_shape(maps)
    size = pixel_mm(maps)
    step = 2.0 * maps.half_mm / (np.array([x, y, z]) - 1.0)
    assert (step[:2] <= 1.05 * size).all()
    assert size < step[2] <= 2.1 * size


def test_the_lattice_turns_with_the_axes() -> None:
    """A box twice as long has twice as many points along that axis."""
    middle, half = (LOW + HIGH) / 2.0, (HIGH - LOW) / 2.0
    short = fit_volume_polynomials(CAMERAS, middle - 0.5 * half, middle + 0.5 * half)
    long = fit_volume_polynomials(CAMERAS, middle - half, middle + half)
    assert_allclose(np.array(lattice_shape(long)) / np.array(lattice_shape(short)), 2.0, rtol=0.06)


_BLOCK = 20  # px


def test_shares_are_those_of_random_points(maps: Maps) -> None:
    shares = volume_shares(maps, (ROWS, COLUMNS))
    count = 1_000_000
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (count, 3))
    for camera, share in enumerate(shares):
        column, row = project_points(maps, camera, points).T
        edges = np.arange(0, ROWS + 1, _BLOCK) - 0.5, np.arange(0, COLUMNS + 1, _BLOCK) - 0.5
        expected = np.histogram2d(row, column, edges)[0]
        blocks = share.reshape(ROWS // _BLOCK, _BLOCK, COLUMNS // _BLOCK, _BLOCK).sum(axis=(1, 3))
        assert np.abs(blocks * count - expected).max() < 6.0 * np.sqrt(expected.max())


def test_shared_views_are_what_enough_cameras_see_all_of(maps: Maps) -> None:
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
