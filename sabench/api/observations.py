"""Observations: the data that an experimenter has.

They are one frame, an image sequence, a calibration, or a pair of frames or volumes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from sabench.api.truth import Target
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel, describe_cameras
from sabench.geometry.grid import Grid
from sabench.images.flaws import Flaws, Repaired
from sabench.plotting.card import Card
from sabench.utils.arrays import F32, F64, U16, Bool
from sabench.utils.errors import InputError
from sabench.utils.validation import Unknown

Shown = Literal["particles", "target", "bubbles", "code"]  # kinds of objects in a data set's frames


@dataclass(frozen=True, repr=False)
class Observation(Card):
    """One frame as an experimenter has it.

    Attributes
    ----------
    images : (camera, row, column) uint16 grey values.
    cameras : calibrated cameras in the order of the images, each with its wall. They may be wrong:
        see `[calibration]` in a scene.
    grid : the voxels to reconstruct.
    black_dn, white_dn : grey values of no light and of saturation.
    flaws : pixels that have been repaired in the images; None where they have not been looked for.

    Raises InputError for images of another kind, number or size than the cameras', or a black level
    that is not below the white one.
    """

    images: U16
    cameras: tuple[CameraModel, ...]
    grid: Grid
    black_dn: float
    white_dn: float
    flaws: Flaws | None = None

    def __post_init__(self) -> None:
        if not self.black_dn < self.white_dn:
            raise InputError(
                f"black_dn: expected it below white_dn, got {self.black_dn:g} and {self.white_dn:g}"
            )
        images: Any = self.images
        cameras = self.cameras
        if not isinstance(images, np.ndarray):
            raise InputError(
                "images: expected one uint16 array (camera, row, column), got "
                f"{type(images).__name__}"
            )
        if images.dtype != np.uint16:
            odd = _oddities(images)
            raise InputError(f"images: expected uint16 grey values, got {images.dtype}{odd}")
        if images.ndim != 3:
            got = images.shape
            raise InputError(f"images: expected the shape (camera, row, column), got {got}")
        if not cameras or len(images) != len(cameras):
            without = ", ".join(camera.name for camera in cameras[len(images) :])
            raise InputError(
                f"images: expected one for each of {len(cameras)} cameras, got "
                f"{len(images)}{': none for ' + without if without else ''}"
            )
        rows, columns = images.shape[1:]
        for camera in cameras:
            if (camera.rows, camera.columns) != (rows, columns):
                raise InputError(
                    f"{camera.name}: expected an image of {camera.rows} x {camera.columns} pixels "
                    f"(rows x columns), got {rows} x {columns}"
                )

    def normalised_images(self) -> F32:
        """Scale each camera's images to the peak of a bright particle in it.

        Black becomes 0. Flaws have been repaired: see `repaired`, and
        `sabench.images.levels.normalise`.
        """
        from sabench.images.levels import normalise

        good = self.repaired
        return normalise(good.images, self.black_dn, good.flaws.unknown)

    @cached_property
    def repaired(self) -> Repaired:
        """Replace hot and dead pixels and reflections in images of particles.

        What has been replaced is unknown, neither light nor dark: see `sabench.images.repair`.
        """
        from sabench.images.repair import repair  # numba is loaded at the first use

        if self.flaws is not None:
            return Repaired(self.images, self.flaws)
        return repair(self.images, self.black_dn, self.white_dn)

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (type(self).__name__,)
        yield "cameras", describe_cameras(self.cameras)
        yield "grey values", f"black {self.black_dn:g}, white {self.white_dn:g}"
        yield "grid", str(self.grid)

    def _picture(self) -> bytes:
        """Draw the first camera's image."""
        from sabench.plotting.pictures import thumbnail

        return thumbnail(self.images[0], self.black_dn, self.white_dn)


def _oddities(values: Any) -> str:
    """Describe which values of an array of another type cannot be grey values."""
    if values.dtype.kind not in "fi":
        return ""
    counts = {
        "NaN or infinite": int((~np.isfinite(values)).sum()),
        "negative": int((values < 0).sum()),
    }
    return "".join(f", {count} of them {what}" for what, count in counts.items() if count)


@dataclass(frozen=True)
class ImageSequence:
    """Image sequence as an experimenter has it.

    Each frame is read when it is requested, and none is kept.

    Attributes
    ----------
    cameras, grid : of all frames, as in `Observation`.
    times_s : time of each frame.
    load : function that reads a frame; frames count from 0.
    """

    cameras: tuple[CameraModel, ...]
    grid: Grid
    times_s: tuple[float, ...]
    load: Callable[[int], Observation]

    @classmethod
    def of(cls, frames: list[Observation], interval_s: float = 1.0) -> ImageSequence:
        """Make an image sequence of frames that are in memory."""
        return cls(
            frames[0].cameras,
            frames[0].grid,
            tuple(interval_s * i for i in range(len(frames))),
            frames.__getitem__,
        )

    def __len__(self) -> int:
        return len(self.times_s)

    def __getitem__(self, frame: int) -> Observation:
        """Read a frame."""
        if not 0 <= frame < len(self):
            raise IndexError(f"frame {frame}: expected 0 to {len(self) - 1}")
        return self.load(frame)

    def __iter__(self) -> Iterator[Observation]:
        return (self[frame] for frame in range(len(self)))


@dataclass(frozen=True)
class CalibrationCase:
    """Data of a calibration as an experimenter has them.

    Attributes
    ----------
    target : the target, in its own frame.
    pixels : (camera, frame, point, 2) column and row of the target's m points; NaN where one was
        not found.
    cameras : initial guess of the cameras, each with its wall.
    initial_mm : (frame, point, 3) initial guess of the positions of the target's points, in the
        world frame; NaN where there is none.
    known_mm : (frame, point, 3) coordinates that were measured by other means; NaN where they were
        not.
    known_sigma_mm : the same shape, their standard deviations.
    unknown : parameters that were not measured, besides the focal lengths: "principal_point",
        names of coefficients of distortion and "tilt" of the lenses; "wall" (its place and tilt),
        "thickness" and "layer_index" of its layers, "fluid_index", and the "bend" of a board.
    known_cameras : whether the cameras are exact and only the wall and the target are not, as after
        a calibration without the tank.

    Raises InputError for arrays of other shapes, or a camera that found no point.
    """

    target: Target
    pixels: F64
    cameras: tuple[Camera, ...]
    initial_mm: F64
    known_mm: F64
    known_sigma_mm: F64
    unknown: tuple[Unknown, ...] = ()
    known_cameras: bool = False

    def __post_init__(self) -> None:
        count = len(self.target.points_mm)
        if (
            self.pixels.ndim != 4
            or self.pixels.shape[::2] != (len(self.cameras), count)
            or self.pixels.shape[3] != 2
        ):
            raise InputError(
                f"pixels: expected the shape ({len(self.cameras)}, frames, {count}, 2), got "
                f"{self.pixels.shape}"
            )
        expected = (self.pixels.shape[1], count, 3)
        for name in ("initial_mm", "known_mm", "known_sigma_mm"):
            if getattr(self, name).shape != expected:
                raise InputError(
                    f"{name}: expected the shape {expected}, got {getattr(self, name).shape}"
                )
        for camera, detected in zip(self.cameras, self.found, strict=True):
            if not detected.any():
                raise InputError(
                    f"{camera.name}: expected it to see some of the target, but not one of its "
                    "points was found"
                )

    @property
    def found(self) -> Bool:
        """Flags (camera, frame, point) of the points that were found."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))


@dataclass(frozen=True)
class VolumePair:
    """Two reconstructed volumes of one grid, some time apart.

    Attributes
    ----------
    first, second : (z, y, x) float32 intensities.
    grid : their voxels.
    interval_s : time between them.

    Raises InputError for volumes of another shape than the grid's, or without any contrast.
    """

    first: F32
    second: F32
    grid: Grid
    interval_s: float

    def __post_init__(self) -> None:
        for name in ("first", "second"):
            volume = getattr(self, name)
            if volume.shape != self.grid.shape:
                raise InputError(
                    f"{name} volume: expected {self.grid.shape} voxels (z, y, x) as its grid has, "
                    f"got {volume.shape}"
                )
            if not np.isfinite(volume).all():
                raise InputError(
                    f"{name} volume: expected finite intensities, got NaN or infinite ones"
                )
            if volume.min() == volume.max():
                raise InputError(
                    f"{name} volume: expected one that shows something, got {volume.flat[0]:g} "
                    "everywhere"
                )


@dataclass(frozen=True)
class ImagePair:
    """Two frames of the same cameras, some time apart.

    Attributes
    ----------
    first, second : the frames.
    interval_s : time between them.

    Raises InputError for frames of different numbers of cameras or image sizes.
    """

    first: Observation
    second: Observation
    interval_s: float

    def __post_init__(self) -> None:
        if self.first.images.shape != self.second.images.shape:
            raise InputError(
                f"second frame: expected images {self.first.images.shape} (camera, row, column) as "
                f"in the first one, got {self.second.images.shape}"
            )
