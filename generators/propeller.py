"""Propeller."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from sabench.api import F64, Solid, SolidGenerator, SolidParameters
from sabench.worlds.library.implicit_surfaces import capsules, surface_of
from sabench.worlds.library.naca import half_thickness


class PropellerParameters(SolidParameters):
    """Propeller with its axis along X before rotation.

    A flow along +X meets the leading edges first.
    """

    blades: int = Field(
        4, ge=2, le=12, description="number of blades; the first one points along +Y"
    )
    diameter_mm: float = Field(
        30.0, gt=0.0, description="diameter of the circle of the blades' tips"
    )
    hub_mm: float = Field(
        6.0,
        gt=0.0,
        description="diameter of the hub, a cylinder with round ends as long as the blades need",
    )
    pitch_mm: float = Field(
        30.0,
        description="distance along the axis that a blade's mean surface, a helicoid, climbs in a "
        "turn; negative: left-handed",
    )
    chord_mm: float = Field(9.0, gt=0.0, description="chord of the sections, equal at every radius")
    thickness: float = Field(
        0.15,
        gt=0.0,
        le=0.4,
        description="largest thickness of the sections, NACA's without camber, over their chord",
    )
    step_mm: float = Field(
        0.25, gt=0.0, description="spacing of the lattice: edges are two of it thick, and round"
    )

    @model_validator(mode="after")
    def _check_shape(self) -> PropellerParameters:
        thick = self.thickness * self.chord_mm
        if not self.hub_mm < self.diameter_mm:
            raise ValueError(
                f"hub_mm: expected less than diameter_mm, {self.diameter_mm:g}, got {self.hub_mm:g}"
            )
        if not self.pitch_mm:
            raise ValueError("pitch_mm: expected another value than 0")
        if not 2.0 * self.step_mm <= thick:
            raise ValueError(
                f"step_mm: expected at most half of the blades' thickness, {thick:.3g} mm, got "
                f"{self.step_mm:g}"
            )
        around = np.pi * self.hub_mm
        gap = around / self.blades * abs(self.pitch_mm) / np.hypot(around, self.pitch_mm)
        if not thick < gap:
            raise ValueError(
                f"blades: expected sections thinner than their distance at the hub, {gap:.3g} "
                f"mm, got {thick:.3g} mm"
            )
        return self


class Propeller(SolidGenerator):
    """Round hub with twisted blades of one pitch, one chord and one section."""

    name = "propeller"
    Parameters = PropellerParameters

    def body(self, seed: int) -> Solid:
        """Make the propeller around the middle of its hub."""
        chosen: PropellerParameters = self.parameters
        half = (
            chosen.chord_mm * (1.0 + chosen.thickness) / 2.0
        )  # blades of any pitch end on the hub
        hub = np.array([[half, 0.0, 0.0]]), np.array([chosen.hub_mm / 2.0])

        def body(points_mm: F64) -> F64:
            return np.minimum(
                capsules(points_mm, -hub[0], hub[0], hub[1], hub[1]), self._blades(points_mm)
            )

        high = (
            np.array(
                [half + chosen.hub_mm / 2.0, chosen.diameter_mm / 2.0, chosen.diameter_mm / 2.0]
            )
            + 2.0 * chosen.step_mm
        )
        return surface_of(body, -high, high, chosen.step_mm)

    def _blades(self, points_mm: F64) -> F64:
        """Approximate distances (n,) to the nearest blade.

        On a cylinder, unrolled, a blade is a straight section at the angle of its helix.
        """
        chosen: PropellerParameters = self.parameters
        edge, (x, y, z) = chosen.step_mm, points_mm.T
        radius = np.hypot(y, z)
        cosine, sine = np.array(
            [2.0 * np.pi * radius, np.full(len(x), chosen.pitch_mm)]
        ) / np.hypot(2.0 * np.pi * radius, chosen.pitch_mm)
        turns = (
            np.arctan2(z, y) - 2.0 * np.pi * x / chosen.pitch_mm
        )  # from the first blade's mean surface
        share = 2.0 * np.pi / chosen.blades
        turns = turns - share * np.rint(turns / share)  # from the nearest one's
        across = radius * turns * sine
        along = np.sign(chosen.pitch_mm) * (
            x * sine + radius * (turns + 2.0 * np.pi * x / chosen.pitch_mm) * cosine
        )  # downstream
        wide = chosen.chord_mm * half_thickness(
            np.clip(along / chosen.chord_mm + 0.5, 0.0, 1.0), chosen.thickness
        )
        over = np.array(
            [
                np.abs(along) - (chosen.chord_mm / 2.0 - edge),
                np.abs(across) - np.maximum(wide - edge, 0.0),
                radius - (chosen.diameter_mm / 2.0 - edge),
            ]
        )
        return np.asarray(
            np.linalg.norm(np.maximum(over, 0.0), axis=0) + np.minimum(over.max(axis=0), 0.0) - edge
        )
