"""Particles that a solver finds frame after frame, and their trajectories."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.algorithms.particles import link
from sabench.api import FoundParticles, ImageSequence
from sabench.dataset.cameras import CamerasFile
from sabench.tasks.sequence_call import answers_of_frames
from sabench.tasks.solver_call import SolverClock
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
    linked = None
    for one in answers_of_frames(algorithm, name, sequence, frames, FoundParticles, clock):
        linked = one.trajectory is not None if linked is None else linked
        if linked != (one.trajectory is not None):
            raise InputError(
                f"solver {name}: expected trajectories in every frame or in none, got them in some"
            )
        yield one


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
