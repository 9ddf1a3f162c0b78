"""numba with the folder of sabench's kernels, and a clock of its compiler.

All modules with kernels import numba from here, so that the folder is set before the first kernel.
"""

import functools
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, event
from numba.core.registry import CPUDispatcher, cpu_target

from sabench.utils.code_hash import PACKAGE
from sabench.utils.kernel_folder import kernel_folder

numba.config.CACHE_DIR = str(kernel_folder())


class _PlaceInPackage(caching._CacheLocator):  # type: ignore[misc]
    """Folder of a module's kernels by its place in the package.

    numba's own depends on the path of the file, so that another checkout or environment would
    compile the same sources again.
    """

    def __init__(self, function: Any, file: Path) -> None:
        self._path = str(kernel_folder() / file.relative_to(PACKAGE).parent)
        self._line = str(function.__code__.co_firstlineno)

    def get_cache_path(self) -> str:
        """Return the folder."""
        return self._path

    def get_source_stamp(self) -> str:
        """Return no stamp: the folder of all kernels has the hash of their sources."""
        return ""

    def get_disambiguator(self) -> str:
        """Tell functions of one name apart."""
        return self._line

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        """Find the folder of a function; None if the hash of sources leaves out its file."""
        file = Path(py_file)
        if not file.is_relative_to(PACKAGE) or "_plugins" in file.parts:
            return None
        locator = cls(py_func, file)
        try:
            locator.ensure_cache_path()
        except OSError:  # numba's own come next
            return None
        return locator


caching.CacheImpl._locator_classes.insert(0, _PlaceInPackage)


class _InnerKernel(CPUDispatcher):  # type: ignore[misc]
    """Kernel without wrappers, an eighth of the time of compiling."""

    def add_overload(self, cres: Any) -> None:
        """Keep what was compiled out of the table of what Python may call."""
        self.overloads[tuple(cres.signature.args)] = cres

    @functools.cached_property
    def _door(self) -> Any:
        return numba.njit(lambda *arguments: self(*arguments))

    def _compile_for_args(self, *arguments: Any) -> Any:
        """Return a kernel that calls it, for tests."""
        return self._door


def inner_kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate as `numba.njit(cache=True)` a kernel that only kernels call."""
    options |= {"nopython": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = _InnerKernel(function, targetoptions=options)
        kernel.enable_caching()
        return kernel

    return decorate


class _CompileClock(event.Listener):  # type: ignore[misc]
    """Time while at least one thread holds or awaits numba's compiler.

    The compiler also loads kernels from their folder. A solver that starts threads waits for the
    kernels that they compile.
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
            if self._busy:  # else it began before the clock was there
                self._busy -= 1
                if not self._busy:
                    self.seconds += time.perf_counter() - self._start


_CLOCK = _CompileClock()
event.register("numba:compiler_lock", _CLOCK)


def compile_s() -> float:
    """Return the seconds that this process spent compiling or loading kernels.

    Those of all threads count once. This happens once for a kernel and a machine, or a process, and
    is no part of a solver's time.
    """
    return _CLOCK.seconds


def load_registries() -> None:
    """Load all that numba loads with the first kernel of a process: half a second."""
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


__all__ = ["compile_s", "inner_kernel", "load_registries", "numba"]
