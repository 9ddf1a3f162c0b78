"""Refractive auto-calibration as in the thesis: cameras and boards in turn."""

from pydantic import Field

from sabench.algorithms.calibration import (
    CalibrationProblem,
    alternate,
    check_plane_wall,
    lens_unknowns,
)
from sabench.api import Calibration, CalibrationCase, CalibrationSolver, Parameters


class AlternatingParameters(Parameters):
    """Criteria for stopping."""

    tolerance_px: float = Field(
        0.001,
        gt=0.0,
        description="stop when the largest mean reprojection error of a camera changes by less "
        "in a round",
    )
    rounds: int = Field(1000, ge=1, description="stop after as many rounds in any case")


class RefractiveAutocalAlternating(CalibrationSolver):
    """Alternating adjustment of cameras to the boards and boards to the cameras.

    It stops when the errors hardly change. Since this criterion is a change and not a gradient, it
    stops before the least-squares solution is reached.
    """

    name = "refractive_autocal_alternating"
    references = ("J. Belden, PhD thesis, MIT 2011, figure 4-1 and section 4.4.2",)
    Parameters = AlternatingParameters

    def solve(self, case: CalibrationCase) -> Calibration:
        """Alternate, bring the points to the known reference points, and alternate again."""
        check_plane_wall(case.cameras)  # behind others thousands of small fits would take hours
        chosen: AlternatingParameters = self.parameters
        free = lens_unknowns(case)
        problem = CalibrationProblem.from_case(case, free)
        state = problem.start
        for _ in range(2):
            state = problem.align_to_nominal(
                alternate(state, problem.seen, free, chosen.tolerance_px, chosen.rounds).state
            )
        return problem.answer(state)
