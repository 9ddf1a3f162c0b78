"""Calls of solvers, on cases or image sequences, with checks of their answers."""

import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.api import ImageSequence, IterativeSolver, Observation, Reconstruction
from sabench.dataset.reader import Dataset
from sabench.utils.errors import DeclinedError, InputError


@dataclass
class SolverClock:
    """Run time of a solver in seconds, without compilation."""

    seconds: float = 0.0

    @contextmanager
    def running(self, name: str, where: str = "") -> Iterator[None]:
        """Measure a piece of a solver's work; what it raises becomes an InputError."""
        from sabench.utils.compiled import compile_s  # numba takes half a second to import

        start, compiled_s = time.perf_counter(), compile_s()
        try:
            yield
        except DeclinedError as error:
            raise DeclinedError(f"solver {name} declines this case: {error}") from error
        except InputError as error:
            raise InputError(f"solver {name}: {error}") from error
        except Exception as error:
            what = f"{type(error).__name__}: {error} ({_place_of(error)})"
            raise InputError(f"solver {name} failed{where}: {what}") from error
        took = time.perf_counter() - start - (compile_s() - compiled_s)
        self.seconds += max(took, 0.0)


def _place_of(error: Exception) -> str:
    """Name the innermost file and line, but of libraries, that raised."""
    frames = traceback.extract_tb(error.__traceback__)
    user_frames = [frame for frame in frames if not frame.filename.startswith(sys.prefix)]
    place = (user_frames or frames)[-1]
    return f"{Path(place.filename).name}, line {place.lineno}"


def call_iterations(
    algorithm: IterativeSolver,
    name: str,
    case: Observation,
    store: Callable[[int, float, Reconstruction], None],
) -> tuple[Reconstruction, float]:
    """Call an iterative solver, and store its estimates after some iterations.

    These are the iterations 1, 2, 3, 5, 8, ... The clock is stopped while an estimate is made and
    stored.

    Parameters
    ----------
    store : takes the number of the iteration, the seconds so far and the estimate.

    Returns and raises as `call_solver` does.
    """
    clock, number, due, following = SolverClock(), 0, 1, 2
    with clock.running(name):
        if reason := algorithm.skip(case):
            raise DeclinedError(reason)
        steps = algorithm.iterations(case)
    make: Callable[[], Reconstruction] | None = None
    while True:
        with clock.running(name):
            latest = next(steps, None)
        if latest is None:
            break
        number, make = number + 1, latest
        if number == due:
            store(number, clock.seconds, _run_make(make, name, SolverClock()))
            due, following = following, due + following
    if make is None:
        raise InputError(f"solver {name}: expected an iteration at least, got none")
    return _run_make(make, name, clock), clock.seconds


def _run_make(make: Callable[[], Reconstruction], name: str, clock: SolverClock) -> Reconstruction:
    with clock.running(name):
        estimate = make()
    if not isinstance(estimate, Reconstruction):
        raise InputError(f"solver {name}: expected Reconstruction, got {type(estimate).__name__}")
    return estimate


def call_solver(
    algorithm: Any, name: str, case: Any, expected: type[Any], where: str = ""
) -> tuple[Any, float]:
    """Call a solver, which may raise anything, on a case.

    `where` is added to the messages of failures, as in " on frame 0".

    Returns
    -------
    Its answer, and the seconds that it took without those of compiling its kernels.

    Raises InputError for a solver that declines, raises, or returns something else than an
    `expected`.
    """
    clock = SolverClock()
    with clock.running(name, where):
        if reason := algorithm.skip(case):
            raise DeclinedError(reason)
        answer = algorithm.solve(case)
    if not isinstance(answer, expected):
        sentence = f"solver {name}: expected {expected.__name__}, got {type(answer).__name__}"
        raise InputError(sentence)
    return answer, clock.seconds


@dataclass
class FrameReader:
    """Reader of one sequence's frames, which measures the seconds of reading.

    They are not part of the solver's time.
    """

    data: Dataset
    frames: range
    seconds: float = 0.0

    def __call__(self, number: int) -> Observation:
        """Read a frame of the sequence, counted from its first."""
        start = time.perf_counter()
        observation = self.data.observation(self.frames[number])
        self.seconds += time.perf_counter() - start
        return observation


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

    Raises InputError for any error of the solver; something else than an `expected` for every
    frame.
    """
    every = f"frames {frames[0]} to {frames[-1]}" if len(frames) > 1 else f"frame {frames[0]}"
    where = f" on {every}"
    answer, took = call_solver(algorithm, name, sequence, Iterable, where)
    clock.seconds += took
    answers, count = iter(answer), 0
    while True:
        with clock.running(name, where):
            estimate = next(answers, None)
        if estimate is None and count == len(frames):
            return
        if count == len(frames) or not isinstance(estimate, expected):
            raise InputError(_not_each(name, expected, len(frames), count, estimate))
        count += 1
        yield estimate


def _not_each(name: str, expected: type[Any], frames: int, count: int, answer: object) -> str:
    got = f"{count} of them"
    if count == frames:
        got = "more"
    elif answer is not None:
        got = f"a {type(answer).__name__} for one"
    return f"solver {name}: expected {expected.__name__} for each of {frames} frames, got {got}"
