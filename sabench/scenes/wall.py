"""Tables of a scene: the tank wall and opaque discs in front of it."""

from __future__ import annotations

from pydantic import Field

from sabench.utils.fields import Direction, Index, Positive, Table, Vector

MOST_LAYERS = 20  # of a wall


class LayerSpec(Table):
    """Solid layer of the wall."""

    name: str = "glass"
    index: Index = Field(description="refractive index")
    thickness_mm: Positive


class WallSpec(Table):
    """Tank wall between the cameras and the fluid.

    A scene without this table is in plain air.
    """

    point_mm: Vector = Field((0.0, 0.0, 0.0), description="a point on the outer face")
    normal: Direction = Field(
        (0.0, 0.0, 1.0), description="direction from the cameras into the tank"
    )
    air_index: Index = Field(1.0, description="refractive index on the cameras' side")
    layers: tuple[LayerSpec, ...] = Field(
        (), max_length=MOST_LAYERS, description="solid layers, the cameras' side first"
    )
    fluid_index: Index = Field(description="refractive index of the fluid")
    depth_mm: Positive | None = Field(
        None, description="distance from the inner face to the back wall"
    )
    rear: tuple[LayerSpec, ...] | None = Field(
        None,
        max_length=MOST_LAYERS,
        description="solid layers of the back wall, the fluid's side first; air is behind it",
    )


class OccluderSpec(Table):
    """Thin opaque black disc in front of the wall or, in plain air, of the volume."""

    center_mm: Vector
    normal: Direction = Field((0.0, 0.0, 1.0), description="normal of the disc")
    radius_mm: Positive
