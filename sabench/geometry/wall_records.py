"""Walls of any shape as JSON keeps them: one, or one for each camera."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Discriminator, Tag

from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Wall


def _shape(value: Any) -> str:
    """Tell a list, a cylinder (it has an axis) and a plane wall apart."""
    if isinstance(value, list | tuple):
        return "faces"
    axis = "axis" in value if isinstance(value, dict) else isinstance(value, CylinderWall)
    return "cylinder" if axis else "plane"


WallRecord = Annotated[
    Annotated[Wall, Tag("plane")] | Annotated[CylinderWall, Tag("cylinder")],
    Discriminator(_shape),
]
WallsRecord = Annotated[
    Annotated[Wall, Tag("plane")]
    | Annotated[CylinderWall, Tag("cylinder")]
    | Annotated[tuple[WallRecord | None, ...], Tag("faces")],
    Discriminator(_shape),
]
