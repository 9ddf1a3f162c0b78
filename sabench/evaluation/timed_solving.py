"""Solvers timed next to a kernel that measures this machine's current speed.

Times of solvers are compared as multiples of its time.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sabench.dataset.reader import Dataset
from sabench.evaluation.suites import SolverEntry
from sabench.tasks import NAMES
from sabench.tasks.solve_and_score import solve
from sabench.utils import backend
from sabench.utils.compiled import numba
from sabench.utils.files import clear_abandoned
from sabench.utils.processes.call import call_isolated, preload

_CELLS = 1 << 20  # 8 MB: more than the second-level cache, so that memory counts, too
_ROUNDS = 3


def reference_s(clock: Callable[[], float] = time.perf_counter) -> float:
    """Measure the seconds of the kernel on one thread: the median of a few rounds.

    A round takes some 15 ms on a current processor. The arithmetic must never change, because the
    times of old records are multiples of it.
    """
    table = np.arange(_CELLS, dtype=np.float64)
    _work(table[:64])  # compiles it, or loads the compiled code
    return float(np.median([_time(table, clock) for _ in range(_ROUNDS)]))


def _time(table: Any, clock: Callable[[], float]) -> float:
    start = clock()
    _work(table)
    return clock() - start


@numba.njit(cache=True)
def _work(table: Any) -> float:
    """Compute square roots of neighbours, with branches and distant memory access."""
    total, last = 0.0, len(table) - 1
    for i in range(len(table)):
        value = table[i]
        total += math.sqrt(value * value + 1.0) if i & 3 else value / (1.0 + total * 1e-9)
        j = (i * 40503) & last  # an odd factor modulo a power of two reaches every cell once
        table[j] = 0.5 * (table[j] + total % 7.0)
    return total


# Import all modules that solvers may need once, before many solvers run.
preload(
    "sabench.evaluation.timed_solving", "tifffile", *(f"sabench.tasks.{name}" for name in NAMES)
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

    Returns seconds of the reference kernel, the mean of before and after.
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
