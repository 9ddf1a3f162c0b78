"""Particles followed over time by prediction and fits to the images."""

from collections.abc import Iterator

from pydantic import Field

from sabench.algorithms.particles import (
    BayesianIprSettings,
    ShakeTheBoxSettings,
    find_fault,
    fit_cameras,
    track_particles,
)
from sabench.api import FoundParticles, ImageSequence, Parameters, ParticleSolver, progress_bar


class ShakeTheBoxParameters(Parameters):
    """Parameters of the tracker."""

    searches: int = Field(
        2, ge=1, description="rounds of search and removal in frames with predictions"
    )
    splits: int = Field(1, ge=0, description="rounds in which particles are tried as two there")
    gap: int = Field(2, ge=0, description="frames in a row that a trajectory may miss")
    budget_s: float | None = Field(
        None,
        gt=0.0,
        description="seconds for a frame, after which the particles so far are the result; twice "
        "as long for the second frame, which is searched twice",
    )


class ShakeTheBox(ParticleSolver):
    """Shake-The-Box on the probability of the images.

    The first two frames are searched by `bayesian_ipr` and linked by displacements that neighbours
    share. Later ones start from a Kalman filter's predictions; what is left of the images is
    searched. Velocities and accelerations are the most probable ones given the positions in the
    three frames before and after.
    """

    name = "shake_the_box"
    references = (
        "Schanz, Gesemann and Schroeder, Exp. Fluids 57 (2016) 70",
        "Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation"
        " (Wiley 2001)",
    )
    Parameters = ShakeTheBoxParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip fewer than three cameras, as two lines of sight meet by chance too often."""
        return find_fault(case.cameras, case.grid)

    def solve(self, case: ImageSequence) -> Iterator[FoundParticles]:
        """Follow the particles through the sequence."""
        chosen = self.parameters
        first = BayesianIprSettings(budget_s=chosen.budget_s)
        settings = ShakeTheBoxSettings(first, chosen.searches, chosen.splits, chosen.gap)
        frames = progress_bar(case, "shake the box")
        return track_particles(frames, case.times_s, fit_cameras(case[0]), settings)
