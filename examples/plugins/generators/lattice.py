"""Particles on a regular lattice."""

import numpy as np
from pydantic import Field

from sabench.api import Domain, Generator, Parameters, Particles, stream


class LatticeParameters(Parameters):
    """Spacing of the lattice, displacement of the particles and their diameter."""

    pitch_mm: float = Field(gt=0.0, description="distance of neighbours along x, y and z")
    jitter_mm: float = Field(
        0.0, ge=0.0, description="standard deviation of the displacement from the lattice"
    )
    diameter_mm: float = Field(0.02, gt=0.0, description="diameter of all particles")


class Lattice(Generator):
    """Particles at rest on a cubic lattice, displaced at random."""

    name = "lattice"
    Parameters = LatticeParameters

    def particles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Particles:
        """Place the same particles in every frame; the seed draws the displacements."""
        chosen = self.parameters
        axes = [
            low + np.arange(chosen.pitch_mm / 2, size, chosen.pitch_mm)
            for low, size in zip(domain.low_mm, domain.size_mm, strict=True)
        ]
        position = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
        position += chosen.jitter_mm * stream(seed, "lattice").standard_normal(position.shape)
        count = len(position)
        return Particles(
            np.arange(count), position, np.full(count, chosen.diameter_mm), np.zeros((count, 3))
        )
