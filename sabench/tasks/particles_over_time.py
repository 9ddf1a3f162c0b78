"""Trajectories of particles in image sequences, and their scores."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.algorithms.particles import link
from sabench.api import FoundParticles, ImageSequence
from sabench.api.truth import Particles
from sabench.dataset.cameras import CamerasFile
from sabench.dataset.reader import Dataset
from sabench.geometry.grid import Grid
from sabench.metrics.averages import finite_or_none
from sabench.metrics.particle_detection import CHALLENGE_RADIUS, challenge_pairs
from sabench.metrics.trajectories import (
    Sightings,
    accelerations,
    claimed_errors,
    identity_scores,
    link_scores,
    median_errors,
)
from sabench.tasks.solver_call import SolverClock, answers_of_frames
from sabench.tasks.task import Figures
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError


def find_in_each_frame(
    algorithm: Any, name: str, sequence: ImageSequence, frames: range, clock: SolverClock
) -> Iterator[FoundParticles]:
    """Call a solver on a sequence, and yield each frame's particles.

    The clock runs while the solver does.

    Raises InputError for any error of the solver; something else than `FoundParticles` of every
    frame; trajectories in some of them only.
    """
    linked = None
    for particles in answers_of_frames(algorithm, name, sequence, frames, FoundParticles, clock):
        linked = particles.trajectory is not None if linked is None else linked
        if linked != (particles.trajectory is not None):
            raise InputError(
                f"solver {name}: expected trajectories in every frame or in none, got them in some"
            )
        yield particles


class TrajectoryNumbers:
    """Numbers of trajectories from 0, in order of appearance.

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
            self._known.setdefault(number, self._first + len(self._known))
            for number in np.asarray(one.trajectory).tolist()
        ]
        return replace(one, trajectory=np.array(numbers, dtype=np.int64))


def link_sequence(
    found: Sequence[FoundParticles], times_s: Sequence[float]
) -> list[FoundParticles]:
    """Link the particles of a sequence's frames, which have no trajectories."""
    if not found:
        return []
    positions = [frame.position_mm for frame in found]
    numbers = link(positions, [np.ones(len(points)) for points in positions], list(times_s))
    return [replace(frame, trajectory=ids) for frame, ids in zip(found, numbers, strict=True)]


def link_frames(setup: CamerasFile, found: Sequence[FoundParticles]) -> list[FoundParticles]:
    """Assign trajectory numbers to every frame's particles.

    The numbers are the solver's own, or come from linking. No trajectory leads from one group of
    pulses to the next.
    """
    numbers, out = TrajectoryNumbers(), list[FoundParticles]()
    for frames in setup.sequences():
        part = [found[frame] for frame in frames]
        if any(particles.trajectory is None for particles in part):
            part = link_sequence(part, [setup.time_s(frame) for frame in frames])
        out += [numbers.assign(particles) for particles in part]
        numbers.begin_sequence()
    return out


def score_over_time(
    data: Dataset, found: Sequence[FoundParticles], truth: Sequence[Particles]
) -> Figures:
    """Score trajectories.

    Only particles in the scored part count, and those matched to a true particle there.
    """
    grid, times = data.setup.grid, [data.setup.time_s(n) for n in range(data.setup.frames)]
    parts = [_scored_part(grid, answer, true) for answer, true in zip(found, truth, strict=True)]
    sequences = data.setup.sequences()
    linked = (
        [part.found.position_mm for part in parts],
        [np.asarray(part.found.trajectory) for part in parts],
        [part.true.position_mm for part in parts],
        [part.true.id for part in parts],
        [part.pairs for part in parts],
    )
    scores = link_scores(*linked, times, sequences)
    sightings = [[_sighting(grid, parts[n]) for n in frames] for frames in sequences]
    scores |= identity_scores(sightings) | _motion_scores(parts, times, sequences)
    return {key: finite_or_none(value) for key, value in scores.items()}


@dataclass(frozen=True)
class _ScoredPart:
    """Scored particles of a frame, found and true, and rows that form pairs."""

    found: FoundParticles
    true: Particles
    pairs: tuple[I64, I64]


def _scored_part(grid: Grid, estimate: FoundParticles, true: Particles) -> _ScoredPart:
    """Select those in the scored part, and those paired with a true one there."""
    inner = grid.in_scored(grid.to_voxels(true.position_mm))
    voxels = grid.to_voxels(estimate.position_mm)
    i, j = challenge_pairs(voxels, grid.to_voxels(true.position_mm))
    i, j = i[inner[j]], j[inner[j]]
    counted = grid.in_scored(voxels)
    counted[i] = True
    pairs = (np.cumsum(counted) - 1)[i], (np.cumsum(inner) - 1)[j]
    return _ScoredPart(estimate.rows(counted), true.rows(inner), pairs)


def _sighting(grid: Grid, part: _ScoredPart) -> Sightings:
    (i, j), numbers = part.pairs, np.asarray(part.found.trajectory)
    apart = grid.to_voxels(part.found.position_mm[i]) - grid.to_voxels(part.true.position_mm[j])
    near = np.abs(apart).max(axis=1, initial=0.0) / CHALLENGE_RADIUS
    return Sightings(numbers, part.true.id, part.pairs, near)


def _motion_scores(
    parts: Sequence[_ScoredPart], times: Sequence[float], sequences: Sequence[range]
) -> dict[str, float]:
    """Score accelerations, and velocities if the result has them."""
    claimed = [part.found.velocity_mm_s for part in parts]
    scores = {}
    if all(velocity is not None for velocity in claimed):
        pairs = [
            (np.asarray(velocity)[part.pairs[0]], part.true.velocity_mm_s[part.pairs[1]])
            for velocity, part in zip(claimed, parts, strict=True)
        ]
        off, percent = median_errors(*claimed_errors(pairs))
        scores = {"velocity_mm_s": off, "velocity_percent": percent}
    threes = [frames[k : k + 3] for frames in sequences for k in range(len(frames) - 2)]
    pairs = [
        _accelerations_of([parts[n] for n in three], times[three[1]] - times[three[0]])
        for three in threes
        if np.isclose(times[three[1]] - times[three[0]], times[three[2]] - times[three[1]])
    ]
    return scores | {"acceleration_percent": median_errors(*claimed_errors(pairs))[1]}


def _accelerations_of(parts: Sequence[_ScoredPart], duration: float) -> tuple[F64, F64]:
    """Pair estimated and true accelerations in the middle one of three frames."""
    middle = parts[1]
    rows, true = accelerations([(part.true.id, part.true.position_mm) for part in parts], duration)
    i, j = middle.pairs
    if middle.found.acceleration_mm_s2 is not None:
        ids, estimate = np.arange(len(middle.found.position_mm)), middle.found.acceleration_mm_s2
    else:
        ids, estimate = accelerations(
            [(np.asarray(part.found.trajectory), part.found.position_mm) for part in parts],
            duration,
        )
    _, a, k = np.intersect1d(ids, i, return_indices=True)
    _, b, m = np.intersect1d(rows, j[k], return_indices=True)
    return estimate[a[m]], true[b]
