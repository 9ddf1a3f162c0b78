"""Map-shift-average: synthetic aperture refocusing as it was first published."""

from sabench.algorithms.refocus import (
    ExtractionParameters,
    extract_particles,
    find_edge_on,
    refocus_by_shifts,
    typical_where_covered,
)
from sabench.api import Observation, Reconstruction, Solver


class MapShiftAverage(Solver):
    """Map-shift-average: the mean of mapped images shifted by whole pixels.

    The images are mapped to one plane. For cameras on one plane without refraction.
    """

    name = "map_shift_average"
    references = (
        "Belden, MIT thesis, equations 2.1 to 2.3",
        "Vaish et al., Using plane + parallax for calibrating dense camera arrays, CVPR 2004",
    )
    Parameters = ExtractionParameters

    def skip(self, case: Observation) -> str | None:
        """Skip cameras that see planes of constant Z edge-on."""
        return find_edge_on(case.cameras, case.grid)

    def solve(self, case: Observation) -> Reconstruction:
        """Average mapped and shifted images, thresholded plane by plane.

        The images are mapped to the reference plane. I_k = (1 / N) sum_i of image i shifted by mu_k
        (dX_i, dY_i).
        """
        volume = refocus_by_shifts(typical_where_covered(case), case.cameras, case.grid)
        return Reconstruction(extract_particles(volume, case, self.parameters))
