"""Motion-tracking-enhanced multiplicative algebraic reconstruction."""

import itertools
from collections.abc import Iterator

import numpy as np
from pydantic import Field

from sabench.algorithms.tomography import (
    Displacement,
    Exposure,
    SparseParameters,
    enhanced_guesses,
)
from sabench.algorithms.velocimetry import VolumeCorrelationParameters, evaluate
from sabench.api import ImageSequence, Observation, Reconstruction, SequenceSolver


class MteMartParameters(SparseParameters, VolumeCorrelationParameters):
    """Parameters of `block_mart` and of the correlation, and repetitions."""

    exposures: int = Field(
        2, ge=2, le=100, description="consecutive frames that are reconstructed together"
    )
    repeats: int = Field(
        3, ge=0, le=100, description="times that exposures start again from each other's volumes"
    )
    later_iterations: int = Field(
        10, ge=1, le=1000, description="how often all cameras correct the volume after that"
    )


class MteMart(SequenceSolver):
    """Block MART of several exposures that start from each other's volumes.

    The mean of an exposure's volume and of its neighbours', moved by the measured displacements, is
    the next initial guess: ghosts, which do not move as the particles around them, fade.
    """

    name = "mte_mart"
    references = (
        "Novara, Batenburg and Scarano, Meas. Sci. Technol. 21 (2010) 035401",
        "Belden, MIT thesis, section 3.3.2",
    )
    Parameters = MteMartParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Refuse a single frame, which has no other exposure."""
        return "it needs two frames, got one" if len(case) < 2 else None

    def solve(self, case: ImageSequence) -> Iterator[Reconstruction]:
        """Reconstruct groups of consecutive frames, each group together."""
        groups = max(1, len(case) // self.parameters.exposures)
        for frames in np.array_split(np.arange(len(case)), groups):
            yield from self._together([case[int(frame)] for frame in frames])

    def _together(self, frames: list[Observation]) -> list[Reconstruction]:
        """Reconstruct exposures of the same particles."""
        chosen: MteMartParameters = self.parameters
        exposures = [Exposure.from_case(frame, chosen) for frame in frames]
        for exposure in exposures:
            exposure.correct(chosen, chosen.iterations, self.name)
        for _ in range(chosen.repeats):
            exposures = self._enhance(exposures)
        return [Reconstruction(exposure.volume(chosen.floor)) for exposure in exposures]

    def _enhance(self, exposures: list[Exposure]) -> list[Exposure]:
        """Measure displacements, and correct the guesses that follow from them."""
        chosen: MteMartParameters = self.parameters
        plan = chosen.volume_plan(exposures[0].problem.grid.shape)
        volumes = [exposure.volume(chosen.floor) for exposure in exposures]
        moves = [
            Displacement.of(evaluate(first, second, plan), exposures[0].problem.splits)
            for first, second in itertools.pairwise(volumes)
        ]
        blobs = [exposure.problem.blobs(exposure.state) for exposure in exposures]
        guesses = enhanced_guesses(blobs, moves)
        new = [exposure.restart(guess) for exposure, guess in zip(exposures, guesses, strict=True)]
        for exposure in new:
            exposure.correct(chosen, chosen.later_iterations, self.name)
        return new
