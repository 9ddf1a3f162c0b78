"""Worlds and tables of particles between other programs and sabench."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from sabench.api import Detections, FoundParticles
from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F32, F64, I64, U8, Bool, Rows, triple
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, read_json

WORLD_FILE = "sabench-world.json"
# grey values of a bright particle's peak and of the brightest pixel: two particles may overlap
BRIGHT = 160.0
WHITE = int(np.iinfo(np.uint8).max)
BLOB_PX = 3  # width of a particle's image where it is not known
LENGTHS_MM = {"m": 1e3, "dm": 1e2, "cm": 10.0, "mm": 1.0, "um": 1e-3, "in": 25.4}
_UNIT_AXES: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def to_8_bits(images: F32) -> U8:
    """Scale images to grey values; a bright particle's peak is 1."""
    return np.asarray(np.clip(np.rint(BRIGHT * images), 0, WHITE).astype(np.uint8))


class ForeignFormatWarning(UserWarning):
    """Loss in a foreign format, or a change that was needed to read it."""


def note(sentence: str) -> None:
    """Warn of a loss or a change."""
    warnings.warn(ForeignFormatWarning(sentence), stacklevel=2)


def check_form(what: str, form: str, known: Any) -> None:
    """Raise an InputError for a format that is none of the words of a `Literal`."""
    if form not in get_args(known):
        raise InputError(f"{what}: expected a format of {', '.join(get_args(known))}, got {form!r}")


def unit_mm(unit: str) -> float:
    """Return a unit of length in mm; raises InputError for one that is not known."""
    if unit not in LENGTHS_MM:
        raise InputError(f"unit: expected one of {', '.join(LENGTHS_MM)}, got {unit!r}")
    return LENGTHS_MM[unit]


@dataclass(frozen=True)
class ForeignWorld:
    """World of another program in ours.

    Attributes
    ----------
    origin_mm : its origin.
    axes : its X, Y and Z axes as rows, a right-handed rotation.
    """

    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: Rows = _UNIT_AXES

    def into(self, points_mm: F64) -> F64:
        """Transform points (n, 3) of our world to the other."""
        return np.asarray((points_mm - np.asarray(self.origin_mm)) @ np.asarray(self.axes).T)

    def back(self, points_mm: F64) -> F64:
        """Transform points (n, 3) of the other world to ours."""
        return np.asarray(points_mm @ np.asarray(self.axes) + np.asarray(self.origin_mm))

    def write(self, folder: Path) -> None:
        """Write the file that converts results back into the world of the data set."""
        record = {"origin_mm": self.origin_mm, "axes": self.axes}
        (folder / WORLD_FILE).write_text(canonical_json(record), encoding="utf-8")


def read_world(path: Path) -> ForeignWorld:
    """Read the world of a folder or of one of the two above it; by default ours."""
    for folder in (path, *path.parents[:2]):
        file = folder / WORLD_FILE
        if file.is_file():
            record = read_json(file)
            try:
                origin, axes = np.array(record["origin_mm"], float), np.array(record["axes"], float)
                sound = origin.shape == (3,) and np.allclose(axes @ axes.T, np.eye(3), atol=1e-9)
            except (KeyError, TypeError, ValueError):
                sound = False
            if not sound:
                raise InputError(f"{file}: expected origin_mm and orthonormal axes, got {record!r}")
            return ForeignWorld(triple(origin), tuple(triple(row) for row in axes))
    return ForeignWorld()


_VECTORS = ("velocity_mm_s", "acceleration_mm_s2", "turn")
_OPTIONAL = ("trajectory", "intensity", "semi_axes_mm", *_VECTORS)


@dataclass(frozen=True)
class TrackTable:
    """Particles or bubbles, one row each; frames in rising order.

    Attributes
    ----------
    frame : (n,) numbers of frames as the files count them.
    position_mm : (n, 3).
    trajectory : (n,) numbers of trajectories; None where particles are not linked.
    intensity : (n,), of any scale.
    velocity_mm_s, acceleration_mm_s2 : (n, 3).
    semi_axes_mm : (n, 3) of bubbles; None for particles.
    turn : (n, 3, 3) directions of the semi-axes as rows; None: those of the world's axes.
    """

    frame: I64
    position_mm: F64
    trajectory: I64 | None = None
    intensity: F64 | None = None
    velocity_mm_s: F64 | None = None
    acceleration_mm_s2: F64 | None = None
    semi_axes_mm: F64 | None = None
    turn: F64 | None = None

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def kind(self) -> Literal["particles", "bubbles"]:
        """Kind of the rows, which is the task of their result."""
        return "particles" if self.semi_axes_mm is None else "bubbles"

    def rows(self, chosen: Bool | I64) -> TrackTable:
        """Return some of the rows."""
        columns = {
            name: None if getattr(self, name) is None else getattr(self, name)[chosen]
            for name in _OPTIONAL
        }
        return TrackTable(self.frame[chosen], self.position_mm[chosen], **columns)

    def sorted(self) -> TrackTable:
        """Sort the particles by frame, those of a frame as they were."""
        return self.rows(np.argsort(self.frame, kind="stable"))

    def of_frame(self, frame: int) -> TrackTable:
        """Return the particles of a frame."""
        low, high = np.searchsorted(self.frame, [frame, frame + 1])
        return self.rows(np.arange(low, high))

    def into(self, world: ForeignWorld) -> TrackTable:
        """Transform positions and vectors from our world to another."""
        return self._turned(world.into(self.position_mm), np.asarray(world.axes).T)

    def back(self, world: ForeignWorld) -> TrackTable:
        """Transform positions and vectors from another world to ours."""
        return self._turned(world.back(self.position_mm), np.asarray(world.axes))

    def _turned(self, position: F64, axes: F64) -> TrackTable:
        given = [name for name in _VECTORS if getattr(self, name) is not None]
        turned = {name: getattr(self, name) @ axes for name in given}
        return replace(self, position_mm=position, **turned)

    def estimate(self, frame: int) -> FoundParticles | Detections:
        """Return the particles or bubbles of a frame as an estimate.

        Raises InputError for two of one trajectory.
        """
        part = self.of_frame(frame)
        if part.semi_axes_mm is not None:
            turn = np.tile(np.eye(3), (len(part), 1, 1)) if part.turn is None else part.turn
            return Detections(part.position_mm, part.semi_axes_mm, turn, part.trajectory)
        return FoundParticles(
            part.position_mm,
            part.intensity,
            part.trajectory,
            velocity_mm_s=part.velocity_mm_s,
            acceleration_mm_s2=part.acceleration_mm_s2,
        )


@dataclass(frozen=True)
class Recording:
    """Cameras and times, which some formats store next to the particles.

    Attributes
    ----------
    cameras : in the world of the particles.
    times_s : time of each frame; some frames may have no particle.
    """

    cameras: Sequence[CameraModel]
    times_s: tuple[float, ...]

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.times_s)

    @property
    def interval_s(self) -> float:
        """Mean time between frames; 1 for a single frame."""
        steps = self.frames - 1
        return (self.times_s[-1] - self.times_s[0]) / steps if steps else 1.0


def of_estimates(found: Sequence[FoundParticles]) -> TrackTable:
    """Make the table of the estimates of frames 0, 1, ...

    Quantities that are missing in some frames are left out.
    """
    counts = [len(frame.position_mm) for frame in found]
    parts = {
        name: [getattr(frame, name) for frame in found]
        for name in ("position_mm", *_OPTIONAL)
        if all(getattr(frame, name, None) is not None for frame in found)
    }
    joined = {name: np.concatenate(part) for name, part in parts.items()}
    return TrackTable(np.repeat(np.arange(len(found)), counts), **joined)


def number_strangers(trajectory: I64) -> I64:
    """Give each particle without a trajectory (below zero) a new number."""
    out, lone = trajectory.copy(), trajectory < 0
    out[lone] = trajectory.max(initial=-1) + 1 + np.arange(lone.sum())
    return out
