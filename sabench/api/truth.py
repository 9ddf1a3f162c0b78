"""Truth of a frame: particles, bubbles, bodies, targets and their images.

Each class declares its arrays: see `sabench.api.arrays`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt

from sabench.api.arrays import Array, Arrays
from sabench.geometry.rigid_motion import Pose
from sabench.utils.arrays import F32, F64, I32, I64, Bool, triple
from sabench.utils.errors import InputError

Pattern = Literal["checkerboard", "circles", "charuco", "wand", "points"]
_ANY = float("inf")
_WIDEST_PX = 1000.0  # standard deviation of a particle image: wider than any sensor


class Truth(Arrays):
    """Base of truth; generators may make other types of numbers."""

    EXACT = False


def _number(value: float) -> F64:
    return np.array([value])


def _only(values: F64) -> float:
    return float(values[0])


@dataclass(frozen=True, repr=False)
class Particles(Truth):
    """Particles at one instant, world frame.

    Attributes
    ----------
    id : (n,) int64, unique within the frame; the same id in two frames is the same particle.
    position_mm : (n, 3).
    diameter_mm : (n,).
    velocity_mm_s : (n, 3).
    """

    ARRAYS = (
        Array("id", ("n",), np.int64, unique=True),
        Array("position_mm", ("n", 3), largest=_ANY),
        Array("diameter_mm", ("n",), largest=_ANY),
        Array("velocity_mm_s", ("n", 3), largest=_ANY),
    )

    id: I64
    position_mm: F64
    diameter_mm: F64
    velocity_mm_s: F64

    def __post_init__(self) -> None:
        self.check()
        if len(self) and not (self.diameter_mm > 0.0).all():
            raise InputError("diameter_mm: expected positive values")

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, repr=False)
class Bubbles(Truth):
    """Bubbles or droplets at one instant, world frame.

    They are spheroids, or ellipsoids of any axes.

    Attributes
    ----------
    id : (n,) int64, unique within the frame; the same id in two frames is the same bubble.
    center_mm : (n, 3).
    semi_axes_mm : (n, 3), along the rows of `turn`.
    turn : (n, 3, 3) rotations from the world to the bubble's own axes.
    velocity_mm_s : (n, 3).
    index : refractive index of their content.
    """

    GROUP = "bubbles"
    ARRAYS = (
        Array("id", ("n",), np.int64, unique=True),
        Array("center_mm", ("n", 3), largest=_ANY),
        Array("semi_axes_mm", ("n", 3), largest=_ANY),
        Array("turn", ("n", 3, 3), largest=_ANY),
        Array("velocity_mm_s", ("n", 3), largest=_ANY),
        Array("index", (1,), encode=_number, decode=_only),
    )

    id: I64
    center_mm: F64
    semi_axes_mm: F64
    turn: F64
    velocity_mm_s: F64
    index: float = 1.0

    def __post_init__(self) -> None:
        self.check()
        if len(self) and not (self.semi_axes_mm > 0.0).all():
            raise InputError("semi_axes_mm: expected positive values")
        if len(self) and np.abs(self.turn @ self.turn.transpose(0, 2, 1) - np.eye(3)).max() > 1e-9:
            raise InputError("turn: expected rotations")
        if self.index < 1.0:
            raise InputError(f"index: expected 1 or more, got {self.index:g}")

    def __len__(self) -> int:
        return len(self.id)

    def __getitem__(self, chosen: Bool | I64) -> Bubbles:
        """Select some of the bubbles."""
        rows = {one.name: getattr(self, one.name)[chosen] for one in self.ARRAYS[:-1]}
        return Bubbles(**rows, index=self.index)

    @property
    def radius_mm(self) -> F64:
        """Radii (n,) of balls of the same volumes."""
        return np.asarray(np.cbrt(self.semi_axes_mm.prod(axis=1)))

    @property
    def volume_mm3(self) -> F64:
        """Volumes (n,)."""
        return np.asarray(4.0 / 3.0 * np.pi * self.semi_axes_mm.prod(axis=1))

    @property
    def to_ball(self) -> F64:
        """Compute matrices M (n, 3, 3); x is inside where `|M (x - center)| < 1`."""
        return np.asarray(self.turn / self.semi_axes_mm[:, :, None])

    def reach_mm(self, direction: npt.ArrayLike) -> F64:
        """Compute how far (n,) each extends from its centre along a unit vector (3,)."""
        own = self.turn @ np.asarray(direction, dtype=np.float64)
        return np.asarray(np.linalg.norm(self.semi_axes_mm * own, axis=1))


@dataclass(frozen=True)
class Solid(Truth):
    """A closed surface at one instant, world frame.

    Attributes
    ----------
    vertices_mm : (v, 3).
    faces : (f, 3) int64, counter-clockwise as seen from outside.
    """

    GROUP = "bodies/{}"
    ARRAYS = (
        Array("vertices_mm", ("vertices", 3), largest=_ANY),
        Array("faces", ("faces", 3), np.int64, largest=_ANY),
    )

    vertices_mm: F64
    faces: I64


@dataclass(frozen=True)
class Materials(Truth):
    """Materials of the particles of a frame.

    Attributes
    ----------
    material : (n,) number of each particle's material in the scene's mixture.
    """

    ARRAYS = (Array("material", ("n",), np.int64),)

    material: I64


@dataclass(frozen=True)
class ExactFlow(Truth):
    """Exact flow of a frame on a lattice along the world's axes.

    Attributes
    ----------
    velocity_mm_s, gradient_1_s : (z, y, x, 3) and (z, y, x, 3, 3), du_i / dx_j.
    low_mm, step_mm : the first node, and the spacing of nodes.
    """

    GROUP = "flow"
    ARRAYS = (
        Array("velocity_mm_s", ("planes", "rows", "columns", 3), largest=_ANY),
        Array("gradient_1_s", ("planes", "rows", "columns", 3, 3), largest=_ANY),
        Array("low_mm", (3,), encode=np.array, decode=triple),
        Array("step_mm", (3,), encode=np.array, decode=triple),
    )

    velocity_mm_s: F64
    gradient_1_s: F64
    low_mm: tuple[float, float, float]
    step_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Target:
    """A calibration target in its own frame.

    Attributes
    ----------
    pattern : what it shows. The points of a checkerboard and of a ChArUco board are its inner
        corners, those of the others are centres; "points" stands for points in any places.
    columns, rows : of points; they are counted row by row.
    pitch_mm : distance of neighbours.
    mark_mm : diameter of a circle or a ball, edge of a ChArUco marker; 0 for a checkerboard.
    places_mm : places of the pattern "points"; empty for any other.
    points_mm : (columns x rows, 3), centred; a board lies in Z = 0, X along its rows, Y down its
        columns, and shows its pattern towards -Z. Or (n, 3), the places.
    """

    pattern: Pattern
    columns: int
    rows: int
    pitch_mm: float
    mark_mm: float
    places_mm: tuple[tuple[float, float, float], ...] = ()

    @classmethod
    def from_places(cls, places_mm: tuple[tuple[float, float, float], ...]) -> Target:
        """Make a target of points in any places, not all in one plane perhaps."""
        return cls("points", len(places_mm), 1, 0.0, 0.0, places_mm)

    @property
    def points_mm(self) -> F64:
        """The points, row by row."""
        if self.places_mm:
            return np.array(self.places_mm)
        across, down = (
            (np.arange(count) - (count - 1) / 2.0) * self.pitch_mm
            for count in (self.columns, self.rows)
        )
        x, y = np.meshgrid(across, down)
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


@dataclass(frozen=True)
class Placed:
    """Target and its position in every frame: truth."""

    target: Target
    poses: tuple[Pose, ...]

    @property
    def points_mm(self) -> F64:
        """World points (frame, point, 3)."""
        return np.stack([pose(self.target.points_mm) for pose in self.poses])


class TargetPose(Pose, Truth):
    """Rotation and position of the target in a frame."""

    ARRAYS = (
        Array("rotation", (3, 3), stored="turn", largest=_ANY),
        Array("position_mm", (3,), stored="place_mm", largest=_ANY),
    )


@dataclass(frozen=True)
class Sighting(Truth):
    """True images of a target's points in one camera.

    Attributes
    ----------
    pixel : (frame, point, 2) column and row; NaN where the camera does not see the point.
    outlier : (frame, point) whether the detected point lies elsewhere.
    """

    GROUP = "cameras/{}"
    OF_FRAME = False
    ARRAYS = (
        Array("pixel", ("frame", "point", 2), finite=False, largest=_ANY),
        Array("outlier", ("frame", "point"), np.bool_),
    )

    pixel: F64
    outlier: Bool


@dataclass(frozen=True)
class Prior:
    """Positions of a target that are known before a calibration.

    The arrays are those of `api.CalibrationCase`.
    """

    initial_mm: F64
    known_mm: F64
    known_sigma_mm: F64


@dataclass(frozen=True)
class TargetPoints(Arrays):
    """Observed pixels of a target's points and the positions known beforehand.

    The arrays are those of `api.CalibrationCase`.
    """

    OF_FRAME = False
    ARRAYS = (
        Array("pixels", ("camera", "frame", "point", 2), finite=False, largest=_ANY),
        Array("initial_mm", ("frame", "point", 3), stored="rough_mm", finite=False, largest=_ANY),
        Array("known_mm", ("frame", "point", 3), finite=False, largest=_ANY),
        Array("known_sigma_mm", ("frame", "point", 3), finite=False, largest=_ANY),
    )

    pixels: F64
    initial_mm: F64
    known_mm: F64
    known_sigma_mm: F64


NOTHING, BODY = -1, -2  # of `Sight.number`: BODY - k is the k-th body


@dataclass(frozen=True)
class Sight(Truth):
    """True view of a frame's n bubbles and bodies by one camera.

    Attributes
    ----------
    number : (rows, columns) int32 of the bubble (its row in the frame's bubbles) or body that each
        pixel's middle sees first: see `NOTHING`, `BODY`.
    depth_mm : (rows, columns) float32, of the surface there: along the wall's normal from its outer
        face, without a wall along the camera's axis from its pinhole; NaN for nothing.
    path_mm : (rows, columns) float32, length of the light path from the pinhole to it; NaN for
        nothing.
    visible : (n,) part of each bubble's outline that the camera sees: 1 for all of it, less where
        it is covered or outside the image.
    pixel : (n, 2) column and row of the centre; NaN where it has none.
    contour : (n, 48, 2) float32, column and row of the outline, whatever is in front of it; NaN
        where a line of sight does not reach it.
    error : mean relative standard error of the photons of pixels that show bubbles and bodies; None
        before they are rendered.
    """

    GROUP = "sights/{}"
    ARRAYS = (
        Array("number", ("rows", "columns"), np.int32, packed=True),
        Array("depth_mm", ("rows", "columns"), np.float32, finite=False, largest=_ANY, packed=True),
        Array("path_mm", ("rows", "columns"), np.float32, finite=False, largest=_ANY, packed=True),
        Array("visible", ("n",), finite=False, largest=_ANY),
        Array("pixel", ("n", 2), finite=False, largest=_ANY),
        Array("contour", ("n", "points", 2), np.float32, finite=False, largest=_ANY),
        Array(
            "error", (1,), optional=True, finite=False, largest=_ANY, encode=_number, decode=_only
        ),
    )

    number: I32
    depth_mm: F32
    path_mm: F32
    visible: F64
    pixel: F64
    contour: F32
    error: float | None = None


@dataclass(frozen=True)
class ParticleView(Truth):
    """Images of a frame's n particles in one camera.

    Attributes
    ----------
    pixel : (n, 2) column, row of the centre; NaN where there is none.
    photons : (n,) mean number that reaches the whole sensor plane in one exposure; 0 where an
        occluder stops the chief ray.
    sigma_px : (n,) standard deviation of the Gaussian image.
    visible : (n,) whether the centre has a light path that nothing obstructs, and lies on the
        sensor.
    """

    GROUP = "cameras/{}"
    ARRAYS: ClassVar[tuple[Array, ...]] = (
        Array("pixel", ("n", 2), finite=False, largest=_ANY),
        Array("photons", ("n",), largest=_ANY),
        Array("sigma_px", ("n",), finite=False, largest=_WIDEST_PX, file_dtype=np.float32),
        Array("visible", ("n",), np.bool_),
    )

    pixel: F64
    photons: F64
    sigma_px: F64
    visible: Bool

    def __post_init__(self) -> None:
        if not np.isfinite(self.pixel[self.visible]).all():
            raise InputError("pixel of visible particles: expected finite values")
