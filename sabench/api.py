"""What a plug-in implements: a generator makes truth, a solver makes an estimate from what an experimenter would see.

A plug-in is a file in generators/ or solvers/ with one class; its `name` is the file's stem, the first line of its docstring
is what `sabench list` shows, its `Parameters` are what a scene or `-p name=value` may set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sabench.arrays import F32, F64, I64, U16, Bool
from sabench.errors import InputError
from sabench.optics.camera import Camera
from sabench.optics.model import CameraModel
from sabench.scene import LensNumber, Vector
from sabench.volume import Grid
from sabench.world import Bubbles, Domain, Particles, Pose, Solid, Target

Track = Literal["reconstruction", "particles", "calibration", "velocimetry", "bubbles", "see_through"]
Shown = Literal["particles", "target", "bubbles", "code"]  # what a data set's frames show


class Parameters(BaseModel):
    """Base of a plug-in's parameters: immutable, unknown names refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class FileParameters(Parameters):
    """Base of the parameters of a generator that reads a file; a data set keeps a copy of it."""

    file: str = Field(description="its path, from the scene file's folder")
    sha256: str | None = Field(None, pattern="^[0-9a-f]{64}$", description="of the file: filled in where it is not given")


class PlugIn:
    """What all plug-ins have."""

    name: ClassVar[str]
    references: ClassVar[tuple[str, ...]] = ()
    Parameters: ClassVar[type[Parameters]] = Parameters

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters


class Generator(PlugIn):
    """Base of a generator of particles: `particles` makes one frame of truth, the same for the same arguments whatever else is generated."""

    makes: ClassVar[str] = "particles"

    def particles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Particles:
        """Particles of a frame at a time; draw from `sabench.seeds.stream(seed, ...)` only."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement particles()")


class Flow(PlugIn):
    """Base of a velocity field that carries particles: `velocity`, and `gradient` where it is known exactly."""

    makes: ClassVar[str] = "flow"

    def check(self, domain: Domain) -> None:
        """Raise an InputError if the field is not known in all of the volume."""

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Velocities (n, 3) in mm/s at points (n, 3) of the world frame."""
        raise NotImplementedError(f"flow {type(self).__name__} must implement velocity()")

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Gradients (n, 3, 3) in 1/s, du_i / dx_j."""
        raise NotImplementedError(f"flow {type(self).__name__} must implement gradient()")


class BubbleParameters(Parameters):
    """Base of a generator of bubbles: what is in them."""

    index: float = Field(1.0, ge=1.0, le=4.0, description="refractive index of what is inside: 1 for air, 1.333 for drops of water")
    overlap: bool = Field(False, description="true: bubbles may reach into each other, as if a thin film of the fluid were between them")


class BubbleGenerator(PlugIn):
    """Base of a generator of bubbles or droplets: `bubbles` makes one frame of truth, the same for the same arguments."""

    makes: ClassVar[str] = "bubbles"
    Parameters: ClassVar[type[BubbleParameters]] = BubbleParameters

    def bubbles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Bubbles:
        """Bubbles of a frame at a time; draw from `sabench.seeds.stream(seed, ...)` only."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement bubbles()")


class Material(BaseModel):
    """What a solid is made of."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    kind: Literal["matte", "principled", "measured", "liquid"] = Field("matte", description="how it reflects, or liquid: transparent")
    reflectance: float = Field(0.5, ge=0.0, le=1.0, description="of matte and principled materials")
    roughness: float = Field(0.5, ge=0.0, le=1.0, description="of principled materials")
    metallic: float = Field(0.0, ge=0.0, le=1.0, description="of principled materials")
    specular: float = Field(0.5, ge=0.0, le=1.0, description="of principled materials")
    index: float = Field(1.333, ge=1.0, le=4.0, description="refractive index of a liquid")
    measured: str | None = Field(None, description="whole path of a measured material in the RGL format (.bsdf), read when it is rendered")


class SolidParameters(Parameters):
    """Base of a generator of a body: where it is, how it moves, what it is made of."""

    place_mm: Vector = Field((0.0, 0.0, 0.0), description="where its own origin is at the start")
    turn_deg: Vector = Field((0.0, 0.0, 0.0), description="rotation vector, world frame: its direction is the axis, its length the angle")
    velocity_mm_s: Vector = (0.0, 0.0, 0.0)
    spin_deg_s: Vector = Field((0.0, 0.0, 0.0), description="rotation vector a second, about its own axes")
    material: Material = Material()


class SolidGenerator(PlugIn):
    """Base of a generator of a body: `body` makes it in its own frame; `sabench.solids` brings it to its place."""

    makes: ClassVar[str] = "solids"
    Parameters: ClassVar[type[SolidParameters]] = SolidParameters

    def body(self, seed: int) -> Solid:
        """The closed surface in its own frame, mm."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement body()")


@dataclass(frozen=True)
class Code:
    """What is written on a body, in its own frame.

    Attributes
    ----------
    points_mm : (cell, point, 3) points spread over each cell.
    dark : (cell,) which cells let no light through.
    """

    points_mm: F64
    dark: Bool


class CodeGenerator(SolidGenerator):
    """Base of a generator of a body with a code that is to be read through what is in front of it."""

    def code(self, seed: int) -> Code:
        """What is written on it, in its own frame."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement code()")


class TargetGenerator(PlugIn):
    """Base of a generator of calibration targets: one target, which every frame shows at another place."""

    makes: ClassVar[str] = "targets"

    def target(self) -> Target:
        """The target itself, in its own frame."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement target()")

    def pose(self, domain: Domain, seed: int, frame: int, frames: int) -> Pose:
        """Where a frame shows it; draw from `sabench.seeds.stream(seed, ...)` only."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement pose()")


@dataclass(frozen=True)
class Observation:
    """One frame as an experimenter has it.

    Attributes
    ----------
    images : (camera, row, column) uint16 grey values.
    cameras : calibrated cameras in the order of the images; each knows its wall. What they say may be off: see `[calibration]` in a scene.
    grid : the voxels to reconstruct.
    black_dn, white_dn : grey values of no light and of saturation.

    Raises
    ------
    InputError
        Images of another kind, number or size than the cameras', or a black level that is not below the white one.
    """

    images: U16
    cameras: tuple[CameraModel, ...]
    grid: Grid
    black_dn: float
    white_dn: float

    def __post_init__(self) -> None:
        if not self.black_dn < self.white_dn:
            raise InputError(f"black_dn: expected it below white_dn, got {self.black_dn:g} and {self.white_dn:g}")
        _check_kind(self.images)
        _check_sizes(self.images, self.cameras)


def _check_kind(images: Any) -> None:
    """Grey values are 16-bit numbers without sign, in one array."""
    if not isinstance(images, np.ndarray):
        raise InputError(f"images: expected one uint16 array (camera, row, column), got {type(images).__name__}")
    if images.dtype != np.uint16:
        raise InputError(f"images: expected uint16 grey values, got {images.dtype}{_oddities(images)}")
    if images.ndim != 3:
        raise InputError(f"images: expected the shape (camera, row, column), got {images.shape}")


def _oddities(values: Any) -> str:
    """What of other numbers cannot be a grey value."""
    if values.dtype.kind not in "fi":
        return ""
    counts = {"NaN or infinite": int((~np.isfinite(values)).sum()), "negative": int((values < 0).sum())}
    return "".join(f", {count} of them {what}" for what, count in counts.items() if count)


def _check_sizes(images: U16, cameras: tuple[CameraModel, ...]) -> None:
    """Every camera has an image, of its own size."""
    if not cameras or len(images) != len(cameras):
        without = ", ".join(camera.name for camera in cameras[len(images) :])
        raise InputError(f"images: expected one for each of {len(cameras)} cameras, got {len(images)}{': none for ' + without if without else ''}")
    rows, columns = images.shape[1:]
    for camera in cameras:
        if (camera.rows, camera.columns) != (rows, columns):
            raise InputError(f"{camera.name}: expected an image of {camera.rows} x {camera.columns} pixels (rows x columns), got {rows} x {columns}")


@dataclass(frozen=True)
class Reconstruction:
    """A solver's estimate of one frame.

    Attributes
    ----------
    volume : (z, y, x) float32 intensities on the grid, zero where there is nothing.
    particles_mm : (n, 3) positions if the algorithm finds particles itself, else None: the score then detects them in the volume.
    """

    volume: F32
    particles_mm: F64 | None = None


class Solver(PlugIn):
    """Base of a reconstruction algorithm: `solve` turns one observation into one reconstruction."""

    track: ClassVar[Track] = "reconstruction"
    sees: ClassVar[Shown] = "particles"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Reconstruction:
        """Reconstruct one frame."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


@dataclass(frozen=True)
class Film:
    """Frames that follow each other, as an experimenter has them: each is read when it is asked for, and none is kept.

    Attributes
    ----------
    cameras, grid : of all frames, as in `Observation`.
    times_s : when each frame was taken.
    load : reads a frame, counted from 0.
    """

    cameras: tuple[CameraModel, ...]
    grid: Grid
    times_s: tuple[float, ...]
    load: Callable[[int], Observation]

    @classmethod
    def of(cls, frames: list[Observation], interval_s: float = 1.0) -> Film:
        """A film of frames that are in memory."""
        return cls(frames[0].cameras, frames[0].grid, tuple(interval_s * i for i in range(len(frames))), frames.__getitem__)

    def __len__(self) -> int:
        return len(self.times_s)

    def __getitem__(self, frame: int) -> Observation:
        if not 0 <= frame < len(self):
            raise IndexError(f"frame {frame}: expected 0 to {len(self) - 1}")
        return self.load(frame)

    def __iter__(self) -> Iterator[Observation]:
        return (self[frame] for frame in range(len(self)))


@dataclass(frozen=True)
class FoundParticles:
    """Particles that were found in one frame.

    Attributes
    ----------
    position_mm : (n, 3).
    intensity : (n,), of any scale, if the algorithm knows it.
    track : (n,) numbers of tracks, different within a frame: particles of one number in several frames are one. None: the harness links them.

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
                raise InputError(f"track: expected different numbers, got {values[times.argmax()]} for {times.max()} particles")


def _check_numbers(name: str, value: Any, shape: tuple[int, ...], kind: type[np.generic]) -> None:
    if not isinstance(value, np.ndarray) or value.shape != shape or value.dtype != kind or not np.isfinite(value).all():
        got = f"{value.dtype} of shape {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise InputError(f"{name}: expected finite {np.dtype(kind)} values of shape {shape}, got {got}")


class ParticleSolver(PlugIn):
    """Base of an algorithm that finds particles, or tracks them: `solve` turns a film into the particles of each of its frames."""

    track: ClassVar[Track] = "particles"
    sees: ClassVar[Shown] = "particles"

    def skip(self, case: Film) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Film) -> list[FoundParticles]:
        """Find the particles of every frame; all of them with track numbers, or none."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


@dataclass(frozen=True)
class CalibrationCase:
    """A calibration as an experimenter has it.

    Attributes
    ----------
    target : what was shown, in its own frame.
    pixels : (camera, frame, point, 2) column and row of the target's m points; NaN where one was not found.
    cameras : roughly known cameras; each knows its wall.
    rough_mm : (frame, point, 3) roughly known places of the target's points, world frame; NaN where nothing is known.
    known_mm : (frame, point, 3) coordinates that were measured by other means; NaN where they were not.
    known_sigma_mm : the same shape, their standard deviations.
    unknown : what nobody has measured of the lenses besides their focal lengths: "principal_point" and names of coefficients of distortion.

    Raises
    ------
    InputError
        Arrays of other shapes, or a camera that found nothing.
    """

    target: Target
    pixels: F64
    cameras: tuple[Camera, ...]
    rough_mm: F64
    known_mm: F64
    known_sigma_mm: F64
    unknown: tuple[LensNumber, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.target.points_mm)
        if self.pixels.ndim != 4 or self.pixels.shape[::2] != (len(self.cameras), count) or self.pixels.shape[3] != 2:
            raise InputError(f"pixels: expected the shape ({len(self.cameras)}, frames, {count}, 2), got {self.pixels.shape}")
        expected = (self.pixels.shape[1], count, 3)
        for name in ("rough_mm", "known_mm", "known_sigma_mm"):
            if getattr(self, name).shape != expected:
                raise InputError(f"{name}: expected the shape {expected}, got {getattr(self, name).shape}")
        for camera, found in zip(self.cameras, self.found, strict=True):
            if not found.any():
                raise InputError(f"{camera.name}: expected it to see some of the target, but not one of its points was found")

    @property
    def found(self) -> Bool:
        """Which points were found: (camera, frame, point)."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))


@dataclass(frozen=True)
class Calibration:
    """A calibration's result.

    Attributes
    ----------
    cameras : in the order of the case.
    points_mm : (frame, point, 3) places of the target's points, world frame, if the algorithm finds them itself, else None: the score then
        intersects the cameras' lines of sight.
    used : (camera, frame, point) observations that the algorithm took for good, None: all.
    """

    cameras: tuple[CameraModel, ...]
    points_mm: F64 | None = None
    used: Bool | None = None


class CalibrationSolver(PlugIn):
    """Base of a calibration algorithm: `solve` turns all observations of a target into cameras."""

    track: ClassVar[Track] = "calibration"
    sees: ClassVar[Shown] = "target"

    def skip(self, case: CalibrationCase) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: CalibrationCase) -> Calibration:
        """Calibrate an array."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class SelfCalibrationSolver(PlugIn):
    """Base of an algorithm that corrects cameras by images of particles: `solve` turns one observation into cameras."""

    track: ClassVar[Track] = "calibration"
    sees: ClassVar[Shown] = "particles"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Calibration:
        """Correct the cameras of an array by one frame."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


@dataclass(frozen=True)
class VolumePair:
    """Two reconstructed volumes of one grid, some time apart.

    Attributes
    ----------
    first, second : (z, y, x) float32 intensities.
    grid : their voxels.
    interval_s : the time between them.

    Raises
    ------
    InputError
        Volumes of another shape than the grid's, or without any contrast.
    """

    first: F32
    second: F32
    grid: Grid
    interval_s: float

    def __post_init__(self) -> None:
        for name in ("first", "second"):
            volume = getattr(self, name)
            if volume.shape != self.grid.shape:
                raise InputError(f"{name} volume: expected {self.grid.shape} voxels (z, y, x) as its grid has, got {volume.shape}")
            if not np.isfinite(volume).all():
                raise InputError(f"{name} volume: expected finite intensities, got NaN or infinite ones")
            if volume.min() == volume.max():
                raise InputError(f"{name} volume: expected one that shows something, got {volume.flat[0]:g} everywhere")


@dataclass(frozen=True)
class Velocity:
    """A velocity field on a lattice along the world's axes.

    Attributes
    ----------
    low_mm, step_mm : the first node and the spacing of nodes, as (x, y, z).
    velocity_mm_s : (z, y, x, 3), finite everywhere: where nothing was measured it is what the neighbours say.
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
        x, y, z = (low + step * np.arange(count) for low, step, count in zip(self.low_mm, self.step_mm, counts, strict=True))
        return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1)


class VelocimetryParameters(Parameters):
    """Which solver reconstructs the volumes."""

    reconstruction: str = Field("block_mart", description="name of a reconstruction solver, with its own defaults")


class VelocimetrySolver(PlugIn):
    """Base of a velocimetry algorithm: `solve` turns two volumes into a velocity field."""

    track: ClassVar[Track] = "velocimetry"
    sees: ClassVar[Shown] = "particles"
    Parameters = VelocimetryParameters

    def skip(self, case: VolumePair) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: VolumePair) -> Velocity:
        """Measure the velocity field of a pair."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


@dataclass(frozen=True)
class Detections:
    """Bubbles that were found in one frame.

    Attributes
    ----------
    center_mm, semi_axes_mm : (n, 3).
    turn : (n, 3, 3) rotations from the world to the bubbles' own axes, whose rows the semi-axes lie along.

    Raises
    ------
    InputError
        Arrays of other shapes, values that are not finite, semi-axes that are not positive, or matrices that are no rotations.
    """

    center_mm: F64
    semi_axes_mm: F64
    turn: F64

    def __post_init__(self) -> None:
        count = len(self.center_mm)
        for name, expected in {"center_mm": (count, 3), "semi_axes_mm": (count, 3), "turn": (count, 3, 3)}.items():
            _check_numbers(name, getattr(self, name), expected, np.float64)
        if count and self.semi_axes_mm.min() <= 0.0:
            raise InputError(f"semi_axes_mm: expected positive lengths, got {self.semi_axes_mm.min():g}")
        if count and np.abs(self.turn @ self.turn.transpose(0, 2, 1) - np.eye(3)).max() > 1e-6:
            raise InputError("turn: expected rotations")

    @classmethod
    def balls(cls, center_mm: F64, radius_mm: F64) -> Detections:
        """Spheres (n, 3), (n,)."""
        return cls(np.asarray(center_mm, dtype=np.float64), np.repeat(radius_mm[:, None], 3, axis=1), np.tile(np.eye(3), (len(radius_mm), 1, 1)))

    @property
    def radius_mm(self) -> F64:
        """Radii (n,) of balls of the same volumes."""
        return np.asarray(np.cbrt(self.semi_axes_mm.prod(axis=1)))


class BubbleSolver(PlugIn):
    """Base of an algorithm that finds bubbles: `solve` turns one observation into detections."""

    track: ClassVar[Track] = "bubbles"
    sees: ClassVar[Shown] = "bubbles"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Detections:
        """Find the bubbles of one frame."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class SeeThroughSolver(PlugIn):
    """Base of an algorithm that looks through what is in front of a body: `solve` turns one observation into a stack of planes."""

    track: ClassVar[Track] = "see_through"
    sees: ClassVar[Shown] = "code"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Reconstruction:
        """Planes in which bright is what lets light through."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


AnySolver = ParticleSolver | BubbleSolver | SeeThroughSolver | Solver | CalibrationSolver | SelfCalibrationSolver | VelocimetrySolver
