"""Particles by triangulation."""

from __future__ import annotations

from pydantic import Field

from sabench.algorithms.particles import (
    TriangulationSettings,
    fit_cameras,
    triangulate_particles,
)
from sabench.api import FoundParticles, ImageSequence, Parameters, ParticleSolver, progress_bar


class TriangulationParameters(Parameters):
    """Thresholds of particle images and of their agreement in a particle."""

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


class RayTriangulation(ParticleSolver):
    """Particles at the intersections of lines of sight.

    Lines of sight match particle images between the cameras; every image is used once. The harness
    links the frames.
    """

    name = "ray_triangulation"
    references = ("Maas, Gruen and Papantoniou, Exp. Fluids 15 (1993) 133-146",)
    Parameters = TriangulationParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip fewer than three cameras, as two lines of sight meet by chance too often."""
        return "it needs three cameras" if len(case.cameras) < 3 else None

    def solve(self, case: ImageSequence) -> list[FoundParticles]:
        """Triangulate each frame on its own."""
        chosen = self.parameters
        settings = TriangulationSettings(chosen.floor, chosen.noise, chosen.reach_px)
        maps = fit_cameras(case[0])
        return [
            triangulate_particles(frame, maps, settings)
            for frame in progress_bar(case, "triangulation")
        ]
