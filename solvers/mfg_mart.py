"""Multiplicative algebraic reconstruction from a multiplicative first guess."""

from collections.abc import Callable, Iterator

from sabench.algorithms.tomography import SparseParameters, TomographyProblem, iterate, mart
from sabench.api import IterativeSolver, Observation, Reconstruction


class MfgMart(IterativeSolver):
    """MFG-MART: the product of back-projected pixels, then MART on what remains."""

    name = "mfg_mart"
    references = (
        "Worth and Nickels, Exp. Fluids 45 (2008) 847-856",
        "Belden, MIT thesis, equations 3.9 and 3.11",
    )
    Parameters = SparseParameters

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        """Start from I_j = (prod_c P_c)^(1/N), then iterate pixel by pixel.

        I_j <- I_j (P_i / sum_k W_ik I_k)^(mu W_ij).
        """
        chosen = self.parameters
        problem = TomographyProblem.from_case(case, chosen)
        state = problem.mfg(chosen.threshold)
        for _ in iterate(
            lambda: mart(state, problem.measured, chosen.relaxation),
            problem.measured,
            chosen.iterations,
            chosen.tolerance,
            self.name,
        ):
            yield lambda: Reconstruction(problem.volume(state, chosen.floor))
