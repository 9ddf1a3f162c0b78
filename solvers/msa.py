"""Multiplicative synthetic aperture refocusing."""

import numpy as np
from pydantic import Field

from sabench.algorithms.refocus import (
    ExtractionParameters,
    count_views,
    extract_particles,
    find_edge_on,
    refocus_log2,
)
from sabench.api import Observation, Reconstruction, Solver


class MsaParameters(ExtractionParameters):
    """Exponent n and floor of the product over cameras.

    With a floor, an object survives a camera that does not see it.
    """

    exponent: float | None = Field(
        None,
        gt=0.0,
        le=1.0,
        description="n of equation 3.4; by default 3 / N for N cameras (1/3 for 9)",
    )
    floor: float = Field(
        0.01,
        ge=1e-6,
        lt=1.0,
        description="smallest sample, as a fraction of a bright particle's peak",
    )
    seen_only: bool = Field(
        False,
        description="multiply only the cameras that see a voxel, and adapt n to their number "
        "(thesis section 2.2.4)",
    )


class Msa(Solver):
    """Multiplicative synthetic aperture: the thresholded product of all cameras.

    The product is taken at every voxel. Each factor is raised to the power n, and to a floor.
    """

    name = "msa"
    references = (
        "Belden, MIT thesis, equation 3.4 and section 3.3.1",
        "Belden et al., Meas. Sci. Technol. 21 (2010) 125403",
    )
    Parameters = MsaParameters

    def skip(self, case: Observation) -> str | None:
        """Decline a case with a camera that sees planes of constant Z edge-on."""
        return find_edge_on(case.cameras, case.grid)

    def solve(self, case: Observation) -> Reconstruction:
        """Compute I_k = prod_i max(I_ki, floor)^n, thresholded plane by plane."""
        count, floor = len(case.cameras), self.parameters.floor
        exponent = self.parameters.exponent or min(1.0, 3.0 / count)
        # where a camera shows nothing its factor is 1
        images = np.where(case.repaired.flaws.covered, np.float32(1.0), case.normalised_images())
        outside = 1.0 if self.parameters.seen_only else 0.0
        volume = refocus_log2(images, case.cameras, case.grid, floor, outside=outside)
        volume *= exponent * count / count_views(case, seen_only=self.parameters.seen_only)
        return Reconstruction(extract_particles(np.exp2(volume, out=volume), case, self.parameters))
