"""Particle solvers within a time budget, measured by a clock that ticks at each look."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest

from sabench.api import FoundParticles, ImageSequence
from sabench.api.make import make_algorithm
from sabench.tasks.particles_over_time import find_in_each_frame
from sabench.tasks.solver_call import SolverClock
from tests.helpers.small_particles import count_found, make_small

SOLVERS = ["bayesian_ipr", "shake_the_box"]


def solve(solver: str, budget_s: float | None, frames: int = 1) -> list[FoundParticles]:
    case = ImageSequence.of([make_small(6, 0.05).observation] * frames)
    algorithm = make_algorithm(solver, {} if budget_s is None else {"budget_s": budget_s})
    return list(find_in_each_frame(algorithm, solver, case, range(frames), SolverClock()))


def equal(one: FoundParticles, other: FoundParticles) -> bool:
    values = {declared.name: value for declared, value in other.arrays()}
    return all(np.array_equal(value, values[declared.name]) for declared, value in one.arrays())


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_long_budget_changes_nothing(solver: str) -> None:
    assert equal(solve(solver, None, 2)[1], solve(solver, 1e6, 2)[1])


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_budget_that_is_spent_gives_a_valid_result_quickly(solver: str) -> None:
    start = time.perf_counter()
    full = solve(solver, None, 3)
    between = time.perf_counter()
    found = solve(solver, 1e-6, 3)
    assert time.perf_counter() - between < 0.5 * (between - start)
    assert len(full[2].position_mm) > 200
    assert [len(one.position_mm) for one in found] == [0, 0, 0]


@pytest.mark.slow
def test_more_time_finds_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever the search ends, the result is valid; its F1 grows with the budget."""
    shot = make_small(6, 0.05)
    scores = []
    for ticks in (2, 12, 40, 100, 100_000):
        tick = itertools.count().__next__
        monkeypatch.setattr("sabench.utils.threads.time.monotonic", tick)
        found = solve("bayesian_ipr", float(ticks))[0]
        assert found.probability is not None
        scores.append(count_found(shot, found).f1)
    assert scores[-1] > 0.97
    assert scores == sorted(scores)
    assert scores[1] > 0.2
