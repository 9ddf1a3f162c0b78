"""Reference kernel, whose time measures the current speed of this machine.

Times of solvers are compared as multiples of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from sabench.utils.compiled import numba

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
