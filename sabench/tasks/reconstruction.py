"""Task `reconstruction`: solvers turn one observation into one volume."""

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any

import numpy as np

from sabench.api import IterativeSolver, Observation, Reconstruction, SequenceSolver
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.dataset.schema import frame_group
from sabench.geometry.camera_model import any_in_view
from sabench.geometry.common_view import lattice_of
from sabench.geometry.grid import Grid
from sabench.metrics.averages import mean_of_each
from sabench.metrics.particle_detection import MATCHING_DISTANCES
from sabench.metrics.quality_factor import quality
from sabench.metrics.reconstruction_error import peak_f1_over_distance, score_frame, true_field
from sabench.plotting import pictures
from sabench.tasks.solver_call import (
    SolverClock,
    answers_of_frames,
    call_iterations,
    image_sequence,
)
from sabench.tasks.task import (
    ALIKE,
    PERCENT,
    Captions,
    Figures,
    FrameByFrame,
    Gate,
    MatchingCurve,
    Score,
    Source,
    check_estimate,
    check_number,
    correlation,
    share,
)
from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

# float32 volumes that must fit next to the images: the solver's own, and as much again for its
# work and the checks
_VOLUMES = 2.0
PARTICLE_IMAGES = (
    "First frame of every camera, one brightness scale for all; dim particles are raised."
)
_TOLERANCE = MatchingCurve("peak_f1", "peak F1", "voxel", MATCHING_DISTANCES)


class VolumeTask(FrameByFrame):
    """Base of tasks with a volume for each frame."""

    estimate = Reconstruction

    def check_case(self, case: Observation, source: str) -> None:
        """Raise an InputError for a saturated image, or a grid out of memory or of view.

        A black image passes.
        """
        for camera, image in zip(case.cameras, case.images, strict=True):
            if image.min() >= case.white_dn:
                raise InputError(
                    f"{source}: {camera.name}: expected an image that shows something, "
                    f"but every pixel is saturated ({case.white_dn:g} or more)"
                )
        check_memory(case, source)
        if not any_in_view(case.cameras, lattice_of(case.grid)):
            raise InputError(
                f"{source}: grid: expected it in view of at least one camera, "
                f"but no camera of {len(case.cameras)} sees any of it"
            )

    def empty(self, data: Dataset, frame: int) -> Reconstruction:
        """Make a dark volume."""
        return Reconstruction(np.zeros(data.setup.grid.shape, dtype=np.float32))

    def score(self, data: Dataset, source: Source) -> Figures:
        """Average the scores of the frames that have them."""
        frames = progress_bar(self.frames(data), "score")
        return mean_of_each([self._score_frame(data, source, frame) for frame in frames])

    @abstractmethod
    def _score_frame(self, data: Dataset, source: Source, frame: int) -> Figures:
        """Score the volume of a frame."""

    def alike(self, data: Dataset, one: Reconstruction, other: Reconstruction) -> bool:
        """Compare volumes by their correlation: MART and its kin depend on the order."""
        return correlation(one.volume, other.volume) > ALIKE


class ReconstructionTask(VolumeTask):
    """Reconstruction of every frame's volume of intensities."""

    name = "reconstruction"
    shown = "particles"
    # fmt: off
    scores = (
        Score("q", "larger", 3, "quality factor, the correlation of the reconstructed with the "
              "true intensity: 1 is perfect", heading="Q", range=(-1.0, 1.0)),
        share("peak_f1", 3, "harmonic mean of peak precision and peak recall: it does not depend "
              "on the blobs' shape", heading="peak F1"),
        Score("intensity_error", "smaller", 3, "relative root mean square error of the blobs' "
              "intensities over the true particles; lost ones are dark"),
        Score("true_percent", "larger", 1, "share of the true particles that were found within 1.5 "
              "voxels", counted=True, range=PERCENT),
        Score("ghost_percent", "smaller", 1,
              "ghosts, relative to the particles found", counted=True),
        share("precision", 3, "share of the detections that are true, closer than 1 voxel along "
              "every axis, one to one"),
        share("recall", 3, "share of the true particles that were found, by the same rule"),
        Score("rms_px", "smaller", 3,
              "root mean square distance between the pairs of that rule", unit="voxel"),
        Score("peak_true_percent", "larger", 1, "true %, with particles found as local maxima: "
              "touching ones count as two", counted=True, range=PERCENT),
        Score("peak_ghost_percent", "smaller", 1,
              "ghost %, with particles found as local maxima", counted=True),
        share("peak_precision", 4, "precision, with particles found as local maxima", hidden=True),
        share("peak_recall", 4, "recall, with particles found as local maxima", hidden=True),
        Score("peak_rms_px", "smaller", 4,
              "rms px, with particles found as local maxima", unit="voxel", hidden=True),
    )
    # fmt: on
    tolerance = _TOLERANCE
    sufficient = 0.75  # the usual limit of a good reconstruction, Elsinga et al. (2006)
    gate = Gate("peak_precision", 0.02)
    captions = Captions(
        heading="Middle slice",
        estimates="The same central window of the middle z plane of the scored volume, x to the "
        "right, y down; each figure has its own brightness scale.",
        cameras=PARTICLE_IMAGES,
        errors="The estimate, scaled to fit best, minus the truth in the same window: blue is "
        "missing light, orange is too much light. All maps of a case have one scale.",
    )

    def run(self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
        """Reconstruct every frame, or every sequence; return the seconds of each frame."""
        if isinstance(algorithm, IterativeSolver) and writer.keeps_iterations:
            return self._run_iterations(algorithm, name, data, writer)
        if not isinstance(algorithm, SequenceSolver):
            return super().run(algorithm, name, data, writer)
        seconds = list[float]()
        for frames in progress_bar(data.setup.sequences(), f"volumes by {name}"):
            clock = SolverClock()
            volumes = self.call_sequence(algorithm, name, data, frames, clock)
            for frame, volume in zip(frames, volumes, strict=True):
                writer.add(volume, frame)
            seconds += [clock.seconds / len(frames)] * len(frames)
            memory.trim()
        return seconds

    def _run_iterations(
        self, algorithm: IterativeSolver, name: str, data: Dataset, writer: ResultWriter
    ) -> list[float]:
        """Reconstruct every frame, and write the first one's estimates on the way, too."""

        def store(number: int, seconds: float, estimate: Reconstruction) -> None:
            check_estimate(estimate, name, data, 0)
            writer.add_iteration(estimate, number, seconds)

        case = data.observation(0)
        self.check_case(case, f"{data.root}: frame 0")
        volume, took = call_iterations(algorithm, name, case, store)
        check_estimate(volume, name, data, 0)
        writer.add(volume, 0)
        return [took, *self.run_frames(algorithm, name, data, writer, self.frames(data)[1:])]

    def call_sequence(
        self, algorithm: SequenceSolver, name: str, data: Dataset, frames: range, clock: SolverClock
    ) -> Iterator[Reconstruction]:
        """Call a solver on a sequence; yield its checked estimates.

        The clock runs while the solver does; at the end, the time for reading images is taken off.
        """
        self.check_case(data.observation(frames[0]), f"{data.root}: frame {frames[0]}")
        sequence, reader = image_sequence(data, frames)
        volumes = answers_of_frames(algorithm, name, sequence, frames, Reconstruction, clock)
        for frame, volume in zip(frames, volumes, strict=True):
            check_estimate(volume, name, data, frame)
            yield volume
        clock.seconds = max(clock.seconds - reader.seconds, 0.0)

    def truth(self, data: Dataset, frame: int) -> Reconstruction:
        """Make the synthesised field, with the true positions."""
        particles = data.particles(frame)
        volume = true_field(data.setup.grid, particles, data.views(frame))
        return Reconstruction(volume, particles.position_mm)

    def wrong(self, data: Dataset, frame: int) -> Reconstruction:
        """Move the true field by less than a voxel, and add a fainter copy of a part."""
        true = true_field(data.setup.grid, data.particles(frame), data.views(frame))
        ghosts = np.roll(true, (3, 11, 17), axis=(0, 1, 2))
        ghosts[:, :, : true.shape[2] // 2] = 0.0
        volume = 0.6 * true + 0.4 * np.roll(true, 1, axis=2) + 0.5 * ghosts
        return Reconstruction(np.asarray(volume, dtype=np.float32))

    def score_iterations(self, data: Dataset, result: Result) -> list[list[float]]:
        """Compute [iteration, seconds, Q] of the first frame's estimates on the way."""
        grid = data.setup.grid
        true = true_field(grid, data.particles(0), data.views(0))[grid.scored]
        return [
            [number, seconds, quality(estimate.volume[grid.scored], true)]
            for number, seconds, estimate in result.iterations(Reconstruction)
        ]

    def _score_frame(self, data: Dataset, source: Source, frame: int) -> Figures:
        estimate, particles = self.read(data, source, frame), data.particles(frame)
        if isinstance(source, Result) and estimate.particles_mm is not None:
            where = f"{source.path}: {frame_group(frame)}/particles_mm"
            check_number(len(estimate.particles_mm), len(particles.position_mm), where)
        grid = data.setup.grid
        curve = peak_f1_over_distance(grid, particles, estimate)
        scores = score_frame(grid, particles, data.views(frame), estimate)
        return scores | _TOLERANCE.figures(curve)

    def picture(self, data: Dataset, source: Source) -> bytes:
        """Draw a slice of the first frame's volume as a PNG."""
        grid = data.setup.grid
        drawn = pictures.slice_picture(self.read(data, source, 0).volume, grid.scored)
        return with_bar(drawn, grid)

    def error_picture(self, data: Dataset, result: Result) -> bytes:
        """Draw the same slice of the estimate minus the truth as a PNG."""
        estimate, truth = self.read(data, result, 0), self.truth(data, 0)
        grid = data.setup.grid
        return with_bar(pictures.error_slice(estimate.volume, truth.volume, grid.scored), grid)


def with_bar(picture: bytes, grid: Grid) -> bytes:
    """Draw a scale bar into the picture of a slice of a grid."""
    return pictures.with_scale_bar(picture, pictures.slice_voxels(grid.scored) * grid.voxel_mm[0])


def check_memory(case: Observation, source: str) -> None:
    """Raise an InputError if the volumes and images do not fit into memory.

    These are `_VOLUMES` volumes and the images as float32.
    """
    available, images = memory.available_mb(), case.images.size * 4 / 1e6
    (planes, rows, columns), voxel = case.grid.shape, _VOLUMES * 4 / 1e6
    need = images + planes * rows * columns * voxel
    if available is None or need <= available:
        return
    voxels = max(0, int((available - images) / voxel))
    whole = voxels // (rows * columns)
    largest = f"{whole} of its planes" if whole else f"{voxels} of its voxels"
    raise InputError(
        f"{source}: grid: expected it to fit into memory, but its "
        f"{planes} x {rows} x {columns} voxels (z, y, x) need {need:.0f} MB "
        f"where {available:.0f} MB are there: at most {largest} fit"
    )


TASK = ReconstructionTask()
