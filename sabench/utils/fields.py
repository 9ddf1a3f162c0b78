"""Types of numbers, vectors and tables in scenes and in parameters of plug-ins."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

Vector = tuple[float, float, float]


def _not_zero(vector: Vector) -> Vector:
    if math.hypot(*vector) < 1e-9:
        raise ValueError("expected a vector of non-zero length")
    return vector


Direction = Annotated[Vector, AfterValidator(_not_zero)]
Positive = Annotated[float, Field(gt=0.0)]
TiltAngle = Annotated[float, Field(gt=-90.0, lt=90.0)]
Index = Annotated[float, Field(ge=1.0, le=4.0)]
LensNumber = Literal["principal_point", "k1", "k2", "p1", "p2", "k3", "tilt"]
WallNumber = Literal["wall", "thickness", "layer_index", "fluid_index"]
Unknown = LensNumber | WallNumber | Literal["bend"]


class Table(BaseModel):
    """Base of the tables of a file: immutable, unknown keys refused, numbers finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
