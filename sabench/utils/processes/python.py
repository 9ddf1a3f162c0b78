"""Python child processes: one module, some code, or servers that answer requests.

A crash of a child and its output stay there.
"""

import contextlib
import importlib.util
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from sabench.utils import memory
from sabench.utils.code_hash import PACKAGE
from sabench.utils.errors import InputError
from sabench.utils.processes.program import (
    check_exit_code,
    describe_end,
    kill_if_left,
    last_line,
    overdue,
    reap,
)
from sabench.utils.progress import progress_bar

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
    paths = [path for path in (*sys.path, str(PACKAGE.parent)) if path]
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


def missing_package(module: str, package: str) -> str | None:
    """Say how to install a package of the extra `competitors`; None if it is there."""
    if importlib.util.find_spec(module):
        return None
    return f"the package {package} is not installed: pip install sabench[competitors]"


def run_module(module: str, folder: Path, name: str, mark: str, steps: int) -> None:
    """Run `python -m MODULE FOLDER` with a progress bar.

    Its memory is counted as this process's.

    Parameters
    ----------
    folder : working directory; the output goes to its file log.txt.
    name : of the program, for the progress bar and errors.
    mark : text of those lines of output that advance the bar.
    steps : length of the bar.

    Raises InputError: the exit code is not 0; the text quotes the last line of output.
    """
    log = folder / "log.txt"
    with log.open("wb") as errors:
        process = start_python(["-m", module, str(folder)], folder=folder, stderr=errors)
    with kill_if_left(process):
        assert process.stdout is not None
        bar = iter(progress_bar(range(steps), name))
        with log.open("ab") as output:
            for line in process.stdout:
                output.write(line)
                if mark.encode() in line:
                    next(bar, None)
        for _ in bar:  # steps that the program did not announce
            pass
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        memory.add_child(used.ru_maxrss * (1024 if sys.platform != "darwin" else 1) / 1e6)
    check_exit_code(name, process.returncode, last_line(log.read_bytes()))


def run_code(code: str, name: str, time_s: float) -> str:
    """Run Python code in a child process and return what it prints.

    Raises InputError: it exceeds its time, or its exit code is not 0; the text quotes its last line
    of errors.
    """
    process = start_python(["-c", code], stderr=subprocess.PIPE)
    with kill_if_left(process):
        try:
            output, errors = process.communicate(timeout=time_s)
        except subprocess.TimeoutExpired:
            raise InputError(f"{name}: {overdue(time_s)}") from None
    check_exit_code(name, process.returncode, last_line(errors))
    return output.decode("utf-8", "replace").strip()


@dataclass(frozen=True)
class Reply:
    """Answer of server `number`; `end` says how its process ended, if it did."""

    number: int
    value: Any = None
    end: str | None = None


class Servers:
    """Equal Python processes, numbered in the order of their start.

    Parameters
    ----------
    arguments : of the interpreter. The program reads requests from its standard input, one line
        of JSON each, and answers each with one line of JSON on its standard output.
    count : number of processes.
    threads : of each process.
    """

    def __init__(self, arguments: Sequence[str], count: int, threads: int) -> None:
        self._arguments, self._count, self._threads = arguments, count, threads
        self._processes: dict[int, subprocess.Popen[bytes]] = {}
        self._lines: queue.SimpleQueue[tuple[int, bytes]] = queue.SimpleQueue()
        self._started = 0

    @property
    def pids(self) -> list[int]:
        """Process numbers of the servers."""
        return [process.pid for process in list(self._processes.values())]

    def running(self) -> list[int]:
        """Return the numbers of all servers, after replacing those that have ended."""
        while len(self._processes) < self._count:
            self._start()
        return list(self._processes)

    def request(self, number: int, value: Any) -> None:
        """Send a request; if the server is dead, `receive` reports its end."""
        pipe = self._processes[number].stdin
        assert pipe is not None
        with contextlib.suppress(OSError):
            pipe.write(f"{json.dumps(value)}\n".encode())
            pipe.flush()

    def receive(self) -> Reply:
        """Wait for the next answer or end of a server."""
        number, line = self._lines.get()
        if line:
            return Reply(number, json.loads(line))
        return Reply(number, end=describe_end(reap(self._processes.pop(number))))

    def close(self) -> None:
        """Kill all servers."""
        for process in self._processes.values():
            process.kill()
        for process in self._processes.values():
            reap(process)

    def _start(self) -> None:
        number, self._started = self._started, self._started + 1
        process = start_python(self._arguments, threads=self._threads, stdin=subprocess.PIPE)
        self._processes[number] = process

        def listen() -> None:
            with contextlib.suppress(OSError, ValueError):
                for line in process.stdout or ():
                    if line.endswith(b"\n"):  # a killed server may leave half a line
                        self._lines.put((number, line))
            self._lines.put((number, b""))  # it has ended

        threading.Thread(target=listen, daemon=True).start()
