"""Order of a recording's tasks, and the workers that do them.

The truth of a frame comes first, then each of its cameras. A worker stays with its last frame as
long as that frame has cameras left, because it holds that frame in memory. Workers are this
process, several on this machine, or those of a Dask cluster.
"""

import os
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from sabench.utils.errors import InputError
from sabench.utils.processes.python import Servers
from sabench.utils.progress import bar

TRIES = 3


@dataclass(frozen=True)
class RecordingTask:
    """One frame's truth, or what one camera, counted from 0, records of it."""

    frame: int
    camera: int | None = None

    def __str__(self) -> str:
        """Name the frame and the camera."""
        return f"frame {self.frame}" + ("" if self.camera is None else f", camera {self.camera}")


@dataclass(frozen=True)
class Outcome:
    """End of a worker's task; `failure` is the reason of a failed one."""

    worker: Hashable
    task: RecordingTask
    failure: str | None = None


class WorkerPool(Protocol):
    """Workers that do one task at a time each."""

    @property
    def ahead(self) -> int:
        """Number of frames that may be in progress simultaneously."""

    def idle(self) -> Sequence[Hashable]:
        """Return the workers without a task."""

    def give(self, worker: Hashable, task: RecordingTask) -> None:
        """Give an idle worker a task."""

    def wait(self) -> list[Outcome]:
        """Wait for something to happen, and return the tasks that have ended.

        Raises InputError, OSError for failures that another try would not change.
        """

    def close(self) -> None:
        """Stop the workers."""


@dataclass
class _Frame:
    """Frame in progress, whose cameras' tasks are queued once its truth exists."""

    made: bool = False
    given: bool = False
    touched: bool = False
    left: int = 0
    views: deque[RecordingTask] = field(default_factory=deque)


class Schedule:
    """Tasks of a recording; memory does not grow with the number of frames.

    Parameters
    ----------
    frames, cameras : number of frames, and of cameras in each.
    chained : whether each frame's truth is computed from the previous frame's.
    ahead : number of frames that may be in progress simultaneously.
    """

    def __init__(self, frames: int, cameras: int, *, chained: bool, ahead: int) -> None:
        self._frames, self._cameras, self._chained, self._ahead = frames, cameras, chained, ahead
        self.tasks = frames * (1 + cameras)
        self._next, self._reached, self._broken = 0, -1, False
        self._open: dict[int, _Frame] = {}
        self._tries: dict[RecordingTask, int] = {}
        self.failures: list[tuple[RecordingTask, str]] = []

    @property
    def finished(self) -> bool:
        """True if no task is left that can still be done."""
        return not self._open and (self._next == self._frames or self._broken)

    def take(self, last: int | None) -> RecordingTask | None:
        """Return a task for a worker after frame `last`; None if it has to wait."""
        while len(self._open) < self._ahead and self._next < self._frames and not self._broken:
            self._open[self._next] = _Frame()
            self._next += 1
        own = self._open.get(last) if last is not None else None
        if own is not None and own.views:
            return self._view(own)
        for number, frame in self._open.items():
            if not frame.given and (not self._chained or number <= self._reached + 1):
                frame.given = True
                return RecordingTask(number)
        # then a frame that no worker has recorded from yet, or the one with the most cameras left
        waiting = [frame for frame in self._open.values() if frame.views]
        chosen = next((frame for frame in waiting if not frame.touched), None) or max(
            waiting, key=lambda frame: len(frame.views), default=None
        )
        return self._view(chosen) if chosen is not None else None

    def complete(self, task: RecordingTask) -> None:
        """Note that a task has been done."""
        self._tries.pop(task, None)
        frame = self._open[task.frame]
        if task.camera is None:
            frame.made = True
            frame.left = self._cameras
            frame.views.extend(RecordingTask(task.frame, camera) for camera in range(self._cameras))
            self._reached = max(self._reached, task.frame)
        else:
            frame.left -= 1
        if not frame.left:
            del self._open[task.frame]

    def fail(self, task: RecordingTask, why: str) -> None:
        """Note that a task has failed; it is given up after `TRIES` attempts."""
        tries = self._tries[task] = self._tries.get(task, 0) + 1
        if tries < TRIES:
            frame = self._open[task.frame]
            if task.camera is None:
                frame.given = False
            else:
                frame.views.appendleft(task)
            return
        self.failures.append((task, why))
        if task.camera is not None:
            self.complete(task)
            return
        del self._tries[task], self._open[task.frame]
        if self._chained:  # later frames are computed from this one
            self._broken = True
            self._open = {number: frame for number, frame in self._open.items() if frame.made}

    def _view(self, frame: _Frame) -> RecordingTask:
        frame.touched = True
        return frame.views.popleft()


def run_schedule(
    pool: WorkerPool, schedule: Schedule, doing: str, name: Callable[[RecordingTask], str] = str
) -> None:
    """Have workers do all tasks of a schedule; `name` names one that failed.

    Raises UnfinishedError: some tasks failed `TRIES` times; all others have been done, and their
    results are kept.
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
        (task, why), *others = schedule.failures
        more = f", and {len(others)} more" if others else ""
        raise UnfinishedError(
            f"{doing}: {name(task)} failed {TRIES} times{more}: {why}; "
            "finished tasks are kept: run the same command again to resume"
        )


class UnfinishedError(InputError):
    """Failure of some tasks; the results of the others are kept."""


class InProcess:
    """Pool with this process as its only worker."""

    ahead = 1

    def __init__(self, do: Callable[[RecordingTask], None]) -> None:
        self._do = do
        self._ended: list[Outcome] = []

    def idle(self) -> Sequence[Hashable]:
        """Return this process, unless the outcome of its task has not been fetched yet."""
        return () if self._ended else (0,)

    def give(self, worker: Hashable, task: RecordingTask) -> None:
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
        self._busy: dict[Hashable, RecordingTask] = {}
        self.ahead = jobs + 1  # a frame for each, and one for the first that is done

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers."""
        return self._servers.pids

    def idle(self) -> Sequence[Hashable]:
        """Return the processes without a task, after replacing those that died."""
        return [number for number in self._servers.running() if number not in self._busy]

    def give(self, worker: Hashable, task: RecordingTask) -> None:
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
