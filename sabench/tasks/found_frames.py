"""Particles that a solver finds frame after frame, and their trajectories."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.algorithms.particles import link
from sabench.api import FoundParticles, ImageSequence
from sabench.dataset.camera_files import CamerasFile
from sabench.tasks.solver_call import SolverClock, call_solver
from sabench.utils.errors import InputError


def find_in_each_frame(
    algorithm: Any, name: str, sequence: ImageSequence, frames: range, clock: SolverClock
) -> Iterator[FoundParticles]:
    """Call a solver on a sequence, and yield each frame's particles.

    The clock runs while the solver does.

    Raises
    ------
    InputError
        Whatever the solver raises; something else than `FoundParticles` of every frame;
        trajectories in some of them only.
    """
    where = f" on frames {frames[0]} to {frames[-1]}"
    answer, took = call_solver(algorithm, name, sequence, Iterable, where)
    clock.seconds += took
    found, count, linked = iter(answer), 0, None
    while True:
        with clock.running(name, where):
            one = next(found, None)
        if one is None and count == len(frames):
            return
        if count == len(frames) or not isinstance(one, FoundParticles):
            raise InputError(_not_each(name, len(frames), count, one))
        linked = one.trajectory is not None if linked is None else linked
        if linked != (one.trajectory is not None):
            raise InputError(
                f"solver {name}: expected trajectories in every frame or in none, got them in some"
            )
        count += 1
        yield one


def _not_each(name: str, frames: int, count: int, one: object) -> str:
    got = f"{count} of them"
    if count == frames:
        got = "more"
    elif one is not None:
        got = f"a {type(one).__name__} for one"
    return f"solver {name}: expected FoundParticles for each of {frames} frames, got {got}"


class TrajectoryNumbers:
    """Numbers of trajectories from 0 on, in the order in which they appear.

    A solver's own may be any integers. No trajectory leads from one sequence to the next.
    """

    def __init__(self) -> None:
        self._first = 0
        self._known: dict[int, int] = {}

    def begin_sequence(self) -> None:
        """Give the same numbers of the solver other ones from now on."""
        self._first, self._known = self._first + len(self._known), {}

    def assign(self, one: FoundParticles) -> FoundParticles:
        """Replace the numbers of a frame's trajectories."""
        numbers = [
            self._known.setdefault(own, self._first + len(self._known))
            for own in np.asarray(one.trajectory).tolist()
        ]
        return replace(one, trajectory=np.array(numbers, dtype=np.int64))


def link_sequence(
    found: Sequence[FoundParticles], times_s: Sequence[float]
) -> list[FoundParticles]:
    """Link the particles of a sequence's frames, which have no trajectories."""
    if not found:
        return []
    positions = [one.position_mm for one in found]
    numbers = link(positions, [np.ones(len(one)) for one in positions], list(times_s))
    return [replace(one, trajectory=own) for one, own in zip(found, numbers, strict=True)]


def link_frames(setup: CamerasFile, found: Sequence[FoundParticles]) -> list[FoundParticles]:
    """Assign trajectory numbers to every frame's particles.

    The numbers are the solver's own, or come from linking. No trajectory leads from one group of
    pulses to the next.
    """
    numbers, out = TrajectoryNumbers(), list[FoundParticles]()
    for frames in setup.sequences():
        part = [found[frame] for frame in frames]
        if any(one.trajectory is None for one in part):
            part = link_sequence(part, [setup.time_s(frame) for frame in frames])
        out += [numbers.assign(one) for one in part]
        numbers.begin_sequence()
    return out
