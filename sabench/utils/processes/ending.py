"""End of child processes.

How one ended, its last words, and killing all that it started.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterable, Iterator

import psutil

from sabench.utils.errors import InputError
from sabench.utils.validation import printable

_LONGEST = 300  # characters of a process's last line that an error repeats


def describe_end(code: int | None) -> str:
    """Return "exit code 3" or "signal SIGABRT"."""
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


def last_line(output: bytes) -> str:
    """Return the last line that is not empty, fit for printing."""
    lines = output.decode("utf-8", "replace").splitlines()
    return printable(next((line.strip() for line in reversed(lines) if line.strip()), ""), _LONGEST)


def last_words(line: str) -> str:
    """Return the clause of an error that quotes a process's last line, if any."""
    return f"; its last words: {line}" if line else ""


def check_end(name: str, code: int, line: str) -> None:
    """Raise an InputError with the last line of output unless the exit code is 0."""
    if code:
        end = f"expected exit code 0, but it ended with {describe_end(code)}"
        raise InputError(f"{name}: {end}{last_words(line)}")


def overdue(time_s: float) -> str:
    """Return the clause of an error about a process that exceeds its time limit."""
    return f"expected an end within {time_s:g} s, but it was still running"


@contextlib.contextmanager
def kill_if_left(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """Kill a process and all below it if the block ends first.

    Its pipes are closed, too.
    """
    try:
        yield
    finally:
        if process.poll() is None:
            kill_tree(process.pid)
        reap(process)


def reap(process: subprocess.Popen[bytes]) -> int:
    """Wait for a process that ends, close its pipes, and return its exit code."""
    code = process.wait()
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    return code


def kill_tree(pid: int) -> None:
    """Kill a process and all below it."""
    with contextlib.suppress(psutil.Error):
        head = psutil.Process(pid)
        kill_running([head, *head.children(recursive=True)])


def kill_running(processes: Iterable[psutil.Process]) -> int:
    """Kill those processes that still run, but not this one; returns their number."""
    left = [one for one in processes if one.pid != os.getpid() and _runs(one)]
    for one in left:
        with contextlib.suppress(psutil.Error):
            one.kill()
    return len(left)


def _runs(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    return False
