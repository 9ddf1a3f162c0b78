"""A cubic polynomial for every camera."""

from sabench.algorithms.calibration import (
    fit_soloff,
    known_points,
    reason_if_edge_on,
    reason_if_flat,
)
from sabench.api import Calibration, CalibrationCase, CalibrationSolver


class SoloffCalibration(CalibrationSolver):
    """Soloff's polynomial of 19 terms, fitted to the nominal target positions.

    The nominal positions are taken as exact, so their errors pass to the cameras.
    """

    name = "soloff"
    needs_places = True
    references = ("S. M. Soloff, R. J. Adrian and Z.-C. Liu, Meas. Sci. Technol. 8, 1441, 1997",)

    def skip(self, case: CalibrationCase) -> str | None:
        """Skip nominal positions in one plane, and cameras that do not look along Z."""
        return reason_if_flat(case) or reason_if_edge_on(case)

    def solve(self, case: CalibrationCase) -> Calibration:
        """Fit every camera on its own."""
        cameras = [
            fit_soloff(camera.name, camera.rows, camera.columns, *known_points(case, number))
            for number, camera in enumerate(case.cameras)
        ]
        return Calibration(tuple(cameras))
