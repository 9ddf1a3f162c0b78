"""Base classes of generators: each makes the truth of one frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from sabench.api.parameters import Parameters, PlugIn
from sabench.api.truth import Bubbles, Particles, Solid, Target
from sabench.geometry.rigid_motion import Domain, Pose
from sabench.utils.arrays import F64, Bool
from sabench.utils.validation import Vector


class Generator(PlugIn):
    """Base of a generator of particles.

    `particles` makes one frame of truth. The result is the same for the same arguments, whatever
    else is generated.
    """

    makes: ClassVar[str] = "particles"

    def particles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Particles:
        """Generate the particles of a frame at a time.

        Draw random numbers from `sabench.utils.rng.stream(seed, ...)` only.
        """
        raise NotImplementedError(f"generator {type(self).__name__} must implement particles()")


class Flow(PlugIn):
    """Base of a velocity field that carries particles.

    Implement `velocity`, `gradient` where the exact gradient is known, and `carry` where paths are.
    """

    makes: ClassVar[str] = "flow"

    def check(self, domain: Domain) -> None:
        """Raise an InputError if the field is not defined in all of the volume."""

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute velocities (n, 3) in mm/s at points (n, 3) of the world frame."""
        raise NotImplementedError(f"flow {type(self).__name__} must implement velocity()")

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute gradients (n, 3, 3) in 1/s, du_i / dx_j."""
        raise NotImplementedError(f"flow {type(self).__name__} must implement gradient()")

    def carry(self, points_mm: F64, start_s: float, end_s: float) -> F64 | None:
        """Compute where points (n, 3) are at another time, earlier or later.

        None, as here, where paths have no formula: sabench then integrates velocities.
        """
        return None


class BodyFlow(Flow):
    """Base of a velocity field around the bodies of a scene.

    The bodies rest. sabench calls `surround` once, before it asks for velocities.
    """

    def surround(self, bodies: Sequence[Solid], domain: Domain) -> None:
        """Prepare the flow around closed surfaces in the world frame."""
        raise NotImplementedError(f"flow {type(self).__name__} must implement surround()")


class BubbleParameters(Parameters):
    """Base of the parameters of a generator of bubbles: their content."""

    index: float = Field(
        1.0,
        ge=1.0,
        le=4.0,
        description="refractive index of what is inside: 1 for air, 1.333 for drops of water",
    )
    overlap: bool = Field(
        False,
        description="true: bubbles may reach into each other, as if a thin film of the fluid were "
        "between them",
    )


class BubbleGenerator(PlugIn):
    """Base of a generator of bubbles or droplets.

    `bubbles` makes one frame of truth, the same for the same arguments.
    """

    makes: ClassVar[str] = "bubbles"
    Parameters: ClassVar[type[BubbleParameters]] = BubbleParameters

    def bubbles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Bubbles:
        """Generate the bubbles of a frame at a time.

        Draw random numbers from `sabench.utils.rng.stream(seed, ...)` only.
        """
        raise NotImplementedError(f"generator {type(self).__name__} must implement bubbles()")


class Material(BaseModel):
    """Optical material of a solid."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    kind: Literal["matte", "principled", "measured", "liquid"] = Field(
        "matte", description="model of its reflection; `liquid` is transparent"
    )
    reflectance: float = Field(
        0.5, ge=0.0, le=1.0, description="reflected fraction of the light: matte and principled"
    )
    roughness: float = Field(0.5, ge=0.0, le=1.0, description="roughness: principled")
    metallic: float = Field(0.0, ge=0.0, le=1.0, description="share of metal: principled")
    specular: float = Field(0.5, ge=0.0, le=1.0, description="specular reflection: principled")
    index: float = Field(1.333, ge=1.0, le=4.0, description="refractive index of a liquid")
    measured: str | None = Field(
        None,
        description="absolute path of a measured material in the RGL format (.bsdf), read when "
        "images are rendered",
        examples=["/data/brdf/satin_gold_rgb.bsdf"],
    )


class SolidParameters(Parameters):
    """Base of the parameters of a body's generator: position, motion, material."""

    place_mm: Vector = Field((0.0, 0.0, 0.0), description="position of its own origin at the start")
    turn_deg: Vector = Field(
        (0.0, 0.0, 0.0),
        description="rotation vector, world frame: its direction is the axis, its length the angle",
    )
    velocity_mm_s: Vector = Field((0.0, 0.0, 0.0), description="velocity of its own origin")
    spin_deg_s: Vector = Field(
        (0.0, 0.0, 0.0), description="rotation vector a second, about its own axes"
    )
    material: Material = Field(Material(), description="optical material of its surface")


class SolidGenerator(PlugIn):
    """Base of a generator of a body.

    `body` makes the surface in the body's own frame; sabench moves it to its position in the world.
    """

    makes: ClassVar[str] = "solids"
    Parameters: ClassVar[type[SolidParameters]] = SolidParameters

    def body(self, seed: int) -> Solid:
        """Generate the closed surface in the body's own frame, mm."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement body()")


@dataclass(frozen=True)
class Code:
    """Code on a body, in the body's own frame.

    Attributes
    ----------
    points_mm : (cell, point, 3) points spread over each cell.
    dark : (cell,) whether each cell is opaque.
    """

    points_mm: F64
    dark: Bool


class CodeGenerator(SolidGenerator):
    """Base of a generator of a body with a code.

    The code is to be read through the objects in front of it.
    """

    def code(self, seed: int) -> Code:
        """Generate the code in the body's own frame."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement code()")


class TargetGenerator(PlugIn):
    """Base of a generator of calibration targets.

    It makes one target, which every frame shows at another pose.
    """

    makes: ClassVar[str] = "targets"

    def target(self) -> Target:
        """Generate the target in its own frame."""
        raise NotImplementedError(f"generator {type(self).__name__} must implement target()")

    def pose(self, domain: Domain, seed: int, frame: int, frames: int) -> Pose:
        """Generate the target's pose in a frame.

        Draw random numbers from `sabench.utils.rng.stream(seed, ...)` only.
        """
        raise NotImplementedError(f"generator {type(self).__name__} must implement pose()")
