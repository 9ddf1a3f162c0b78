"""Distributions of bubbles' sizes, shapes and directions."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, Field, model_validator

from sabench.api.truth import Bubbles
from sabench.geometry.rigid_motion import Domain
from sabench.utils.arrays import F64, UP, Bool


class Spectrum(BaseModel):
    """Log-normal sizes within a range, and oblate shapes.

    Radii are those of balls of the same volume; the short axis is near the vertical.
    """

    radius_mm: float = Field(0.6, gt=0.0, description="median radius of a ball of the same volume")
    radius_spread: float = Field(
        0.5, ge=0.0, le=2.0, description="standard deviation of the logarithm of the radius"
    )
    radius_range_mm: tuple[float, float] = Field(
        (0.1, 4.0), description="range of radii; those beyond it are drawn again"
    )
    aspect_range: tuple[float, float] = Field(
        (1.0, 1.0), description="range of the short axis over the long one, uniform"
    )
    tilt_deg: float = Field(
        0.0,
        ge=0.0,
        le=90.0,
        description="standard deviation of the short axis's angle to the vertical, in both "
        "directions",
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> Spectrum:
        low, high = self.radius_range_mm
        if not 0.0 < low <= high or not low <= self.radius_mm <= high:
            raise ValueError(
                "radius_range_mm: expected positive, rising values around radius_mm = "
                f"{self.radius_mm:g}, got {[low, high]}"
            )
        if not 0.0 < self.aspect_range[0] <= self.aspect_range[1] <= 1.0:
            raise ValueError(
                "aspect_range: expected rising values between 0 and 1, got "
                f"{list(self.aspect_range)}"
            )
        return self


def radii(
    spectrum: Spectrum, rng: np.random.Generator, count: int, largest_mm: float = np.inf
) -> F64:
    """Draw radii (count,) from a spectrum, none above `largest_mm`."""
    low, high = spectrum.radius_range_mm
    out = np.full(count, spectrum.radius_mm)
    left = np.ones(count, dtype=np.bool_)
    while spectrum.radius_spread > 0.0 and left.any():
        draws = rng.standard_normal(int(left.sum()))
        out[left] = spectrum.radius_mm * np.exp(spectrum.radius_spread * draws)
        left = (out < low) | (out > min(high, largest_mm))
    return out


def spheroids(
    spectrum: Spectrum, rng: np.random.Generator, count: int, largest_mm: float = np.inf
) -> tuple[F64, F64]:
    """Draw semi-axes (count, 3), the second short, and rotations of oblate spheroids."""
    radius = radii(spectrum, rng, count, largest_mm)
    aspect = rng.uniform(*spectrum.aspect_range, count)
    long = radius * aspect ** (-1.0 / 3.0)
    rotation = upright(rng, count, np.deg2rad(spectrum.tilt_deg))
    return np.column_stack([long, long * aspect, long]), rotation


def upright(rng: np.random.Generator, count: int, tilt: float) -> F64:
    """Draw rotations (count, 3, 3) with second rows near the vertical.

    They are tilted at random about both horizontal axes.
    """
    short = np.tile(UP, (count, 1))
    short[:, [0, 2]] = np.tan(np.clip(tilt * rng.standard_normal((count, 2)), -1.5, 1.5))
    short /= np.linalg.norm(short, axis=1, keepdims=True)
    first = np.cross(short, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, short, np.cross(first, short)], axis=1)


def within(domain: Domain, bubbles: Bubbles) -> Bool:
    """Find which bubbles lie wholly in the box."""
    extent = np.stack([bubbles.reach_mm(axis) for axis in np.eye(3)], axis=1)
    low, high = domain.low_mm, domain.low_mm + np.asarray(domain.size_mm)
    inside = bubbles.center_mm - extent >= low - 1e-9
    inside &= bubbles.center_mm + extent <= high + 1e-9
    return np.asarray(inside.all(axis=1))
