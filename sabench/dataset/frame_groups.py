"""Frames of a data set of version 1 as samples.

Each group of pulses is one; without groups, each frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench.api import Observation
from sabench.api.truth import Particles, View
from sabench.dataset.camera_files import CamerasFile
from sabench.dataset.reader import Dataset
from sabench.geometry.camera import Camera
from sabench.utils.arrays import F32, U16
from sabench.utils.errors import InputError


class FrameGroups:
    """Groups of frames of one data set."""

    def __init__(self, data: Dataset) -> None:
        self._data = data
        pulses = data.setup.pulses
        self._size = pulses if pulses > 1 else 1
        if data.setup.frames % self._size:
            raise InputError(f"{data.root}: expected frames in groups of {self._size}")

    def __len__(self) -> int:
        """Return the number of groups."""
        return self._data.setup.frames // self._size

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def number(self, row: int) -> int:
        """Return the number of a group."""
        return row

    def images(self, row: int) -> U16:
        """Read the grey values (frame, camera, row, column) of a group."""
        cameras = range(len(self._data.setup.cameras))
        return np.stack(
            [[self._data.raw_image(n, frame) for n in cameras] for frame in self._frames(row)]
        )

    def setup(self, row: int) -> CamerasFile:
        """Select the cameras and times of a group."""
        times = [self._data.setup.time_s(frame) for frame in self._frames(row)]
        return self._data.setup.model_copy(update={"frames": self._size, "times_s": tuple(times)})

    def observation(self, row: int, frame: int, images: U16) -> Observation:
        """Build what a solver sees of a frame of a group."""
        if not 0 <= frame < self._size:
            raise InputError(f"frame {frame}: expected 0 to {self._size - 1}")
        return self._data.observation(self._frames(row)[frame])

    def true_cameras(self, row: int) -> tuple[Camera, ...]:
        """Read the cameras that took the images."""
        return self._data.true_cameras

    def seed(self, row: int) -> int:
        """Read the seed of the data set."""
        return self._data.manifest.seed

    def redrawn(self, row: int) -> int:
        """Return 0: nothing varies."""
        return 0

    def drawn(self, row: int) -> dict[str, Any]:
        """Return no values: nothing varies."""
        return {}

    def particles(self, row: int) -> tuple[Particles, ...]:
        """Read the true particles of each frame."""
        return tuple(self._data.particles(frame) for frame in self._frames(row))

    def views(self, row: int) -> tuple[tuple[View, ...], ...]:
        """Read the true particle images of each frame and camera."""
        return tuple(tuple(self._data.views(frame)) for frame in self._frames(row))

    def radiance(self, row: int) -> F32:
        """Read the radiance (frame, camera, row, column) without noise."""
        return np.stack([self._data.radiance(frame) for frame in self._frames(row)])

    def _frames(self, row: int) -> range:
        return range(row * self._size, (row + 1) * self._size)
