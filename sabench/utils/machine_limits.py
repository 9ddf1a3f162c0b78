"""Memory and threads: peak and available memory, and work on all cores."""

import contextlib
import ctypes
import functools
import itertools
import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np

from sabench.utils.compiled import numba

Result = TypeVar("Result")


def for_each(work: Callable[[int], Result], count: int) -> list[Result]:
    """Work on the numbers below a count; returns the results in their order."""
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(work, range(count)))


def share_rows(
    work: Callable[[slice], Result], count: int, parts: int | None = None
) -> list[Result]:
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
        """Return whether the budget is spent."""
        return time.monotonic() >= self._end_s


_LARGEST = 31 << 20  # bytes of a block that glibc lets a process keep, at most

_children = [0.0]  # largest peak of a child process (MB)


def add_child(mb: float) -> None:
    """Count the peak of a child process in addition to this process's own memory."""
    _children[0] = max(_children[0], mb)


def forget_peak() -> None:
    """Reset the process's memory high-water mark, where the system can (Linux)."""
    _children[0] = 0.0
    marks = Path("/proc/self/clear_refs")
    # not permitted in some containers: the peak of the whole process is then an upper bound
    with contextlib.suppress(OSError):
        if marks.exists():
            marks.write_text("5")


def peak_mb() -> float | None:
    """Return the peak resident memory of this process and its largest child, MB.

    1 MB is 10^6 bytes. None where the system does not report it.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return _read_kb(status, "VmHWM:") * 1024 / 1e6 + _children[0]
    try:
        import resource
    except ImportError:  # Windows
        return None
    # macOS counts bytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6 + _children[0]


def _read_kb(table: Path, key: str) -> int:
    line = next(line for line in table.read_text().splitlines() if line.startswith(key))
    return int(line.split()[1])


def available_mb() -> float | None:
    """Return the memory that a process can still take, in MB (10^6 bytes).

    None where the system does not report it. Where only the total memory is known (macOS) it is
    that, an upper bound. A container's own limit is not considered.
    """
    info = Path("/proc/meminfo")
    if info.exists():
        return _read_kb(info, "MemAvailable:") * 1024 / 1e6
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (AttributeError, ValueError):  # Windows has no sysconf, other systems may lack the names
        return None


def trim() -> None:
    """Return freed memory to the system, where the C library keeps it (glibc).

    Large blocks of one frame are freed below small ones that HDF5 keeps until its file is closed;
    glibc then holds on to all of them, and a long data set would cost some 3 MB a frame.
    """
    _trimmer()(0)


def keep_freed() -> None:
    """Keep blocks of up to some 30 MB that this process frees (glibc).

    By default glibc returns the memory of an image to the system and asks for new pages for the
    next, which costs up to a sixth of the time of a stream of small images. A block that is freed
    raises its limits to the block's size (up to 32 MB: `mallopt`'s manual page); no page of it is
    used.
    """
    np.empty(_LARGEST, dtype=np.uint8)


@functools.cache
def _trimmer() -> Callable[[int], object]:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library, which returns large blocks
        return lambda _: None
