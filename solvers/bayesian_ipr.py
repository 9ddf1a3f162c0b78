"""Iterative particle reconstruction as the most probable explanation of images."""

from pydantic import Field

from sabench.algorithms.particles import (
    BayesianIprSettings,
    find_fault,
    fit_cameras,
    reconstruct_most_probable,
)
from sabench.api import FoundParticles, ImageSequence, Parameters, ParticleSolver, progress_bar


class BayesianIprParameters(Parameters):
    """Parameters of the search for the most probable particles."""

    rounds: int = Field(
        8, ge=1, description="most rounds of search and removal, after the first candidates"
    )
    splits: int = Field(
        3, ge=0, description="most rounds in which particles are tried as two, after those"
    )
    fits: int = Field(8, ge=1, description="most times that all particles are fitted at each step")
    widening: float = Field(
        1.3,
        ge=1.0,
        le=2.0,
        description="modelled width of particle images over the measured one, while the first "
        "candidates are fitted jointly",
    )
    budget_s: float | None = Field(
        None,
        gt=0.0,
        description="seconds for a frame, after which the particles so far are the result",
    )


class BayesianIpr(ParticleSolver):
    """Bayesian iterative particle reconstruction.

    Widths, light and its scatter, noise and shifts of the cameras come from the images. Candidates
    are local maxima of the mean logarithm of the cameras' light; they are fitted jointly, the
    darkest are removed, and each one that is left is removed on trial. Splits and searches in what
    is left of the images follow until the number of particles is constant (moves of P. J. Green,
    Biometrika 82, 711, 1995, where they raise the probability). The variance of a pixel is the
    noise of dark pixels, a share of its light, 3 % of the model squared, and a quarter of what is
    left squared. Saturated pixels are lower bounds. The harness links the frames.
    """

    name = "bayesian_ipr"
    references = (
        "Wieneke, Meas. Sci. Technol. 24 (2013) 024008",
        "Green, Biometrika 82 (1995) 711",
    )
    Parameters = BayesianIprParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip fewer than three cameras, as two lines of sight meet by chance too often."""
        return find_fault(case.cameras, case.grid)

    def solve(self, case: ImageSequence) -> list[FoundParticles]:
        """Reconstruct each frame on its own."""
        chosen = self.parameters
        settings = BayesianIprSettings(
            chosen.rounds, chosen.splits, chosen.fits, chosen.widening, chosen.budget_s
        )
        maps = fit_cameras(case[0])
        return [
            reconstruct_most_probable(frame, maps, settings)
            for frame in progress_bar(case, "most probable particles")
        ]
