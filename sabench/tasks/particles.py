"""The particles track: the frames of a film in, the particles of each of them out, with tracks if the algorithm makes some."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sabench.algorithms.particles.linking import link
from sabench.api import Film, FoundParticles, Observation, ParticleSolver
from sabench.api.truth import Particles
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.dataset.schema import CamerasFile, frame_group
from sabench.geometry.grid import synthesise
from sabench.metrics.averages import finite_or_none, mean_of_each, root_mean_square
from sabench.metrics.particle_detection import challenge_pairs, count_challenge
from sabench.metrics.trajectories import link_scores
from sabench.plotting import pictures
from sabench.tasks.solver_call import attempt
from sabench.utils import memory
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.errors import InputError
from sabench.utils.progress import track

_DRAWN_VOXELS = 1.0  # standard deviation of the balls of light that stand for particles in pictures


@dataclass
class _Reader:
    """Reads the frames of one film and counts the seconds that it takes, which are not the solver's."""

    data: Dataset
    frames: range
    seconds: float = field(default=0.0)

    def __call__(self, number: int) -> Observation:
        start = time.perf_counter()
        seen = self.data.observation(self.frames[number])
        self.seconds += time.perf_counter() - start
        return seen


def run(algorithm: ParticleSolver, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
    """Find the particles of every film; returns the seconds per frame of each, without the reading of images.

    Raises
    ------
    InputError
        A solver that declines, raises, or returns something else than particles of every frame.
    """
    seconds, every = [], []
    for frames in track(data.rig.sequences(), f"particles by {name}"):
        reader = _Reader(data, frames)
        film = Film(
            data.rig.cameras,
            data.rig.grid,
            tuple(data.rig.time_s(frame) for frame in frames),
            reader,
        )
        start = time.perf_counter()
        found = _attempt(algorithm, name, film, frames)
        seconds += [(time.perf_counter() - start - reader.seconds) / len(frames)] * len(frames)
        every += found
        memory.trim()
    for frame, (one, number) in enumerate(zip(every, _numbers(data.rig, every), strict=True)):
        writer.add_particles(frame, replace(one, track=number))
    return seconds


def _attempt(
    algorithm: ParticleSolver, name: str, film: Film, frames: range
) -> list[FoundParticles]:
    """One call of a solver; what it returns is checked here."""
    found: list[FoundParticles] = attempt(
        algorithm, name, film, list, f" on frames {frames[0]} to {frames[-1]}"
    )
    other = next((type(one).__name__ for one in found if not isinstance(one, FoundParticles)), "")
    if len(found) != len(frames) or other:
        raise InputError(
            f"solver {name}: expected FoundParticles for each of {len(frames)} frames, got {len(found)} of {other or 'them'}"
        )
    if len({one.track is None for one in found}) > 1:
        raise InputError(
            f"solver {name}: expected track numbers in every frame or in none, got them in some"
        )
    return found


def _numbers(rig: CamerasFile, found: Sequence[FoundParticles]) -> list[I64]:
    """Numbers (n,) of every frame's tracks: the solver's own, or those that `link` makes; none goes from one group of pulses to the next."""
    out: list[I64] = []
    for frames in rig.sequences():
        own = [number for frame in frames if (number := found[frame].track) is not None]
        places = [found[frame].position_mm for frame in frames]
        part = (
            own
            if len(own) == len(frames)
            else link(
                places,
                [np.ones(len(one)) for one in places],
                [rig.time_s(frame) for frame in frames],
            )
        )
        first = (
            max((int(one.max(initial=-1)) for one in out), default=-1)
            + 1
            - min((int(one.min(initial=0)) for one in part), default=0)
        )
        out.extend(first + one for one in part)
    return out


def copy(data: Dataset, result: Result, writer: ResultWriter) -> None:
    """Write the particles of every frame of a foreign result anew, with its tracks or those that `link` makes; reading checks it."""
    found = [result.particles(frame) for frame in range(data.rig.frames)]
    for frame, (one, number) in enumerate(zip(found, _tracks(data, result, found), strict=True)):
        writer.add_particles(frame, replace(one, track=number))


def score_result(data: Dataset, result: Result | str) -> dict[str, float | None]:
    """All scores: means over the frames, and the figures of tracks from all frames together."""
    found = [estimate(data, result, frame) for frame in range(data.rig.frames)]
    true = [data.particles(frame) for frame in range(data.rig.frames)]
    frames = [
        score_frame(data, guess, known)
        for guess, known in track(list(zip(found, true, strict=True)), "score")
    ]
    return mean_of_each(frames) | _over_time(data, result, found, true)


def estimate(data: Dataset, result: Result | str, frame: int) -> FoundParticles:
    """The estimate of a frame: a result's, or the one that the word `truth` or `empty` stands for."""
    if isinstance(result, Result):
        return result.particles(frame)
    if result == "truth":
        particles = data.particles(frame)
        return FoundParticles(particles.position_mm, None, particles.id.astype(np.int64))
    return FoundParticles(np.zeros((0, 3)), None, np.zeros(0, dtype=np.int64))


def score_frame(data: Dataset, guess: FoundParticles, known: Particles) -> dict[str, float | None]:
    """The figures of one frame's particles."""
    grid = data.rig.grid
    found, truths = grid.to_voxels(guess.position_mm), grid.to_voxels(known.position_mm)
    counts = count_challenge(found, truths, grid.in_scored(found), grid.in_scored(truths))
    i, j = _scored_pairs(found, truths, grid.in_scored(truths))
    whole = counts.precision + counts.recall
    return {
        "f1": 2.0 * counts.precision * counts.recall / whole if whole else 0.0,
        "precision": counts.precision,
        "recall": counts.recall,
        "ghost_percent": counts.ghost_percent,
        "rms_px": _apart_px(data, guess.position_mm[i], known.position_mm[j]),
        "rms_mm": finite_or_none(
            root_mean_square(np.linalg.norm(guess.position_mm[i] - known.position_mm[j], axis=1))
        ),
    }


def _scored_pairs(found: F64, truths: F64, scored: Bool) -> tuple[I64, I64]:
    """Rows of found and of true particles that belong together and whose truths lie in the scored part."""
    i, j = challenge_pairs(found, truths)
    return i[scored[j]], j[scored[j]]


def _apart_px(data: Dataset, found_mm: F64, true_mm: F64) -> float | None:
    """Root mean square distance of pairs of points in the true cameras' images."""
    apart = [
        np.linalg.norm(camera.project(found_mm)[0] - camera.project(true_mm)[0], axis=1)
        for camera in data.true_cameras
    ]
    return finite_or_none(root_mean_square(np.concatenate(apart)))


def _over_time(
    data: Dataset, result: Result | str, found: Sequence[FoundParticles], true: Sequence[Particles]
) -> dict[str, float | None]:
    """The figures of tracks, over what lies in the scored part or belongs to a particle that does."""
    grid, places, numbers, identities, truths, matched = data.rig.grid, [], [], [], [], []
    for guess, known, number in zip(found, true, _tracks(data, result, found), strict=True):
        there = grid.in_scored(grid.to_voxels(known.position_mm))
        i, j = _scored_pairs(
            grid.to_voxels(guess.position_mm), grid.to_voxels(known.position_mm), there
        )
        kept = grid.in_scored(grid.to_voxels(guess.position_mm))
        kept[i] = True
        places.append(guess.position_mm[kept])
        numbers.append(number[kept])
        truths.append(known.position_mm[there])
        identities.append(known.id[there])
        matched.append(((np.cumsum(kept) - 1)[i], (np.cumsum(there) - 1)[j]))
    times = [data.rig.time_s(frame) for frame in range(data.rig.frames)]
    scores = link_scores(places, numbers, truths, identities, matched, times, data.rig.sequences())
    return {key: finite_or_none(value) for key, value in scores.items()}


def _tracks(data: Dataset, result: Result | str, found: Sequence[FoundParticles]) -> list[I64]:
    """Numbers of the tracks of every frame's estimate: its own, or what linking makes of it.

    Raises
    ------
    InputError
        A result that has tracks in some frames only.
    """
    missing = [frame for frame, one in enumerate(found) if one.track is None]
    if missing and len(missing) < len(found):
        where = result.path if isinstance(result, Result) else result
        raise InputError(
            f"{where}: {frame_group(missing[0])}/particles/track: expected one in every frame or in none, found none here"
        )
    return _numbers(data.rig, found)


def images(data: Dataset) -> bytes:
    """What the cameras saw, as a PNG."""
    seen = data.observation(0)
    return pictures.montage(seen.images, seen.black_dn, seen.white_dn)


def picture(data: Dataset, result: Result | str) -> bytes:
    """The particles in a slice, drawn as balls of light, as a PNG."""
    grid, places = data.rig.grid, estimate(data, result, 0).position_mm
    volume = synthesise(grid, places, np.ones(len(places)), _DRAWN_VOXELS * grid.voxel_mm[0])
    return pictures.slice_picture(volume, grid.scored)
