"""Bubbles listed one by one."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from sabench.api import (
    BubbleGenerator,
    BubbleParameters,
    Bubbles,
    Domain,
    Vector,
    rotation_matrices,
)


class BubbleListParameters(BubbleParameters):
    """Each list has one entry for each bubble."""

    center_mm: tuple[Vector, ...] = Field((), description="at the start")
    radius_mm: tuple[float, ...] = Field((), description="long semi-axes")
    aspect: tuple[float, ...] | None = Field(
        None, description="short over long axis; by default 1, a ball", examples=[[0.8]]
    )
    turn_deg: tuple[Vector, ...] | None = Field(
        None,
        description="rotation vectors; unturned, the short axis is Y",
        examples=[[[0.0, 0.0, 30.0]]],
    )
    velocity_mm_s: tuple[Vector, ...] | None = Field(
        None, description="by default they rest", examples=[[[0.0, -250.0, 0.0]]]
    )

    @model_validator(mode="after")
    def _one_each(self) -> BubbleListParameters:
        count = len(self.center_mm)
        for name, what in (
            ("radius_mm", "radius"),
            ("aspect", "aspect"),
            ("turn_deg", "turn"),
            ("velocity_mm_s", "velocity"),
        ):
            given = getattr(self, name)
            if given is not None and len(given) != count:
                raise ValueError(
                    f"{name}: expected one {what} for each of {count} centres, got {len(given)}"
                )
        if any(radius <= 0.0 for radius in self.radius_mm) or any(
            not 0.0 < aspect <= 1.0 for aspect in self.aspect or ()
        ):
            raise ValueError("expected positive radii and aspects above 0 and up to 1")
        return self


class BubbleList(BubbleGenerator):
    """Bubbles or drops of given positions, sizes and velocities."""

    name = "bubble_list"
    Parameters = BubbleListParameters

    def bubbles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Bubbles:
        """Return all bubbles, moved to the time."""
        chosen: BubbleListParameters = self.parameters
        count = len(chosen.center_mm)
        velocity = np.array(chosen.velocity_mm_s or np.zeros((count, 3)), dtype=np.float64).reshape(
            count, 3
        )
        center = np.array(chosen.center_mm, dtype=np.float64).reshape(count, 3) + velocity * time_s
        long = np.array(chosen.radius_mm, dtype=np.float64)
        semi_axes = np.column_stack([long, long * np.array(chosen.aspect or np.ones(count)), long])
        rotations = np.deg2rad(
            np.array(chosen.turn_deg or np.zeros((count, 3)), dtype=np.float64)
        ).reshape(count, 3)
        rotation = np.array([rotation_matrices(vector).T for vector in rotations]).reshape(
            count, 3, 3
        )
        return Bubbles(np.arange(count), center, semi_axes, rotation, velocity, chosen.index)
