"""Additive synthetic aperture refocusing."""

import numpy as np
from pydantic import Field

from sabench.algorithms.refocus import (
    ExtractionParameters,
    extract_particles,
    find_edge_on,
    refocus_sum,
    typical_where_covered,
)
from sabench.api import Observation, Reconstruction, Solver


class AsaParameters(ExtractionParameters):
    """Parameters of the average over cameras.

    A camera that does not see a voxel may count as one that sees it dark.
    """

    seen_only: bool = Field(
        False, description="average only the cameras that see a voxel (thesis section 2.2.4)"
    )


class Asa(Solver):
    """Additive synthetic aperture: the thresholded mean of all cameras.

    The mean is taken at every voxel; a threshold in each plane then keeps the particles.
    """

    name = "asa"
    references = (
        "Belden, MIT thesis, equation 3.3 and section 2.2.3",
        "Belden et al., Meas. Sci. Technol. 21 (2010) 125403",
    )
    Parameters = AsaParameters

    def skip(self, case: Observation) -> str | None:
        """Decline a case with a camera that sees planes of constant Z edge-on."""
        return find_edge_on(case.cameras, case.grid)

    def solve(self, case: Observation) -> Reconstruction:
        """Compute I_k = (1 / N) sum_i I_ki, thresholded plane by plane."""
        volume = refocus_sum(typical_where_covered(case), case.cameras, case.grid)
        if self.parameters.seen_only:
            volume /= np.maximum(
                refocus_sum(np.ones(case.images.shape, dtype=np.float32), case.cameras, case.grid),
                1.0,
            )
        else:
            volume /= len(case.cameras)
        return Reconstruction(extract_particles(volume, case, self.parameters))
