"""Three-dimensional PIV.

Window correlation in several passes on volumes that are moved towards each other.
"""

from sabench.algorithms.velocimetry import VolumeCorrelationParameters, evaluate
from sabench.api import VelocimetryParameters, VelocimetrySolver, Velocity, VolumePair


class Piv3dParameters(VolumeCorrelationParameters, VelocimetryParameters):
    """Windows and passes, and the solver that reconstructs the volumes."""


class Piv3d(VelocimetrySolver):
    """Multi-pass correlation with deformed volumes and validation between passes.

    The first pass correlates by spectra, the later ones by sums over blocks on volumes that cubic
    splines deform. The mean over shifts of the second volume and opposite shifts of the first makes
    the correlation symmetric. Particles narrower than 0.7 voxels are blurred, since splines would
    bias their displacements towards whole voxels. Vectors are compared with their neighbours
    (Westerweel and Scarano, 2005).
    """

    name = "piv3d"
    references = (
        "F. Scarano and M. L. Riethmuller, Exp. Fluids 29, S051-S060, 2000",
        "J. Westerweel and F. Scarano, Exp. Fluids 39, 1096-1100, 2005",
    )
    Parameters = Piv3dParameters

    def solve(self, case: VolumePair) -> Velocity:
        """Divide displacements at the windows' middles by the time between the volumes."""
        plan = self.parameters.volume_plan(case.grid.shape)
        return evaluate(case.first, case.second, plan).on_grid(case.grid, case.interval_s)
