"""Map-shift-average: synthetic aperture refocusing as it was first published."""

from __future__ import annotations

from sabench.algorithms.refocus import ExtractionParameters, extract_particles, refocus_by_shifts
from sabench.api import Observation, Reconstruction, Solver


class MapShiftAverage(Solver):
    """Map-shift-average: images mapped to one plane, shifted by whole pixels and averaged; for cameras on one plane without refraction."""

    name = "map_shift_average"
    references = (
        "Belden, MIT thesis, equations 2.1 to 2.3",
        "Vaish et al., Using plane + parallax for calibrating dense camera arrays, CVPR 2004",
    )
    Parameters = ExtractionParameters

    def solve(self, case: Observation) -> Reconstruction:
        """I_k = (1 / N) sum_i of image i mapped to the reference plane and shifted by mu_k (dX_i, dY_i), thresholded plane by plane."""
        volume = refocus_by_shifts(case.normalised_images(), case.cameras, case.grid)
        return Reconstruction(extract_particles(volume, case, self.parameters))
