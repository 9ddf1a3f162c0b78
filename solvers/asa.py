"""Additive synthetic aperture refocusing."""

from __future__ import annotations

from typing import Any

from sabench.api import Observation, Reconstruction, Solver
from sabench.extraction import ExtractionParameters, extract, normalised
from sabench.reproject import sweep


class Asa(Solver):
    """Additive synthetic aperture: the mean of all cameras at every voxel, then what stands out of each plane."""

    name = "asa"
    references = ("Belden, MIT thesis, equation 3.3 and section 2.2.3", "Belden et al., Meas. Sci. Technol. 21 (2010) 125403")
    Parameters = ExtractionParameters

    def solve(self, case: Observation) -> Reconstruction:
        """I_k = (1 / N) sum_i I_ki, thresholded plane by plane."""

        def mean(dr: Any, samples: Any) -> Any:
            return sum(samples) / len(samples)

        volume = sweep(normalised(case), case.cameras, case.grid, mean)
        return Reconstruction(extract(volume, self.parameters.k, self.parameters.keep))
