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

from sabench.utils.errors import InputError
from sabench.utils.processes.ending import describe_end
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

    A worker that may have no child processes (Dask's) calls it directly: the process that hands out
    the tasks has read the same file before.

    Parameters
    ----------
    size_bytes : size of all that it reads; None: that of the file.

    Raises
    ------
    InputError
        The function raises an exception, the process crashes, takes more memory than the file's
        size justifies, or more CPU time.
    """
    if multiprocessing.current_process().daemon:
        read(path, *arguments)
        return
    size = path.stat().st_size if size_bytes is None else size_bytes
    cpu_s = math.ceil(_CPU_S + size / _RATE)
    memory_mb = _MEMORY_MB + _EXPANSION * size / 1e6
    doing = f"{path}: reading it"
    try:
        call_isolated(
            _read,
            read,
            (memory_mb, cpu_s),
            path,
            arguments,
            doing=doing,
            time_s=_PATIENCE * max(cpu_s, 1.0),
        )
    except InputError as error:
        if str(error).endswith(_OVERDUE):
            raise InputError(f"{doing}: it could not be read in {cpu_s:g} s of CPU time") from error
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
