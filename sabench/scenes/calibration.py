"""Tables of a scene for calibration.

Errors of the nominal cameras and of the detection of targets.
"""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import Field, model_validator

from sabench.utils.validation import LensNumber, Positive, Table, WallNumber


class KnownPoint(Table):
    """Point of a target with a position measured by other means."""

    frame: int = Field(0, ge=0, description="frame that shows the target")
    point: int = Field(ge=0, description="number of the point")
    axes: Annotated[str, Field(pattern="^x?y?z?$", min_length=1)] = Field(
        "xyz", description="known coordinates"
    )
    sigma_mm: Positive = Field(0.05, description="standard deviation of each of them")


class Calibration(Table):
    """Errors of the nominal cameras and of the initial guess of a target's positions.

    Without this table solvers receive the true ones.

    Errors are normally distributed, each number of each camera or point on its own.
    """

    shift_px: float = Field(
        0.0,
        ge=0.0,
        description="distance of every nominal principal point from the true one, in a random "
        "direction for each camera",
    )
    center_mm: float = Field(
        0.0, ge=0.0, description="standard deviation of each coordinate of the pinholes"
    )
    turn_deg: float = Field(
        0.0,
        ge=0.0,
        description="standard deviation of each component of the cameras' rotation vectors",
    )
    focal_percent: float = Field(
        0.0, ge=0.0, lt=100.0, description="standard deviation of the principal distances"
    )
    tilt_deg: float | None = Field(
        None,
        ge=0.0,
        le=10.0,
        description="standard deviation of each angle between sensor and lens",
        examples=[0.2],
    )
    points: float = Field(
        0.0,
        ge=0.0,
        description="standard deviation of each coordinate of the target's points, divided by the "
        "volume's largest edge",
    )
    blank: bool = Field(
        False,
        description="the initial guess is the same for all frames: no rotation, at the volume's "
        "centre",
    )
    known: tuple[KnownPoint, ...] = Field((), description="points whose positions are known")
    wall_mm: float | None = Field(
        None,
        ge=0.0,
        description="standard deviation of the plane wall's place along its normal",
        examples=[1.0],
    )
    wall_deg: float | None = Field(
        None,
        ge=0.0,
        le=10.0,
        description="standard deviation of the wall's tilt about two axes",
        examples=[0.5],
    )
    thickness_percent: float | None = Field(
        None,
        ge=0.0,
        le=20.0,
        description="standard deviation of the thickness of every layer",
        examples=[2.0],
    )
    layer_index: float | None = Field(
        None,
        ge=0.0,
        le=0.05,
        description="standard deviation of the index of every layer",
        examples=[0.005],
    )
    fluid_index: float | None = Field(
        None,
        ge=0.0,
        le=0.05,
        description="standard deviation of the fluid's index",
        examples=[0.001],
    )
    known_cameras: bool | None = Field(
        None,
        description="solvers learn that the nominal cameras are the true ones, and that only the "
        "wall and the target are not",
        examples=[True],
    )
    unknown: tuple[LensNumber | WallNumber, ...] | None = Field(
        None,
        description="unmeasured numbers of the lenses and the wall; solvers receive their names, "
        "and zero for coefficients of distortion; `tilt` is that of the sensors against the "
        "lenses, `wall` the place and tilt of the wall",
        examples=[["k1", "wall"]],
    )

    @property
    def errs_in_wall(self) -> bool:
        """Truth of a nominal wall that is not the true one."""
        place = self.wall_mm or self.wall_deg
        return bool(place or self.thickness_percent or self.layer_index or self.fluid_index)

    @model_validator(mode="after")
    def _check_known(self) -> Calibration:
        if not self.known_cameras:
            return self
        errors = ("shift_px", "center_mm", "turn_deg", "focal_percent", "tilt_deg")
        if wrong := [name for name in errors if getattr(self, name)]:
            raise ValueError(f"known_cameras: expected cameras without errors, got {wrong[0]}")
        if wrong := [name for name in self.unknown or () if name in get_args(LensNumber)]:
            raise ValueError(f"known_cameras: expected unknowns of the wall, got {wrong[0]}")
        return self


class Detection(Table):
    """Errors of detected points of a target, where no images are rendered."""

    noise_px: float = Field(0.0, ge=0.0, description="standard deviation of each pixel coordinate")
    missing: float = Field(
        0.0, ge=0.0, lt=1.0, description="share of points that are not detected, at random"
    )
    hidden: float = Field(
        0.0,
        ge=0.0,
        lt=1.0,
        description="share of a camera's views of a target that are partly hidden",
    )
    outliers: float = Field(
        0.0, ge=0.0, lt=1.0, description="share of detected points that are outliers"
    )
    outlier_px: Positive = Field(20.0, description="standard deviation of an outlier's coordinates")
