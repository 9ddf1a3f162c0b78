"""Multiplicative algebraic reconstruction, pixel by pixel."""

from collections.abc import Callable, Iterator

import numpy as np

from sabench.algorithms.tomography import SparseParameters, TomographyProblem, iterate, mart
from sabench.api import IterativeSolver, Observation, Reconstruction


class Mart(IterativeSolver):
    """MART from a uniform guess: multiplicative updates, pixel by pixel.

    Every pixel in turn scales the voxels on its line of sight to the light that it recorded.
    """

    name = "mart"
    references = (
        "Elsinga, Scarano, Wieneke and van Oudheusden, Exp. Fluids 41 (2006) 933-947",
        "Herman and Lent, Comput. Biol. Med. 6 (1976) 273-294",
        "Belden, MIT thesis, equation 3.9",
    )
    Parameters = SparseParameters

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        """Iterate I_j <- I_j (P_i / sum_k W_ik I_k)^(mu W_ij), pixel i by pixel.

        Voxels that a camera sees black are zero from the start.
        """
        chosen = self.parameters
        problem = TomographyProblem.from_case(case, chosen)
        state = problem.mlos(chosen.threshold)
        np.sign(state.values, out=state.values)
        for _ in iterate(
            lambda: mart(state, problem.measured, chosen.relaxation),
            problem.measured,
            chosen.iterations,
            chosen.tolerance,
            self.name,
        ):
            yield lambda: Reconstruction(problem.volume(state, chosen.floor))
