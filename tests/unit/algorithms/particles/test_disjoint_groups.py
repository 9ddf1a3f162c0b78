"""Groups that are fitted side by side share no pixel, and threads do not change results."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from sabench.algorithms.particles import all_particles as module
from sabench.algorithms.particles.all_particles import disjoint_groups, side_by_side
from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.image_model import paint_all
from sabench.algorithms.particles.joint_fit import refine
from sabench.algorithms.particles.model_moves import find_neighbours
from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.utils.arrays import F64, I64
from tests.helpers.image_model import TYPICAL, model_of, paint, particles_of, room_of
from tests.unit.algorithms.particles.test_triangulation import COLUMNS, ROWS, maps, unit_points

__all__ = ["maps"]
COUNT, WINDOW, PORTIONS = 600, 8, 3
MOST = numba.config.NUMBA_NUM_THREADS
RNG = np.random.default_rng(12)
Neighbours = tuple[I64, I64] | None


def spans(maps: VolumePolynomials, points: F64, rows: I64, neighbours: Neighbours) -> F64:
    """Windows' first and last pixels (k, camera, 2, 2) of particles and their neighbours."""
    touched = set(rows.tolist())
    if neighbours is not None:
        starts, near = neighbours
        for n in rows:
            touched |= set(near[starts[n] : starts[n + 1]].tolist())
    every = points[sorted(touched)]
    pixels = np.stack([project_points(maps, camera, every) for camera in range(4)], axis=1)
    return np.stack([pixels - WINDOW, pixels + WINDOW], axis=2)


@pytest.mark.parametrize("whole", [False, True])
def test_groups_of_a_turn_share_no_pixel(
    maps: VolumePolynomials, whole: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_FEW", 2)
    points = unit_points(COUNT)
    neighbours = find_neighbours(maps, np.full((4, 2), 0.7), points) if whole else None
    rows = np.sort(RNG.permutation(COUNT)[:500])
    turns = disjoint_groups(maps, points, rows, WINDOW, 0.3 * pixel_mm(maps), PORTIONS, neighbours)
    assert (
        np.sort(np.concatenate([one for turn in turns for one in turn])).tolist() == rows.tolist()
    )
    assert max(len(turn) for turn in turns) > 1
    for turn in turns:
        all_spans = [spans(maps, points, group, neighbours) for group in turn]
        for k, one in enumerate(all_spans):
            for other in all_spans[:k]:
                below = one[:, None, :, 0] <= other[None, :, :, 1]
                above = other[None, :, :, 0] <= one[:, None, :, 1]
                assert not (below & above).all(axis=3).any()


def fitted(maps: VolumePolynomials, points: F64, turns: list[list[I64]], threads: int) -> list[F64]:
    """Positions, light and what is left of images after three rounds of fits."""
    light = np.full((COUNT, 4), TYPICAL)
    images = paint(maps, points, light, ROWS, COLUMNS)
    model, start = model_of(maps, images, between=0.3), points + 2e-3 * np.sin(np.arange(3.0))
    particles = particles_of(np.clip(start, -1.0, 1.0), light)
    paint_all(model, room_of(maps), particles, -1.0)
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        side_by_side(lambda rows: refine(model, room_of(maps), particles, rows) and None, 3 * turns)
    finally:
        numba.set_num_threads(before)
    return [particles.position, particles.light, model.left.astype(np.float64)]


def test_few_rows_keep_their_order(maps: VolumePolynomials) -> None:
    rows = RNG.permutation(COUNT)
    turns = disjoint_groups(maps, unit_points(COUNT), rows, WINDOW, pixel_mm(maps), PORTIONS)
    assert [one.tolist() for turn in turns for one in turn] == [rows.tolist()]


def test_the_number_of_threads_does_not_change_a_fit(
    maps: VolumePolynomials, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_FEW", 2)
    points = 0.95 * unit_points(COUNT)
    turns = disjoint_groups(maps, points, np.arange(COUNT), WINDOW, 0.3 * pixel_mm(maps), PORTIONS)
    assert max(len(turn) for turn in turns) > 1
    one, two = (fitted(maps, points, turns, threads) for threads in (1, min(2, MOST)))
    for before, after in zip(one, two, strict=True):
        np.testing.assert_array_equal(before, after)
    assert np.abs(one[0] - points).max() < 1e-2
