"""Tables of a scene: the cameras' sensor and the accuracy of rendered images."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

from pydantic import Field, model_validator

from sabench.utils.validation import Positive, Table, refuse

_BY_CAMERA = ("camera_exposure", "camera_gain", "camera_black_dn")


class Sensor(Table):
    """Sensor that turns photons into grey values."""

    exposure_s: Positive = Field(1e-3, description="exposure time, which collects dark current")
    quantum_efficiency: float = Field(0.6, gt=0.0, le=1.0, description="electrons per photon")
    dark_current_e_s: float = Field(0.0, ge=0.0, description="electrons per pixel without light")
    read_noise_e: float = Field(0.0, ge=0.0, description="standard deviation of a pixel's readout")
    full_well_e: Positive = Field(20000.0, description="electrons at which a pixel saturates")
    gain_dn_e: Positive = Field(0.2, description="grey values per electron")
    black_level_dn: float = Field(0.0, ge=0.0, description="grey value without light")
    bit_depth: int = Field(12, ge=1, le=16, description="bits of the analogue-digital converter")
    shot_noise: bool = Field(True, description="whether electrons are counted with Poisson noise")
    prnu: float | None = Field(
        None,
        ge=0.0,
        le=0.2,
        description="photo-response non-uniformity: relative standard deviation of the pixels' "
        "responses to light",
    )
    dsnu_e: float | None = Field(
        None,
        ge=0.0,
        description="dark-signal non-uniformity: standard deviation of the pixels' signals without "
        "light",
    )
    hot_pixels: float | None = Field(
        None, ge=0.0, le=0.05, description="share of pixels with a large dark signal"
    )
    hot_e: Positive | None = Field(
        None,
        description="mean dark signal of hot pixels, distributed exponentially; by default half "
        "the full well",
        examples=[5000.0],
    )
    dead_pixels: float | None = Field(
        None, ge=0.0, le=0.05, description="share of pixels without any signal"
    )
    nonlinearity: float | None = Field(
        None,
        ge=0.0,
        le=0.3,
        description="part of the signal that is missing at the full well; below, it falls with the "
        "square of the signal",
    )
    camera_exposure: tuple[Positive, ...] | None = Field(
        None,
        description="exposure time of each camera, relative to exposure_s",
        examples=[[1.0, 1.2, 0.9, 1.0]],
    )
    camera_gain: tuple[Positive, ...] | None = Field(
        None,
        description="gain of each camera, relative to gain_dn_e",
        examples=[[1.0, 1.05, 0.95, 1.0]],
    )
    camera_black_dn: tuple[Annotated[float, Field(ge=0.0)], ...] | None = Field(
        None,
        description="grey value without light of each camera, in place of black_level_dn",
        examples=[[64.0, 70.0, 60.0, 64.0]],
    )

    @property
    def white_dn(self) -> int:
        """Grey value of a saturated pixel: the lower limit of full well and converter."""
        most = self.full_well_e * (1.0 - (self.nonlinearity or 0.0))
        converter = float((1 << self.bit_depth) - 1)
        return round(min(converter, self.black_level_dn + self.gain_dn_e * most))

    @property
    def full_well_photons(self) -> float:
        """Mean number of photons that fill a pixel's well."""
        return self.full_well_e / self.quantum_efficiency

    def of_camera(self, number: int) -> Sensor:
        """Give the sensor of one camera, by its number in the rig.

        It has no keys by camera.
        """
        own: dict[str, float | None] = dict.fromkeys(_BY_CAMERA)
        if self.camera_exposure is not None:
            own["exposure_s"] = self.exposure_s * self.camera_exposure[number]
        if self.camera_gain is not None:
            own["gain_dn_e"] = self.gain_dn_e * self.camera_gain[number]
        if self.camera_black_dn is not None:
            own["black_level_dn"] = self.camera_black_dn[number]
        return self.model_copy(update=own)

    def levels_by_camera(self, cameras: int) -> tuple[tuple[float, float], ...]:
        """List the grey values of no light and of saturation of each camera.

        Empty where they are the same in all of them.
        """
        if self.camera_black_dn is None and self.camera_gain is None:
            return ()
        sensors = [self.of_camera(number) for number in range(cameras)]
        return tuple((sensor.black_level_dn, float(sensor.white_dn)) for sensor in sensors)

    def faults_by_camera(self, cameras: int) -> Iterator[str]:
        """List the keys by camera that have another number of values."""
        for name in _BY_CAMERA:
            values = getattr(self, name)
            if values is not None and len(values) != cameras:
                expected = f"expected one value for each of {cameras} cameras"
                yield f"sensor.{name}: {expected}, got {len(values)}"

    @model_validator(mode="after")
    def _check_flaws(self) -> Sensor:
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[tuple[str, str]]:
        well, white = self.full_well_e, (1 << self.bit_depth) - 1
        if self.dsnu_e is not None and 3.0 * self.dsnu_e > well:
            expected = f"expected at most a third of full_well_e = {well:g} electrons"
            yield "dsnu_e", f"{expected}, got {self.dsnu_e:g}"
        if self.hot_e is not None and self.hot_pixels is None:
            yield "hot_e", "expected hot_pixels, their share, next to it, got none"
        if self.hot_e is not None and self.hot_e > well:
            yield "hot_e", f"expected at most full_well_e = {well:g} electrons, got {self.hot_e:g}"
        levels = {"camera_black_dn": self.camera_black_dn, "black_level_dn": (self.black_level_dn,)}
        for key, values in levels.items():
            if values and max(values) >= white:
                yield key, f"expected less than the white level {white}, got {max(values):g}"


class Render(Table):
    """Accuracy of rendered images."""

    relative_error: float | None = Field(
        None,
        ge=1e-4,
        le=0.2,
        description="relative standard error of the pixels that show bubbles and solids, mean over "
        "them; by default 0.04",
    )

    samples_per_pixel: int = Field(
        9, ge=1, le=4096, description="a square number: a regular grid of rays in each pixel"
    )

    @model_validator(mode="after")
    def _square(self) -> Render:
        if math.isqrt(self.samples_per_pixel) ** 2 != self.samples_per_pixel:
            raise ValueError(
                f"samples_per_pixel: expected a square number, got {self.samples_per_pixel}"
            )
        return self
