"""Refractive resection: every camera on its own from known places."""

from sabench.algorithms.calibration import (
    CalibrationProblem,
    adjust,
    lens_unknowns,
)
from sabench.api import Calibration, CalibrationCase, CalibrationSolver


class RefractiveResection(CalibrationSolver):
    """Robust fit of pinholes behind the wall to known places of the target.

    The target's nominal positions are taken as exact, so their errors pass to the cameras, and the
    wall is where the case says. `refractive_autocal` weighs both against the images.
    """

    name = "refractive_resection"
    needs_places = True
    references = ("R. Hartley and A. Zisserman, Multiple View Geometry, chapter 7",)

    def solve(self, case: CalibrationCase) -> Calibration:
        """Adjust the cameras to the nominal positions."""
        free = lens_unknowns(case)
        problem = CalibrationProblem.from_case(case, free)
        robust = adjust(problem.start, problem.seen, free, moving="cameras")
        return problem.answer(robust.fit.state, robust.used)
