"""Triangulation within a time budget, and of more peaks than can be told apart."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sabench.algorithms.particles import fit_cameras
from sabench.algorithms.particles import matching as module
from sabench.algorithms.particles.matching import (
    TriangulationSettings,
    count_by_chance,
    find_candidates,
    triangulate_particles,
)
from sabench.api import Observation
from sabench.images.peaks import Peaks, find_near, keep_peaks, sort_peaks
from tests.helpers.small_particles import count_found, make_small

CLOCK = "sabench.utils.threads.time.monotonic"


def solve(case: Observation, **changes: Any) -> Any:
    return triangulate_particles(case, fit_cameras(case), TriangulationSettings(**changes))


def noisy(case: Observation, black: float = 0.0) -> Observation:
    """The same cameras with noise that is cut at black, and no particles."""
    rng = np.random.default_rng(1)
    images = np.clip(np.rint(rng.normal(black, 0.8, case.images.shape)), 0, 255).astype(np.uint16)
    return replace(case, images=images, black_dn=black, white_dn=255.0)


def test_a_long_budget_changes_nothing() -> None:
    case = make_small(3).observation
    found, limited = solve(case), solve(case, budget_s=1e6)
    assert len(found.position_mm) > 10
    assert np.array_equal(found.position_mm, limited.position_mm)


def test_a_spent_budget_is_said_and_gives_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    shot = make_small(3)
    counts = []
    monkeypatch.setattr("sabench.algorithms.particles.matching._BATCH", 8)
    for ticks in (1.0, 8.0):
        monkeypatch.setattr(CLOCK, itertools.count().__next__)
        with pytest.warns(UserWarning, match=rf"the time budget of {ticks:g} s a frame is spent"):
            found = solve(shot.observation, budget_s=ticks)
        counts.append(len(found.position_mm))
        if len(found.position_mm):
            assert count_found(shot, found).precision > 0.9
    assert counts[0] == 0 < counts[1] < len(solve(shot.observation).position_mm)


def test_noise_without_particles_makes_none() -> None:
    case = noisy(make_small(3).observation)
    assert len(solve(case, floor=1e-6).position_mm) == 0


def test_peaks_that_agree_by_chance_are_thinned_with_a_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = noisy(make_small(3).observation, black=20.0)
    monkeypatch.setattr(module, "_MOST_BY_CHANCE", 0.01)
    with pytest.warns(UserWarning, match=r"at most 0.01 sets .* by chance .* \d+ of \d+ in camera"):
        many = solve(case, floor=1e-6, false_alarms=0.3)
    monkeypatch.undo()
    assert len(many.position_mm) < len(solve(case, floor=1e-6, false_alarms=0.3).position_mm)


def test_the_number_of_sets_by_chance_is_about_right() -> None:
    case = make_small(3).observation
    rng, maps = np.random.default_rng(2), fit_cameras(case)
    rows, columns = case.images.shape[1:]
    peaks = tuple(
        sort_peaks(rng.uniform([1.0, 1.0], [columns - 2.0, rows - 2.0], (400, 2)), (rows, columns))
        for _ in case.cameras
    )
    covered = np.zeros(case.images.shape, dtype=np.bool_)
    found = find_candidates(maps, peaks, 0.8, covered)
    expected = count_by_chance(maps, peaks, 0.8, rows * columns)
    assert 0.2 < len(found.position) / 400.0 / expected < 1.5


def test_peaks_that_are_kept_are_found_near() -> None:
    rng = np.random.default_rng(3)
    peaks = sort_peaks(rng.uniform(0.0, 60.0, (200, 2)), (60, 60))
    numbers = np.flatnonzero(rng.random(200) < 0.3)
    kept = keep_peaks(peaks, numbers)
    assert np.array_equal(kept.pixels, peaks.pixels[numbers])
    room = np.zeros(64, dtype=np.int64)
    for number, pixel in enumerate(kept.pixels):
        count = find_near(kept, pixel, 0.01, room)
        assert room[:count].tolist() == [number]
    none: Peaks = keep_peaks(peaks, np.zeros(0, dtype=np.int64))
    assert find_near(none, np.array([30.0, 30.0]), 20.0, room) == 0
