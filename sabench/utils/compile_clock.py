"""Clock of the time in which kernels are compiled and modules imported.

A kernel may come out of its cache in place of it. All this happens once for a kernel and a machine,
or for a process, so that it is no part of what a solver costs.
"""

from __future__ import annotations

import builtins
import contextlib
import functools
import threading
import time
from collections.abc import Iterator
from typing import Any


def compile_s() -> float:
    """Return the seconds in which any thread of this process compiled or imported.

    They count from the first call.
    """
    return float(_clock().seconds)


def load_registries() -> None:
    """Load all that numba loads with the first kernel of a process: half a second."""
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


@contextlib.contextmanager
def timed_imports() -> Iterator[None]:
    """Count imports for a while."""
    plain, clock = builtins.__import__, _clock()

    def timed(*words: Any, **more: Any) -> Any:
        clock.on_start(None)
        try:
            return plain(*words, **more)
        finally:
            clock.on_end(None)

    builtins.__import__ = timed
    try:
        yield
    finally:
        builtins.__import__ = plain


@functools.cache
def _clock() -> Any:
    from numba.core import event

    class CompileClock(event.Listener):  # type: ignore[misc]
        """Time in which at least one thread holds or awaits numba's compiler, or imports.

        A solver that starts threads waits for the kernels that they compile.
        """

        def __init__(self) -> None:
            self.seconds, self._busy, self._start = 0.0, 0, 0.0
            self._lock = threading.Lock()

        def on_start(self, event: Any) -> None:
            """Start with the first one: kernels compile those that they call."""
            with self._lock:
                self._busy += 1
                if self._busy == 1:
                    self._start = time.perf_counter()

        def on_end(self, event: Any) -> None:
            """Stop with the last one."""
            with self._lock:
                if self._busy:
                    self._busy -= 1
                    if not self._busy:
                        self.seconds += time.perf_counter() - self._start

    clock = CompileClock()
    event.register("numba:compiler_lock", clock)
    return clock
