"""Time budget of a search that returns its best result so far."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

_PORTION = 128  # particles between two looks at the clock


class Deadline:
    """End of a time budget in seconds, which starts now; None is no end."""

    def __init__(self, budget_s: float | None = None) -> None:
        self._end_s = math.inf if budget_s is None else time.monotonic() + budget_s

    @property
    def over(self) -> bool:
        """Say whether the budget is spent."""
        return time.monotonic() >= self._end_s

    def portions(self, count: int) -> Iterator[slice]:
        """Divide a number of rows into slices, until the budget is spent.

        Without an end it is one slice.
        """
        size = max(count, 1) if self._end_s == math.inf else _PORTION
        for first in range(0, count, size):
            if self.over:
                return
            yield slice(first, min(first + size, count))
