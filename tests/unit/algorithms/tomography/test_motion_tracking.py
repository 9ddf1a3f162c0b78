"""Displacements between exposures, and the guesses that follow from them."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import map_coordinates

from sabench.algorithms.tomography.motion_tracking import Displacement, enhanced_guesses
from sabench.algorithms.velocimetry.deformation import deform, spline_coefficients
from sabench.algorithms.velocimetry.multipass import Field
from sabench.algorithms.velocimetry.windows import Windows
from sabench.geometry.grid import Grid, synthesise
from sabench.metrics.quality_factor import quality
from sabench.utils.arrays import F32, F64

GRID = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (24, 40, 48))
ORIGIN, STEP, COUNTS = (4.0, 6.0, 5.0), (4.0, 7.0, 6.0), (5, 5, 7)
MEAN = np.array([1.5, -0.5, 0.3])
SLOPE = np.array([[0.01, 0.0, 0.1], [0.0, -0.02, 0.0], [0.03, 0.0, 0.01]])


def lattice_xyz() -> F64:
    """Nodes (z, y, x, 3) as (x, y, z)."""
    z, y, x = (o + s * np.arange(n) for o, s, n in zip(ORIGIN, STEP, COUNTS, strict=True))
    return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1)


def linear() -> Displacement:
    """Displacements at the middle of the interval that are linear in space."""
    return Displacement(MEAN + lattice_xyz() @ SLOPE.T, ORIGIN, STEP)


def blobs(points: F64) -> F32:
    return synthesise(GRID, points, np.ones(len(points)), 0.9)


def points(count: int, seed: int) -> F64:
    return np.random.default_rng(seed).uniform([5, 5, 5], [42, 34, 18], (count, 3))


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, -1.0])
def test_a_deformed_volume_is_the_spline_read_away_from_its_voxels(share: float) -> None:
    volume, shift = blobs(points(40, 0)), np.zeros((2, 2, 2, 3)) + np.array([1.3, -0.6, 0.4])
    out = np.full(volume.shape, -1.0, dtype=np.float32)
    rows, step = slice(0, math.prod(out.shape[:2])), (24.0, 40.0, 48.0)
    deform(rows, spline_coefficients(volume), shift, (0.0, 0.0, 0.0), step, share, out)
    places = np.indices(volume.shape) + share * np.array([0.4, -0.6, 1.3])[:, None, None, None]
    expected = map_coordinates(volume, places, order=3, mode="mirror")
    inside = np.all(
        [(p >= 0) & (p <= n - 1) for p, n in zip(places, volume.shape, strict=True)], axis=0
    )
    assert_allclose(out[inside], expected[inside], atol=2e-5)
    assert (out[~inside] == -1.0).all()


@pytest.mark.parametrize("share", [0.5, -0.5])
def test_displacements_at_the_ends_are_those_of_the_same_particles(share: float) -> None:
    found = linear().at_end(share)
    inverse = np.linalg.inv(np.eye(3) - share * SLOPE)
    expected = (MEAN + lattice_xyz() @ SLOPE.T) @ inverse.T
    inner = (slice(1, -1),) * 3  # beyond the outer nodes the field is continued as a constant
    assert_allclose(found[inner], expected[inner], atol=2e-3)


def test_split_voxels_have_finer_displacements() -> None:
    windows = Windows((8, 8, 8), (4, 4, 4), (3, 3, 3))
    field = Field(windows, np.ones((3, 3, 3, 3)), np.ones((3, 3, 3), dtype=np.bool_))
    made = Displacement.of(field, (1, 2, 3))
    assert_array_equal(made.shift[0, 0, 0], [1.0, 2.0, 3.0])
    assert made.step == (12.0, 8.0, 4.0)
    assert made.origin == (11.5, 7.5, 3.5)  # the middle of 24, 16 and 8 fine voxels


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_particles_coincide_in_the_guesses_and_ghosts_fade(count: int) -> None:
    move = linear()
    start, volumes, truths = points(25, 1), list[F32](), list[F32]()
    ghosts = points(25, 2) * np.array([1.0, 0.75, 1.0])  # inside, also after their moves
    for _ in range(count):
        truths.append(blobs(start))
        volumes.append(truths[-1] + blobs(ghosts))
        start = 2.0 * np.linalg.solve(np.eye(3) - SLOPE / 2.0, (start + MEAN / 2.0).T).T - start
        ghosts = ghosts + np.array([0.0, 4.0, 0.0])  # not with the particles
    guesses = enhanced_guesses(volumes, [move] * (count - 1))
    for number, (guess, volume, truth) in enumerate(zip(guesses, volumes, truths, strict=True)):
        averaged = 3 if count == 3 and number == 1 else 2  # each has ghosts of 1 / averaged
        assert quality(volume, truth) == pytest.approx(np.sqrt(1.0 / 2.0), abs=0.02)
        expected = np.sqrt(1.0 / (1.0 + 1.0 / averaged))
        assert quality(guess, truth) == pytest.approx(expected, abs=0.02)
        bright = truth > 0.5
        assert np.median(guess[bright] / volume[bright]) == pytest.approx(1.0, abs=0.05)
