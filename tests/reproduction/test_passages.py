"""Passages through a plane: each trajectory counts once, and only from before to beyond."""

from __future__ import annotations

import numpy as np

from reproduction.chapter_6_jet import count_passages


def test_a_trajectory_counts_once_and_only_from_before_to_beyond() -> None:
    along = [np.array(values) for values in ([0.0, 2.0, -1.0], [1.5, 3.0, 0.5], [0.5, 4.0, 2.0])]
    numbers = [np.array([1, 2, 3])] * 3
    # 1 passes in the second frame and comes back, 2 is beyond from the start, 3 passes in the third
    assert count_passages(along, numbers, 1.0) == [0, 1, 2]


def test_a_trajectory_that_misses_the_frame_at_the_plane_counts() -> None:
    along = [np.array([0.0]), np.zeros(0), np.array([2.0])]
    numbers = [np.array([7]), np.zeros(0, dtype=np.int64), np.array([7])]
    assert count_passages(along, numbers, 1.0) == [0, 0, 1]


def test_a_broken_trajectory_does_not_count() -> None:
    along = [np.array([0.0]), np.array([2.0])]
    assert count_passages(along, [np.array([1]), np.array([2])], 1.0) == [0, 0]


def test_uniform_stream_has_its_flux() -> None:
    """Drops at 10 mm/s, one every 0.5 mm: 20 a second pass."""
    start = np.arange(-50.0, 0.0, 0.5) + 0.25
    along = [start + 10.0 * time for time in (0.0, 1.0, 2.0)]
    numbers = [np.arange(len(start))] * 3
    assert count_passages(along, numbers, 0.0) == [0, 20, 40]
