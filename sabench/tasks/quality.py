"""Quality of a result without truth, estimated from its images.

Particles, or the voxels of a volume, are compared with the images of the data set. Then the solver
runs again without one camera, to predict its image from the others, and with one camera scrambled,
to measure chance detections.
"""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench import plugins
from sabench.api import FoundParticles, Reconstruction
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, open_result
from sabench.metrics.averages import finite_or_none, mean_of_each, mean_of_finite, root_mean_square
from sabench.metrics.trajectories import jitter_mm, share_followed
from sabench.plotting import pictures
from sabench.plotting.card import Card
from sabench.tasks.image_evidence import (
    FrameEvidence,
    scramble_shift,
    volume_correlation,
    with_scrambled_camera,
    without_camera,
)
from sabench.tasks.particles_over_time import link_frames
from sabench.tasks.solve_and_score import solve
from sabench.tasks.task import ANY, Figures, Score, share
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing
from sabench.utils.number_text import format_number
from sabench.utils.progress import progress_bar

# fmt: off
FIGURES = {score.key: score for score in (
    Score("residual_px", "smaller", 3,
          "RMS distance of particles' images from their projections, px"),
    Score("explained", "larger", 3,
          "share of the images' light that the result explains", range=ANY),
    share("held_out", 3, "share of particles found without a camera that this camera shows"),
    Score("held_out_correlation", "larger", 3, "correlation of an image with the others' "
          "prediction", heading="held-out correlation", range=ANY),
    Score("ghost_percent", "smaller", 2, "expected ghosts, relative to true particles, %",
          heading="expected ghosts %", counted=True),
    Score("chance_percent", "smaller", 2,
          "found with a scrambled camera, relative to what is found, %", counted=True),
    Score("jitter_mm", "smaller", 4,
          "scatter of positions along an axis, from jitter of trajectories, mm"),
    share("followed", 3, "share of particles in trajectories of three frames or more"),
)}
# fmt: on

# figures that results of a task have; other tasks have none
FIGURES_OF: dict[str, tuple[Score, ...]] = {
    "particles": tuple(FIGURES.values()),
    "reconstruction": tuple(
        FIGURES[key] for key in ("explained", "held_out_correlation", "chance_percent")
    ),
}


_FOLLOWED = 3  # frames


@dataclass(frozen=True, repr=False)
class Quality(Card):
    """Figures of a result that need no truth.

    Attributes
    ----------
    figures : by the keys of `FIGURES`; None where the data or the task give none.
    cameras : those of each camera, by its name.
    left : (camera, row, column) what particles leave of the first frame's images, less black and
        background, in grey values; None for volumes.
    notes : one sentence each.
    """

    figures: Figures
    cameras: dict[str, Figures]
    left: F64 | None
    notes: tuple[str, ...]

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield ("Quality without truth",)
        shown = {key: one for key, one in FIGURES.items() if self.figures[key] is not None}
        for key, one in shown.items():
            yield key, format_number(self.figures[key], one.decimals), one.meaning
        yield ("cameras",)
        keys = [key for key in shown if any(key in one for one in self.cameras.values())]
        yield "camera", *keys
        for name, camera in self.cameras.items():
            yield name, *(format_number(camera.get(key), shown[key].decimals) for key in keys)
        yield from ((f"note: {note}",) for note in self.notes)


def quality(
    dataset: Dataset | str | Path, result: str | Path, *, frames: int = 1, solve_again: bool = True
) -> Quality:
    """Estimate the quality of a result from its images.

    Parameters
    ----------
    frames : number of frames, from the first one on, that are compared with their images.
    solve_again : run the solver again without each camera, and with each one scrambled; without
        it, the figures that need that are None.

    Raises InputError for a result of another data set, or of another task than particles or
    reconstruction.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    opened = open_result(result, data)
    if opened.task not in FIGURES_OF:
        raise InputError(
            f"{result}: expected a result of the task particles or reconstruction, got one of "
            f"{opened.task}"
        )
    count = min(frames, len(data.setup.sequences()[0]))
    judge = _Particles if opened.task == "particles" else _Volumes
    return _judge(judge(data, opened, count), solve_again=solve_again)


class _Particles:
    """Particles of some frames, and the evidence of their images."""

    def __init__(self, data: Dataset, result: Result, frames: int) -> None:
        self.data, self.result, self.frames = data, result, frames
        self.evidence = [FrameEvidence.of(data.observation(frame)) for frame in range(frames)]
        self.found = _read_all(result, frames)
        self.fits = [
            frame.fit(cloud.position_mm)
            for frame, cloud in zip(self.evidence, self.found, strict=True)
        ]

    def compared(self, camera: int) -> Figures:
        """Compare one camera's images with the particles."""
        pairs = list(zip(self.evidence, self.fits, strict=True))
        shifts = [frame.certain_shifts(camera, fits[camera]) for frame, fits in pairs]
        return {
            "residual_px": finite_or_none(
                root_mean_square(np.linalg.norm(np.concatenate(shifts), axis=1))
            ),
            "explained": mean_of_finite(
                frame.explained(camera, fits[camera].left) for frame, fits in pairs
            ),
        }

    def over_time(self) -> Figures:
        """Compute the figures of the first sequence's trajectories."""
        frames = self.data.setup.sequences()[0]
        linked = link_frames(self.data.setup, _read_all(self.result, self.data.setup.frames))
        numbers = [linked[frame].trajectory for frame in frames]
        trajectories = [np.asarray(ids) for ids in numbers]
        if len(trajectories) < _FOLLOWED:
            return {"jitter_mm": None, "followed": None}
        positions = [linked[frame].position_mm for frame in frames]
        return {
            "jitter_mm": finite_or_none(jitter_mm(trajectories, positions)),
            "followed": finite_or_none(share_followed(trajectories, _FOLLOWED)),
        }

    def held_out(self, camera: int, again: Result) -> Figures:
        """Compare a camera's images with a result without that camera."""
        shift = scramble_shift(self.data.setup.cameras[camera])
        figures = []
        others = [n for n in range(len(self.data.setup.cameras)) if n != camera]
        for frame, all_found, cloud in zip(
            self.evidence, self.found, _read_all(again, self.frames), strict=True
        ):
            shown = frame.compare(camera, cloud.position_mm, all_found.position_mm, shift)
            ghosts = (1.0 - shown.true_share) * len(cloud.position_mm) * shown.chance
            rest = len(all_found.position_mm) - ghosts
            figures.append(
                {
                    "held_out": shown.true_share,
                    "held_out_correlation": frame.correlation(camera, cloud.position_mm, others),
                    "ghost_percent": 100.0 * ghosts / rest if rest > 0.0 else None,
                }
            )
        return mean_of_each(figures)

    def scrambled(self, camera: int, again: Result) -> Figures:
        """Count the particles of a result with a scrambled camera that its images show."""
        shift = scramble_shift(self.data.setup.cameras[camera])
        chance = sum(
            frame.count_shown(camera, other.position_mm, cloud.position_mm, shift)
            for frame, cloud, other in zip(
                self.evidence, self.found, _read_all(again, self.frames), strict=True
            )
        )
        whole = sum(len(cloud.position_mm) for cloud in self.found)
        return {"chance_percent": 100.0 * chance / whole if whole else None}

    def left(self) -> F64:
        """Return the residuals of the first frame's images."""
        return np.stack([fit.left for fit in self.fits[0]])


class _Volumes:
    """Volumes of some frames, and the images that they predict."""

    def __init__(self, data: Dataset, result: Result, frames: int) -> None:
        self.data, self.result, self.frames = data, result, frames
        self.cases = [data.observation(frame) for frame in range(frames)]

    def compared(self, camera: int) -> Figures:
        """Compare one camera's images with the projected volumes."""
        value = self._correlation(self.result, camera)
        return {"explained": None if value is None else max(value, 0.0) ** 2}

    def _correlation(self, result: Result, camera: int) -> float | None:
        return mean_of_finite(
            volume_correlation(case, camera, result.read(Reconstruction, frame).volume)
            for frame, case in enumerate(self.cases)
        )

    def over_time(self) -> Figures:
        """Return no figures: volumes have no trajectories."""
        return {}

    def held_out(self, camera: int, again: Result) -> Figures:
        """Compare a camera's images with the projected volumes of the others."""
        return {"held_out_correlation": self._correlation(again, camera)}

    def scrambled(self, camera: int, again: Result) -> Figures:
        """Compare the intensities with and without a scrambled camera."""
        frames = range(self.frames)
        chance, whole = (
            sum(float(result.read(Reconstruction, frame).volume.sum()) for frame in frames)
            for result in (again, self.result)
        )
        return {"chance_percent": 100.0 * chance / whole if whole else None}

    def left(self) -> None:
        """Return nothing: scales of volumes and images differ."""
        return


def write_quality(
    dataset: Dataset | str | Path, judged: Quality, out: Path, *, overwrite: bool = False
) -> None:
    """Write quality.json and, for particles, residuals.png into a new folder."""
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    values = {"figures": judged.figures, "cameras": judged.cameras, "notes": judged.notes}
    with complete_or_nothing(out, overwrite=overwrite) as folder:
        folder.mkdir()
        (folder / "quality.json").write_text(canonical_json(values), encoding="utf-8")
        if judged.left is not None:
            (folder / "residuals.png").write_bytes(residual_picture(data, judged.left))


def residual_picture(data: Dataset, left: F64) -> bytes:
    """Draw the first frame's images, each above its residual, as a PNG."""
    case = data.observation(0)
    grey = np.clip(np.rint(left + case.black_dn), 0.0, 65535.0).astype(np.uint16)
    both = np.concatenate([case.images, grey], axis=1)
    return pictures.montage(both, case.black_dn, case.white_dn)


def middle_residuals(data: Dataset, result: Result) -> bytes | None:
    """Draw the middle camera's first image and what particles leave of it as a PNG.

    None for results of other tasks than particles.
    """
    if result.task != "particles":
        return None
    case, left = data.observation(0), _Particles(data, result, 1).left()
    middle = len(left) // 2
    grey = np.clip(np.rint(left[middle] + case.black_dn), 0.0, 65535.0).astype(np.uint16)
    both = np.stack([case.images[middle], grey])
    return pictures.montage(both, case.black_dn, case.white_dn)


def _judge(judge: Any, *, solve_again: bool) -> Quality:
    cameras = judge.data.setup.cameras
    figures: dict[str, Figures] = {
        camera.name: judge.compared(number) for number, camera in enumerate(cameras)
    }
    notes: list[str] = []
    if solve_again:
        for number, camera in enumerate(progress_bar(cameras, "quality: solve again")):
            figures[camera.name] |= _again(judge, number, notes)
    whole = mean_of_each(list(figures.values())) | judge.over_time()
    return Quality({key: whole.get(key) for key in FIGURES}, figures, judge.left(), tuple(notes))


def _again(judge: Any, number: int, notes: list[str]) -> Figures:
    """Solve without one camera, and with that camera scrambled."""
    data, figures = judge.data, Figures()
    tries: tuple[tuple[Callable[..., Dataset], Callable[[Result], Figures]], ...] = (
        (without_camera, lambda again: judge.held_out(number, again)),
        (with_scrambled_camera, lambda again: judge.scrambled(number, again)),
    )
    for change, figures_of in tries:
        try:
            with _solved_again(judge.result, change, data, number, judge.frames) as again:
                figures |= figures_of(again)
        except InputError as error:
            doing = change.__name__.replace("_", " ")
            notes.append(f"{data.setup.cameras[number].name}: not solved {doing}: {error}")
    return figures


@contextmanager
def _solved_again(
    result: Result, change: Callable[..., Dataset], data: Dataset, number: int, frames: int
) -> Iterator[Result]:
    if result.solver not in plugins.names("solvers"):
        raise InputError(f"expected a solver that sabench has, got {result.solver}")
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        changed = change(data, number, frames, Path(folder) / "data")
        out = Path(folder) / "result.h5"
        yield solve(result.solver, changed, out, parameters=result.parameters)


def _read_all(result: Result, frames: int) -> list[FoundParticles]:
    return [result.read(FoundParticles, frame) for frame in range(frames)]
