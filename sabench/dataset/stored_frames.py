"""Frames on disk: observations for solvers, truth for scores, whatever file they lie in."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from sabench.api import Observation
from sabench.api.truth import Particles, View
from sabench.dataset.cameras import CamerasFile
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.images.preprocessing import WHITE, Step, preprocess, takes_all_frames
from sabench.images.repair import Flaws, Repaired
from sabench.utils.arrays import F32, U16, Bool
from sabench.utils.errors import InputError


class StoredFrames(Protocol):
    """Frames on disk with one setup: a data set folder, or a sample of a shard.

    A store reads the setup, images and truth from its files; observations are built on these.
    """

    @property
    def setup(self) -> CamerasFile:
        """Cameras, wall, grid and sensor levels that solvers receive."""

    @property
    def true_cameras(self) -> tuple[Camera, ...]:
        """Cameras that took the images: truth, as all below, not for solvers."""

    @property
    def seed(self) -> int:
        """Seed that the frames were made with."""

    def raw_images(self, frame: int) -> U16:
        """Read the raw images (camera, row, column) of a frame."""

    def radiance(self, frame: int) -> Sequence[F32]:
        """Read the noise-free radiance (row, column) of every camera."""

    def particles(self, frame: int) -> Particles:
        """Read the true particles of a frame."""

    def views(self, frame: int) -> Sequence[View]:
        """Read every camera's true particle images, in the cameras' order."""

    @property
    def redrawn(self) -> int:
        """Number of times that the values were drawn again: 0 where nothing varies."""
        return 0

    @property
    def drawn(self) -> dict[str, Any]:
        """Values of the keys that vary: none where nothing varies."""
        return {}

    @property
    def masked(self) -> Bool | None:
        """Pixels (camera, row, column) that masks leave out; None without masks."""
        return None

    def observation(self, frame: int, steps: Sequence[Step] | None = None) -> Observation:
        """Read one frame as a solver receives it, or after other steps of preprocessing."""
        images, setup = self.raw_images(frame), self.setup
        steps = setup.preprocessing if steps is None else steps
        return build_observation(
            images,
            setup.cameras,
            setup.grid,
            (setup.sensor.black_dn, setup.sensor.white_dn),
            steps,
            lowest=self._lowest if takes_all_frames(steps) else None,
            by_camera=setup.sensor.by_camera,
            backlit="bubbles" in setup.shows,
            masked=self.masked,
        )

    @cached_property
    def _lowest(self) -> U16:
        lowest = self.raw_images(0).copy()
        for frame in range(1, self.setup.frames):
            np.minimum(lowest, self.raw_images(frame), out=lowest)
        return lowest


@dataclass(frozen=True)
class StoredSample:
    """One sample on disk; its truth is read when it is asked for.

    Attributes
    ----------
    number : number of the sample.
    images : (frame, camera, row, column) grey values.
    """

    number: int
    images: U16
    _store: StoredFrames
    _frames: range  # of the store
    _setup: CamerasFile | None = None  # None: that of the store

    @property
    def setup(self) -> CamerasFile:
        """Nominal cameras, wall, grid and sensor levels, which solvers receive."""
        return self._setup or self._store.setup

    def observation(self, frame: int = 0) -> Observation:
        """Build what a solver sees of a frame."""
        if not 0 <= frame < len(self._frames):
            raise InputError(f"frame {frame}: expected 0 to {len(self._frames) - 1}")
        return self._store.observation(self._frames[frame])

    @property
    def seed(self) -> int:
        """Seed of the sample: truth, as all below, not for solvers."""
        return self._store.seed

    @property
    def redrawn(self) -> int:
        """Number of times that its values were drawn again, as no such scene can be."""
        return self._store.redrawn

    @property
    def drawn(self) -> dict[str, Any]:
        """Values of the keys that vary."""
        return self._store.drawn

    @property
    def true_cameras(self) -> tuple[Camera, ...]:
        """Cameras that took the images."""
        return self._store.true_cameras

    @property
    def particles(self) -> tuple[Particles, ...]:
        """True particles of each frame, the same rows for the same `id`."""
        return tuple(self._store.particles(frame) for frame in self._frames)

    @property
    def views(self) -> tuple[tuple[View, ...], ...]:
        """True particle images of each frame and camera."""
        return tuple(tuple(self._store.views(frame)) for frame in self._frames)

    @property
    def radiance(self) -> F32:
        """Radiance (frame, camera, row, column) without noise, photons / (mm2 sr)."""
        return np.stack([self._store.radiance(frame) for frame in self._frames])


def build_observation(
    images: U16,
    cameras: tuple[CameraModel, ...],
    grid: Grid,
    levels: tuple[float, float],
    steps: Sequence[Step],
    *,
    lowest: U16 | None = None,
    by_camera: Sequence[tuple[float, float]] = (),
    backlit: bool = False,
    masked: Bool | None = None,
) -> Observation:
    """Build the observation of raw images, after the steps of preprocessing.

    Steps would spread hot pixels, and darken reflections: both are replaced before, unless the
    images are backlit.

    Parameters
    ----------
    levels : grey values of no light and of saturation.
    lowest : each pixel's least value over all frames; only where a step needs it.
    by_camera : those of each camera, where they differ: all images are brought to one black level.
    masked : pixels (camera, row, column) that do not count, as if a reflection covered them.
    """
    if by_camera:
        lowest = None if lowest is None else _align_levels(lowest, levels[0], by_camera)[0]
        images, levels = _align_levels(images, levels[0], by_camera)
    if not steps and masked is None:
        return Observation(images, cameras, grid, *levels)
    flaws = None
    if not backlit:
        images, flaws = _repaired(images, levels, masked)
    if steps:
        images, levels = preprocess(images, *levels, steps, lowest), (0.0, float(WHITE))
    return Observation(images, cameras, grid, *levels, flaws)


def _repaired(images: U16, levels: tuple[float, float], masked: Bool | None) -> Repaired:
    from sabench.images.repair import repair  # numba is loaded at the first use

    if masked is None:
        return repair(images, *levels)
    black = np.uint16(np.rint(levels[0]))
    good, flaws = repair(np.where(masked, black, images), *levels)
    return Repaired(np.where(masked, black, good), Flaws(flaws.points, flaws.covered | masked))


def _align_levels(
    images: U16, black_dn: float, by_camera: Sequence[tuple[float, float]]
) -> tuple[U16, tuple[float, float]]:
    """Subtract each camera's dark level and add `black_dn`, in whole grey values.

    Returns the images with one black and one white level, which saturated pixels have.
    """
    widest = max(round(camera_white - black) for black, camera_white in by_camera)
    white = min(round(black_dn) + widest, np.iinfo(np.uint16).max)
    aligned = np.empty_like(images)
    for image, out, (black, camera_white) in zip(images, aligned, by_camera, strict=True):
        grey = image.astype(np.int64) - round(black) + round(black_dn)
        out[:] = np.where(image >= camera_white, white, np.clip(grey, 0, white))
    return aligned, (black_dn, float(white))
