"""Iterative particle reconstruction."""

from __future__ import annotations

from pydantic import Field

from sabench.algorithms.particles import IprSettings, fit_cameras, reconstruct_particles
from sabench.api import FoundParticles, ImageSequence, Parameters, ParticleSolver, progress_bar


class IprParameters(Parameters):
    """Parameters of the search for particles and the removal of ghosts."""

    floor: float = Field(
        0.05,
        gt=0.0,
        lt=1.0,
        description="smallest peak of a particle image, over that of a bright particle",
    )
    noise: float = Field(
        5.0,
        ge=0.0,
        description="the same in standard deviations of the background; the larger one holds",
    )
    reach_px: float = Field(
        0.8,
        gt=0.0,
        description="largest distance of a particle image from where its camera sees the particle",
    )
    rounds: int = Field(
        4,
        ge=1,
        description="rounds of triangulation with all cameras, on what is left of the images",
    )
    reduced: int | None = Field(
        None,
        ge=0,
        description="the same where one camera may show nothing; None: each camera leads one, "
        "but four at least",
    )
    fits: int = Field(8, ge=1, description="times that every particle is fitted in each of them")
    faint: float = Field(
        0.15,
        ge=0.0,
        description="brightness in the second darkest camera below which a particle is a ghost, "
        "over the median",
    )


class Ipr(ParticleSolver):
    """Iterative particle reconstruction (IPR).

    Particles are triangulated, fitted to the images and subtracted from them, in several rounds.
    The harness links the frames.
    """

    name = "ipr"
    references = ("Wieneke, Meas. Sci. Technol. 24 (2013) 024008",)
    Parameters = IprParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip fewer than three cameras, as two lines of sight meet by chance too often."""
        return "it needs three cameras" if len(case.cameras) < 3 else None

    def solve(self, case: ImageSequence) -> list[FoundParticles]:
        """Reconstruct each frame on its own."""
        chosen = self.parameters
        reduced = max(4, len(case.cameras)) if chosen.reduced is None else chosen.reduced
        settings = IprSettings(
            chosen.floor,
            chosen.noise,
            chosen.reach_px,
            (chosen.rounds, reduced),
            chosen.fits,
            chosen.faint,
        )
        maps = fit_cameras(case[0])
        return [
            reconstruct_particles(frame, maps, settings)
            for frame in progress_bar(case, "iterative reconstruction")
        ]
