"""Work on all cores, and within a time budget."""

import itertools
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from sabench.utils.compiled import numba

_Result = TypeVar("_Result")


def for_each(work: Callable[[int], _Result], count: int) -> list[_Result]:
    """Work on the numbers below a count; returns the results in their order."""
    threads = min(count, numba.get_num_threads())
    if threads < 2:
        return [work(number) for number in range(count)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, range(count)))


def share_rows(work: Callable[[slice], _Result], count: int) -> list[_Result]:
    """Work on slices of rows, one a core; returns the results in their order."""
    parts = max(1, min(count, numba.get_num_threads()))
    ends = np.linspace(0, count, parts + 1).astype(int)
    slices = [slice(*pair) for pair in itertools.pairwise(ends)]
    return for_each(lambda part: work(slices[part]), len(slices))


def on_cores(kernel: Callable[..., _Result], count: int, *arguments: object) -> list[_Result]:
    """Call kernel(jobs, *arguments) for slices of a number of jobs, one a core.

    This is how kernels use all cores: each of numba's own parallel loops takes three more seconds
    to compile.
    """
    return share_rows(lambda rows: kernel(rows, *arguments), count)


class Deadline:
    """End of a time budget in seconds, which starts now; None is no end."""

    def __init__(self, budget_s: float | None = None) -> None:
        self._end_s = math.inf if budget_s is None else time.monotonic() + budget_s

    @property
    def over(self) -> bool:
        """Say whether the budget is spent."""
        return time.monotonic() >= self._end_s
