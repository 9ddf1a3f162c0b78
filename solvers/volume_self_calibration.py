"""Volume self-calibration on particle images."""

from pydantic import Field

from sabench.algorithms.calibration import (
    Tracking,
    adjust_cameras,
    follow_disparities,
    match_particles,
)
from sabench.api import Calibration, Observation, Parameters, SelfCalibrationSolver


class VolumeSelfCalibrationParameters(Parameters):
    """Limits of the cameras' errors and of particle images."""

    reach_px: float = Field(
        4.0,
        gt=0.5,
        le=20.0,
        description="largest error that is looked for; it is halved in every round",
    )
    least_px: float = Field(0.7, gt=0.1, description="search radius at which the rounds end")
    bright: float = Field(
        0.15,
        gt=0.0,
        lt=1.0,
        description="least peak of a particle image, as a fraction of a bright one's",
    )
    false_alarms: float = Field(
        1e-5,
        gt=0.0,
        lt=0.5,
        description="probability that noise makes a particle image of a pixel; the larger of both "
        "thresholds holds",
    )


class VolumeSelfCalibration(SelfCalibrationSolver):
    """Correction of cameras that are a few pixels off, from the particles they share.

    Disparities of particle images between the cameras are removed first. The disparities of a set
    of images in all cameras form a vector. The part that a shift of the particle
    explains is projected out: in the dimensions that are left (five for four cameras) right sets
    agree and wrong ones scatter, even where these far outnumber the right ones. Particles do not
    show a common motion of all cameras: it stays uncorrected, and so do errors that resemble one.
    """

    name = "volume_self_calibration"
    references = ("B. Wieneke, Exp. Fluids 45, 549-556, 2008",)
    Parameters = VolumeSelfCalibrationParameters

    def skip(self, case: Observation) -> str | None:
        """Skip fewer than three cameras, as two cameras agree on anything."""
        return (
            f"expected 3 cameras or more, got {len(case.cameras)}"
            if len(case.cameras) < 3
            else None
        )

    def solve(self, case: Observation) -> Calibration:
        """Adjust four cameras first, then the others to the particles of these."""
        chosen: VolumeSelfCalibrationParameters = self.parameters
        tracking = Tracking.from_case(case, chosen.bright, chosen.false_alarms)
        maps = follow_disparities(tracking, chosen.reach_px, chosen.least_px)
        return Calibration(
            adjust_cameras(tracking, match_particles(tracking, maps, chosen.least_px))
        )
