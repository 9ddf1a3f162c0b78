"""Tables of a scene: the cameras' sensor and the accuracy of rendered images."""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from sabench.utils.fields import Positive, Table


class Sensor(Table):
    """Sensor that turns photons into grey values."""

    exposure_s: Positive = 1e-3
    quantum_efficiency: float = Field(0.6, gt=0.0, le=1.0)
    dark_current_e_s: float = Field(0.0, ge=0.0)
    read_noise_e: float = Field(0.0, ge=0.0)
    full_well_e: Positive = 20000.0
    gain_dn_e: Positive = Field(0.2, description="grey values per electron")
    black_level_dn: float = Field(0.0, ge=0.0, description="grey value without light")
    bit_depth: int = Field(12, ge=1, le=16)
    shot_noise: bool = True

    @property
    def white_dn(self) -> int:
        """Grey value of a saturated pixel: the lower limit of full well and converter."""
        full = round(self.black_level_dn + self.gain_dn_e * self.full_well_e)
        return min((1 << self.bit_depth) - 1, full)


class Render(Table):
    """Accuracy of rendered images."""

    relative_error: float | None = Field(
        None,
        ge=1e-4,
        le=0.2,
        description="relative standard error of pixels of bubbles and solids, mean over an image; "
        "by default 0.01",
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
