"""Bubbles of images that also show a body and tracers."""

from typing import Any

from pydantic import Field

from sabench.algorithms.bubbles import image_diameter_px, separate_phases
from sabench.api import BubbleSolver, Detections, Observation, Parameters, make_algorithm


class SeparatedBubblesParameters(Parameters):
    """Largest bubble, and the solver of the separated images."""

    largest_mm: float = Field(1.6, gt=0.0, description="radius; what is dark and wider is the body")
    solver: str = Field("rim_fit", description="solver of the task bubbles")


class SeparatedBubbles(BubbleSolver):
    """Bubbles found after tracers and the body are removed from the images."""

    name = "separated_bubbles"
    references = ("radiance is conserved: nothing that is not lit itself exceeds the diffuser",)
    Parameters = SeparatedBubblesParameters

    def skip(self, case: Observation) -> str | None:
        """Skip what the solver of the bubbles skips."""
        reason: str | None = self._solver().skip(case)
        return reason

    def solve(self, case: Observation) -> Detections:
        """Separate the phases and find the bubbles."""
        widest = image_diameter_px(case, self.parameters.largest_mm)
        detections: Detections = self._solver().solve(separate_phases(case, widest).bubbles)
        return detections

    def _solver(self) -> Any:
        return make_algorithm(self.parameters.solver, {})
