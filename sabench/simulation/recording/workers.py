"""Workers of a recording.

This process, several on this machine, or those of a Dask cluster.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path

from sabench.simulation.recording.schedule import TRIES, Outcome, Schedule, Task, WorkerPool
from sabench.utils.errors import InputError
from sabench.utils.processes.python import Servers
from sabench.utils.progress import bar


def run_schedule(
    pool: WorkerPool, schedule: Schedule, doing: str, name: Callable[[Task], str] = str
) -> None:
    """Have workers do all tasks of a schedule; `name` names one that failed.

    Raises
    ------
    UnfinishedError
        Some tasks failed `TRIES` times; all others have been done, and their results are kept.
    """
    last: dict[Hashable, int] = {}
    with bar(doing, schedule.tasks) as advance:
        while not schedule.finished:
            _give_tasks(pool, schedule, last)
            for outcome in pool.wait():
                if outcome.failure is None:
                    schedule.complete(outcome.task)
                    advance()
                else:
                    schedule.fail(outcome.task, outcome.failure)
    if schedule.failures:
        raise UnfinishedError(f"{doing}: {_describe_failures(schedule, name)}")


def _give_tasks(pool: WorkerPool, schedule: Schedule, last: dict[Hashable, int]) -> None:
    for worker in pool.idle():
        task = schedule.take(last.get(worker))
        if task is None:
            return
        last[worker] = task.frame
        pool.give(worker, task)


def _describe_failures(schedule: Schedule, name: Callable[[Task], str]) -> str:
    (task, why), *others = schedule.failures
    more = f", and {len(others)} more" if others else ""
    return (
        f"{name(task)} failed {TRIES} times{more}: {why}; "
        "finished tasks are kept: run the same command again to resume"
    )


class UnfinishedError(InputError):
    """Failure of some tasks; the results of the others are kept."""


class InProcess:
    """Pool whose only worker is this process."""

    ahead = 1

    def __init__(self, do: Callable[[Task], None]) -> None:
        self._do = do
        self._ended: list[Outcome] = []

    def idle(self) -> Sequence[Hashable]:
        """Return this process, unless the outcome of its task has not been fetched yet."""
        return () if self._ended else (0,)

    def give(self, worker: Hashable, task: Task) -> None:
        """Do the task."""
        self._do(task)
        self._ended.append(Outcome(worker, task))

    def wait(self) -> list[Outcome]:
        """Return the task that was done."""
        ended, self._ended = self._ended, []
        return ended

    def close(self) -> None:
        """Do nothing."""


class ProcessPool:
    """Processes on this machine that share its cores; one that dies is replaced.

    Parameters
    ----------
    root : folder of the job.
    jobs : number of processes.
    threads : of each process; None: an equal share of the cores.
    """

    def __init__(self, root: Path, jobs: int, threads: int | None = None) -> None:
        threads = threads or max(1, (os.cpu_count() or 1) // jobs)
        program = ["-m", "sabench.simulation.recording.worker", str(root), str(threads)]
        self._servers = Servers(program, jobs, threads)
        self._busy: dict[Hashable, Task] = {}
        self.ahead = jobs + 1  # a frame for each, and one for the first that is done

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers."""
        return self._servers.pids

    def idle(self) -> Sequence[Hashable]:
        """Return the processes without a task, after replacing those that died."""
        return [number for number in self._servers.running() if number not in self._busy]

    def give(self, worker: Hashable, task: Task) -> None:
        """Send a process its next task."""
        assert isinstance(worker, int)
        self._busy[worker] = task
        self._servers.request(worker, [task.frame, task.camera])

    def wait(self) -> list[Outcome]:
        """Wait for the next answer or death of a process."""
        reply = self._servers.receive()
        task = self._busy.pop(reply.number, None)
        if task is None:  # it died idle
            return []
        if reply.end is not None:
            return [Outcome(reply.number, task, f"its process ended with {reply.end}")]
        kind, why = reply.value
        if kind == "input":
            raise InputError(why)
        if kind == "system":
            raise OSError(why)
        return [Outcome(reply.number, task, why)]

    def close(self) -> None:
        """Kill all processes; they leave no half-written file."""
        self._servers.close()


def dask_pool(address: str, root: Path) -> WorkerPool:
    """Connect to the workers of a Dask scheduler.

    Raises
    ------
    InputError
        Dask is not installed, or there is no scheduler at the address.
    """
    try:
        from sabench.simulation.recording.dask_workers import DaskPool
    except ImportError as error:
        raise InputError(
            f"scheduler: expected the package distributed, got {error}: "
            "run pip install 'sabench[dask]'"
        ) from error
    return DaskPool(address, root)
