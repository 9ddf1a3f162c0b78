"""Tracers of images that also show bubbles and a body."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from pydantic import Field

from sabench.algorithms.bubbles import image_diameter_px, separate_phases
from sabench.api import (
    FoundParticles,
    ImageSequence,
    Observation,
    Parameters,
    ParticleSolver,
    make_algorithm,
)


class SeparatedTracersParameters(Parameters):
    """Largest bubble, and the solver of the separated images."""

    largest_mm: float = Field(1.6, gt=0.0, description="radius; what is dark and wider is the body")
    solver: str = Field("bayesian_ipr", description="solver of the task particles")


class SeparatedTracers(ParticleSolver):
    """Tracers found after bubbles and the body are removed from the images."""

    name = "separated_tracers"
    references = ("radiance is conserved: nothing that is not lit itself exceeds the diffuser",)
    Parameters = SeparatedTracersParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip what the solver of the tracers skips."""
        reason: str | None = self._solver().skip(case)
        return reason

    def solve(self, case: ImageSequence) -> Iterable[FoundParticles]:
        """Separate the phases of each frame and find the tracers."""
        particles: Iterable[FoundParticles] = self._solver().solve(
            replace(case, load=lambda number: self._tracers(case[number]))
        )
        return particles

    def _tracers(self, frame: Observation) -> Observation:
        widest = image_diameter_px(frame, self.parameters.largest_mm)
        return separate_phases(frame, widest).tracers

    def _solver(self) -> Any:
        return make_algorithm(self.parameters.solver, {})
