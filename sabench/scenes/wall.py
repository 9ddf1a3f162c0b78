"""Tables of a scene: the tank's walls and opaque discs in front of them."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    model_serializer,
    model_validator,
)

from sabench.utils.validation import UNION_TAG, Direction, Index, Positive, Table, Vector, refuse

MOST_LAYERS = 20  # of a wall
MOST_FACES = 12  # of a tank


class _Named(Table):
    """Table with the refractive index of a material, which may be named in its place."""

    model_config = ConfigDict(
        json_schema_extra=lambda schema, cls: schema["required"].remove(cls.INDEX)
    )
    NAME: ClassVar[str]
    INDEX: ClassVar[str]

    @model_validator(mode="before")
    @classmethod
    def _check_light(cls, values: Any) -> Any:
        """Refuse a named material where no scene has added its index."""
        named = isinstance(values, dict) and values.get(cls.NAME) is not None
        if named and cls.INDEX not in values:
            light = "the wavelength of a scene's light"
            raise ValueError(f"expected {cls.INDEX}: {cls.NAME} needs {light}")
        return values

    @model_serializer(mode="wrap")
    def _leave_out(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out the index of a named material: the scene's light determines it again."""
        table: dict[str, Any] = handler(self)
        if getattr(self, self.NAME) is not None:
            table.pop(self.INDEX, None)
        return table


class LayerSpec(_Named):
    """Solid layer of the wall."""

    NAME, INDEX = "material", "index"

    name: str = Field("glass", description="name of the layer, for messages and files")
    material: str | None = Field(
        None,
        description="name of a material whose index at the light's wavelength is known, instead of "
        "`index`",
        examples=["BK7"],
    )
    index: Index = Field(description="refractive index; left out with `material`")
    thickness_mm: Positive = Field(description="thickness of the layer")


AirIndex = Annotated[Index, Field(description="refractive index on the cameras' side")]
FluidName = Annotated[
    str | None,
    Field(
        description="name of a fluid whose index at the light's wavelength is known, instead of "
        "`fluid_index`",
        examples=["water"],
    ),
]
WaterCelsius = Annotated[
    float | None, Field(description="temperature of water; 20 by default", examples=[20.0])
]
FluidIndex = Annotated[
    Index, Field(description="refractive index of the fluid; left out with `fluid`")
]


class WallSpec(_Named):
    """Plane tank wall between the cameras and the fluid.

    A scene without this table is in plain air. A list of these tables describes a tank with
    cameras that look through several faces.
    """

    NAME, INDEX = "fluid", "fluid_index"

    shape: Literal["plane"] | None = Field(
        None, description="`plane`; the other shape, `cylinder`, has other keys", examples=["plane"]
    )
    name: str | None = Field(None, description="name of the face, for messages", examples=["left"])
    point_mm: Vector = Field((0.0, 0.0, 0.0), description="a point on the outer face")
    normal: Direction = Field(
        (0.0, 0.0, 1.0), description="direction from the cameras into the tank"
    )
    air_index: AirIndex = 1.0
    layers: tuple[LayerSpec, ...] = Field(
        (), max_length=MOST_LAYERS, description="solid layers, the cameras' side first"
    )
    fluid: FluidName = None
    temperature_c: WaterCelsius = None
    fluid_index: FluidIndex
    depth_mm: Positive | None = Field(
        None, description="distance from the inner face to the back wall"
    )
    rear: tuple[LayerSpec, ...] | None = Field(
        None,
        max_length=MOST_LAYERS,
        description="solid layers of the back wall, the fluid's side first; air is behind it",
    )
    mirrors: bool | None = Field(
        None,
        description="whether faces reflect particles' light: those of the back wall (`depth_mm`) "
        "once, those of this wall to and fro",
    )


class CylinderSpec(_Named):
    """Round tank: coaxial cylinders around the fluid, with the cameras outside.

    The cylinder has no ends.
    """

    NAME, INDEX = "fluid", "fluid_index"

    shape: Literal["cylinder"] = Field(description="`cylinder`, a round tank")
    axis_point_mm: Vector = Field((0.0, 0.0, 0.0), description="a point on the axis")
    axis: Direction = Field((0.0, 1.0, 0.0), description="direction of the axis")
    outer_radius_mm: Positive = Field(description="radius of the outer face")
    air_index: AirIndex = 1.0
    layers: tuple[LayerSpec, ...] = Field(
        (), max_length=MOST_LAYERS, description="solid layers, the outermost first"
    )
    fluid: FluidName = None
    temperature_c: WaterCelsius = None
    fluid_index: FluidIndex

    @property
    def inner_radius_mm(self) -> float:
        """Radius of the fluid."""
        return self.outer_radius_mm - sum(layer.thickness_mm for layer in self.layers)

    @model_validator(mode="after")
    def _check_layers(self) -> CylinderSpec:
        if self.inner_radius_mm <= 0.0:
            thick = self.outer_radius_mm - self.inner_radius_mm
            expected = f"expected layers thinner than outer_radius_mm = {self.outer_radius_mm:g}"
            refuse([("layers", f"{expected} together, got {thick:g} mm")])
        return self


def _shape(value: Any) -> str:
    """Name the kind of wall that a table, or a list of tables, describes."""
    if isinstance(value, list | tuple):
        return f"{UNION_TAG}faces"
    if isinstance(value, dict):
        round_ = value.get("shape") == "cylinder" or "outer_radius_mm" in value
    else:
        round_ = isinstance(value, CylinderSpec)
    return f"{UNION_TAG}{'cylinder' if round_ else 'plane'}"


WallTable = Annotated[
    Annotated[WallSpec, Tag(f"{UNION_TAG}plane")]
    | Annotated[CylinderSpec, Tag(f"{UNION_TAG}cylinder")]
    | Annotated[
        tuple[WallSpec, ...], Field(min_length=1, max_length=MOST_FACES), Tag(f"{UNION_TAG}faces")
    ],
    Discriminator(_shape),
]


def wall_tables(wall: WallTable | None) -> tuple[WallSpec | CylinderSpec, ...]:
    """List the tables of all walls; none in plain air."""
    if wall is None:
        return ()
    return wall if isinstance(wall, tuple) else (wall,)


class OccluderSpec(Table):
    """Thin opaque black disc in front of the wall or, in plain air, of the volume."""

    center_mm: Vector = Field(description="centre of the disc")
    normal: Direction = Field((0.0, 0.0, 1.0), description="normal of the disc")
    radius_mm: Positive = Field(description="radius of the disc")
