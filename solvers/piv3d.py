"""Three-dimensional PIV.

Window correlation in several passes on volumes that are moved towards each other.
"""

from __future__ import annotations

from pydantic import Field

from sabench.algorithms.velocimetry import CorrelationParameters, evaluate
from sabench.api import VelocimetryParameters, VelocimetrySolver, Velocity, VolumePair

Voxels = tuple[int, int, int]


class Piv3dParameters(CorrelationParameters, VelocimetryParameters):
    """Windows and passes; all sizes in voxels along x, y, z."""

    first_window: Voxels = Field(
        (64, 64, 32), description="of the first pass; displacements up to a quarter of it are found"
    )
    window: Voxels = Field((32, 32, 16), description="of the later passes")
    reach: Voxels = Field((1, 1, 1), description="largest shift that a later pass looks for")


class Piv3d(VelocimetrySolver):
    """Multi-pass correlation with deformed volumes and validation between passes.

    The first pass correlates by spectra, the later ones by sums over blocks on volumes that cubic
    splines deform.
    """

    name = "piv3d"
    references = (
        "F. Scarano and M. L. Riethmuller, Exp. Fluids 29, S051-S060, 2000",
        "J. Westerweel and F. Scarano, Exp. Fluids 39, 1096-1100, 2005",
    )
    Parameters = Piv3dParameters

    def solve(self, case: VolumePair) -> Velocity:
        """Divide displacements at the windows' middles by the time between the volumes."""
        chosen: Piv3dParameters = self.parameters
        plan = chosen.plan(
            case.grid.shape, chosen.first_window[::-1], chosen.window[::-1], chosen.reach[::-1]
        )
        return evaluate(case.first, case.second, plan).on_grid(case.grid, case.interval_s)
