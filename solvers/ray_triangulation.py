"""Particles by triangulation."""

from pydantic import Field

from sabench.algorithms.particles import (
    PeakParameters,
    TriangulationSettings,
    fit_cameras,
    triangulate_particles,
)
from sabench.api import FoundParticles, ImageSequence, ParticleSolver, progress_bar


class TriangulationParameters(PeakParameters):
    """Thresholds of particle images and of their agreement in a particle."""

    reach_px: float = Field(
        0.8,
        gt=0.0,
        description="largest distance of a particle image from where its camera sees the particle",
    )
    budget_s: float | None = Field(
        300.0,
        gt=0.0,
        description="seconds for a frame, after which the particles so far are the result",
    )


class RayTriangulation(ParticleSolver):
    """Particles at the intersections of lines of sight.

    The line of sight of a peak in one camera is intersected with those of the peaks along it in a
    second one; every other camera must show a peak near the projection of the intersection. The
    least-squares position of such a set is a candidate. Candidates are accepted in the order of
    their fit, so that every image is used once. Source: H. G. Maas, A. Gruen and D. Papantoniou,
    Exp. Fluids 15, 133-146, 1993. The harness links the frames.
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
        settings = TriangulationSettings(
            chosen.floor, chosen.false_alarms, chosen.reach_px, chosen.budget_s
        )
        maps = fit_cameras(case[0])
        return [
            triangulate_particles(frame, maps, settings)
            for frame in progress_bar(case, "triangulation")
        ]
