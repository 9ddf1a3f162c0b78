"""Particles by defocusing digital particle image velocimetry."""

from pydantic import Field

from sabench.algorithms.particles import PeakParameters, find_by_defocusing, find_unsuitable
from sabench.api import FoundParticles, ImageSequence, ParticleSolver, progress_bar


class DefocusingParameters(PeakParameters):
    """Thresholds of particle images and of the triangles that they form."""

    reach_px: float = Field(
        0.8,
        gt=0.0,
        description="largest distance of a particle image from the triangle that fits best",
    )


class Ddpiv(ParticleSolver):
    """Particles from triangles of their images in three parallel pinholes.

    Defocusing digital PIV: the triangle's size gives the depth, its middle the position across.
    """

    name = "ddpiv"
    references = (
        "Willert and Gharib, Exp. Fluids 12 (1992) 353-358",
        "Pereira and Gharib, Meas. Sci. Technol. 13 (2002) 683-694",
    )
    Parameters = DefocusingParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip cameras that are not three parallel pinholes in an equilateral triangle."""
        return find_unsuitable(case.cameras, case.grid)

    def solve(self, case: ImageSequence) -> list[FoundParticles]:
        """Find each frame's triangles on their own."""
        return [
            find_by_defocusing(frame, **self.parameters.model_dump())
            for frame in progress_bar(case, "triangles")
        ]
