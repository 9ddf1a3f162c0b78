"""Clock of the time that kernels take to compile, or to come out of their cache.

It happens once for a kernel and a machine, so that it is no part of what a solver costs.
"""

from __future__ import annotations

import functools
import threading
import time
from typing import Any


def compile_s() -> float:
    """Return the seconds of compilation by this thread since the first call."""
    return float(_clock().seconds)


@functools.cache
def _clock() -> Any:
    from numba.core import event

    class CompileClock(event.Listener):  # type: ignore[misc]
        """Sum of the times in which this thread holds numba's compiler."""

        def __init__(self) -> None:
            self.seconds, self._depth, self._start = 0.0, 0, 0.0
            self._thread = threading.get_ident()

        def on_start(self, event: Any) -> None:
            """Start with the outermost compilation: a kernel compiles those that it calls."""
            if threading.get_ident() == self._thread:
                self._depth += 1
                if self._depth == 1:
                    self._start = time.perf_counter()

        def on_end(self, event: Any) -> None:
            """Stop with the outermost compilation."""
            if threading.get_ident() == self._thread and self._depth:
                self._depth -= 1
                if not self._depth:
                    self.seconds += time.perf_counter() - self._start

    clock = CompileClock()
    event.register("numba:compiler_lock", clock)
    return clock
