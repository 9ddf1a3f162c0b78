"""The thesis's auto-calibration on random subsets of the cameras."""

from dataclasses import replace

import numpy as np
from pydantic import Field

from sabench.algorithms.calibration import (
    CalibrationProblem,
    FreeParameters,
    State,
    alternate,
    check_plane_wall,
    lens_unknowns,
    mean_rotation,
    select_cameras,
)
from sabench.api import Calibration, CalibrationCase, CalibrationSolver, Parameters, stream


class RandomisedParameters(Parameters):
    """Sizes of the subsets and criteria of their agreement."""

    subset: int = Field(
        4, ge=2, description="cameras in a subset; two subsets are drawn in every iteration"
    )
    agreement_mm: float = Field(
        0.001,
        gt=0.0,
        description="stop when the points of two subsets differ by less, as a standard deviation",
    )
    iterations: int = Field(20, ge=1, description="stop after as many in any case")
    tolerance_px: float = Field(0.001, gt=0.0, description="of the alternation")
    rounds: int = Field(1000, ge=1, description="of the alternation, at most")
    seed: int = Field(1, ge=0, description="of the draws")


class RefractiveAutocalRandomised(CalibrationSolver):
    """Alternating calibrations of random subsets until two agree.

    The mean of their boards is the initial guess for all cameras.
    """

    name = "refractive_autocal_randomised"
    references = ("J. Belden, PhD thesis, MIT 2011, section 4.4.2",)
    Parameters = RandomisedParameters

    def skip(self, case: CalibrationCase) -> str | None:
        """Skip unless two different subsets exist."""
        chosen: RandomisedParameters = self.parameters
        if len(case.cameras) > chosen.subset:
            return None
        return (
            f"expected more than {chosen.subset} cameras, of which subsets can be drawn, got "
            f"{len(case.cameras)}"
        )

    def solve(self, case: CalibrationCase) -> Calibration:
        """Draw and average until the subsets agree, or agree less than before."""
        check_plane_wall(case.cameras)  # behind others thousands of small fits would take hours
        chosen: RandomisedParameters = self.parameters
        free, rng = lens_unknowns(case), stream(self.parameters.seed, "subsets")
        problem = CalibrationProblem.from_case(case, free)
        state, least = problem.start, np.inf
        for _ in range(chosen.iterations):
            pair = [self._subset(problem, state, rng, free) for _ in range(2)]
            points = [part.points(problem.seen.board) for part in pair]
            spread = float((points[0] - points[1]).std(axis=(0, 1)).max())
            if spread > least:
                break
            state, least = _average(state, pair), spread
            if spread < chosen.agreement_mm:
                break
        return problem.answer(
            problem.align_to_nominal(
                alternate(state, problem.seen, free, chosen.tolerance_px, chosen.rounds).state
            )
        )

    def _subset(
        self,
        problem: CalibrationProblem,
        state: State,
        rng: np.random.Generator,
        free: FreeParameters,
    ) -> State:
        """Calibrate one subset from the boards as they are known so far."""
        chosen: RandomisedParameters = self.parameters
        cameras = np.sort(rng.permutation(len(state.rotations))[: chosen.subset])
        part, views = select_cameras(state, problem.seen, cameras)
        return problem.align_to_nominal(
            alternate(part, views, free, chosen.tolerance_px, chosen.rounds).state
        )


def _average(state: State, pair: list[State]) -> State:
    """Average both subsets' boards in a state."""
    positions = np.mean([part.board_positions for part in pair], axis=0)
    return replace(
        state,
        board_rotations=mean_rotation(np.stack([part.board_rotations for part in pair])),
        board_positions=positions,
    )
