"""Simultaneous additive algebraic reconstruction on multiplied lines of sight."""

from collections.abc import Callable, Iterator

import numpy as np
from pydantic import Field

from sabench.algorithms.tomography import SparseParameters, TomographyProblem, iterate, sart
from sabench.api import IterativeSolver, Observation, Reconstruction


class MlosSartParameters(SparseParameters):
    """Parameters of SART; the iteration converges for relaxations below 2."""

    relaxation: float = Field(
        1.0, gt=0.0, lt=2.0, description="mu, the part of what is missing that one iteration adds"
    )


class MlosSart(IterativeSolver):
    """MLOS-SART: simultaneous additive updates where all cameras see light.

    The mean over cameras of the light that is missing along the lines of sight is added.
    """

    name = "mlos_sart"
    references = (
        "Atkinson and Soria, Exp. Fluids 47 (2009) 553-568",
        "Andersen and Kak, Ultrasonic Imaging 6 (1984) 81-94",
        "Belden, MIT thesis, equation 3.12",
    )
    Parameters = MlosSartParameters

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        """Iterate on the voxels that MLOS leaves.

        I_j <- max(0, I_j + mu sum_i W_ij (P_i - sum_k W_ik I_k) / L_i / N_j).
        """
        chosen = self.parameters
        problem = TomographyProblem.from_case(case, chosen)
        state = problem.mlos(chosen.threshold)
        lengths = state.lines.forward(np.ones_like(state.values))
        for _ in iterate(
            lambda: sart(state, problem.measured, lengths, chosen.relaxation),
            problem.measured,
            chosen.iterations,
            chosen.tolerance,
            self.name,
        ):
            yield lambda: Reconstruction(problem.volume(state, chosen.floor))
