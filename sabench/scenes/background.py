"""Table of a scene for static light that does not come from the volume."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import Field, model_validator

from sabench.utils.fields import Positive, Table
from sabench.utils.validation import refuse

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
