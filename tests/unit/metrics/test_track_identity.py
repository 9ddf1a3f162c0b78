"""Tests of the identities of trajectories."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sabench.metrics.trajectories import Sightings, identity_scores


def _frame(
    trajectory: list[int], identity: list[int], pairs: list[tuple[int, int]], apart: float = 0.0
) -> Sightings:
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return Sightings(
        np.array(trajectory, dtype=np.int64),
        np.array(identity, dtype=np.int64),
        (rows[:, 0], rows[:, 1]),
        np.full(len(rows), apart),
    )


def test_the_truth_is_complete() -> None:
    frames = [_frame([4, 9], [1, 2], [(0, 0), (1, 1)]) for _ in range(5)]
    assert identity_scores([frames]) == {
        "hota": 1.0,
        "complete": 1.0,
        "switch_percent": 0.0,
        "fragment_percent": 0.0,
    }


def test_half_missed_detections_halve_hota() -> None:
    # detection: 5 of 10; association: each pair's trajectory is one true one, in all its frames
    frames = [_frame([4], [1, 2], [(0, 0)]) for _ in range(5)]
    scores = identity_scores([frames])
    assert scores["hota"] == pytest.approx(math.sqrt(0.5))
    assert scores["complete"] == 0.5


def test_a_switch_in_the_middle_splits_a_trajectory() -> None:
    frames = [_frame([4], [1], [(0, 0)]) for _ in range(3)]
    frames += [_frame([5], [1], [(0, 0)]) for _ in range(3)]
    scores = identity_scores([frames])
    # association: 3 / (3 + 6 - 3) for all pairs
    assert scores["hota"] == pytest.approx(math.sqrt(0.5))
    assert scores["switch_percent"] == pytest.approx(20.0)
    assert scores["fragment_percent"] == 0.0
    assert scores["complete"] == 0.0


def test_a_gap_is_a_fragment_but_no_switch() -> None:
    there, gone = _frame([4], [1], [(0, 0)]), _frame([], [1], [])
    scores = identity_scores([[there, there, gone, there]])
    assert scores["switch_percent"] == 0.0
    assert scores["fragment_percent"] == pytest.approx(100.0 / 3.0)


def test_distances_lower_hota_only() -> None:
    frames = [_frame([4], [1], [(0, 0)], apart=0.5) for _ in range(4)]
    scores = identity_scores([frames])
    assert scores["hota"] == pytest.approx(10.0 / 19.0)  # ten of the levels .05 ... .95
    assert scores["complete"] == 1.0


def test_ghost_trajectories_lower_hota() -> None:
    frames = [_frame([4, 100 + n], [1], [(0, 0)]) for n in range(4)]
    assert identity_scores([frames])["hota"] == pytest.approx(math.sqrt(0.5))


def test_sequences_are_scored_apart() -> None:
    one = [_frame([4], [1], [(0, 0)])] * 2
    other = [_frame([5], [1], [(0, 0)])] * 2
    assert identity_scores([one, other])["switch_percent"] == 0.0


@pytest.mark.parametrize(
    ("similarity", "levels"), [(0.04, 0), (0.06, 1), (0.52, 10), (0.94, 18), (0.96, 19)]
)
def test_hota_is_the_share_of_levels_that_a_pair_is_similar_enough_for(
    similarity: float, levels: int
) -> None:
    """Levels are 0.05, 0.10 to 0.95; complete pairs count fully at each."""
    frames = [_frame([4], [1], [(0, 0)], 1.0 - similarity) for _ in range(3)]
    assert identity_scores([frames])["hota"] == pytest.approx(levels / 19.0)


def test_no_estimate_has_hota_0_and_nothing_at_all_has_none() -> None:
    assert identity_scores([[_frame([], [1, 2], [])]])["hota"] == 0.0
    assert identity_scores([[_frame([4], [], [])]])["hota"] == 0.0
    assert math.isnan(identity_scores([[_frame([], [], [])]])["hota"])
