"""Estimates: results of solvers, with the shapes and units of their arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F32, F64, I64, Bool
from sabench.utils.errors import InputError


@dataclass(frozen=True)
class Reconstruction:
    """A solver's estimate of one frame.

    Attributes
    ----------
    volume : (z, y, x) float32 intensities on the grid, zero where there is nothing.
    particles_mm : (n, 3) positions if the algorithm finds particles itself, else None: the score
        then detects them in the volume.
    """

    volume: F32
    particles_mm: F64 | None = None


@dataclass(frozen=True)
class FoundParticles:
    """Particles that were found in one frame.

    Attributes
    ----------
    position_mm : (n, 3).
    intensity : (n,), of any scale, if the algorithm knows it.
    track : (n,) numbers of tracks, different within a frame: particles of one number in several
        frames are one. None: the harness links them.

    Raises
    ------
    InputError
        Arrays of other shapes or kinds, values that are not finite, or two particles of one track.
    """

    position_mm: F64
    intensity: F64 | None = None
    track: I64 | None = None

    def __post_init__(self) -> None:
        count = len(self.position_mm)
        _check_numbers("position_mm", self.position_mm, (count, 3), np.float64)
        if self.intensity is not None:
            _check_numbers("intensity", self.intensity, (count,), np.float64)
        if self.track is not None:
            _check_numbers("track", self.track, (count,), np.int64)
            values, times = np.unique(self.track, return_counts=True)
            if len(values) < count:
                raise InputError(
                    f"track: expected different numbers, got {values[times.argmax()]} for {times.max()} particles"
                )


def _check_numbers(name: str, value: Any, shape: tuple[int, ...], kind: type[np.generic]) -> None:
    if (
        not isinstance(value, np.ndarray)
        or value.shape != shape
        or value.dtype != kind
        or not np.isfinite(value).all()
    ):
        got = (
            f"{value.dtype} of shape {value.shape}"
            if isinstance(value, np.ndarray)
            else type(value).__name__
        )
        raise InputError(
            f"{name}: expected finite {np.dtype(kind)} values of shape {shape}, got {got}"
        )


@dataclass(frozen=True)
class Calibration:
    """A calibration's result.

    Attributes
    ----------
    cameras : in the order of the case.
    points_mm : (frame, point, 3) places of the target's points, world frame, if the algorithm finds
        them itself, else None: the score then
        intersects the cameras' lines of sight.
    used : (camera, frame, point) observations that the algorithm took for good, None: all.
    """

    cameras: tuple[CameraModel, ...]
    points_mm: F64 | None = None
    used: Bool | None = None


@dataclass(frozen=True)
class Velocity:
    """A velocity field on a lattice along the world's axes.

    Attributes
    ----------
    low_mm, step_mm : the first node and the spacing of nodes, as (x, y, z).
    velocity_mm_s : (z, y, x, 3), finite everywhere: where nothing was measured it is what the
        neighbours say.
    valid : (z, y, x) where it was measured.
    """

    low_mm: tuple[float, float, float]
    step_mm: tuple[float, float, float]
    velocity_mm_s: F64
    valid: Bool

    @property
    def positions_mm(self) -> F64:
        """Nodes (z, y, x, 3)."""
        counts = self.valid.shape[::-1]
        x, y, z = (
            low + step * np.arange(count)
            for low, step, count in zip(self.low_mm, self.step_mm, counts, strict=True)
        )
        return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1)


@dataclass(frozen=True)
class Detections:
    """Bubbles that were found in one frame.

    Attributes
    ----------
    center_mm, semi_axes_mm : (n, 3).
    turn : (n, 3, 3) rotations from the world to the bubbles' own axes, whose rows the semi-axes lie
        along.

    Raises
    ------
    InputError
        Arrays of other shapes, values that are not finite, semi-axes that are not positive, or
        matrices that are no rotations.
    """

    center_mm: F64
    semi_axes_mm: F64
    turn: F64

    def __post_init__(self) -> None:
        count = len(self.center_mm)
        for name, expected in {
            "center_mm": (count, 3),
            "semi_axes_mm": (count, 3),
            "turn": (count, 3, 3),
        }.items():
            _check_numbers(name, getattr(self, name), expected, np.float64)
        if count and self.semi_axes_mm.min() <= 0.0:
            raise InputError(
                f"semi_axes_mm: expected positive lengths, got {self.semi_axes_mm.min():g}"
            )
        if count and np.abs(self.turn @ self.turn.transpose(0, 2, 1) - np.eye(3)).max() > 1e-6:
            raise InputError("turn: expected rotations")

    @classmethod
    def balls(cls, center_mm: F64, radius_mm: F64) -> Detections:
        """Spheres (n, 3), (n,)."""
        return cls(
            np.asarray(center_mm, dtype=np.float64),
            np.repeat(radius_mm[:, None], 3, axis=1),
            np.tile(np.eye(3), (len(radius_mm), 1, 1)),
        )

    @property
    def radius_mm(self) -> F64:
        """Radii (n,) of balls of the same volumes."""
        return np.asarray(np.cbrt(self.semi_axes_mm.prod(axis=1)))
