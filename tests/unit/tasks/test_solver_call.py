"""Calls of solvers that hand control back after each iteration."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from sabench.api import IterativeSolver, Observation, Reconstruction
from sabench.simulation.in_memory import simulate
from sabench.tasks.solver_call import call_iterations, call_solver
from sabench.utils.errors import DeclinedError
from tests.helpers.particle_scenes import make_scene
from tests.helpers.refusals import refused


class Counting(IterativeSolver):
    name = "counting"
    most = 7

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        volume = np.zeros(case.grid.shape, dtype=np.float32)

        def estimate() -> Reconstruction:
            return Reconstruction(volume.copy())

        for _ in range(self.most):
            np.add(volume, np.float32(1.0), out=volume)
            yield estimate


class Declining(Counting):
    def skip(self, case: Observation) -> str | None:
        return "it takes none"


@pytest.fixture(scope="module")
def case() -> Observation:
    return simulate(make_scene(particles={"count": 3}), seed=1).observation


def counting(most: int = 7) -> Counting:
    made = Counting(Counting.Parameters())
    made.most = most
    return made


def test_some_iterations_are_stored_and_the_last_is_the_answer(case: Observation) -> None:
    stored: list[tuple[int, float, float]] = []

    def store(number: int, seconds: float, estimate: Reconstruction) -> None:
        stored.append((number, seconds, float(estimate.volume.max())))

    found, seconds = call_iterations(counting(), "counting", case, store)
    assert [(number, value) for number, _, value in stored] == [(k, k) for k in (1, 2, 3, 5)]
    assert np.all(np.diff([at for _, at, _ in stored] + [seconds]) >= 0.0)
    same, _ = call_solver(counting(), "counting", case, Reconstruction)
    np.testing.assert_array_equal(found.volume, same.volume)
    assert found.volume.max() == 7.0


def test_solvers_without_an_iteration_and_those_that_decline_are_said(case: Observation) -> None:
    def store(number: int, seconds: float, estimate: Reconstruction) -> None:
        raise AssertionError

    with refused():
        call_iterations(counting(0), "counting", case, store)
    with refused():
        counting(0).solve(case)
    with refused("declines this case", kind=DeclinedError):
        call_iterations(Declining(Declining.Parameters()), "declining", case, store)
