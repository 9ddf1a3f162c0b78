"""Reading of other people's files in a limited child process.

Libraries that read them may crash, loop for ever or fill the memory.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sabench.utils.errors import InputError, UncheckedError
from sabench.utils.processes.ending import describe_end, overdue
from sabench.utils.processes.isolated import call_isolated
from sabench.utils.processes.own_limits import limit_self

_CPU_S = 4.0  # seconds of CPU time for the structure of a file
_RATE = 2e7  # bytes of a file for each further second
_MEMORY_MB = 1000.0  # of the child, besides what it shares with its server
_EXPANSION = 50.0  # times a file's size that its values may take in addition
_PATIENCE = 30.0  # seconds for each of CPU time, after which a sleeping child is killed
_OVERDUE = describe_end(-24)  # SIGXCPU


def read_isolated(
    read: Callable[..., None], path: Path, *arguments: Any, size_bytes: int | None = None
) -> None:
    """Call `read(path, *arguments)`, a module's function, in a limited child process.

    The limit of time is CPU time of the reading alone: the start of the process and other programs
    on the machine do not count.

    A worker that may have no child processes (Dask's) calls it directly: the process that hands out
    the tasks has read the same file before.

    Parameters
    ----------
    size_bytes : size of all that it reads; None: that of the file.

    Raises
    ------
    InputError
        The function raises an exception, the process crashes, or takes more memory than the file's
        size justifies.
    UncheckedError
        The reading took more than its CPU time, so the file may be intact.
    """
    if multiprocessing.current_process().daemon:
        read(path, *arguments)
        return
    size = path.stat().st_size if size_bytes is None else size_bytes
    cpu_s = math.ceil(_CPU_S + size / _RATE)
    memory_mb = _MEMORY_MB + _EXPANSION * size / 1e6
    limits, time_s = (memory_mb, cpu_s), _PATIENCE * max(cpu_s, 1)
    doing = f"{path}: reading it"
    try:
        call_isolated(_read, read, limits, path, arguments, doing=doing, time_s=time_s)
    except InputError as error:
        spent, late = str(error).endswith(_OVERDUE), str(error).endswith(overdue(time_s))
        if spent or late:
            limit = f"{cpu_s} s of CPU time" if spent else f"{time_s:g} s"
            raise UncheckedError(
                f"{path}: could not be checked, because reading it takes more than {limit}"
            ) from error
        raise


def _read(
    read: Callable[..., None],
    limits: tuple[float, float],
    path: Path,
    arguments: tuple[Any, ...],
) -> None:
    limit_self(*limits)
    _silence()
    try:
        read(path, *arguments)
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(
            f"{path}: expected a file that can be read with {limits[0]:.0f} MB of memory"
        ) from error
    except Exception as error:  # libraries raise what their parsers raise
        name = type(error).__name__
        raise InputError(f"{path}: expected an intact file, got {name}: {error}") from error


def _silence() -> None:
    """Send what libraries print about damaged files nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    os.close(nowhere)
