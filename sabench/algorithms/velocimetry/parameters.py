"""Parameters that solvers by window correlation share."""

from pydantic import Field

from sabench.algorithms.velocimetry.multipass import MultipassPlan
from sabench.algorithms.velocimetry.windows import Size
from sabench.api import Parameters

Voxels = tuple[int, int, int]


class CorrelationParameters(Parameters):
    """Parameters of the multi-pass correlation, planar or three-dimensional."""

    overlap: float = Field(
        0.75, ge=0.0, lt=1.0, description="of neighbouring windows, as a part of them"
    )
    passes: int = Field(4, ge=1, le=20, description="after the first")
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
        description="standard deviation of the Gaussian on the field that moves the images, as "
        "a part of the windows",
    )
    width: float = Field(
        0.7,
        ge=0.0,
        description="standard deviation in pixels or voxels to which narrower particles are "
        "blurred, for splines to follow them",
    )
    taper: float | None = Field(
        None,
        gt=0.0,
        description="standard deviation of the later windows' Gaussian weights, as a part of them",
    )

    def plan(self, shape: Size, first: Size, last: Size, search: Size) -> MultipassPlan:
        """Make the plan for volumes of a shape; the first windows are cut to fit in.

        Parameters
        ----------
        shape, first, last, search : as in `Plan`, all (z, y, x).
        """
        z, y, x = (
            min(edge, max(1, 2 * (size // 2))) for edge, size in zip(first, shape, strict=True)
        )
        return MultipassPlan(
            (z, y, x),
            last,
            self.overlap,
            self.passes,
            search,
            self.least_ratio,
            self.least_height,
            self.median,
            self.smoothing,
            self.width,
            self.taper,
        )


class VolumeCorrelationParameters(CorrelationParameters):
    """Windows and passes on volumes; sizes in voxels along x, y, z."""

    first_window: Voxels = Field(
        (64, 64, 32), description="of the first pass; displacements up to a quarter of it are found"
    )
    window: Voxels = Field((32, 32, 16), description="of the later passes")
    reach: Voxels = Field((1, 1, 1), description="largest shift that a later pass looks for")

    def volume_plan(self, shape: Size) -> MultipassPlan:
        """Make the plan for volumes (z, y, x)."""
        return self.plan(shape, self.first_window[::-1], self.window[::-1], self.reach[::-1])
