"""Estimates: results of solvers, with names, shapes and types of their arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.api.arrays import Array, Arrays
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.camera_records import decode_cameras, encode_cameras
from sabench.geometry.rigid_motion import cross
from sabench.utils.arrays import F32, F64, I64, LARGEST, Bool, triple
from sabench.utils.errors import InputError


class Estimate(Arrays):
    """Base of estimates."""


@dataclass(frozen=True, repr=False)
class Reconstruction(Estimate):
    """Reconstructed intensities of one frame.

    Attributes
    ----------
    volume : (z, y, x) float32 intensities on the grid, zero where there is nothing.
    particles_mm : (n, 3) positions if the algorithm finds particles itself, else None: the score
        then detects them in the volume.
    """

    ARRAYS = (
        Array("volume", ("z", "y", "x"), np.float32, largest=float("inf")),
        Array("particles_mm", ("n", 3), optional=True),
    )

    volume: F32
    particles_mm: F64 | None = None

    def _picture(self) -> bytes:
        """Draw the largest intensity along Z."""
        from sabench.plotting.pictures import slice_picture

        return slice_picture(self.volume.max(axis=0, keepdims=True), (slice(None),) * 3)


@dataclass(frozen=True, repr=False)
class FoundParticles(Estimate):
    """Particles found in one frame.

    Attributes
    ----------
    position_mm : (n, 3).
    intensity : (n,), of any scale, if the algorithm estimates it.
    light : (n, camera) in each camera, of any scale.
    covariance_mm2 : (n, 3, 3) of the positions' errors.
    probability : (n,) that there is a particle.
    velocity_mm_s, velocity_covariance : (n, 3) and (n, 3, 3) mm2/s2, at the time of the frame.
    acceleration_mm_s2, acceleration_covariance : (n, 3) and (n, 3, 3) mm2/s4.
    trajectory : (n,) numbers of trajectories, different within a frame: particles with the same
        number in several frames are the same particle. None: sabench links them.

    Raises InputError for arrays of other shapes or types, values that are not finite, two particles
    of one trajectory, a probability that is none, or a covariance that is none.
    """

    GROUP = "particles"
    ARRAYS = (
        Array("position_mm", ("n", 3)),
        Array("intensity", ("n",), optional=True),
        Array("light", ("n", "camera"), optional=True),
        Array("covariance_mm2", ("n", 3, 3), optional=True),
        Array("probability", ("n",), optional=True),
        Array("velocity_mm_s", ("n", 3), optional=True),
        Array("velocity_covariance", ("n", 3, 3), optional=True),
        Array("acceleration_mm_s2", ("n", 3), optional=True),
        Array("acceleration_covariance", ("n", 3, 3), optional=True, largest=LARGEST**2),
        Array("trajectory", ("n",), np.int64, optional=True, unique=True, stored="track"),
    )

    position_mm: F64
    intensity: F64 | None = None
    trajectory: I64 | None = None
    light: F64 | None = None
    covariance_mm2: F64 | None = None
    probability: F64 | None = None
    velocity_mm_s: F64 | None = None
    velocity_covariance: F64 | None = None
    acceleration_mm_s2: F64 | None = None
    acceleration_covariance: F64 | None = None

    def __post_init__(self) -> None:
        self.check()
        if self.probability is not None:
            wrong = self.probability[(self.probability < 0.0) | (self.probability > 1.0)]
            if len(wrong):
                raise InputError(f"probability: expected values from 0 to 1, got {wrong[0]:g}")
        for name in ("covariance_mm2", "velocity_covariance", "acceleration_covariance"):
            value = getattr(self, name)
            if value is not None:
                _check_covariances(name, value)


def _check_covariances(name: str, value: F64) -> None:
    """Check matrices (n, 3, 3); rounding may leave their halves a little uneven."""
    scale = np.abs(value).max(axis=(1, 2), initial=0.0)
    uneven = np.abs(value - value.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0) > 1e-6 * scale
    even = np.where(uneven[:, None, None], np.eye(3), value)
    wrong = np.flatnonzero(uneven | ~(np.linalg.eigvalsh(even)[:, 0] > 0.0))
    if len(wrong):
        raise InputError(
            f"{name}: expected symmetric matrices with positive eigenvalues, got another one for "
            f"particle {wrong[0]}"
        )


@dataclass(frozen=True, repr=False)
class Calibration(Estimate):
    """Estimated cameras.

    Attributes
    ----------
    cameras : in the order of the case.
    points_mm : (frame, point, 3) positions of the target's points, world frame, if the algorithm
        estimates them itself, else None: the score then intersects the cameras' lines of sight.
    used : (camera, frame, point) observations that the algorithm accepted, None: all.
    remarks : sentences for the user, such as on what the data did not determine; not stored.
    """

    GROUP = "calibration"
    OF_FRAME = False
    ARRAYS = (
        Array("cameras", ("bytes",), np.uint8, encode=encode_cameras, decode=decode_cameras),
        Array("points_mm", ("frame", "point", 3), optional=True),
        Array("used", ("camera", "frame", "point"), np.bool_, optional=True),
    )

    cameras: tuple[CameraModel, ...]
    points_mm: F64 | None = None
    used: Bool | None = None
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class Velocity(Estimate):
    """Velocity field on a lattice along the world's axes, or in a plane.

    Attributes
    ----------
    low_mm, step_mm : the first node, and the spacing of nodes along the lattice's x, y and z.
    velocity_mm_s : (z, y, x, 3) along the world's axes, finite everywhere: where nothing was
        measured it is interpolated from the neighbours.
    valid : (z, y, x) where it was measured.
    plane_axes : (2, 3) unit vectors of the lattice's x and y, if the field lies in a plane and only
        its components in this plane were measured (planar PIV). The lattice then has a single plane
        of nodes, `low_mm` is a point of the world, and `step_mm[2]` the depth that a node
        represents. None: the lattice lies along the world's axes, and all components were measured.

    Raises InputError for a spacing that is not a positive number, a lattice without nodes, axes
    that are no unit vectors at right angles, or a planar field with several planes of nodes.
    """

    GROUP = "velocity"
    ARRAYS = (
        Array("valid", ("planes", "rows", "columns"), np.bool_),
        Array("velocity_mm_s", ("planes", "rows", "columns", 3)),
        Array("low_mm", (3,), encode=np.array, decode=triple),
        Array("step_mm", (3,), encode=np.array, decode=triple),
        Array("plane_axes", (2, 3), optional=True),
    )

    low_mm: tuple[float, float, float]
    step_mm: tuple[float, float, float]
    velocity_mm_s: F64
    valid: Bool
    plane_axes: F64 | None = None

    def __post_init__(self) -> None:
        if not all(0.0 < step < float("inf") for step in self.step_mm):
            raise InputError(f"step_mm: expected positive numbers, got {self.step_mm}")
        if not self.valid.size:
            raise InputError(f"valid: expected nodes (z, y, x), got {self.valid.shape}")
        axes, planes = self.plane_axes, len(self.valid)
        if axes is None:
            return
        if axes.shape != (2, 3) or not np.allclose(axes @ axes.T, np.eye(2), atol=1e-6):
            raise InputError(
                "plane_axes: expected two unit vectors (2, 3) at right angles, got "
                f"{np.asarray(axes).tolist()}"
            )
        if planes != 1:
            raise InputError(
                f"plane_axes: expected a field of one plane of nodes, got {planes} planes"
            )

    @property
    def axes(self) -> F64:
        """Unit vectors (3, 3) of the lattice's x, y and z."""
        if self.plane_axes is None:
            return np.eye(3)
        return np.vstack([self.plane_axes, cross(*self.plane_axes)])

    def components(self, velocity_mm_s: F64) -> F64:
        """Resolve velocities (..., 3) along the lattice's axes, as far as measured."""
        along = velocity_mm_s @ self.axes.T
        return np.asarray(along if self.plane_axes is None else along * [1.0, 1.0, 0.0])

    def in_own_axes(self) -> Velocity:
        """Express the field in the lattice's own axes, with the world's origin."""
        if self.plane_axes is None:
            return self
        low = triple(self.axes @ np.asarray(self.low_mm))
        return Velocity(low, self.step_mm, self.velocity_mm_s @ self.axes.T, self.valid)

    @property
    def positions_mm(self) -> F64:
        """Nodes (z, y, x, 3)."""
        steps = np.moveaxis(np.indices(self.valid.shape)[::-1], 0, -1) * np.asarray(self.step_mm)
        return np.asarray(np.asarray(self.low_mm) + steps @ self.axes)

    def _picture(self) -> bytes:
        """Draw speeds and vectors in the lattice's middle plane."""
        from sabench.plotting.drawing import Slice, draw_panel

        own = self.in_own_axes()
        plane = own.velocity_mm_s[len(self.valid) // 2]
        ends = zip(own.low_mm, own.step_mm, plane.shape[1::-1], strict=False)
        x, y = (low + step * np.arange(count) for low, step, count in ends)
        speeds = Slice("mm/s", x, y, np.linalg.norm(plane, axis=-1), arrows=plane[..., :2])
        return draw_panel("x, mm", "y, mm", speeds)


@dataclass(frozen=True, repr=False)
class Detections(Estimate):
    """Bubbles found in one frame.

    Attributes
    ----------
    center_mm, semi_axes_mm : (n, 3).
    turn : (n, 3, 3) rotations from the world to the bubbles' own axes: the rows are the
        directions of the semi-axes.
    trajectory : (n,) numbers of trajectories, different within a frame. None: sabench links them.

    Raises InputError for arrays of other shapes, values that are not finite, semi-axes that are not
    positive, matrices that are no rotations, or two bubbles of one trajectory.
    """

    GROUP = "bubbles"
    ARRAYS = (
        Array("center_mm", ("n", 3)),
        Array("semi_axes_mm", ("n", 3)),
        Array("turn", ("n", 3, 3)),
        Array("trajectory", ("n",), np.int64, optional=True, unique=True, stored="track"),
    )

    center_mm: F64
    semi_axes_mm: F64
    turn: F64
    trajectory: I64 | None = None

    def __post_init__(self) -> None:
        self.check()
        if not len(self.center_mm):
            return
        if self.semi_axes_mm.min() <= 0.0:
            got = self.semi_axes_mm.min()
            raise InputError(f"semi_axes_mm: expected positive lengths, got {got:g}")
        if np.abs(self.turn @ self.turn.transpose(0, 2, 1) - np.eye(3)).max() > 1e-6:
            raise InputError("turn: expected rotations")

    @classmethod
    def balls(cls, center_mm: F64, radius_mm: F64) -> Detections:
        """Build detections of spheres from centres (n, 3) and radii (n,)."""
        return cls(
            np.asarray(center_mm, dtype=np.float64),
            np.repeat(radius_mm[:, None], 3, axis=1),
            np.tile(np.eye(3), (len(radius_mm), 1, 1)),
        )

    @property
    def radius_mm(self) -> F64:
        """Radii (n,) of balls of the same volumes."""
        return np.asarray(np.cbrt(self.semi_axes_mm.prod(axis=1)))
