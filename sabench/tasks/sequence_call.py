"""Calls of solvers on image sequences, with checks of their answers."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from sabench.api import ImageSequence, Observation
from sabench.dataset.reader import Dataset
from sabench.tasks.solver_call import SolverClock, call_solver
from sabench.utils.errors import InputError


@dataclass
class FrameReader:
    """Reader of one sequence's frames, which measures the seconds of reading.

    They are not part of the solver's time.
    """

    data: Dataset
    frames: range
    seconds: float = field(default=0.0)

    def __call__(self, number: int) -> Observation:
        """Read a frame of the sequence, counted from its first."""
        start = time.perf_counter()
        seen = self.data.observation(self.frames[number])
        self.seconds += time.perf_counter() - start
        return seen


def image_sequence(data: Dataset, frames: range) -> tuple[ImageSequence, FrameReader]:
    """Make a sequence of some frames of a data set, and the clock of its reading."""
    reader = FrameReader(data, frames)
    times = tuple(data.setup.time_s(frame) for frame in frames)
    return ImageSequence(data.setup.cameras, data.setup.grid, times, reader), reader


def answers_of_frames(
    algorithm: Any,
    name: str,
    sequence: ImageSequence,
    frames: range,
    expected: type[Any],
    clock: SolverClock,
) -> Iterator[Any]:
    """Call a solver on a sequence, and yield its answer to each frame.

    The clock runs while the solver does.

    Raises
    ------
    InputError
        Whatever the solver raises; something else than an `expected` for every frame.
    """
    every = f"frames {frames[0]} to {frames[-1]}" if len(frames) > 1 else f"frame {frames[0]}"
    where = f" on {every}"
    answer, took = call_solver(algorithm, name, sequence, Iterable, where)
    clock.seconds += took
    found, count = iter(answer), 0
    while True:
        with clock.running(name, where):
            one = next(found, None)
        if one is None and count == len(frames):
            return
        if count == len(frames) or not isinstance(one, expected):
            raise InputError(_not_each(name, expected, len(frames), count, one))
        count += 1
        yield one


def _not_each(name: str, expected: type[Any], frames: int, count: int, one: object) -> str:
    got = f"{count} of them"
    if count == frames:
        got = "more"
    elif one is not None:
        got = f"a {type(one).__name__} for one"
    return f"solver {name}: expected {expected.__name__} for each of {frames} frames, got {got}"
