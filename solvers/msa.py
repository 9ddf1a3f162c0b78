"""Multiplicative synthetic aperture refocusing."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from sabench.api import Observation, Reconstruction, Solver
from sabench.extraction import ExtractionParameters, extract, normalised
from sabench.reproject import sweep


class MsaParameters(ExtractionParameters):
    """The exponent n and the floor that lets an object survive a camera that does not see it."""

    exponent: float | None = Field(None, gt=0.0, le=1.0, description="n of equation 3.4; by default 3 / N for N cameras (1/3 for 9)")
    floor: float = Field(0.01, gt=0.0, lt=1.0, description="smallest sample, as a fraction of a bright particle's peak")


class Msa(Solver):
    """Multiplicative synthetic aperture: the product of all cameras at every voxel, each raised to n and to a floor."""

    name = "msa"
    references = ("Belden, MIT thesis, equation 3.4 and section 3.3.1", "Belden et al., Meas. Sci. Technol. 21 (2010) 125403")
    Parameters = MsaParameters

    def solve(self, case: Observation) -> Reconstruction:
        """I_k = prod_i max(I_ki, floor)^n, thresholded plane by plane."""
        floor = self.parameters.floor
        exponent = self.parameters.exponent or min(1.0, 3.0 / len(case.cameras))

        def product(dr: Any, samples: Any) -> Any:
            return dr.exp2(exponent * sum(dr.log2(dr.maximum(sample, floor)) for sample in samples))

        volume = sweep(normalised(case), case.cameras, case.grid, product)
        return Reconstruction(extract(volume, self.parameters.k, self.parameters.keep))
