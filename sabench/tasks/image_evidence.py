"""Evidence of a frame's images for or against a result.

Data sets are also copied without one camera, or with the images of one camera shifted, so that a
solver can run again on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sabench.algorithms.particles.bayesian_ipr import dark_images
from sabench.api import Observation
from sabench.dataset import schema
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.recorded import RecordedWriter, recorded_writer
from sabench.geometry.camera_model import CameraModel
from sabench.images.widths import ImageStatistics, measure_images
from sabench.metrics import reprojection
from sabench.utils.arrays import F32, F64, U16, Bool
from sabench.utils.files import inside, read_json

_LEAST = 0.3  # light of an image that counts, share of a typical particle's
_SHIFTS = 5  # multiples of the scramble's shift used to measure chance
_BLUR_PX = 0.7  # standard deviation of a voxel's image


class _CameraEvidence(NamedTuple):
    """Evidence of one camera for particles that were found without it.

    Attributes
    ----------
    true_share : of the particles; 0 where they show no more light than any other place, 1 where
        they show as much as the particles found with the camera.
    chance : share of other places that show an image.
    """

    true_share: float
    chance: float


@dataclass(frozen=True)
class FrameEvidence:
    """Images of a frame, less black and background, and their statistics.

    Attributes
    ----------
    case : the frame.
    images : (camera, row, column).
    valid : the same shape, pixels that count.
    statistics : widths and light of particle images, and noise.
    """

    case: Observation
    images: F64
    valid: Bool
    statistics: ImageStatistics

    @classmethod
    def of(cls, case: Observation) -> FrameEvidence:
        """Clear a frame's images and measure them."""
        clear = dark_images(case)
        valid = ~(clear.flaws.unknown | clear.saturated)
        images = clear.images.astype(np.float64)
        return cls(case, images, valid, measure_images(images, valid))

    def fit(self, positions_mm: F64) -> list[reprojection.LightFit]:
        """Fit the light of particles (n, 3) in every camera."""
        return [self._fit(camera, positions_mm) for camera in range(len(self.images))]

    def _fit(self, camera: int, positions_mm: F64) -> reprojection.LightFit:
        patches = self._patches(camera, self._pixels(camera, positions_mm))
        return reprojection.fit_light(self.images[camera], patches, len(positions_mm))

    def certain_shifts(self, camera: int, fit: reprojection.LightFit) -> F64:
        """Return the shifts (k, 2) of images that are bright enough to have a place."""
        bright = fit.light > _LEAST * self.statistics.light[camera]
        good: F64 = fit.shift_px[bright & np.isfinite(fit.shift_px).all(axis=1)]
        return good

    def explained(self, camera: int, left: F64) -> float:
        """Compute the share of an image's light that the particles explain."""
        noise = float(self.statistics.noise[camera])
        return reprojection.explained_share(self.images[camera], left, self.valid[camera], noise)

    def compare(
        self, camera: int, positions_mm: F64, found_mm: F64, shift: tuple[int, int]
    ) -> _CameraEvidence:
        """Compare a camera's light at particles found without it, with it, and elsewhere.

        Light is ranked among the light at other positions (mean rank one half): particles show
        `true_share` of the excess of those found with the camera.

        Parameters
        ----------
        positions_mm, found_mm : (n, 3) found without and with the camera.
        shift : rows and columns from a particle to another place.
        """
        pixels = self._pixels(camera, positions_mm)
        light = self._light(camera, pixels)
        size = np.array([self.case.cameras[camera].columns, self.case.cameras[camera].rows])
        step = np.array(shift[::-1])
        elsewhere = np.sort(
            np.concatenate(
                [
                    self._light(camera, (pixels + 0.5 + number * step) % size - 0.5)
                    for number in range(1, _SHIFTS + 1)
                ]
            )
        )
        expected = self._light(camera, self._pixels(camera, found_mm))
        if not (len(light) and len(expected) and len(elsewhere)):
            return _CameraEvidence(float("nan"), float("nan"))
        excess = [
            float(np.searchsorted(elsewhere, sample).mean()) / len(elsewhere) - 0.5
            for sample in (light, expected)
        ]
        share = excess[0] / excess[1] if excess[1] > 0.0 else float("nan")
        chance = float((elsewhere > _LEAST * np.median(expected)).mean())
        return _CameraEvidence(float(np.clip(share, 0.0, 1.0)), chance)

    def count_shown(
        self, camera: int, positions_mm: F64, found_mm: F64, shift: tuple[int, int]
    ) -> int:
        """Count the particles (n, 3) that a camera shows in its shifted image.

        Parameters
        ----------
        found_mm : (m, 3) found with the camera; their light gives the threshold of an image.
        shift : rows and columns.
        """
        size = np.array([self.case.cameras[camera].columns, self.case.cameras[camera].rows])
        pixels = self._pixels(camera, positions_mm) + 0.5 - np.array(shift[::-1])
        expected = self._light(camera, self._pixels(camera, found_mm))
        if not len(expected):
            return 0
        light = self._light(camera, pixels % size - 0.5)
        return int((light > _LEAST * np.median(expected)).sum())

    def correlation(self, camera: int, positions_mm: F64, others: Sequence[int]) -> float:
        """Correlate a camera's image with the one that other cameras' light predicts."""
        lights = [
            self._fit(other, positions_mm).light / self.statistics.light[other] for other in others
        ]
        finite = np.isfinite(lights)
        light = np.where(finite, lights, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
        patches = self._patches(camera, self._pixels(camera, positions_mm))
        drawn = reprojection.draw_reprojection(
            self.images[camera].shape, patches, light[patches.rows]
        )
        return correlate(self.images[camera], drawn, self.valid[camera])

    def _pixels(self, camera: int, positions_mm: F64) -> F64:
        pixels, valid = self.case.cameras[camera].project(positions_mm)
        return np.where(valid[:, None], pixels, np.nan)

    def _patches(self, camera: int, pixels: F64) -> reprojection.Patches:
        sigma = self.statistics.sigma[camera]
        return reprojection.cut_patches(
            self.images[camera].shape, pixels, sigma, self.valid[camera]
        )

    def _light(self, camera: int, pixels: F64) -> F64:
        light = reprojection.matched_light(self.images[camera], self._patches(camera, pixels))
        return light[np.isfinite(light)]


def correlate(one: F64, other: F64, known: Bool) -> float:
    """Correlate two images over known pixels; NaN without any, or without contrast."""
    if not known.any():
        return float("nan")
    a, b = one[known] - one[known].mean(), other[known] - other[known].mean()
    norm = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / norm if norm else float("nan")


def volume_correlation(case: Observation, camera: int, volume: F32) -> float:
    """Correlate a camera's image with a volume (z, y, x) that is projected into it.

    Every voxel shines as a Gaussian of the size of a pixel.
    """
    image = case.repaired.images[camera].astype(np.float64) - case.black_dn
    pixel_valid = ~case.repaired.flaws.unknown[camera]
    drawn = np.zeros(image.shape)
    x, y, z = case.grid.axes_mm
    for plane, depth in zip(volume, z, strict=True):
        row, column = np.nonzero(plane)
        points = np.column_stack([x[column], y[row], np.full(len(row), depth)])
        pixels, valid = case.cameras[camera].project(points)
        pixels = np.where(valid[:, None], pixels, np.nan)
        patches = reprojection.cut_patches(image.shape, pixels, np.full(2, _BLUR_PX), pixel_valid)
        drawn += reprojection.draw_reprojection(
            image.shape, patches, plane[row, column].astype(np.float64)[patches.rows]
        )
    return correlate(image, drawn, pixel_valid)


_SHARE = (0.37, 0.41)  # shift of a scrambled image as a share of its rows and columns


def without_camera(data: Dataset, number: int, frames: int, out: Path) -> Dataset:
    """Copy the first frames of all cameras but one."""
    return _copy(data, [n for n in range(len(data.setup.cameras)) if n != number], frames, out)


def with_scrambled_camera(data: Dataset, number: int, frames: int, out: Path) -> Dataset:
    """Copy the first frames with one camera's images shifted by many pixels.

    They are shifted by .37 of the rows and .41 of the columns, and what leaves the image enters on
    the other side.
    """
    return _copy(data, range(len(data.setup.cameras)), frames, out, scrambled=number)


def scramble_shift(camera: CameraModel) -> tuple[int, int]:
    """Compute the shift of a camera's images in rows and columns."""
    return round(_SHARE[0] * camera.rows), round(_SHARE[1] * camera.columns)


def _copy(
    data: Dataset, cameras: Any, frames: int, out: Path, scrambled: int | None = None
) -> Dataset:
    setup = data.setup
    keys = read_json(inside(data.root, schema.CAMERAS))
    for name in ("format", "version", "cameras", "wall"):
        keys.pop(name, None)
    keys["frames"] = frames
    if "times_s" in keys:
        keys["times_s"] = keys["times_s"][:frames]
    if levels := keys["sensor"].get("by_camera"):
        keys["sensor"]["by_camera"] = [levels[number] for number in cameras]
    with recorded_writer(out, data.root.name) as writer:
        for number in cameras:
            camera = setup.cameras[number]
            shift = scramble_shift(camera) if number == scrambled else (0, 0)
            _copy_images(writer, data, number, frames, shift)
        writer.set_cameras([setup.cameras[number] for number in cameras], **keys)
    return open_dataset(out)


def _copy_images(
    writer: RecordedWriter, data: Dataset, number: int, frames: int, shift: tuple[int, int]
) -> None:
    name = data.setup.cameras[number].name
    for frame in range(frames):
        image: U16 = np.roll(data.raw_image(number, frame), shift, axis=(0, 1))
        writer.add_image(name, frame, image)
    if data.masked is not None and data.masked[number].any():
        writer.add_mask(name, ~data.masked[number])
