"""Time budget of a search that returns its best result so far."""

from __future__ import annotations

import math
import time


class Deadline:
    """End of a time budget in seconds, which starts now; None is no end."""

    def __init__(self, budget_s: float | None = None) -> None:
        self._end_s = math.inf if budget_s is None else time.monotonic() + budget_s

    @property
    def over(self) -> bool:
        """Say whether the budget is spent."""
        return time.monotonic() >= self._end_s
