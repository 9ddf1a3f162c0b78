"""Multiplicative algebraic reconstruction, camera by camera."""

from collections.abc import Callable, Iterator

from sabench.algorithms.tomography import SparseParameters, TomographyProblem, block_mart, iterate
from sabench.api import IterativeSolver, Observation, Reconstruction


class BlockMart(IterativeSolver):
    """Block MART: multiplicative updates, one camera after the other.

    Where all cameras see light, voxels are multiplied by the ratio of recorded to projected light.
    """

    name = "block_mart"
    references = (
        "Byrne, IEEE Trans. Image Process. 7 (1998) 100-109",
        "Atkinson and Soria, Exp. Fluids 47 (2009) 553-568",
    )
    Parameters = SparseParameters

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        """Iterate I_j <- I_j prod_i (P_i / sum_k W_ik I_k)^(mu W_ij).

        The product is over the pixels i of one camera; only voxels that MLOS leaves are updated.
        """
        chosen = self.parameters
        problem = TomographyProblem.from_case(case, chosen)
        state = problem.mlos(chosen.threshold)
        for _ in iterate(
            lambda: block_mart(state, problem.measured, chosen.relaxation),
            problem.measured,
            chosen.iterations,
            chosen.tolerance,
            self.name,
        ):
            yield lambda: Reconstruction(problem.volume(state, chosen.floor))
