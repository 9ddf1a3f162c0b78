"""Tables of a scene: the cameras' sensor and the accuracy of rendered images."""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from sabench.utils.fields import Positive, Table


class Sensor(Table):
    """From photons to grey values."""

    exposure_s: Positive = 1e-3
    quantum_efficiency: float = Field(0.6, gt=0.0, le=1.0)
    dark_current_e_s: float = Field(0.0, ge=0.0)
    read_noise_e: float = Field(0.0, ge=0.0)
    full_well_e: Positive = 20000.0
    gain_dn_e: Positive = Field(0.2, description="grey values per electron")
    black_level_dn: float = Field(0.0, ge=0.0, description="grey value of no light")
    bit_depth: int = Field(12, ge=1, le=16)
    shot_noise: bool = True


class Render(Table):
    """How the images are computed."""

    relative_error: float | None = Field(
        None,
        ge=1e-4,
        le=0.2,
        description="of pixels of bubbles and solids, mean over an image: standard error over value; by default 0.01",
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


def white_level(sensor: Sensor) -> int:
    """Grey value of a saturated pixel: the full well's or the converter's limit, whichever comes first."""
    return min(
        (1 << sensor.bit_depth) - 1,
        round(sensor.black_level_dn + sensor.gain_dn_e * sensor.full_well_e),
    )
