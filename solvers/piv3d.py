"""Three-dimensional PIV.

Window correlation in several passes on volumes that are moved towards each other.
"""

from __future__ import annotations

from pydantic import Field

from sabench.algorithms.velocimetry import Plan, evaluate
from sabench.api import VelocimetryParameters, VelocimetrySolver, Velocity, VolumePair

Voxels = tuple[int, int, int]


class Piv3dParameters(VelocimetryParameters):
    """Windows and passes; all sizes in voxels along x, y, z."""

    first_window: Voxels = Field(
        (64, 64, 32), description="of the first pass; displacements up to a quarter of it are found"
    )
    window: Voxels = Field((32, 32, 16), description="of the later passes")
    overlap: float = Field(
        0.75, ge=0.0, lt=1.0, description="of neighbouring windows, as a part of them"
    )
    passes: int = Field(4, ge=1, le=20, description="after the first")
    reach: Voxels = Field((1, 1, 1), description="largest shift that a later pass looks for")
    least_ratio: float = Field(
        1.2, ge=1.0, description="of the highest to the second highest peak in the first pass"
    )
    least_height: float = Field(
        0.1, ge=0.0, lt=1.0, description="normalised correlation of a measured vector"
    )
    median: float = Field(
        2.0,
        gt=0.0,
        description="test against the neighbours' median, in their own median distances from it",
    )
    smoothing: float = Field(
        0.35,
        ge=0.0,
        description="standard deviation of the Gaussian on the field that moves the volumes, as "
        "a part of the windows",
    )
    width: float = Field(
        0.7,
        ge=0.0,
        description="standard deviation in voxels to which narrower particles are blurred, for "
        "splines to follow them",
    )
    taper: float | None = Field(
        None,
        gt=0.0,
        description="standard deviation of the later windows' Gaussian weights, as a part of them",
    )


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
        first = tuple(
            min(own, 2 * (there // 2))
            for own, there in zip(chosen.first_window[::-1], case.grid.shape, strict=True)
        )
        plan = Plan(
            (first[0], first[1], first[2]),
            chosen.window[::-1],
            chosen.overlap,
            chosen.passes,
            chosen.reach[::-1],
            chosen.least_ratio,
            chosen.least_height,
            chosen.median,
            chosen.smoothing,
            chosen.width,
            chosen.taper,
        )
        return evaluate(case.first, case.second, plan).on_grid(case.grid, case.interval_s)
