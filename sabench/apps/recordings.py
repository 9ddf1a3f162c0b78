"""Statistics of the images of data sets and of real recordings."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sabench.algorithms.particles import TriangulationSettings, fit_cameras, triangulate_particles
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.schema import MANIFEST
from sabench.images import statistics
from sabench.images.statistics import read_recordings
from sabench.metrics.averages import finite_or_none
from sabench.metrics.reprojection import FARTHEST_PX
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

_APART_PX = 4.0  # nearer peaks and particles leave a particle out

Matched = Literal["true positions", "triangulated positions"]


@dataclass(frozen=True)
class Measured:
    """Statistics of all cameras.

    Attributes
    ----------
    cameras : by their names.
    frames : number of images of each camera, at most.
    white_dn : grey values of saturated pixels, of each camera.
    ratio : of a particle's flux between cameras; None without a calibration.
    matched : source of the correspondences between the peaks of the cameras.
    """

    cameras: dict[str, statistics.CameraStatistics]
    frames: int
    white_dn: dict[str, float]
    ratio: statistics.RatioSpread | None = None
    matched: Matched | None = None

    def medians(self) -> dict[str, float | None]:
        """Give each figure's median over the cameras, and those of the ratio.

        None where the images do not determine it.
        """
        every = [asdict(camera) for camera in self.cameras.values()]
        out = {key: _median([figures[key] for figures in every]) for key in every[0]}
        if self.ratio is not None:
            out["ln_ratio"] = finite_or_none(self.ratio.plain)
            out["ln_ratio_robust"] = finite_or_none(self.ratio.robust)
        return out

    def to_json(self) -> dict[str, Any]:
        """Give all figures as JSON holds them."""
        cameras = {
            name: {key: finite_or_none(value) for key, value in asdict(camera).items()}
            for name, camera in self.cameras.items()
        }
        pairs = self.ratio.pairs if self.ratio else None
        return {
            "frames": self.frames,
            "white_dn": self.white_dn,
            "median": self.medians(),
            "cameras": cameras,
            "ratio_matched_by": self.matched,
            "ratio_pairs": pairs,
        }


def _median(values: list[float]) -> float | None:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.median(finite)) if finite else None


def measure(path: Path, most: int, white_dn: float | None = None) -> Measured:
    """Measure a data set, or a folder of images.

    Parameters
    ----------
    most : number of frames.
    white_dn : grey value of a saturated pixel of a folder of images.

    Raises
    ------
    InputError
        A data set without particles, or with a white level given; a folder without images, or with
        some that cannot be read.
    """
    if (path / MANIFEST).is_file():
        if white_dn is not None:
            raise InputError(
                f"{path}: expected no white level for a data set, which states its own"
            )
        return measure_dataset(open_dataset(path), most)
    frames, cameras, white = 0, {}, {}
    for recording in read_recordings(path, most, white_dn):
        cameras[recording.name] = statistics.measure_camera(recording.frames, recording.white_dn)
        white[recording.name] = recording.white_dn
        frames = max(frames, len(recording.frames))
    return Measured(cameras, frames, white)


def measure_dataset(dataset: Dataset, most: int) -> Measured:
    """Measure the raw images of a data set's first frames.

    Raises
    ------
    InputError
        A data set that does not show particles alone.
    """
    if tuple(dataset.shows) != ("particles",):
        got = ", ".join(dataset.shows)
        raise InputError(f"{dataset.root}: expected a data set of particles, got one of {got}")
    frames, setup = min(most, dataset.setup.frames), dataset.setup
    cameras, white = {}, {}
    for number, camera in enumerate(progress_bar(setup.cameras, "measure images")):
        stack = [dataset.raw_image(number, frame) for frame in range(frames)]
        white[camera.name] = _white(dataset, number)
        cameras[camera.name] = statistics.measure_camera(stack, white[camera.name])
    flux = np.concatenate([*_fluxes(dataset, frames)], axis=1)
    matched: Matched = "true positions" if dataset.has_truth else "triangulated positions"
    return Measured(cameras, frames, white, statistics.flux_ratio_spread(flux), matched)


def _white(dataset: Dataset, number: int) -> float:
    sensor = dataset.setup.sensor
    return sensor.by_camera[number][1] if sensor.by_camera else sensor.white_dn


def _fluxes(dataset: Dataset, frames: int) -> Iterator[F64]:
    """Give the flux (camera, particle) of isolated particle images, frame by frame."""
    for frame in range(frames):
        sightings = _pixels(dataset, frame)
        images = [dataset.raw_image(number, frame) for number in range(len(sightings))]
        yield np.stack(
            [
                statistics.flux_near(
                    statistics.fit_particle_images(image, _white(dataset, number)),
                    pixels,
                    FARTHEST_PX,
                    _APART_PX,
                )
                for number, (image, pixels) in enumerate(zip(images, sightings, strict=True))
            ]
        )


def _pixels(dataset: Dataset, frame: int) -> list[F64]:
    """Give where each camera sees each particle (n, 2), NaN where it does not."""
    if dataset.has_truth:
        views = dataset.views(frame)
        return [np.where(view.visible[:, None], view.pixel, np.nan) for view in views]
    case = dataset.observation(frame)
    particles = triangulate_particles(case, fit_cameras(case), TriangulationSettings())
    projected = [camera.project(particles.position_mm) for camera in case.cameras]
    return [np.where(valid[:, None], pixel, np.nan) for pixel, valid in projected]
