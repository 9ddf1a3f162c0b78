"""Bubbles or drops throughout the volume."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from sabench.api import (
    F64,
    I64,
    BubbleGenerator,
    BubbleParameters,
    Bubbles,
    Domain,
    InputError,
    Vector,
    stream,
    triple,
)
from sabench.worlds.library.random_packing import place_ellipsoids
from sabench.worlds.library.sizes import Spectrum, spheroids, within


class BubbleFieldParameters(BubbleParameters, Spectrum):
    """Parameters of the bubbles; give exactly one of `count` and `void_fraction`."""

    count: int | None = Field(None, ge=0, le=1_000_000, description="number of bubbles")
    void_fraction: float | None = Field(
        None, ge=0.0, le=0.3, description="volume of the bubbles over that of the box"
    )
    velocity_mm_s: Vector = Field((0.0, 0.0, 0.0), description="velocity of all bubbles")
    low_mm: Vector | None = Field(
        None, description="the box's corner with the smallest coordinates; by default the volume's"
    )
    high_mm: Vector | None = Field(None, description="its opposite corner")

    @model_validator(mode="after")
    def _check_amount(self) -> BubbleFieldParameters:
        if (self.count is None) == (self.void_fraction is None):
            raise ValueError("expected exactly one of count, void_fraction")
        if (self.low_mm is None) != (self.high_mm is None):
            raise ValueError("expected both of low_mm, high_mm or none")
        return self

    def box(self, domain: Domain) -> Domain:
        """Return the box that the bubbles fill."""
        if self.low_mm is None or self.high_mm is None:
            return domain
        low, high = np.asarray(self.low_mm), np.asarray(self.high_mm)
        if (
            (low < domain.low_mm - 1e-9).any()
            or (high > domain.low_mm + np.asarray(domain.size_mm) + 1e-9).any()
            or (low >= high).any()
        ):
            raise InputError(
                "bubbles: low_mm, high_mm: expected rising corners within the volume, got "
                f"{list(self.low_mm)} and {list(self.high_mm)}"
            )
        return Domain(triple((low + high) / 2.0), triple(high - low), domain.pixels)


class BubbleField(BubbleGenerator):
    """Bubbles of log-normal sizes at uniformly random positions.

    They are carried by one velocity. A bubble that leaves the box is replaced on the other side.
    """

    name = "bubble_field"
    Parameters = BubbleFieldParameters

    def bubbles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Bubbles:
        """Return the bubbles that are wholly in the volume at a time.

        The seed draws the field, the time moves it.
        """
        chosen: BubbleFieldParameters = self.parameters
        domain, rng = chosen.box(domain), stream(seed, "bubbles")
        velocity, size = np.asarray(chosen.velocity_mm_s), np.asarray(domain.size_mm)
        # margin to enter and leave
        margin = 2.0 * chosen.radius_range_mm[1] / chosen.aspect_range[0]
        beyond = np.where(velocity != 0.0, margin, 0.0)
        period = size + beyond
        semi_axes, rotation = self._shapes(rng, float(period.prod()))
        extent = np.linalg.norm(semi_axes[:, None, :] * rotation.transpose(0, 2, 1), axis=2)

        def propose(which: I64, tries: int) -> F64:
            margin = np.maximum(period - 2.0 * extent[which], 0.0)[:, None]
            return np.asarray((period - margin) / 2.0 + margin * rng.random((len(which), tries, 3)))

        start = (
            propose(np.arange(len(semi_axes)), 1)[:, 0]
            if chosen.overlap
            else place_ellipsoids(semi_axes, rotation, propose, "bubble_field")
        )
        travelled = start + velocity * time_s
        turns = np.floor(travelled / period).astype(np.int64)
        identity = np.arange(len(start)) + len(start) * np.abs(turns).sum(axis=1)
        center = domain.low_mm - beyond / 2.0 + travelled - turns * period
        bubbles = Bubbles(
            identity, center, semi_axes, rotation, np.tile(velocity, (len(start), 1)), chosen.index
        )
        return bubbles[within(domain, bubbles)]

    def _shapes(self, rng: np.random.Generator, room_mm3: float) -> tuple[F64, F64]:
        chosen: BubbleFieldParameters = self.parameters
        if chosen.count is not None:
            return spheroids(chosen, rng, chosen.count)
        wanted, count = (chosen.void_fraction or 0.0) * room_mm3, 64
        while True:
            semi_axes, rotation = spheroids(chosen, rng, count)
            volume = np.cumsum(4.0 / 3.0 * np.pi * semi_axes.prod(axis=1))
            if volume[-1] >= wanted:
                enough = int(np.searchsorted(volume, wanted))
                below = volume[enough - 1] if enough else 0.0
                enough += int(volume[enough] - wanted < wanted - below)
                return semi_axes[:enough], rotation[:enough]
            count = int(count * max(1.2, 1.1 * wanted / volume[-1])) + 1
