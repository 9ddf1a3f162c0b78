"""Order of a recording's tasks, and the interface of the workers that do them.

The truth of a frame comes first, then each of its cameras. A worker stays with its last frame as
long as that frame has cameras left, because it holds that frame in memory.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

TRIES = 3


@dataclass(frozen=True)
class Task:
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
    task: Task
    failure: str | None = None


class WorkerPool(Protocol):
    """Workers that do one task at a time each."""

    @property
    def ahead(self) -> int:
        """Number of frames that may be in progress simultaneously."""

    def idle(self) -> Sequence[Hashable]:
        """Return the workers without a task."""

    def give(self, worker: Hashable, task: Task) -> None:
        """Give an idle worker a task."""

    def wait(self) -> list[Outcome]:
        """Wait for something to happen, and return the tasks that have ended.

        Raises
        ------
        InputError, OSError
            Failures that another try would not change.
        """

    def close(self) -> None:
        """Stop the workers."""


@dataclass
class _Frame:
    """State of a frame in progress.

    Its cameras' tasks are queued once its truth exists.
    """

    made: bool = False
    given: bool = False
    touched: bool = False
    left: int = 0
    views: deque[Task] = field(default_factory=deque)


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
        self._tries: dict[Task, int] = {}
        self.failures: list[tuple[Task, str]] = []

    @property
    def finished(self) -> bool:
        """True if no task is left that can still be done."""
        return not self._open and (self._next == self._frames or self._broken)

    def take(self, last: int | None) -> Task | None:
        """Return a task for a worker whose last frame was `last`; None if it has to wait."""
        self._begin()
        own = self._open.get(last) if last is not None else None
        if own is not None and own.views:
            return self._view(own)
        return self._truth() or self._take_untouched() or self._help()

    def complete(self, task: Task) -> None:
        """Note that a task has been done."""
        self._tries.pop(task, None)
        frame = self._open[task.frame]
        if task.camera is None:
            frame.made = True
            frame.left = self._cameras
            frame.views.extend(Task(task.frame, camera) for camera in range(self._cameras))
            self._reached = max(self._reached, task.frame)
        else:
            frame.left -= 1
        if not frame.left:
            del self._open[task.frame]

    def fail(self, task: Task, why: str) -> None:
        """Note that a task has failed.

        It is retried, and given up after `TRIES` attempts.
        """
        tries = self._tries[task] = self._tries.get(task, 0) + 1
        if tries < TRIES:
            self._retry(task)
            return
        self.failures.append((task, why))
        if task.camera is not None:
            self.complete(task)
            return
        del self._tries[task], self._open[task.frame]
        if self._chained:  # later frames are computed from this one
            self._broken = True
            self._open = {number: frame for number, frame in self._open.items() if frame.made}

    def _retry(self, task: Task) -> None:
        frame = self._open[task.frame]
        if task.camera is None:
            frame.given = False
        else:
            frame.views.appendleft(task)

    def _begin(self) -> None:
        while len(self._open) < self._ahead and self._next < self._frames and not self._broken:
            self._open[self._next] = _Frame()
            self._next += 1

    def _truth(self) -> Task | None:
        for number, frame in self._open.items():
            if not frame.given and (not self._chained or number <= self._reached + 1):
                frame.given = True
                return Task(number)
        return None

    def _take_untouched(self) -> Task | None:
        """Take a camera of a frame that no worker has recorded from yet."""
        for frame in self._open.values():
            if frame.views and not frame.touched:
                return self._view(frame)
        return None

    def _help(self) -> Task | None:
        """Take a camera of the frame with the most cameras left."""
        most = max(self._open.values(), key=lambda frame: len(frame.views), default=None)
        return self._view(most) if most is not None and most.views else None

    def _view(self, frame: _Frame) -> Task:
        frame.touched = True
        return frame.views.popleft()
