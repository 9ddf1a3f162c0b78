"""Wing of one NACA section."""

import numpy as np
from pydantic import Field, field_validator

from sabench.api import I64, Solid, SolidGenerator, SolidParameters
from sabench.worlds.library.naca import section


class HydrofoilParameters(SolidParameters):
    """Size and section of the foil in its own frame.

    Its chord runs along X from the leading edge on, its span along Y, and its upper side faces +Z.
    """

    digits: str = Field(
        "0012",
        pattern="^[0-9]{4}$",
        description="NACA's four digits: 2412 is cambered by 2 % at 0.4 of the chord, 12 % thick",
    )
    chord_mm: float = Field(
        20.0, gt=0.0, description="length of the section, from leading to trailing edge"
    )
    span_mm: float = Field(40.0, gt=0.0, description="length along Y")
    points: int = Field(200, ge=8, le=4096, multiple_of=2, description="points around the section")

    @field_validator("digits")
    @classmethod
    def _makes_a_section(cls, digits: str) -> str:
        if not 1 <= int(digits[2:]) <= 40:
            raise ValueError(f"expected a thickness of 01 to 40 percent, got {digits[2:]}")
        if (digits[0] == "0") != (digits[1] == "0"):
            raise ValueError(
                f"expected a camber and its position, or 00 for none, got {digits[:2]}"
            )
        return digits


class Hydrofoil(SolidGenerator):
    """Wing of constant NACA four-digit section with a sharp trailing edge."""

    name = "hydrofoil"
    references = ("E. N. Jacobs, K. E. Ward and R. M. Pinkerton, NACA report 460 (1933)",)
    Parameters = HydrofoilParameters

    def body(self, seed: int) -> Solid:
        """Make the foil around its quarter chord at the middle of its span.

        This is the axis of a pitching wing.
        """
        chosen: HydrofoilParameters = self.parameters
        upper, lower = section(chosen.digits, chosen.points // 2)
        ring = np.concatenate(
            [upper[:-1], lower[:0:-1]]
        )  # from the leading edge over the upper side and back
        x, z = chosen.chord_mm * (ring - [0.25, 0.0]).T
        ends = [
            np.column_stack([x, np.full(len(x), y), z])
            for y in (-chosen.span_mm / 2.0, chosen.span_mm / 2.0)
        ]
        return Solid(np.concatenate(ends), _faces(len(ring)))


def _faces(around: int) -> I64:
    """List triangles between two rings of vertices.

    First the sides, then strips between the upper and the lower side at both ends.
    """
    here = np.arange(around)
    after = (here + 1) % around
    sides = np.concatenate(
        [
            np.column_stack([here, after, after + around]),
            np.column_stack([here, after + around, here + around]),
        ]
    )
    upper = np.arange(around // 2 + 1)
    lower = -upper % around  # the same stations of the other side; the edges are shared
    near = np.column_stack([upper[:-1], lower[1:], upper[1:]])[:-1]
    far = np.column_stack([upper[:-1], lower[:-1], lower[1:]])[1:]
    cap = np.concatenate([near, far])
    return np.concatenate([sides, cap, cap[:, ::-1] + around]).astype(np.int64)
