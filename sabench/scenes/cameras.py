"""Tables of a scene: the camera array and its layouts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from sabench.utils.arrays import F64
from sabench.utils.validation import Direction, Positive, Table, TiltAngle, Vector


class GridLayout(Table):
    """Cameras in columns and rows: uniform by count and spacing, or at given offsets."""

    kind: Literal["grid"] = Field(description="`grid`")
    columns: int | None = Field(None, ge=1, description="number of columns of cameras")
    rows: int | None = Field(None, ge=1, description="number of rows of cameras")
    spacing_mm: tuple[Positive, Positive] | None = Field(
        None, description="distance between columns, and between rows"
    )
    x_mm: tuple[float, ...] | None = Field(
        None, min_length=1, description="offset of each column", examples=[[-120.0, 0.0, 200.0]]
    )
    y_mm: tuple[float, ...] | None = Field(
        None, min_length=1, description="offset of each row", examples=[[-100.0, 100.0]]
    )

    @model_validator(mode="after")
    def _check_offsets(self) -> GridLayout:
        uniform = [self.columns, self.rows, self.spacing_mm]
        uneven = [self.x_mm, self.y_mm]
        if (None in uniform) == (None in uneven) or any(
            v is not None for v in (uniform if None in uniform else uneven)
        ):
            raise ValueError("expected either columns, rows and spacing_mm or x_mm and y_mm")
        return self


class RingLayout(Table):
    """Cameras on a circle."""

    kind: Literal["ring"] = Field(description="`ring`")
    count: int = Field(ge=1, description="number of cameras, at equal angles", examples=[8])
    radius_mm: Positive = Field(description="radius of the circle", examples=[200.0])
    start_deg: float = Field(0.0, description="angle of the first camera, from x_axis to y_axis")


class LineLayout(Table):
    """Cameras on a straight line."""

    kind: Literal["line"] = Field(description="`line`")
    count: int = Field(ge=1, description="number of cameras", examples=[5])
    spacing_mm: Positive = Field(
        description="distance between neighbouring cameras", examples=[100.0]
    )
    angle_deg: float = Field(0.0, description="direction of the line, from x_axis to y_axis")


class CrossLayout(Table):
    """Camera in the centre, with four arms of cameras."""

    kind: Literal["cross"] = Field(description="`cross`")
    arm: int = Field(ge=1, description="number of cameras in each of the four arms", examples=[2])
    spacing_mm: Positive = Field(
        description="distance between neighbouring cameras of an arm", examples=[100.0]
    )


class Place(Table):
    """Position of one camera of a list, with its aim point or its rotation matrix.

    By default it is aimed at the array's aim point.
    """

    center_mm: Vector = Field(description="position of the pinhole")
    aim_mm: Vector | None = Field(
        None,
        description="point at the image centre; by default the array's aim point",
        examples=[[0.0, 0.0, 30.0]],
    )
    rotation: tuple[Vector, Vector, Vector] | None = Field(
        None,
        description="rotation from world to camera axes, instead of `aim_mm`; its rows are the "
        "camera's X, Y, Z axes",
    )


class ListLayout(Table):
    """Cameras at listed positions."""

    kind: Literal["list"] = Field(description="`list`")
    places: tuple[Place, ...] = Field(min_length=1, description="position of each camera")


def offsets_of(layout: GridLayout | RingLayout | LineLayout | CrossLayout) -> F64:
    """Compute the cameras' offsets (n, 2) from the array's centre, in its plane, mm."""
    if isinstance(layout, RingLayout):
        angle = np.deg2rad(layout.start_deg) + 2.0 * np.pi * np.arange(layout.count) / layout.count
        return np.asarray(layout.radius_mm * np.column_stack([np.cos(angle), np.sin(angle)]))
    if isinstance(layout, CrossLayout):
        steps = np.arange(1, layout.arm + 1) * layout.spacing_mm
        zero = np.zeros_like(steps)
        arms = ((steps, zero), (-steps, zero), (zero, steps), (zero, -steps))
        return np.vstack([np.zeros((1, 2)), *(np.column_stack(pair) for pair in arms)])
    if isinstance(layout, LineLayout):
        angle = np.deg2rad(layout.angle_deg)
        along = (np.arange(layout.count) - (layout.count - 1) / 2.0) * layout.spacing_mm
        return np.asarray(along[:, None] * np.array([np.cos(angle), np.sin(angle)]))
    if layout.x_mm is not None and layout.y_mm is not None:
        x_mm, y_mm = np.asarray(layout.x_mm, np.float64), np.asarray(layout.y_mm, np.float64)
    else:  # all others are given: the table checks it
        counts, steps_mm = (layout.columns or 1, layout.rows or 1), layout.spacing_mm or (1.0, 1.0)
        x_mm, y_mm = (
            np.asarray((np.arange(count) - (count - 1) / 2.0) * step, np.float64)
            for count, step in zip(counts, steps_mm, strict=True)
        )
    across, down = np.meshgrid(x_mm, y_mm)
    return np.column_stack([across.ravel(), down.ravel()])


class DistortionSpec(Table):
    """Radial-tangential (Brown-Conrady) coefficients."""

    k1: float = Field(0.0, description="radial coefficient of r^2", examples=[-0.1])
    k2: float = Field(0.0, description="radial coefficient of r^4", examples=[0.05])
    p1: float = Field(0.0, description="first tangential coefficient", examples=[0.001])
    p2: float = Field(0.0, description="second tangential coefficient", examples=[-0.0005])
    k3: float = Field(0.0, description="radial coefficient of r^6", examples=[0.0])


class CameraSpec(Table):
    """Lens and sensor of one camera; other numbers are those of the array."""

    camera: str = Field(description="name of the camera: camera_00, camera_01, ...")
    focal_length_mm: Positive | None = Field(None, description="focal length of the lens")
    f_number: Positive | None = Field(
        None, description="focal length divided by the aperture's diameter"
    )
    focus_mm: Positive | None = Field(
        None, description="distance in air at which the lens is focused", examples=[600.0]
    )
    distortion: DistortionSpec | None = Field(None, description="distortion of the lens")
    principal_point_px: tuple[float, float] | None = Field(
        None,
        description="column and row where the optical axis meets the sensor; by default the centre "
        "of the image",
        examples=[[500.0, 498.0]],
    )
    pixel_mm: float | None = Field(
        None, gt=0.0, le=10.0, description="distance between neighbouring pixels"
    )
    tilt_deg: tuple[TiltAngle, TiltAngle] | None = Field(
        None,
        description="angles by which the sensor is turned against the lens (Scheimpflug): about "
        "the lens's X axis (right), then about its own Y axis (down)",
        examples=[[0.0, 5.0]],
    )


class Cameras(Table):
    """Array of cameras, equal but for the keys in `each`."""

    rows: int = Field(ge=8, le=20000, description="height of the images, pixels")
    columns: int = Field(ge=8, le=20000, description="width of the images, pixels")
    pixel_mm: float = Field(gt=0.0, le=10.0, description="distance between neighbouring pixels")
    focal_length_mm: Positive = Field(description="focal length of the lenses")
    f_number: Positive = Field(description="focal length divided by the aperture's diameter")
    focus_mm: Positive | None = Field(
        None,
        description="distance in air at which the lenses are focused; by default each camera is "
        "focused on its aim point",
        examples=[600.0],
    )
    distortion: DistortionSpec = Field(DistortionSpec(), description="distortion of the lenses")
    particle_sigma_px: Positive | None = Field(
        None,
        description="standard deviation of every particle's image; by default it follows from "
        "diffraction, size and defocus",
        examples=[0.7],
    )
    airy_rings: bool | None = Field(
        None,
        description="whether images of particles have the rings of Airy's pattern; by default "
        "diffraction is the Gaussian nearest to it",
    )
    center_mm: Vector = Field(
        (0.0, 0.0, 0.0), description="centre of the array; no effect on a list"
    )
    x_axis: Direction = Field((1.0, 0.0, 0.0), description="direction of the array's columns")
    y_axis: Direction = Field((0.0, 1.0, 0.0), description="direction of the array's rows")
    aim_mm: Vector | None = Field(
        None,
        description="point at every image centre, or principal point where that is given; by "
        "default the volume's centre",
    )
    focus_normal: Direction | None = Field(
        None,
        description="normal of the plane through the aim point on which cameras are focused by "
        "tilted sensors (Scheimpflug); by default sensors are upright",
    )
    each: tuple[CameraSpec, ...] | None = Field(
        None, description="cameras with another lens or sensor than the others"
    )
    layout: GridLayout | RingLayout | LineLayout | CrossLayout | ListLayout = Field(
        discriminator="kind", description="positions of the cameras; `kind` names the layout"
    )

    @property
    def count(self) -> int:
        """Number of the cameras of the layout."""
        chosen = self.layout
        if isinstance(chosen, ListLayout):
            return len(chosen.places)
        if isinstance(chosen, CrossLayout):
            return 4 * chosen.arm + 1
        if isinstance(chosen, GridLayout):
            across = chosen.columns or 1 if chosen.x_mm is None else len(chosen.x_mm)
            return across * (chosen.rows or 1 if chosen.y_mm is None else len(chosen.y_mm))
        return chosen.count

    def of_camera(self, name: str) -> tuple[Cameras, CameraSpec]:
        """Give the array's table with one camera's numbers, and the camera's own table."""
        camera_spec = next((spec for spec in self.each or () if spec.camera == name), None)
        camera_spec = camera_spec or CameraSpec(camera=name)
        shared = type(self).model_fields
        given = {key: value for key, value in camera_spec if key in shared and value is not None}
        return self.model_copy(update={**given, "each": None}), camera_spec

    def faults_by_camera(self, names: Sequence[str]) -> Iterator[str]:
        """List the entries of `each` that name no camera, or one camera again."""
        given = [spec.camera for spec in self.each or ()]
        for number, camera in enumerate(given):
            key = f"cameras.each.{number}.camera"
            if camera not in names:
                span = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
                yield f"{key}: expected {span}, got {camera!r}"
            elif camera in given[:number]:
                yield f"{key}: expected every camera once, got {camera!r} again"
