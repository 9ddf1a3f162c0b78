"""Tables of a scene: laser, pulses, lamps and backlight, and what the light meets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from sabench.utils.fields import Direction, Positive, Table, Vector
from sabench.utils.validation import refuse


class Illumination(Table):
    """One laser pulse per frame, as a sheet or slab."""

    wavelength_nm: Positive = Field(532.0, description="in vacuum")
    pulse_energy_mj: Positive
    direction: Vector = Field((1.0, 0.0, 0.0), description="in which the light travels")
    sheet_normal: Vector = Field((0.0, 0.0, 1.0), description="across the sheet")
    thickness_mm: Positive = Field(description="full width (top-hat) or e^-2 width (gaussian)")
    height_mm: Positive = Field(
        description="width of the sheet at right angles to its direction and normal"
    )
    shift_mm: float | None = Field(
        None, description="how far the sheet's middle lies from the volume's, along its normal"
    )
    profile: Literal["top-hat", "gaussian"] = "top-hat"
    scattering: Literal["mie", "isotropic"] = "mie"

    @model_validator(mode="after")
    def _crossed(self) -> Illumination:
        lengths = math.hypot(*self.direction) * math.hypot(*self.sheet_normal)
        dot = sum(a * b for a, b in zip(self.direction, self.sheet_normal, strict=True))
        if lengths < 1e-9 or abs(dot) > 1e-6 * lengths:
            raise ValueError(
                "expected direction and sheet_normal of non-zero length and at right angles"
            )
        return self


class Timing(Table):
    """When frames are taken: groups of pulses, one frame each, and what differs from pulse to pulse.

    One pulse a group is a time-resolved sequence, two are frame straddling (double frames), four a
    four-pulse system.
    """

    rate_hz: Positive = Field(description="of the groups")
    pulses_s: tuple[Annotated[float, Field(ge=0.0)], ...] = Field(
        (0.0,), min_length=1, description="times of a group's pulses, from its start"
    )
    energy: tuple[Positive, ...] | None = Field(
        None, description="of each of a group's pulses, over the illumination's"
    )
    energy_spread: float = Field(
        0.0, ge=0.0, lt=1.0, description="standard deviation of each pulse's energy, over its mean"
    )
    shift_mm: tuple[float, ...] | None = Field(
        None,
        description="of each of a group's sheets along its normal: lasers are never aligned exactly",
    )
    duration_s: float = Field(0.0, ge=0.0, description="of a pulse: particles leave streaks")

    @model_validator(mode="after")
    def _ordered(self) -> Timing:
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[tuple[str, str]]:
        times, period = list(self.pulses_s), 1.0 / self.rate_hz
        if times != sorted(set(times)):
            yield "pulses_s", f"expected rising times, got {times}"
        elif times[-1] - times[0] >= period and len(times) > 1:
            expected = f"expected a group shorter than 1 / rate_hz = {period:g} s"
            yield "pulses_s", f"{expected}, got {times}"
        for name in ("energy", "shift_mm"):
            given = getattr(self, name)
            if given is not None and len(given) != len(times):
                expected = f"expected one value for each of {len(times)} pulses"
                yield name, f"{expected}, got {len(given)}"


class Lamp(Table):
    """A small lamp; light from in front of the wall is taken to cross it steeply."""

    center_mm: Vector
    power: Positive = 1.0


class Lighting(Table):
    """What lights a calibration target."""

    lamps: tuple[Lamp, ...] = Field(min_length=1)
    exposure: Positive = Field(
        0.7,
        description="what a white surface at the volume's centre that faces the wall gives, as a part of the full well",
    )
    even: float | None = Field(
        None,
        ge=0.0,
        le=1.0,
        description="part of the light that comes evenly from everywhere, as from balls that glow",
    )
    wavelength_nm: Positive = Field(550.0, description="for diffraction")


class Backlight(Table):
    """A diffuser behind the volume that shines evenly in all directions, as large as it is and dark beyond its edges."""

    center_mm: Vector
    size_mm: tuple[Positive, Positive] = Field(
        description="along x_axis, and at right angles to that"
    )
    normal: Direction = Field((0.0, 0.0, 1.0), description="at right angles to the diffuser")
    x_axis: Direction = Field(
        (1.0, 0.0, 0.0),
        description="along one of its edges, as far as it is at right angles to the normal",
    )
    exposure: Positive = Field(
        0.7, description="what it gives where nothing is in front of it, as a part of the full well"
    )
    wavelength_nm: Positive = Field(550.0, description="for diffraction")


class Tracer(Table):
    """What the particles are made of: complex refractive index m = index - i absorption."""

    index: float = Field(1.59, ge=1.0, le=4.0)
    absorption: float = Field(0.0, ge=0.0, le=5.0)
