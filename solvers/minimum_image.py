"""The thesis's algorithm for bubbles in less dense flows."""

import numpy as np
from pydantic import Field

from sabench.algorithms.bubbles import (
    WINDOW,
    attenuate,
    compute_potential,
    darkness,
    find_outlines,
    merge_overlaps,
    minimum_images,
)
from sabench.algorithms.refocus import find_edge_on
from sabench.api import BubbleSolver, Detections, Observation, Parameters, progress_bar


class MinimumImageParameters(Parameters):
    """Thresholds of edges and small bubbles."""

    least_edge: float = Field(
        0.05, gt=0.0, lt=1.0, description="gradient of darkness per voxel that makes an edge"
    )
    small_px: float = Field(
        4.0,
        gt=0.0,
        description="equivalent diameter in voxels below which a feature is thresholded",
    )


class MinimumImage(BubbleSolver):
    """Circles in minimum images over fifty attenuated multiplicative planes.

    They are found by Hough's transform.
    """

    name = "minimum_image"
    references = ("J. Belden, MIT thesis, section 5.4.2",)
    Parameters = MinimumImageParameters

    def skip(self, case: Observation) -> str | None:
        """Skip cameras that see planes of constant Z edge-on."""
        return find_edge_on(case.cameras, case.grid)

    def solve(self, case: Observation) -> Detections:
        """Detect bubbles by steps 1 to 5 of the section."""
        volume, grid = darkness(case), case.grid
        attenuate(volume, compute_potential(volume, WINDOW), WINDOW)
        ellipses = []
        for dark, depth in progress_bar(minimum_images(volume), "minimum images"):
            rims = find_outlines(dark, depth, self.parameters.least_edge, self.parameters.small_px)
            for (x, y, a, b), z in zip(rims.shapes, rims.depth, strict=True):
                ellipses.append((x, y, z, a, b, a * b))
        shapes = np.array(ellipses, dtype=np.float64).reshape(-1, 6)
        voxel, low = np.asarray(grid.voxel_mm), np.asarray(grid.low_mm)
        shapes[:, :3] = shapes[:, :3] * voxel + low
        shapes[:, 3:5] *= voxel[:2]
        kept = merge_overlaps(shapes, grid)
        return Detections.balls(kept[:, :3].copy(), np.sqrt(kept[:, 3] * kept[:, 4]))
