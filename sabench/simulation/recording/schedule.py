"""Which task comes next: a frame's truth first, then each of its cameras, and who has a frame at hand goes on with it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

TRIES = 3


@dataclass(frozen=True)
class Task:
    """A frame's truth, or what one camera, counted from 0, records of it."""

    frame: int
    camera: int | None = None

    def __str__(self) -> str:
        return f"frame {self.frame}" + ("" if self.camera is None else f", camera {self.camera}")


@dataclass
class _Open:
    """A frame that has been begun: its cameras' tasks are there once its truth is."""

    made: bool = False
    given: bool = False
    touched: bool = False
    left: int = 0
    views: deque[Task] = field(default_factory=deque)


class Plan:
    """The tasks of a recording; memory does not grow with the number of frames.

    Parameters
    ----------
    frames, cameras : how many there are.
    chained : whether a frame's truth can only be made after the one before it.
    ahead : how many frames may be begun at a time.
    """

    def __init__(self, frames: int, cameras: int, *, chained: bool, ahead: int) -> None:
        self._frames, self._cameras, self._chained, self._ahead = frames, cameras, chained, ahead
        self.tasks = frames * (1 + cameras)
        self._next, self._reached, self._broken = 0, -1, False
        self._open: dict[int, _Open] = {}
        self._tries: dict[Task, int] = {}
        self.failures: list[tuple[Task, str]] = []

    @property
    def finished(self) -> bool:
        """Whether nothing is left, or nothing can be done any more."""
        return not self._open and (self._next == self._frames or self._broken)

    def take(self, last: int | None) -> Task | None:
        """A task for one whose last task was of frame `last`; None if all wait for others."""
        self._begin()
        own = self._open.get(last) if last is not None else None
        if own is not None and own.views:
            return self._view(own)
        return self._truth() or self._untouched() or self._help()

    def done(self, task: Task) -> None:
        """A task has been done."""
        self._tries.pop(task, None)
        state = self._open[task.frame]
        if task.camera is None:
            state.made, state.left, self._reached = (
                True,
                self._cameras,
                max(self._reached, task.frame),
            )
            state.views.extend(Task(task.frame, camera) for camera in range(self._cameras))
        else:
            state.left -= 1
        if not state.left:
            del self._open[task.frame]

    def failed(self, task: Task, why: str) -> None:
        """A task has failed: it is given out again, and after `TRIES` times is a failure."""
        tries = self._tries[task] = self._tries.get(task, 0) + 1
        if tries < TRIES:
            self._again(task)
            return
        self.failures.append((task, why))
        if task.camera is not None:
            self.done(task)
            return
        del self._tries[task], self._open[task.frame]
        if self._chained:  # what comes later stands on it
            self._broken = True
            self._open = {number: state for number, state in self._open.items() if state.made}

    def _again(self, task: Task) -> None:
        state = self._open[task.frame]
        if task.camera is None:
            state.given = False
        else:
            state.views.appendleft(task)

    def _begin(self) -> None:
        while len(self._open) < self._ahead and self._next < self._frames and not self._broken:
            self._open[self._next] = _Open()
            self._next += 1

    def _truth(self) -> Task | None:
        for number, state in self._open.items():
            if not state.given and (not self._chained or number <= self._reached + 1):
                state.given = True
                return Task(number)
        return None

    def _untouched(self) -> Task | None:
        """A camera of a frame that nobody is at."""
        return next(
            (
                self._view(state)
                for state in self._open.values()
                if state.views and not state.touched
            ),
            None,
        )

    def _help(self) -> Task | None:
        """A camera of the frame that has most left."""
        most = max(self._open.values(), key=lambda state: len(state.views), default=None)
        return self._view(most) if most is not None and most.views else None

    def _view(self, state: _Open) -> Task:
        state.touched = True
        return state.views.popleft()
