"""Solvers timed next to the reference kernel."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from sabench.dataset.reader import Dataset
from sabench.evaluation.gates.reference_kernel import reference_s
from sabench.evaluation.suites import SolverEntry
from sabench.tasks import NAMES
from sabench.tasks.solve_and_score import solve
from sabench.utils import backend
from sabench.utils.files import clear_abandoned
from sabench.utils.processes.call import call_isolated, preload

# Where many solvers are run, it pays to load all that one of them may need.
preload(
    "sabench.evaluation.timed_solving",
    "tifffile",
    *(f"sabench.tasks.{name}" for name in NAMES),
)


def solve_timed(
    solver_entry: SolverEntry,
    dataset: Dataset,
    out: Path,
    *,
    threads: int | None = None,
    iterations: bool = False,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Solve, and time the reference kernel before and after.

    Parameters
    ----------
    threads : of compiled kernels and of linear algebra; None: as many as there are cores.
    iterations : store the first frame's estimates on the way, too.
    clock : of the reference kernel, a function of the module `time`.

    Returns
    -------
    Seconds of the reference kernel, the mean of before and after.
    """
    try:
        before = _reference_s(threads, clock)
        solve(
            solver_entry.name,
            dataset,
            out,
            parameters=solver_entry.parameters,
            limits=solver_entry.limits,
            threads=threads,
            iterations=iterations,
            overwrite=True,
        )
        return (before + _reference_s(threads, clock)) / 2.0
    finally:
        clear_abandoned(out)


def _reference_s(threads: int | None, clock: Callable[[], float]) -> float:
    return float(call_isolated(_measure, threads, clock, doing="reference kernel"))


def _measure(threads: int | None, clock: Callable[[], float]) -> float:
    with backend.limit_libraries(threads):
        return reference_s(clock)
