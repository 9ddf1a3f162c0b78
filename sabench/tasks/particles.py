"""Task `particles`: solvers find the particles of every frame of a sequence.

They may link them, too.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sabench.api import FoundParticles, ImageSequence
from sabench.api.truth import Particles
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.dataset.schema import frame_group
from sabench.geometry.grid import synthesise
from sabench.metrics import particle_detection
from sabench.metrics.averages import finite_or_none, mean_of_each, root_mean_square
from sabench.metrics.particle_bounds import brier_score, coverage, rms_over_bound
from sabench.plotting import pictures
from sabench.plotting.kinds import DEFINITION, DUPLICATE, FOUND, GHOST
from sabench.tasks import particles_over_time
from sabench.tasks.reconstruction import PARTICLE_IMAGES, with_bar
from sabench.tasks.solver_call import SolverClock, image_sequence
from sabench.tasks.task import (
    AGREEING,
    ANY,
    Captions,
    Figures,
    Gate,
    MatchingCurve,
    Score,
    Source,
    Task,
    check_number,
    check_tracks,
    share,
    share_near,
)
from sabench.utils import memory
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.progress import progress_bar

_NEAR_VOXELS = 0.2  # distance of a particle found with the cameras in another order
_TOLERANCE = MatchingCurve("f1", "F1", "voxel", particle_detection.MATCHING_DISTANCES)


class ParticlesTask(Task):
    """Detection and tracking of particles."""

    name = "particles"
    shown = "particles"
    estimate = FoundParticles
    # fmt: off
    scores = (
        share("f1", 3, "harmonic mean of precision and recall", heading="F1"),
        share("precision", 3, "share of the detections that are true, closer than 1 voxel along "
              "every axis, one to one"),
        share("recall", 3, "share of the true particles that were found"),
        Score("ghost_percent", "smaller", 1,
              "ghosts, duplicates included, relative to the particles found", counted=True),
        Score("rms_px", "smaller", 3, "root mean square distance of found from true particles in "
              "the images, over cameras and pairs"),
        Score("rms_mm", "smaller", 4, "root mean square distance between them in space"),
        share("f1_area", 3, "mean of F1 over matching distances of .1, .2 ... 1 voxel",
              heading="F1 area", hidden=True),
        Score("duplicate_percent", "smaller", 2,
              "further detections closer than 1 voxel to a particle that was found, relative to "
              "the particles found; they are ghosts, too", counted=True, hidden=True),
        Score("rms_over_bound", "smaller", 2, "root mean square distance in space over the "
              "Cramer-Rao bound of each particle in its images, with noise and neighbours; 1 at "
              "the bound", heading="rms / bound", hidden=True),
        Score("coverage_68", "unity", 2, "share of the found particles whose distance is within "
              "the claimed 68 % ellipsoid, over .68", counted=True, hidden=True, range=ANY),
        Score("coverage_95", "unity", 2, "the same for 95 %", counted=True, hidden=True, range=ANY),
        Score("brier", "smaller", 4, "mean square of claimed probabilities less 1 for true "
              "detections, 0 for ghosts", heading="Brier", hidden=True),
        share("link_recall", 3,
              "share of the particles found in two consecutive frames that one trajectory joins"),
        share("link_precision", 3,
              "share of the links between such frames that join the same particle"),
        share("vector_recall", 3, "share of the true displacements between consecutive frames that "
              "a trajectory has; particles that were not found count as missed", hidden=True),
        Score("displacement_mm", "smaller", 4,
              "root mean square error of these displacements", hidden=True),
        share("effectiveness", 3, "share of a particle's frames in which its longest trajectory "
              "has it, mean over the particles"),
        Score("velocity_mm_s", "smaller", 3, "median error of velocities: claimed ones of found "
              "particles against the true ones; without claims those of correct links, against the "
              "true mean velocity between the frames"),
        Score("velocity_percent", "smaller", 2, "the same over that velocity"),
        Score("acceleration_percent", "smaller", 1,
              "median error of accelerations over the true ones, both by second differences of "
              "positions; claimed ones count where there are any", hidden=True),
        share("hota", 3, "higher order tracking accuracy: geometric mean of the quality of "
              "detections and of identities, averaged over matching distances up to 1 voxel",
              heading="HOTA", hidden=True),
        share("complete", 3, "share of the true trajectories that one estimated trajectory has in "
              "all frames", hidden=True),
        Score("switch_percent", "smaller", 2, "changes of the estimated trajectory of a true "
              "particle, relative to true links", heading="switches %", counted=True, hidden=True),
        Score("fragment_percent", "smaller", 2, "times that a true particle is lost and found "
              "again, relative to true links", heading="fragments %", counted=True, hidden=True),
    )
    # fmt: on
    tolerance = _TOLERANCE
    sufficient = 0.8
    gate = Gate("precision", 0.02)
    captions = Captions(
        heading="Particles in the middle slice",
        estimates="Found particles as Gaussian blobs on the grid, in the same window of the middle "
        "z plane of the scored volume, x to the right, y down.",
        cameras=PARTICLE_IMAGES,
        errors=DEFINITION,
    )

    def case(self, data: Dataset) -> ImageSequence:
        """Make the first sequence; a frame is read when it is requested."""
        return image_sequence(data, data.setup.sequences()[0])[0]

    def run(self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
        """Find the particles of every sequence; return the seconds of each frame.

        The time for reading images does not count.
        """
        seconds, numbers = list[float](), particles_over_time.TrajectoryNumbers()
        for frames in progress_bar(data.setup.sequences(), f"particles by {name}"):
            sequence, reader = image_sequence(data, frames)
            clock, waiting = SolverClock(), list[FoundParticles]()
            find = particles_over_time.find_in_each_frame
            answers = find(algorithm, name, sequence, frames, clock)
            for frame, particles in zip(frames, answers, strict=True):
                if particles.trajectory is None:
                    waiting.append(particles)
                else:
                    writer.add(numbers.assign(particles), frame)
            for frame, particles in zip(
                frames, particles_over_time.link_sequence(waiting, sequence.times_s), strict=False
            ):
                writer.add(numbers.assign(particles), frame)
            numbers.begin_sequence()
            seconds += [max(clock.seconds - reader.seconds, 0.0) / len(frames)] * len(frames)
            memory.trim()
        return seconds

    def copy(self, data: Dataset, result: Result, writer: ResultWriter) -> None:
        """Write the particles of a foreign result anew, linked if it has no trajectories."""
        for frame, particles in enumerate(self._all(data, result)):
            writer.add(particles, frame)

    def truth(self, data: Dataset, frame: int) -> FoundParticles:
        """Make the true particles, with their identities."""
        particles = data.particles(frame)
        return FoundParticles(particles.position_mm, None, particles.id.astype(np.int64))

    def empty(self, data: Dataset, frame: int) -> FoundParticles:
        """Make no particles."""
        return FoundParticles(np.zeros((0, 3)), None, np.zeros(0, dtype=np.int64))

    def wrong(self, data: Dataset, frame: int) -> FoundParticles:
        """Drop and move true particles, add ghosts, and swap some trajectories."""
        true, voxel = data.particles(frame), np.asarray(data.setup.grid.voxel_mm)
        rows = np.flatnonzero(true.id % 7 != 3)
        angle = true.id[rows] + 0.5 * frame
        aside = np.stack([np.sin(angle), np.cos(1.3 * angle), np.sin(0.7 * angle + 1.0)], axis=1)
        moved = true.position_mm[rows] + 0.4 * voxel * aside
        ghosts = true.position_mm[::6] + voxel * [5.0, -4.0, 6.0]
        numbers = true.id[rows].astype(np.int64)
        if frame % 2 and len(numbers) > 3:
            numbers[[0, 1, 2]] = numbers[[1, 2, 0]]
        first = int(true.id.max(initial=-1)) + 1 + 100_000 * frame
        numbers = np.concatenate([numbers, first + np.arange(len(ghosts), dtype=np.int64)])
        return FoundParticles(np.concatenate([moved, ghosts]), None, numbers)

    def score(self, data: Dataset, source: Source) -> Figures:
        """Average the frames' scores; those of trajectories come from all frames."""
        truth = [data.particles(frame) for frame in self.frames(data)]
        estimates = self._all(data, source, truth)
        pairs = list(zip(estimates, truth, strict=True))
        frames = [
            score_particle_frame(data, estimate, true, frame)
            for frame, (estimate, true) in zip(
                self.frames(data), progress_bar(pairs, "score"), strict=True
            )
        ]
        return mean_of_each(frames) | particles_over_time.score_over_time(data, estimates, truth)

    def _all(
        self, data: Dataset, source: Source, truth: Sequence[Particles] = ()
    ) -> list[FoundParticles]:
        """Read the particles of all frames; those without trajectories are linked.

        With the true ones, far too many particles raise an InputError.
        """
        estimates: list[FoundParticles] = [self.read(data, source, n) for n in self.frames(data)]
        if isinstance(source, Result):
            for frame, true in enumerate(truth):
                where = f"{source.path}: {frame_group(frame)}/particles"
                check_number(len(estimates[frame].position_mm), len(true.position_mm), where)
            check_tracks(source, estimates)
        return particles_over_time.link_frames(data.setup, estimates)

    def alike(self, data: Dataset, one: FoundParticles, other: FoundParticles) -> bool:
        """Compare particles by the share detected in both."""
        near_mm = _NEAR_VOXELS * min(data.setup.grid.voxel_mm)
        return share_near(one.position_mm, other.position_mm, near_mm) >= AGREEING

    def picture(self, data: Dataset, source: Source) -> bytes:
        """Draw the particles in a slice as Gaussian blobs of a voxel, as a PNG."""
        grid, positions = data.setup.grid, self.read(data, source, 0).position_mm
        volume = synthesise(grid, positions, np.ones(len(positions)), grid.voxel_mm[0])
        return with_bar(pictures.slice_picture(volume, grid.scored), grid)

    def error_picture(self, data: Dataset, result: Result) -> bytes:
        """Draw found, missed, ghost and duplicate particles in the same slice as a PNG."""
        grid, true = data.setup.grid, data.particles(0).position_mm
        positions = self.read(data, result, 0).position_mm
        own, _, j = particle_detection.classify(grid.to_voxels(positions), grid.to_voxels(true))
        kinds = {"found": true[j], "missed": np.delete(true, j, axis=0)}
        kinds |= {"ghost": positions[own == GHOST], "duplicate": positions[own == DUPLICATE]}
        wide = grid.voxel_mm[0]
        parts = {kind: synthesise(grid, p, np.ones(len(p)), wide) for kind, p in kinds.items()}
        return with_bar(pictures.class_slice(parts, grid.scored), grid)


def score_particle_frame(
    data: Dataset, estimate: FoundParticles, truth: Particles, frame: int
) -> Figures:
    """Score one frame's particles."""
    grid = data.setup.grid
    detected, true = grid.to_voxels(estimate.position_mm), grid.to_voxels(truth.position_mm)
    scored = grid.in_scored(detected), grid.in_scored(true)
    counts = particle_detection.count_challenge(detected, true, *scored)
    kind, a, b = particle_detection.classify(detected, true)
    i, j = a[scored[1][b]], b[scored[1][b]]
    whole = counts.precision + counts.recall
    double, error = kind == DUPLICATE, estimate.position_mm[i] - truth.position_mm[j]
    apart = np.linalg.norm(error, axis=1)
    curve = particle_detection.f1_over_distance(
        detected, true, *scored, particle_detection.MATCHING_DISTANCES
    )
    return {
        "f1": 2.0 * counts.precision * counts.recall / whole if whole else 0.0,
        "precision": counts.precision,
        "recall": counts.recall,
        "ghost_percent": counts.ghost_percent,
        "rms_px": _apart_px(data, estimate.position_mm[i], truth.position_mm[j]),
        "rms_mm": finite_or_none(root_mean_square(apart)),
        "f1_area": float(curve.mean()),
        **_TOLERANCE.figures(curve),
        "duplicate_percent": 100.0 * int(double[scored[0]].sum()) / len(i) if len(i) else None,
        "rms_over_bound": finite_or_none(
            rms_over_bound(error, _bounds(data, frame, j)) if len(j) else np.nan
        ),
        **_claims(estimate, error, i, scored[0] & (kind != FOUND)),
    }


def _claims(estimate: FoundParticles, error: F64, i: I64, ghosts: Bool) -> Figures:
    """Score the error estimates of a result; None where it has none.

    Errors (k, 3) belong to the rows i of matched particles; ghosts are marked.
    """
    figures: Figures = {"coverage_68": None, "coverage_95": None, "brier": None}
    if estimate.covariance_mm2 is not None:
        claimed = estimate.covariance_mm2[i]
        figures["coverage_68"] = finite_or_none(coverage(error, claimed, 0.68))
        figures["coverage_95"] = finite_or_none(coverage(error, claimed, 0.95))
    if estimate.probability is not None:
        rows = np.concatenate([i, np.flatnonzero(ghosts)])
        true = np.arange(len(rows)) < len(i)
        figures["brier"] = finite_or_none(brier_score(estimate.probability[rows], true))
    return figures


def _bounds(data: Dataset, frame: int, rows: I64) -> F64:
    """Compute the bounds (k, 3, 3) of the positions of some of a frame's particles."""
    # both have kernels, which take time to load
    from sabench.images.position_bounds import position_bounds
    from sabench.metrics.particle_bounds import true_spots

    cameras = range(len(data.true_cameras))
    spots = true_spots(
        data.particles(frame).position_mm,
        data.views(frame),
        data.true_cameras,
        [data.raw_image(camera, frame) for camera in cameras],
        data.scene.sensor,
    )
    return position_bounds(spots, rows)


def _apart_px(data: Dataset, found_mm: F64, true_mm: F64) -> float | None:
    """Compute the RMS distance of pairs of points in the true cameras' images."""
    apart = [
        np.linalg.norm(camera.project(found_mm)[0] - camera.project(true_mm)[0], axis=1)
        for camera in data.true_cameras
    ]
    return finite_or_none(root_mean_square(np.concatenate(apart)))


TASK = ParticlesTask()
