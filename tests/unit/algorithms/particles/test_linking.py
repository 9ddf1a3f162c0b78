"""Trajectories of bubbles whose ids are known, and the limits of the method."""

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sabench.algorithms.particles.linking import GATE, NEIGHBOUR_REACH, assign, link
from sabench.utils.arrays import F64
from tests.helpers.bubble_sequences import (
    EDGE,
    BubbleSequence,
    link_scores,
    link_sequence,
    make_sequence,
)
from tests.helpers.refusals import refused


@pytest.mark.parametrize(
    ("kind", "furthest", "flaws", "least"),
    [
        ("stream", 2.0, {}, (0.98, 0.99)),
        ("stream", 2.0, {"missing": 0.2, "ghosts": 0.2, "noise": 0.03}, (0.94, 0.94)),
        ("two streams", 1.5, {}, (0.95, 0.98)),
    ],
)
def test_streams_are_followed_beyond_the_distance_of_neighbours(
    kind: str, furthest: float, flaws: Any, least: tuple[float, float]
) -> None:
    for relative in (0.2, 1.0, furthest):
        made = make_sequence(relative, kind, **flaws)
        assert (np.array(link_scores(made, link_sequence(made))) > least).all()


def test_where_it_ends() -> None:
    """Displacements beyond the reach, and random motion over a part of neighbours' distance."""
    assert link_scores(made := make_sequence(1.4 * NEIGHBOUR_REACH), link_sequence(made))[0] < 0.1
    assert link_scores(made := make_sequence(0.2, "random"), link_sequence(made))[0] > 0.97
    assert link_scores(made := make_sequence(1.0, "random"), link_sequence(made))[0] < 0.6


def test_paths_that_cross_are_not_swapped() -> None:
    """Bubbles that meet keep their courses. Either is nearest to the other's next position."""
    made = BubbleSequence()
    for t in np.arange(-4.0, 5.0):
        places = np.array([[t, 0.1, 0.0], [-t, -0.1, 0.0]])
        made.add(places, np.ones(2), np.arange(2), np.random.default_rng(int(t) + 9))
    tracks = zip(link_sequence(made), made.id, strict=True)
    assert len({tuple(number[np.argsort(ids)].tolist()) for number, ids in tracks}) == 1


@pytest.mark.parametrize(
    ("absent", "gap", "whole"),
    [([3], 1, True), ([3, 4], 1, False), ([3, 4], 2, True), ([3], 0, False)],
)
def test_a_track_may_miss_some_frames(absent: list[int], gap: int, whole: bool) -> None:
    made = make_sequence(0.8, count=60, frames=8)
    lost = int(np.intersect1d(made.id[0], made.id[-1])[0])
    for frame in absent:
        keep = made.id[frame] != lost
        for part in (made.center, made.radius, made.id):
            part[frame] = part[frame][keep]
    tracks = zip(link_sequence(made, gap), made.id, strict=True)
    numbers = {int(number) for track, ids in tracks for number in track[ids == lost]}
    assert len(numbers) == (1 if whole else 2)


def test_frames_at_unequal_times() -> None:
    rng = np.random.default_rng(2)
    place, radius = EDGE * rng.random((200, 3)), rng.uniform(0.5, 1.5, 200)
    times = [0.0, 1.0, 3.0, 3.5, 5.5]
    track = link([place + time * np.array([4.0, -2.0, 1.0]) for time in times], [radius] * 5, times)
    assert all(np.array_equal(track[0], one) for one in track)


def test_neither_order_nor_units_matter() -> None:
    made = make_sequence(1.0, missing=0.1, ghosts=0.1, noise=0.02)
    track, rng = link_sequence(made), np.random.default_rng(0)
    turned = [rng.permutation(len(one)) for one in made.center]
    metres = [1e-3 * one[order] for one, order in zip(made.center, turned, strict=True)]
    radii = [1e-3 * one[order] for one, order in zip(made.radius, turned, strict=True)]
    other = link(metres, radii, [100.0 + 5.0 * frame for frame in range(len(metres))])
    for frame in range(len(track) - 1):
        joined = track[frame][turned[frame]][:, None] == track[frame + 1][turned[frame + 1]]
        assert_array_equal(joined, other[frame][:, None] == other[frame + 1])


def test_numbers_are_different_in_a_frame_and_count_up() -> None:
    track = link_sequence(make_sequence(1.0, missing=0.2, ghosts=0.2))
    assert all(len(np.unique(one)) == len(one) for one in track)
    every = np.unique(np.concatenate(track))
    assert_array_equal(every, np.arange(len(every)))


def test_few_bubbles_or_none() -> None:
    none, one = np.zeros((0, 3)), np.array([[1.0, 2.0, 3.0]])

    def numbers(*centers: F64, radii: tuple[float, ...] = (1.0, 1.0, 1.0), gap: int = 1) -> Any:
        sizes = [np.full(len(center), own) for center, own in zip(centers, radii, strict=False)]
        times = [float(number) for number in range(len(centers))]
        return [track.tolist() for track in link([*centers], sizes, times, gap)]

    assert numbers() == []
    assert numbers(none, none) == [[], []]
    assert numbers(one) == [[0]]
    assert numbers(one, one + 5.0, one + 10.0) == [[0], [0], [0]]
    assert numbers(one, one, radii=(1.0, 3.0)) == [[0], [1]]
    assert numbers(one, none, one) == [[0], [], [0]]
    assert numbers(one, none, one, gap=0) == [[0], [], [1]]
    twice = np.repeat(one, 2, axis=0)
    assert sorted(numbers(twice, twice)[1]) == [0, 1]
    nothing = np.zeros(0, dtype=np.int64)
    for shape in ((0, 0), (0, 3), (3, 0), (2, 2)):
        assert len(assign(nothing, nothing, np.zeros(0), shape)[0]) == 0


def test_times_must_increase() -> None:
    with refused("times_s", kind=ValueError):
        link([np.zeros((0, 3))] * 2, [np.zeros(0)] * 2, [1.0, 1.0])


@pytest.mark.parametrize("seed", range(30))
def test_the_choice_is_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 5)), int(rng.integers(1, 5)))
    row, column = np.nonzero(rng.random(shape) < 0.7)
    cost = np.where(rng.random(len(row)) < 0.1, 0.0, 1.4 * GATE * rng.random(len(row)))
    i, j = assign(row, column, cost, shape)
    assert len(set(i.tolist())) == len(i) == len(set(j.tolist())) == len(j)
    price = np.full((shape[0], shape[1] + 1), np.inf)
    price[row, column], price[:, -1] = cost, GATE  # the last column: no link
    best = min(
        price[range(shape[0]), ends].sum()
        for ends in itertools.product(range(-1, shape[1]), repeat=shape[0])
        if len(set(ends) - {-1}) == len(ends) - ends.count(-1)
    )
    got = price[i, j].sum() + GATE * (shape[0] - len(i))
    assert got == pytest.approx(best, abs=1e-9)
