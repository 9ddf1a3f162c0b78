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
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(work, range(count)))


def share_rows(
    work: Callable[[slice], _Result], count: int, parts: int | None = None
) -> list[_Result]:
    """Work on slices of a number of rows; returns the results in their order.

    There are as many as cores. Where results are added up, a given number of parts makes the sum
    the same on any machine.
    """
    ends = np.linspace(0, count, (parts or numba.get_num_threads()) + 1).astype(int)
    slices = [slice(*pair) for pair in itertools.pairwise(ends)]
    return for_each(lambda part: work(slices[part]), len(slices))


class Deadline:
    """End of a time budget in seconds, which starts now; None is no end."""

    def __init__(self, budget_s: float | None = None) -> None:
        self._end_s = math.inf if budget_s is None else time.monotonic() + budget_s

    @property
    def over(self) -> bool:
        """Say whether the budget is spent."""
        return time.monotonic() >= self._end_s
