"""Memory of this process: its peak, the available rest, and freed blocks."""

import contextlib
import ctypes
import functools
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

_LARGEST = 31 << 20  # bytes of a block that glibc lets a process keep, at most

_children: list[float] = []  # largest peak of a child process (MB)


def add_child(mb: float) -> None:
    """Count the peak of a child process in addition to this process's own memory."""
    _children[:] = [max([mb, *_children])]


def forget_peak() -> None:
    """Reset the process's memory high-water mark, where the system can (Linux)."""
    _children.clear()
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
        return _read_kb(status, "VmHWM:") * 1024 / 1e6 + sum(_children)
    try:
        import resource
    except ImportError:  # Windows
        return None
    # macOS counts bytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6 + sum(_children)


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
