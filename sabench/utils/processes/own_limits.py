"""Limits that a process sets for itself before it reads a file of others."""

from __future__ import annotations

import math
import time
from pathlib import Path


def limit_self(memory_mb: float, cpu_s: float) -> None:
    """Limit the memory and the CPU time that this process may still take.

    A request for more memory fails; more CPU time ends the process by SIGXCPU. Only for child
    processes: the limits stay. Without effect where the system has no such limits (Windows), and
    without a limit of memory where the system does not report how much is in use (macOS).
    """
    try:
        import resource
    except ImportError:
        return
    _set(resource.RLIMIT_CORE, 0)
    _set(resource.RLIMIT_CPU, math.ceil(time.process_time() + cpu_s))
    held = _address_space_bytes()
    if held is not None:
        _set(resource.RLIMIT_AS, int(held + 1e6 * memory_mb))


def _set(kind: int, value: int) -> None:
    import resource

    soft, hard = resource.getrlimit(kind)
    bounds = [one for one in (value, soft, hard) if one != resource.RLIM_INFINITY]
    resource.setrlimit(kind, (min(bounds), hard))


def _address_space_bytes() -> int | None:
    sizes = Path("/proc/self/statm")
    if not sizes.exists():
        return None
    import resource

    return int(sizes.read_text().split()[0]) * resource.getpagesize()
