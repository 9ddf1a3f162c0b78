"""Who does the tasks of a recording: this process, several on this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any

from sabench.simulation.recording.job import record
from sabench.simulation.recording.parts import Parts
from sabench.simulation.recording.recorders import Recorder
from sabench.simulation.recording.schedule import TRIES, Outcome, Schedule, Task, WorkerPool
from sabench.utils.errors import InputError
from sabench.utils.progress import bar

_ROOT = Path(__file__).resolve().parents[3]


def run_schedule(pool: WorkerPool, schedule: Schedule, doing: str) -> None:
    """Have workers do all tasks of a schedule.

    Raises
    ------
    InputError
        Tasks that failed `TRIES` times; all others have been done then, and their parts stay.
    """
    last: dict[Hashable, int] = {}
    with bar(doing, schedule.tasks) as advance:
        while not schedule.finished:
            for worker in pool.idle():
                task = schedule.take(last.get(worker))
                if task is None:
                    break
                last[worker] = task.frame
                pool.give(worker, task)
            for outcome in pool.wait():
                if outcome.failure is None:
                    schedule.complete(outcome.task)
                    advance()
                else:
                    schedule.fail(outcome.task, outcome.failure)
    if schedule.failures:
        task, why = schedule.failures[0]
        more = f", and {len(schedule.failures) - 1} more" if len(schedule.failures) > 1 else ""
        raise UnfinishedError(
            f"{doing}: {task} failed {TRIES} times{more}: {why}; what was finished is kept, the same command goes on with it"
        )


class UnfinishedError(InputError):
    """Some tasks failed; the parts of the others are kept."""


class InProcess:
    """This process."""

    ahead = 1

    def __init__(self, recorder: Recorder, parts: Parts) -> None:
        self._recorder, self._parts = recorder, parts
        self._ended: list[Outcome] = []

    def idle(self) -> Sequence[Hashable]:
        """This process, as soon as what it did has been taken note of."""
        return () if self._ended else (0,)

    def give(self, worker: Hashable, task: Task) -> None:
        """Do the task."""
        record(self._recorder, self._parts, task)
        self._ended.append(Outcome(worker, task))

    def wait(self) -> list[Outcome]:
        """The task that was done."""
        ended, self._ended = self._ended, []
        return ended

    def close(self) -> None:
        """Nobody to send home."""


class ProcessPool:
    """Processes on this machine that share its cores; one that dies is replaced."""

    def __init__(self, root: Path, jobs: int, threads: int | None = None) -> None:
        self._root, self._jobs, self._threads = (
            root,
            jobs,
            threads or max(1, (os.cpu_count() or 1) // jobs),
        )
        self._said: queue.SimpleQueue[tuple[int, str]] = queue.SimpleQueue()
        self._workers: dict[int, subprocess.Popen[str]] = {}
        self._busy: dict[int, Task] = {}
        self._count = 0

    @property
    def ahead(self) -> int:
        """One frame for each, and one more for whoever comes first."""
        return self._jobs + 1

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers."""
        return [process.pid for process in list(self._workers.values())]

    def idle(self) -> Sequence[Hashable]:
        """Processes without a task; those that died are replaced."""
        while len(self._workers) < self._jobs:
            self._start()
        return [number for number in self._workers if number not in self._busy]

    def give(self, worker: Hashable, task: Task) -> None:
        """Tell a process what to do."""
        assert isinstance(worker, int)
        self._busy[worker] = task
        pipe = self._workers[worker].stdin
        assert pipe is not None
        with contextlib.suppress(OSError):  # it has died: its reader says so
            pipe.write(f"{json.dumps([task.frame, task.camera])}\n")
            pipe.flush()

    def wait(self) -> list[Outcome]:
        """What the next process says, or that it died."""
        number, line = self._said.get()
        task = self._busy.pop(number, None)
        if not line:
            code = _dismiss(self._workers.pop(number))
            return (
                []
                if task is None
                else [Outcome(number, task, f"its process ended with exit code {code}")]
            )
        assert task is not None
        kind, why = json.loads(line)
        if kind == "input":
            raise InputError(why)
        if kind == "system":
            raise OSError(why)
        return [Outcome(number, task, why)]

    def close(self) -> None:
        """End all processes; they leave nothing half-written."""
        for process in self._workers.values():
            process.kill()
        for process in self._workers.values():
            _dismiss(process)

    def _start(self) -> None:
        number, self._count = self._count, self._count + 1
        with _deaf():
            process = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "sabench.simulation.recording.worker",
                    str(self._root),
                    str(self._threads),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=_environment(self._threads),
            )
        self._workers[number] = process
        threading.Thread(
            target=_listen, args=(process.stdout, number, self._said), daemon=True
        ).start()


def _dismiss(process: subprocess.Popen[str]) -> int:
    """Wait for a process that ends, and close what led to it; returns its exit code."""
    code = process.wait()
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        with contextlib.suppress(OSError):
            pipe.close()
    return code


def _listen(pipe: Any, number: int, said: queue.SimpleQueue[tuple[int, str]]) -> None:
    """Pass on what a process says, and an empty line when it has ended."""
    with contextlib.suppress(OSError, ValueError):
        for line in pipe:
            said.put((number, line))
    said.put((number, ""))


def _environment(threads: int) -> dict[str, str]:
    """This process's own, with sabench in reach, and fewer threads for whoever reads their number here."""
    limits = dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"),
        str(threads),
    )
    path = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
    return os.environ | limits | {"PYTHONPATH": path}


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Processes that are started here do not hear Ctrl-C, which a terminal sends to all: this one hears it and ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def dask_pool(address: str, root: Path) -> WorkerPool:
    """The workers of a Dask scheduler.

    Raises
    ------
    InputError
        Dask is not installed, or nobody answers at the address.
    """
    try:
        from sabench.simulation.recording.dask_workers import DaskPool
    except ImportError as error:
        raise InputError(
            f"scheduler: expected the package distributed, which pip install 'sabench[dask]' brings, got {error}"
        ) from error
    return DaskPool(address, root)
