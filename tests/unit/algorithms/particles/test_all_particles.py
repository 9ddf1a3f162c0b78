"""Passes over all particles give the same on any number of cores."""

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.algorithms.particles import all_particles, all_particles as module
from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.image_model import ImageModel, ModelParticles, paint_all
from sabench.algorithms.particles.joint_fit import fit_particles
from sabench.algorithms.particles.learned_model import add_camera_misses
from sabench.algorithms.particles.model_moves import find_neighbours
from sabench.geometry.volume_polynomials import project_points
from sabench.utils.arrays import F32, F64, I64
from tests.helpers.image_model import NOISE, SIGMA, TYPICAL, model_of, paint, particles_of, room_of
from tests.helpers.particle_box import COLUMNS, ROWS, Maps, unit_points

COUNT, SIGMAS = 120, np.tile(np.array(SIGMA), (4, 1))
MOST = numba.config.NUMBA_NUM_THREADS


def case(maps: Maps) -> tuple[ImageModel, ModelParticles]:
    """A model of noisy images, and particles that are a little off."""
    rng = np.random.default_rng(2)
    points = unit_points(COUNT)
    light = TYPICAL * np.exp(0.2 * rng.standard_normal((COUNT, 4)))
    images = paint(maps, points, light, ROWS, COLUMNS)
    images += NOISE * rng.standard_normal(images.shape)
    return model_of(maps, images), particles_of(points + 0.001, light)


def outcome(maps: Maps) -> list[F64 | F32]:
    model, particles = case(maps)
    all_particles.paint_particles(model, SIGMAS, particles, -1.0)
    return [
        model.left,
        all_particles.sum_in_cameras(add_camera_misses, model, SIGMAS, particles, (5,)),
        all_particles.split_gains(model, SIGMAS, particles, 0.02 * np.eye(3)),
    ]


@pytest.mark.slow
def test_passes_give_what_one_thread_gives(maps: Maps) -> None:
    left, misses, *_ = outcome(maps)
    model, particles = case(maps)
    room, sums = room_of(maps), np.zeros((4, 5))
    paint_all(model, room, particles, -1.0)
    assert_array_equal(left, model.left)
    add_camera_misses(model, room, particles, sums)
    assert_allclose(misses, sums, rtol=1e-9, atol=1e-9 * np.abs(sums).max())


@pytest.mark.slow
@pytest.mark.skipif(MOST < 2, reason="one core")
def test_threads_change_nothing(maps: Maps) -> None:
    many = outcome(maps)
    numba.set_num_threads(1)
    try:
        one = outcome(maps)
    finally:
        numba.set_num_threads(MOST)
    for a, b in zip(many, one, strict=True):
        assert_array_equal(a, b)


GROUPED, WINDOW, PORTIONS = 600, 8, 3
RNG = np.random.default_rng(12)
Neighbours = tuple[I64, I64] | None


def spans(maps: Maps, points: F64, rows: I64, neighbours: Neighbours) -> F64:
    """Windows' first and last pixels (k, camera, 2, 2) of particles and their neighbours."""
    touched = set(rows.tolist())
    if neighbours is not None:
        starts, near = neighbours
        for n in rows:
            touched |= set(near[starts[n] : starts[n + 1]].tolist())
    every = points[sorted(touched)]
    pixels = np.stack([project_points(maps, camera, every) for camera in range(4)], axis=1)
    return np.stack([pixels - WINDOW, pixels + WINDOW], axis=2)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("whole", [False, True])
def test_groups_share_no_pixel(maps: Maps, whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_FEW", 2)
    points = unit_points(GROUPED)
    neighbours = find_neighbours(maps, np.full((4, 2), 0.7), points) if whole else None
    rows = np.sort(RNG.permutation(GROUPED)[:500])
    turns = all_particles.disjoint_groups(
        maps, points, rows, WINDOW, 0.3 * pixel_mm(maps), PORTIONS, neighbours
    )
    assert sorted(row for turn in turns for one in turn for row in one.tolist()) == rows.tolist()
    assert max(len(turn) for turn in turns) > 1
    for turn in turns:
        all_spans = [spans(maps, points, group, neighbours) for group in turn]
        for k, one in enumerate(all_spans):
            for other in all_spans[:k]:
                below = one[:, None, :, 0] <= other[None, :, :, 1]
                above = other[None, :, :, 0] <= one[:, None, :, 1]
                assert not (below & above).all(axis=3).any()


def fitted(maps: Maps, points: F64, turns: list[list[I64]], threads: int) -> list[F64]:
    """Positions, light and what is left of images after three rounds of fits."""
    light = np.full((GROUPED, 4), TYPICAL)
    images = paint(maps, points, light, ROWS, COLUMNS)
    model, start = model_of(maps, images, between=0.3), points + 2e-3 * np.sin(np.arange(3.0))
    particles = particles_of(np.clip(start, -1.0, 1.0), light)
    paint_all(model, room_of(maps), particles, -1.0)
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        all_particles.side_by_side(
            lambda rows: fit_particles(model, room_of(maps), particles, rows) and None, 3 * turns
        )
    finally:
        numba.set_num_threads(before)
    return [particles.position, particles.light, model.left.astype(np.float64)]


def test_few_rows_keep_their_order(maps: Maps) -> None:
    rows = RNG.permutation(GROUPED)
    turns = all_particles.disjoint_groups(
        maps, unit_points(GROUPED), rows, WINDOW, pixel_mm(maps), PORTIONS
    )
    assert [one.tolist() for turn in turns for one in turn] == [rows.tolist()]


def test_a_fit_is_the_same_with_more_threads(maps: Maps, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_FEW", 2)
    points = 0.95 * unit_points(GROUPED)
    turns = all_particles.disjoint_groups(
        maps, points, np.arange(GROUPED), WINDOW, 0.3 * pixel_mm(maps), PORTIONS
    )
    assert max(len(turn) for turn in turns) > 1
    one, two = (fitted(maps, points, turns, threads) for threads in (1, min(2, MOST)))
    for before, after in zip(one, two, strict=True):
        assert_array_equal(before, after)
    assert np.abs(one[0] - points).max() < 1e-2
