"""Start of Python child processes: their environment, their threads, and Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

_ROOT = Path(__file__).resolve().parents[3]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def start_python(
    arguments: Sequence[str],
    *,
    threads: int | None = None,
    folder: Path | None = None,
    stdin: int | None = None,
    stderr: int | IO[bytes] | None = None,
) -> subprocess.Popen[bytes]:
    """Start a Python process that ignores Ctrl-C and has this one's import path.

    It can import the modules that this one can.

    Parameters
    ----------
    arguments : of the interpreter, as `["-m", "package.module"]`.
    threads : number of threads for numerical libraries; None: as in this process.
    folder : working directory.
    stdin, stderr : as for `subprocess.Popen`; standard output is a pipe.
    """
    with ignored_interrupts():
        return subprocess.Popen(
            [sys.executable, "-P", *arguments],
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=stderr,
            cwd=folder,
            env=_environment(threads),
        )


def _environment(threads: int | None) -> dict[str, str]:
    paths = [path for path in (*sys.path, str(_ROOT)) if path]
    limits = {} if threads is None else dict.fromkeys(_THREADS, str(threads))
    return os.environ | limits | {"PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}


@contextlib.contextmanager
def ignored_interrupts() -> Iterator[None]:
    """Start processes that ignore Ctrl-C, which a terminal sends to children as well.

    This process still receives it and ends them. Other threads than the main one cannot set
    signals: children that they start receive Ctrl-C.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
