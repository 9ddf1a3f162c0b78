"""Tables of a scene: the volume and the voxels that solvers reconstruct."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sabench.utils.fields import Positive, Table, Vector


class Volume(Table):
    """Box that the generators fill, world frame."""

    center_mm: Vector = Field(description="centre of the box")
    size_mm: tuple[Positive, Positive, Positive] = Field(
        description="edge lengths along x, y and z"
    )


class GridSpec(Table):
    """Voxels that solvers reconstruct; they fill the volume."""

    voxel_mm: tuple[Positive, Positive, Positive] = Field(description="voxel size along x, y and z")
    crop_mm: tuple[
        Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]
    ] = Field((0.0, 0.0, 0.0), description="margin on each side that scores leave out")
