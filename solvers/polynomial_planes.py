"""A quadratic polynomial for every plane of a traversed target."""

import numpy as np

from sabench.algorithms.calibration import fit_planes, known_frames
from sabench.api import Calibration, CalibrationCase, CalibrationSolver

_FLAT = 0.1  # largest range of Z in a frame, as a part of the distance of the frames


class PolynomialPlanes(CalibrationSolver):
    """Second-order polynomials on the planes of a target that was traversed along Z.

    Lines of sight between the planes are straight, as in the thesis's experiment. The target's
    nominal positions are taken as exact, so their errors pass to the cameras.
    """

    name = "polynomial_planes"
    needs_places = True
    references = ("J. Belden, PhD thesis, MIT 2011, section 2.3.2",)

    def skip(self, case: CalibrationCase) -> str | None:
        """Skip unless the target stood at right angles to Z."""
        depth = case.initial_mm[..., 2]
        middles = np.sort(np.nanmean(depth, axis=1))
        ranges = np.nanmax(depth, axis=1) - np.nanmin(depth, axis=1)
        apart = float(np.diff(middles).min(initial=np.inf))
        if apart > 0.0 and ranges.max() <= _FLAT * apart:
            return None
        return (
            f"expected frames of one Z each, got one with a range of {ranges.max():.3g} mm "
            f"where frames are {apart:.3g} mm apart"
        )

    def solve(self, case: CalibrationCase) -> Calibration:
        """Fit every camera on its own."""
        cameras = [
            fit_planes(camera.name, camera.rows, camera.columns, *known_frames(case, number))
            for number, camera in enumerate(case.cameras)
        ]
        return Calibration(tuple(cameras))
