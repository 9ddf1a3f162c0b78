"""Three-dimensional PIV in one pass, the baseline."""

from pydantic import Field

from sabench.algorithms.velocimetry import evaluate_once
from sabench.api import VelocimetryParameters, VelocimetrySolver, Velocity, VolumePair

Voxels = tuple[int, int, int]


class PlainParameters(VelocimetryParameters):
    """Parameters of the thesis's windows."""

    window: Voxels = Field(
        (32, 32, 16),
        description="voxels along x, y, z; displacements up to half of it could be found",
    )
    overlap: float = Field(
        0.75, ge=0.0, lt=1.0, description="of neighbouring windows, as a part of them"
    )
    least_ratio: float = Field(1.2, ge=1.0, description="of the highest to the second highest peak")


class Piv3dPlain(VelocimetrySolver):
    """Correlation of fixed windows by Fourier transforms, in one pass.

    The thesis's filters, filling and smoothing follow.
    """

    name = "piv3d_plain"
    references = (
        "J. Belden, PhD thesis, MIT 2011, sections 2.2.5 and 2.3.3",
        "J. K. Sveen, An introduction to MatPIV v. 1.6.1, 2004",
    )
    Parameters = PlainParameters

    def solve(self, case: VolumePair) -> Velocity:
        """Divide displacements at the windows' middles by the time between the volumes."""
        chosen: PlainParameters = self.parameters
        return evaluate_once(
            case.first, case.second, chosen.window[::-1], chosen.overlap, chosen.least_ratio
        ).on_grid(case.grid, case.interval_s)
