"""Tables of a calibration's configuration, the file calibration.toml.

docs/using/calibrating.md describes it.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sabench.geometry.sensor_tilt import UPRIGHT
from sabench.scenes.cameras import DistortionSpec
from sabench.scenes.wall import WallTable
from sabench.utils.fields import Direction, Positive, Table, TiltAngle, Unknown, Vector

_UP = (0.0, -1.0, 0.0)


class TargetSpec(Table):
    """Calibration target with a regular pattern."""

    pattern: Literal["checkerboard", "circles", "charuco", "wand"]
    columns: Annotated[int, Field(ge=1, le=200)]
    rows: Annotated[int, Field(ge=1, le=200)]
    pitch_mm: Positive
    mark_mm: Annotated[float, Field(ge=0.0)] = 0.0


class ArraySpec(Table):
    """Properties that all cameras share, as far as they are known."""

    rows: Annotated[int, Field(ge=8, le=20000)]
    columns: Annotated[int, Field(ge=8, le=20000)]
    pixel_mm: Positive
    focal_length_mm: Positive
    principal_distance_mm: Positive | None = Field(None, description="by default the focal length")


class CameraSpec(Table):
    """Initial guess of a camera's position, and the point that it is aimed at.

    Its lens and sensor, where they are not those of the array.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
    center_mm: Vector
    aim_mm: Vector
    up: Direction | None = Field(
        None, description="direction of the world that its images show upwards"
    )
    pixel_mm: Positive | None = None
    focal_length_mm: Positive | None = None
    principal_distance_mm: Positive | None = None
    principal_point_px: tuple[float, float] | None = Field(
        None, description="column and row; by default the centre of the image"
    )
    distortion: DistortionSpec = DistortionSpec()
    tilt_deg: tuple[TiltAngle, TiltAngle] = Field(
        UPRIGHT, description="of the sensor against the lens"
    )


class KnownSpec(Table):
    """Point of the target, or a whole frame, whose position was measured.

    Coordinates that were not measured are left out.
    """

    frame: Annotated[int, Field(ge=0)]
    point: Annotated[int, Field(ge=0)] | None = Field(
        None, description="by default all points: the target stands in a plane of that coordinate"
    )
    x_mm: float | None = None
    y_mm: float | None = None
    z_mm: float | None = None
    sigma_mm: Positive = 0.05


class Configuration(Table):
    """Content of calibration.toml."""

    target: TargetSpec | None = None
    target_points: str | None = Field(
        None,
        min_length=1,
        description="file of a rigid target of any shape: columns point,x_mm,y_mm,z_mm; without it "
        "and without `target`, points.csv has the measured place of every point",
    )
    up: Direction = Field(_UP, description="direction of the world that images show upwards")
    array: ArraySpec | None = None
    wall: WallTable | None = None
    cameras: tuple[CameraSpec, ...] = ()
    known_cameras: str | None = Field(
        None,
        min_length=1,
        description="cameras.json of an earlier calibration, as without the tank, in place of "
        "`array` and `cameras`: only the wall and the target are unknown",
    )
    target_mm: Vector | None = Field(
        None,
        description="initial guess of the target's position; by default the mean of aim_mm",
    )
    known: tuple[KnownSpec, ...] = ()
    unknown: tuple[Unknown, ...] = Field(
        (), description="parameters of lenses and wall to be found besides the focal lengths"
    )
