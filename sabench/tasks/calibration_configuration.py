"""Tables of a calibration's configuration, the file calibration.toml.

docs/using/calibrating.md describes it.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sabench.api.truth import Pattern
from sabench.geometry.sensor_tilt import UPRIGHT
from sabench.scenes.cameras import DistortionSpec
from sabench.scenes.wall import WallTable
from sabench.utils.fields import LensNumber, Positive, Table, TiltAngle, Vector


class TargetSpec(Table):
    """Calibration target that the cameras see."""

    pattern: Pattern
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
    """Point of the target whose position was measured.

    Coordinates that were not measured are left out.
    """

    frame: Annotated[int, Field(ge=0)]
    point: Annotated[int, Field(ge=0)]
    x_mm: float | None = None
    y_mm: float | None = None
    z_mm: float | None = None
    sigma_mm: Positive = 0.05


class Configuration(Table):
    """Content of calibration.toml."""

    target: TargetSpec
    array: ArraySpec
    wall: WallTable | None = None
    cameras: Annotated[tuple[CameraSpec, ...], Field(min_length=2)]
    target_mm: Vector = Field(description="initial guess of the target's position")
    known: tuple[KnownSpec, ...] = ()
    unknown: tuple[LensNumber, ...] = Field(
        (), description="parameters of the lenses to be found besides their focal lengths"
    )
