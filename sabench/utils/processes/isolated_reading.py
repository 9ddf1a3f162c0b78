"""Reading of other people's files in a limited child process.

Libraries that read them may crash or loop for ever.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sabench.utils.errors import InputError, UncheckedError
from sabench.utils.processes.ending import describe_end, overdue
from sabench.utils.processes.isolated import call_isolated

_CPU_S = 4.0  # seconds of CPU time for the structure of a file
_RATE = 2e7  # bytes of a file for each further second
_PATIENCE = 30.0  # seconds for each of CPU time, after which a sleeping child is killed
_OVERDUE = describe_end(-24)  # SIGXCPU


def read_isolated(read: Callable[..., None], path: Path, *arguments: Any) -> None:
    """Call `read(path, *arguments)`, a module's function, in a limited child process.

    The limit is CPU time of the reading alone: the start of the process and other programs on the
    machine do not count.

    Raises
    ------
    InputError
        The function raises one, or the process crashes.
    UncheckedError
        The reading took more than its CPU time, so the file may be intact.
    """
    cpu_s = math.ceil(_CPU_S + path.stat().st_size / _RATE)
    time_s = _PATIENCE * max(cpu_s, 1)
    doing = f"{path}: reading it"
    try:
        call_isolated(_read, read, cpu_s, path, arguments, doing=doing, time_s=time_s)
    except InputError as error:
        spent, late = str(error).endswith(_OVERDUE), str(error).endswith(overdue(time_s))
        if spent or late:
            limit = f"{cpu_s} s of CPU time" if spent else f"{time_s:g} s"
            raise UncheckedError(
                f"{path}: could not be checked, because reading it takes more than {limit}"
            ) from error
        raise


def _read(read: Callable[..., None], cpu_s: int, path: Path, arguments: tuple[Any, ...]) -> None:
    _limit_cpu(cpu_s)
    read(path, *arguments)


def _limit_cpu(seconds: int) -> None:
    """End this process by SIGXCPU after further seconds of CPU time.

    Without effect where the system has no such limit (Windows).
    """
    try:
        import resource
    except ImportError:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    wanted = math.ceil(time.process_time() + seconds)
    soft = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))
