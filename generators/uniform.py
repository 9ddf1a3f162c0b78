"""Uniformly distributed particles in a uniform flow."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from sabench.api import F64, Domain, Generator, InputError, Parameters, Particles, stream

_MOST = 50_000_000
_LEAST = 0.1  # of the median: the smallest of a normal distribution


class UniformParameters(Parameters):
    """Particles; give exactly one of `count`, `per_mm3` and `per_pixel`."""

    count: int | None = Field(None, ge=0, le=_MOST, description="number of particles")
    per_mm3: float | None = Field(None, ge=0.0, description="particles per mm3 of the volume")
    per_pixel: float | None = Field(
        None, ge=0.0, description="particles per pixel of one camera's image (ppp)"
    )
    diameter_mm: float = Field(0.05, gt=0.0, description="median diameter")
    diameter_spread: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="standard deviation of the logarithm of the diameter (log-normal) or of the "
        "diameter over its median (normal); 0: all are equal",
    )
    diameter_distribution: Literal["log-normal", "normal"] | None = Field(
        None,
        description="distribution of diameters, by default log-normal; a normal one ends at a "
        "tenth of the median",
        examples=["normal"],
    )
    diameters_mm: tuple[Annotated[float, Field(gt=0.0)], ...] | None = Field(
        None,
        min_length=1,
        description="diameters of which each particle has one at random, in place of `diameter_mm`",
        examples=[[0.01, 0.05]],
    )
    velocity_mm_s: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="velocity of all particles"
    )

    @model_validator(mode="after")
    def _one_density(self) -> UniformParameters:
        given = [
            name for name in ("count", "per_mm3", "per_pixel") if getattr(self, name) is not None
        ]
        if len(given) != 1:
            raise ValueError(
                "expected exactly one of count, per_mm3, per_pixel, got "
                f"{', '.join(given) or 'none'}"
            )
        return self


class Uniform(Generator):
    """Uniformly random particles carried by one velocity.

    A particle that leaves the volume is replaced on the other side.
    """

    name = "uniform"
    Parameters = UniformParameters

    def particles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Particles:
        """Draw the cloud from the seed and move it to the frame's time."""
        count = self._count(domain)
        rng = stream(seed, "particles")
        size, velocity = np.asarray(domain.size_mm), np.asarray(self.parameters.velocity_mm_s)
        place, identity = rng.random((count, 3)) * size, np.arange(count, dtype=np.int64)
        diameter = self._diameters(rng, count)
        if velocity.any():
            place += velocity * time_s
            turns = np.floor(place / size)
            place = np.clip(place - turns * size, 0.0, size)
            # a particle that re-enters is a new one, with a new id
            identity += count * np.abs(turns).astype(np.int64).sum(axis=1)
        return Particles(identity, domain.low_mm + place, diameter, np.full((count, 3), velocity))

    def _diameters(self, rng: np.random.Generator, count: int) -> F64:
        chosen: UniformParameters = self.parameters
        if chosen.diameters_mm is not None:
            return rng.choice(np.array(chosen.diameters_mm), count)
        if not chosen.diameter_spread:
            return np.full(count, chosen.diameter_mm)
        deviation = chosen.diameter_spread * rng.standard_normal(count)
        if chosen.diameter_distribution == "normal":
            return np.asarray(chosen.diameter_mm * np.maximum(1.0 + deviation, _LEAST))
        return np.asarray(chosen.diameter_mm * np.exp(deviation))

    def _count(self, domain: Domain) -> int:
        chosen: UniformParameters = self.parameters
        if chosen.count is not None:
            return chosen.count
        wanted = (
            chosen.per_mm3 * domain.volume_mm3
            if chosen.per_mm3 is not None
            else (chosen.per_pixel or 0.0) * domain.pixels
        )
        if wanted > _MOST:
            raise InputError(
                f"particles: expected at most {_MOST} of them, but per_mm3 or per_pixel makes "
                f"{wanted:.3g}"
            )
        return round(wanted)
