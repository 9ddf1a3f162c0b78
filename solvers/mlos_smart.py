"""Simultaneous MART on multiplied lines of sight.

MART: multiplicative algebraic reconstruction technique.
"""

from collections.abc import Callable, Iterator

from pydantic import Field

from sabench.algorithms.tomography import SparseParameters, TomographyProblem, iterate, smart
from sabench.api import IterativeSolver, Observation, Reconstruction


class MlosSmartParameters(SparseParameters):
    """Parameters of SMART; relaxations above 1 overrelax the geometric mean."""

    relaxation: float = Field(
        1.5, gt=0.0, le=2.0, description="mu, the power of the geometric mean over cameras"
    )


class MlosSmart(IterativeSolver):
    """MLOS-SMART: simultaneous multiplicative updates where all cameras see light.

    Voxels are multiplied by the geometric mean over cameras of the ratios of recorded to projected
    light.
    """

    name = "mlos_smart"
    references = (
        "Atkinson and Soria, Exp. Fluids 47 (2009) 553-568",
        "Mishra, Muralidhar and Munshi, Inverse Problems 15 (1999)",
        "Belden, MIT thesis, equation 3.13",
    )
    Parameters = MlosSmartParameters

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        """Iterate on the voxels that MLOS leaves.

        I_j <- I_j prod_i (P_i / sum_k W_ik I_k)^(mu W_ij / N_j).
        """
        chosen = self.parameters
        problem = TomographyProblem.from_case(case, chosen)
        state = problem.mlos(chosen.threshold)
        for _ in iterate(
            lambda: smart(state, problem.measured, chosen.relaxation),
            problem.measured,
            chosen.iterations,
            chosen.tolerance,
            self.name,
        ):
            yield lambda: Reconstruction(problem.volume(state, chosen.floor))
