"""Tables for a scene's light and materials: laser, pulses, lamps, static light.

The materials are those of particles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from sabench.scenes.wall import MOST_LAYERS, LayerSpec
from sabench.utils.validation import Direction, Index, Positive, Table, Vector, refuse


class EntrySpec(Table):
    """Window between the laser, in air, and the tank."""

    point_mm: Vector = Field(
        description="a point on the window's outer face", examples=[[-100.0, 0.0, 0.0]]
    )
    normal: Direction = Field(
        description="direction from the laser into the tank", examples=[[1.0, 0.0, 0.0]]
    )
    air_index: Index = Field(1.0, description="refractive index on the laser's side")
    layers: tuple[LayerSpec, ...] = Field(
        (), max_length=MOST_LAYERS, description="solid layers, the laser's side first"
    )


class Illumination(Table):
    """Laser pulse of a frame, as a sheet or slab."""

    wavelength_nm: Positive = Field(532.0, description="wavelength of the laser in vacuum")
    pulse_energy_mj: Positive = Field(description="energy of a pulse")
    direction: Vector = Field(
        (1.0, 0.0, 0.0),
        description="direction of propagation: in the fluid or, with `entry`, in the air before it",
    )
    sheet_normal: Vector = Field((0.0, 0.0, 1.0), description="normal of the sheet")
    thickness_mm: Positive = Field(description="full width (top-hat) or e^-2 width (gaussian)")
    height_mm: Positive = Field(
        description="width of the sheet at right angles to its direction and normal"
    )
    shift_mm: float | None = Field(
        None,
        description="offset of the sheet's middle from the volume's centre, along the normal",
        examples=[2.0],
    )
    profile: Literal["top-hat", "gaussian"] = Field(
        "top-hat", description="intensity over the thickness of the sheet"
    )
    height_profile: Literal["top-hat", "gaussian"] | None = Field(
        None,
        description="intensity over the height, which is the width of the top-hat or the e^-2 "
        "width; by default the sheet is uniform and has no edge",
    )
    entry: EntrySpec | None = Field(
        None,
        description="window that refracts the sheet; without it the sheet would pass through the "
        "volume's centre",
    )
    extinction: bool | None = Field(
        None, description="whether particles attenuate the light on its way to and from others"
    )
    polarisation: Vector | None = Field(
        None, description="direction of the electric field; by default the light is unpolarised"
    )
    scattering: Literal["mie", "isotropic"] = Field(
        "mie", description="light of a particle by direction: Mie's series, or uniform"
    )

    @model_validator(mode="after")
    def _check_directions(self) -> Illumination:
        for vector, what in (
            (self.sheet_normal, "direction and sheet_normal of non-zero length and"),
            (self.polarisation, "polarisation of non-zero length,"),
        ):
            if vector is None:
                continue
            lengths = math.hypot(*self.direction) * math.hypot(*vector)
            dot = sum(a * b for a, b in zip(self.direction, vector, strict=True))
            if lengths < 1e-9 or abs(dot) > 1e-6 * lengths:
                other = "" if vector is self.sheet_normal else " to direction"
                raise ValueError(f"expected {what} at right angles{other}")
        return self


class Timing(Table):
    """Times of frames, in groups of pulses of one frame each, and how pulses differ.

    One pulse a group is a time-resolved sequence, two are frame straddling (double frames), four a
    four-pulse system.
    """

    rate_hz: Positive = Field(description="rate of the groups")
    pulses_s: tuple[Annotated[float, Field(ge=0.0)], ...] = Field(
        (0.0,), min_length=1, description="times of a group's pulses, from its start"
    )
    energy: tuple[Positive, ...] | None = Field(
        None,
        description="energy of each pulse of a group, divided by the illumination's",
        examples=[[1.0, 0.9]],
    )
    energy_spread: float = Field(
        0.0, ge=0.0, lt=1.0, description="relative standard deviation of each pulse's energy"
    )
    shift_mm: tuple[float, ...] | None = Field(
        None,
        description="misalignment of each sheet of a group, along its normal",
    )
    duration_s: float = Field(
        0.0, ge=0.0, description="duration of a pulse; moving particles leave streaks"
    )
    skew_s: tuple[float, ...] | None = Field(
        None,
        min_length=1,
        description="delay of each camera's exposures of sensor.exposure_s; it records the part of "
        "a pulse that falls in them. By default cameras record whole pulses",
        examples=[[0.0, 2e-6, -1e-6, 0.0]],
    )
    gap_s: float | None = Field(
        None,
        ge=0.0,
        description="time from the end of a group's first exposure to the start of its second "
        "(frame straddling); by default each exposure is centred on its pulse",
        examples=[1e-6],
    )

    def faults_by_camera(self, cameras: int) -> Iterator[str]:
        """List delays of another number of cameras than there are."""
        if self.skew_s is not None and len(self.skew_s) != cameras:
            got = len(self.skew_s)
            yield f"timing.skew_s: expected one value for each of {cameras} cameras, got {got}"

    @model_validator(mode="after")
    def _check_times(self) -> Timing:
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[tuple[str, str]]:
        times, period = list(self.pulses_s), 1.0 / self.rate_hz
        if times != sorted(set(times)):
            yield "pulses_s", f"expected rising times, got {times}"
        elif times[-1] - times[0] >= period and len(times) > 1:
            expected = f"expected a group shorter than 1 / rate_hz = {period:g} s"
            yield "pulses_s", f"{expected}, got {times}"
        if self.gap_s is not None and self.skew_s is None:
            yield "gap_s", "expected skew_s, the cameras' delays, next to it, got none"
        if self.gap_s is not None and len(times) != 2:
            yield "gap_s", f"expected two pulses in a group, got {len(times)}"
        for name in ("energy", "shift_mm"):
            given = getattr(self, name)
            if given is not None and len(given) != len(times):
                expected = f"expected one value for each of {len(times)} pulses"
                yield name, f"{expected}, got {len(given)}"


class Lamp(Table):
    """Small lamp.

    Light from in front of the wall is assumed to cross it at steep angles.
    """

    center_mm: Vector = Field(description="position of the lamp")
    power: Positive = Field(1.0, description="radiant power relative to the other lamps")


class Lighting(Table):
    """Lamps that light a calibration target, bubbles or bodies."""

    lamps: tuple[Lamp, ...] = Field(min_length=1, description="position and power of each lamp")
    exposure: Positive = Field(
        0.7,
        description="signal of a white surface at the volume's centre that faces the wall, as a "
        "fraction of the full well",
    )
    even: float | None = Field(
        None,
        ge=0.0,
        le=1.0,
        description="fraction of the light that comes uniformly from all directions",
        examples=[0.5],
    )
    wavelength_nm: Positive = Field(550.0, description="wavelength in vacuum, for diffraction")


class Backlight(Table):
    """Diffuser of finite size behind the volume.

    Its radiance is uniform in all directions.
    """

    center_mm: Vector = Field(description="centre of the diffuser")
    size_mm: tuple[Positive, Positive] = Field(
        description="edge lengths along x_axis and perpendicular to it"
    )
    normal: Direction = Field((0.0, 0.0, 1.0), description="normal of the diffuser")
    x_axis: Direction = Field(
        (1.0, 0.0, 0.0),
        description="direction of one edge; its part along the normal is ignored",
    )
    exposure: Positive = Field(
        0.7, description="signal of the unobstructed diffuser, as a fraction of the full well"
    )
    wavelength_nm: Positive = Field(550.0, description="wavelength in vacuum, for diffraction")


class Material(Table):
    """Material of particles: complex refractive index m = index - i absorption."""

    index: float = Field(
        1.59, ge=1.0, le=4.0, description="real part of the refractive index; 1.59 is polystyrene"
    )
    absorption: float = Field(
        0.0, ge=0.0, le=5.0, description="imaginary part of the refractive index"
    )


class Admixture(Material):
    """Material of a share of the particles."""

    share: float = Field(gt=0.0, lt=1.0, description="fraction of all particles", examples=[0.2])


class Tracer(Material):
    """Material of the particles, or of those that `mixture` leaves."""

    mixture: tuple[Admixture, ...] | None = Field(
        None, max_length=20, description="materials of some of the particles"
    )

    @model_validator(mode="after")
    def _check_shares(self) -> Tracer:
        total = sum(material.share for material in self.mixture or ())
        if total > 1.0 + 1e-9:
            raise ValueError(f"expected shares of mixture that add up to 1 at most, got {total:g}")
        return self


_MOST = 10_000  # glints or specks in an image


class Background(Table):
    """Static light on the sensor, in fractions of the full well.

    Each camera has its own.
    """

    level: float | None = Field(
        None, ge=0.0, le=1.0, description="mean of smooth light; by default none"
    )
    variation: float = Field(
        0.5, ge=0.0, le=1.0, description="largest departure of the smooth light from its mean"
    )
    glints: int = Field(
        0, ge=0, le=_MOST, description="number of small bright reflections in each image"
    )
    glint_level: Positive = Field(2.0, description="peak of the reflections; above 1 they saturate")
    glint_sigma_px: tuple[Positive, Positive] = Field(
        (1.0, 3.0),
        description="smallest and largest standard deviation of the reflections, Gaussians",
    )
    dust: int = Field(
        0, ge=0, le=_MOST, description="number of specks of dust on the wall in each image"
    )
    dust_level: Positive = Field(0.02, description="largest light of a speck, a uniform disc")
    dust_radius_px: Positive = Field(6.0, description="radius of a speck, a disc out of focus")
    flicker: float | None = Field(
        None,
        ge=0.0,
        le=0.5,
        description="relative standard deviation of all this light from frame to frame",
    )

    @model_validator(mode="after")
    def _check_sizes(self) -> Background:
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[tuple[str, str]]:
        low, high = self.glint_sigma_px
        if low > high:
            yield "glint_sigma_px", f"expected rising values, got [{low:g}, {high:g}]"
        if self.flicker and not (self.level or self.glints or self.dust):
            yield "flicker", "expected level, glints or dust next to it, got no light that flickers"
