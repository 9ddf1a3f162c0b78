"""A pinhole without refraction for every camera."""

from sabench.algorithms.calibration import fit_projective, known_points, reason_if_flat
from sabench.api import Calibration, CalibrationCase, CalibrationSolver


class PinholeLinear(CalibrationSolver):
    """Direct linear transform and refinement of 11 parameters, neglecting the wall.

    The target's nominal positions are taken as exact, so their errors pass to the cameras.
    """

    name = "pinhole_linear"
    needs_places = True
    references = (
        "R. Hartley and A. Zisserman, Multiple View Geometry, chapter 7",
        "J. Belden, PhD thesis, MIT 2011, section 4.4 and figure 4-6",
    )

    def skip(self, case: CalibrationCase) -> str | None:
        """Skip nominal positions in one plane, which determine no camera."""
        return reason_if_flat(case)

    def solve(self, case: CalibrationCase) -> Calibration:
        """Fit every camera on its own."""
        cameras = [
            fit_projective(camera.name, camera.rows, camera.columns, *known_points(case, number))
            for number, camera in enumerate(case.cameras)
        ]
        return Calibration(tuple(cameras))
