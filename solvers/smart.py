"""Simultaneous multiplicative algebraic reconstruction on the full volume."""

from collections.abc import Callable, Iterator

from pydantic import Field

from sabench.algorithms.tomography import TomographyParameters, TomographyProblem, iterate, smart
from sabench.api import IterativeSolver, Observation, Reconstruction


class SmartParameters(TomographyParameters):
    """Parameters of SMART; relaxations above 1 overrelax the geometric mean."""

    relaxation: float = Field(
        1.5, gt=0.0, le=2.0, description="mu, the power of the geometric mean over cameras"
    )


class Smart(IterativeSolver):
    """SMART on all voxels from a uniform guess, without a first guess by MLOS.

    It is the plain and slow reference for mlos_smart.
    """

    name = "smart"
    references = (
        "Mishra, Muralidhar and Munshi, Inverse Problems 15 (1999)",
        "Atkinson and Soria, Exp. Fluids 47 (2009) 553-568",
    )
    Parameters = SmartParameters

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        """Iterate I_j <- I_j prod_i (P_i / sum_k W_ik I_k)^(mu W_ij / N_j) on all voxels."""
        chosen = self.parameters
        problem = TomographyProblem.from_case(case, chosen)
        state = problem.uniform()
        for _ in iterate(
            lambda: smart(state, problem.measured, chosen.relaxation),
            problem.measured,
            chosen.iterations,
            chosen.tolerance,
            self.name,
        ):
            yield lambda: Reconstruction(problem.volume(state, chosen.floor))
