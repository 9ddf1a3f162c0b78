"""Tables of a scene: errors of the nominal cameras and of the detection of targets."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sabench.utils.fields import LensNumber, Positive, Table


class KnownPoint(Table):
    """A point of a target whose place was measured by other means."""

    frame: int = Field(0, ge=0, description="which placing of the target")
    point: int = Field(ge=0, description="which of its points")
    axes: Annotated[str, Field(pattern="^x?y?z?$", min_length=1)] = Field(
        "xyz", description="coordinates that are known"
    )
    sigma_mm: Positive = Field(0.05, description="standard deviation of each of them")


class Calibration(Table):
    """How wrongly solvers are told the cameras, and a target's places; without this table they are told the truth.

    Errors are normally distributed, each number of each camera or point on its own.
    """

    shift_px: float = Field(
        0.0,
        ge=0.0,
        description="every principal point is told this far from the true one, in a random direction of its own",
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
    points: float = Field(
        0.0,
        ge=0.0,
        description="standard deviation of each coordinate of the target's points, over the volume's largest edge",
    )
    blank: bool = Field(
        False,
        description="places of the target are told as all alike: unturned, at the volume's centre",
    )
    known: tuple[KnownPoint, ...] = Field((), description="points whose places are known")
    unknown: tuple[LensNumber, ...] | None = Field(
        None,
        description="what nobody has measured of the lenses: solvers are told so, and coefficients of distortion as zero",
    )


class Detection(Table):
    """How a target's points come out of the cameras' images, where no images are rendered."""

    noise_px: float = Field(0.0, ge=0.0, description="standard deviation of each pixel coordinate")
    missing: float = Field(
        0.0, ge=0.0, lt=1.0, description="share of points that are not found, at random"
    )
    hidden: float = Field(
        0.0,
        ge=0.0,
        lt=1.0,
        description="share of a camera's views of a target in which something hides a part of it",
    )
    outliers: float = Field(
        0.0, ge=0.0, lt=1.0, description="share of found points that are elsewhere"
    )
    outlier_px: Positive = Field(20.0, description="standard deviation of each coordinate of where")
