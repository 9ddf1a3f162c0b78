"""Errors, identity and smoothness of trajectories."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.api import Detections
from sabench.api.truth import Bubbles
from sabench.metrics.trajectories import (
    Sightings,
    accelerations,
    claimed_errors,
    identity_scores,
    jitter_mm,
    link_scores,
    median_errors,
    share_followed,
    trajectory_scores,
)
from sabench.utils.arrays import F64, I64

TIMES = [0.0, 0.5, 1.5, 2.0]
SPEED = np.array([2.0, 0.0, 1.0])


def true_bubbles(count: int = 40) -> list[Bubbles]:
    """Bubbles 10 mm apart, all at one velocity; in each frame another order."""
    places = 10.0 * np.stack(np.unravel_index(np.arange(count), (4, 5, 4)), axis=1)
    shape = np.ones((count, 3)), np.tile(np.eye(3), (count, 1, 1)), np.tile(SPEED, (count, 1))
    orders = [np.random.default_rng(int(10 * time)).permutation(count) for time in TIMES]
    return [
        Bubbles(order, places[order] + SPEED * time, *shape)
        for order, time in zip(orders, TIMES, strict=True)
    ]


def scores(
    found: list[Detections] | list[Bubbles], track: list[I64], sequences: list[range] | None = None
) -> dict[str, float]:
    return trajectory_scores(found, track, true_bubbles(), TIMES, sequences or [range(4)])


def test_the_truth_is_perfect() -> None:
    true = true_bubbles()
    got = scores(true, [1000 - one.id for one in true])
    assert (got["link_recall"], got["link_precision"], got["effectiveness"]) == (1.0, 1.0, 1.0)
    assert got["velocity_mm_s"] == got["velocity_percent"] == 0.0


def test_errors_of_velocity_are_those_of_displacements() -> None:
    """An offset grows by 0.1 mm a frame, over 0.5, 1 and 0.5 s: 0.2, 0.1 and 0.2 mm/s."""
    true = true_bubbles()
    found = [
        Detections.balls(one.center_mm + np.array([0.0, 0.1 * frame, 0.0]), one.radius_mm)
        for frame, one in enumerate(true)
    ]
    got = scores(found, [one.id for one in true])
    assert got["velocity_mm_s"] == pytest.approx(0.2)
    assert got["velocity_percent"] == pytest.approx(100.0 * 0.2 / np.sqrt(5.0))
    middle = scores(found, [one.id for one in true], [range(1, 3)])
    assert middle["velocity_mm_s"] == pytest.approx(0.1)


def test_where_there_is_nothing_to_count() -> None:
    true, nothing = true_bubbles(), Detections.balls(np.zeros((0, 3)), np.zeros(0))
    alone = trajectory_scores(true[:1], [true[0].id], true[:1], TIMES[:1], [range(1)])
    assert all(np.isnan(value) for value in alone.values())
    empty = scores([nothing] * 4, [np.zeros(0, dtype=np.int64)] * 4)
    assert empty.pop("effectiveness") == 0.0
    assert all(np.isnan(value) for value in empty.values())
    rest = [
        replace(one, center_mm=one.center_mm - SPEED * time, velocity_mm_s=0.0 * one.velocity_mm_s)
        for one, time in zip(true, TIMES, strict=True)
    ]
    still = trajectory_scores(rest, [one.id for one in rest], rest, TIMES, [range(4)])
    assert still["velocity_mm_s"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_as_counted_one_by_one(seed: int) -> None:
    """Three in ten are missing, there are ghosts, and trajectories swap and break."""
    rng, true = np.random.default_rng(seed), true_bubbles()
    owner: list[dict[int, int]] = []
    found, track = [], []
    for frame, one in enumerate(true):
        keep = np.flatnonzero(rng.random(40) < 0.7)
        center = np.concatenate([one.center_mm[keep], one.center_mm[:6] + 5.0])
        number = np.concatenate([one.id[keep], 40 + np.arange(6)])
        swapped = np.flatnonzero(rng.random(len(number)) < 0.2)
        number[swapped] = rng.permutation(number[swapped])
        number[rng.random(len(number)) < 0.1] += 100 * (frame + 1)
        owner.append(dict(zip(one.id[keep].tolist(), number.tolist(), strict=False)))
        found.append(Detections.balls(center, np.ones(len(center))))
        track.append(number)
    both = [(f, b) for f in range(3) for b in range(40) if b in owner[f] and b in owner[f + 1]]
    right = sum(owner[f][b] == owner[f + 1][b] for f, b in both)
    links = sum(len(set(track[f].tolist()) & set(track[f + 1].tolist())) for f in range(3))
    followed = [Counter(frame[b] for frame in owner if b in frame) for b in range(40)]
    longest = [max(numbers.values(), default=0) / 4.0 for numbers in followed]
    got = scores(found, track)
    assert got["link_recall"] == pytest.approx(right / len(both))
    assert got["link_precision"] == pytest.approx(right / links)
    assert got["effectiveness"] == pytest.approx(np.mean(longest))
    assert got["velocity_mm_s"] == pytest.approx(0.0, abs=1e-9)


def vectors(
    places: list[F64], track: list[I64], sequences: list[range] | None = None
) -> dict[str, float]:
    """Scores of displacements where detection i of a frame is its true bubble i."""
    true = true_bubbles()
    rows = [np.arange(len(one)) for one in places]
    truth = [one.center_mm for one in true], [one.id for one in true]
    pairs = [(own, own) for own in rows]
    return link_scores(places, track, *truth, pairs, TIMES, sequences or [range(4)])


def test_displacements_err_by_the_difference_of_both_ends() -> None:
    """An offset along Y grows by 0.1, 0.3 and 0.1 mm; the last is in another sequence."""
    true, offset = true_bubbles(), [0.0, 0.1, 0.4, 0.5]
    places = [b.center_mm + np.array([0.0, off, 0.0]) for b, off in zip(true, offset, strict=True)]
    track = [one.id for one in true]
    got = vectors(places, track)
    assert got["displacement_mm"] == pytest.approx(np.sqrt((0.01 + 0.09 + 0.01) / 3.0))
    assert vectors(places, track, [range(2), range(2, 4)])["displacement_mm"] == pytest.approx(0.1)


def test_particles_that_are_not_found_are_missed_displacements() -> None:
    """A quarter is missing in the second of four frames, in two of three links."""
    true = true_bubbles()
    places, track = [one.center_mm for one in true], [one.id for one in true]
    places[1], track[1] = places[1][:30], track[1][:30]
    assert vectors(places, track)["vector_recall"] == pytest.approx((30 + 30 + 40) / 120)
    track[3] = track[3] + 1000  # no link to the last frame
    assert vectors(places, track)["vector_recall"] == pytest.approx(60 / 120)
    none = vectors([one[:0] for one in places], [one[:0] for one in track])
    assert none["vector_recall"] == 0.0
    assert np.isnan(none["displacement_mm"])


def _frame(
    trajectory: list[int], identity: list[int], pairs: list[tuple[int, int]], apart: float = 0.0
) -> Sightings:
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    numbers = np.array(trajectory, int), np.array(identity, int)
    return Sightings(*numbers, (rows[:, 0], rows[:, 1]), np.full(len(rows), apart))


def test_the_truth_is_complete() -> None:
    scores = identity_scores([[_frame([4, 9], [1, 2], [(0, 0), (1, 1)])] * 5])
    halves = identity_scores([HALF])["complete"], identity_scores([[SEEN, OTHER]])["complete"]
    assert halves == (0.5, 0.0)
    percents = {"switch_percent": 0.0, "fragment_percent": 0.0}
    assert scores == {"hota": 1.0, "complete": 1.0} | percents


SEEN, OTHER, GONE = _frame([4], [1], [(0, 0)]), _frame([5], [1], [(0, 0)]), _frame([], [1], [])
HALF = [_frame([4], [1, 2], [(0, 0)])] * 5  # 5 of 10 are detected, each by a trajectory of its own
GHOSTS = [_frame([4, 100 + n], [1], [(0, 0)]) for n in range(4)]


@pytest.mark.parametrize(
    ("sequences", "hota", "switch", "fragment"),
    [
        ([HALF], math.sqrt(0.5), 0.0, 0.0),
        ([[SEEN] * 3 + [OTHER] * 3], math.sqrt(0.5), 20.0, 0.0),  # association: 3 / (3 + 6 - 3)
        ([GHOSTS], math.sqrt(0.5), 0.0, 0.0),
        ([[SEEN, SEEN, GONE, SEEN]], 0.75, 0.0, 100.0 / 3.0),
        ([[SEEN] * 2, [OTHER] * 2], 1.0, 0.0, 0.0),
    ],
)
def test_missed_switched_and_ghost_trajectories_lower_hota(
    sequences: list[list[Sightings]], hota: float, switch: float, fragment: float
) -> None:
    scores = identity_scores(sequences)
    assert scores["hota"] == pytest.approx(hota)
    assert scores["switch_percent"] == pytest.approx(switch)
    assert scores["fragment_percent"] == pytest.approx(fragment)


@pytest.mark.parametrize(
    ("similarity", "levels"), [(0.04, 0), (0.06, 1), (0.52, 10), (0.94, 18), (0.96, 19)]
)
def test_hota_is_the_share_of_levels_that_pairs_reach(similarity: float, levels: int) -> None:
    """Levels are 0.05, 0.10 to 0.95; complete pairs count fully at each."""
    scores = identity_scores([[_frame([4], [1], [(0, 0)], 1.0 - similarity)] * 3])
    assert scores["hota"] == pytest.approx(levels / 19.0)
    assert scores["complete"] == 1.0


def test_no_estimate_has_hota_0_and_nothing_at_all_has_none() -> None:
    assert identity_scores([[_frame([], [1, 2], [])]])["hota"] == 0.0
    assert identity_scores([[_frame([4], [], [])]])["hota"] == 0.0
    assert math.isnan(identity_scores([[_frame([], [], [])]])["hota"])


def trajectories(frames: int, noise: float) -> tuple[list[I64], list[F64]]:
    """Two thousand particles on parabolas; each frame numbers them in another order."""
    rng = np.random.default_rng(8)
    start, velocity, bend = rng.standard_normal((3, 2000, 3))
    numbers, positions = [], []
    for frame in range(frames):
        order = rng.permutation(2000)
        exact = start + velocity * frame + 0.5 * bend * frame**2
        numbers.append(order)
        positions.append((exact + noise * rng.standard_normal(exact.shape))[order])
    return numbers, positions


@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_jitter_is_the_noise(noise: float) -> None:
    assert jitter_mm(*trajectories(6, noise)) == pytest.approx(noise, rel=0.05)


def test_share_followed() -> None:
    numbers = [np.array([1, 2, 3]), np.array([2, 1]), np.array([1, 4])]
    assert share_followed(numbers, 3) == pytest.approx(3 / 7)
    assert share_followed(numbers, 2) == pytest.approx(5 / 7)
    assert np.isnan(share_followed([], 3))


def test_second_differences_are_exact_where_acceleration_is_constant() -> None:
    place, velocity, acceleration = np.random.default_rng(3).normal(size=(3, 5, 3))
    step = 0.2
    numbers = [np.array([4, 1, 7, 2, 9]), np.array([9, 7, 1, 4, 3]), np.array([1, 9, 4, 8, 5])]
    order = {4: 0, 1: 1, 7: 2, 2: 3, 9: 4}
    frames = []
    for number, time in zip(numbers, (-step, 0.0, step), strict=True):
        rows = np.array([order.get(one, 0) for one in number.tolist()])
        at = place + velocity * time + acceleration * time**2 / 2.0
        frames.append((number, at[rows]))
    rows, found = accelerations(frames, step)
    assert sorted(numbers[1][rows].tolist()) == [1, 4, 9]  # those in all three frames
    expected = acceleration[[order[one] for one in numbers[1][rows].tolist()]]
    assert_allclose(found, expected, atol=1e-12)


def test_errors_are_medians_over_all_frames() -> None:
    one = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    off, size = claimed_errors([(one + np.array([0.0, 0.0, 0.3]), one), (one[:1] * 1.1, one[:1])])
    assert_allclose(off, [0.3, 0.3, 0.1])
    error, percent = median_errors(off, size)
    assert_allclose([error, percent], [0.3, 15.0])
