"""Planar PIV of a light sheet, by one camera."""

from pydantic import Field

from sabench.algorithms.velocimetry import (
    CorrelationParameters,
    evaluate,
    find_sheet,
    light_in_sheet,
)
from sabench.api import Direction, ImagePair, PlanarVelocimetrySolver, Vector, Velocity

Pixels = tuple[int, int]


class Piv2dParameters(CorrelationParameters):
    """Place of the light sheet, camera, windows and passes; sizes in pixels x, y."""

    point_mm: Vector | None = Field(
        None, description="a point in the middle of the light sheet; by default the grid's middle"
    )
    normal: Direction | None = Field(
        None,
        description="normal of the light sheet; by default across a grid of one plane, or along "
        "the grid's shortest edge",
    )
    camera: str | None = Field(
        None, description="name; by default the camera that looks most squarely at the sheet"
    )
    first_window: Pixels = Field(
        (64, 64), description="of the first pass; displacements up to a quarter of it are found"
    )
    window: Pixels = Field((32, 32), description="of the later passes")
    reach: Pixels = Field((1, 1), description="largest shift that a later pass looks for")


class Piv2d(PlanarVelocimetrySolver):
    """Multi-pass correlation of one camera's images, mapped to a light sheet.

    The images are resampled through the camera model, with the wall's refraction; `piv3d`'s
    correlation of volumes of one plane then gives the two components in the plane.
    """

    name = "piv2d"
    references = (
        "J. Belden, PhD thesis, MIT 2011, section 2.3",
        "F. Scarano and M. L. Riethmuller, Exp. Fluids 29, S051-S060, 2000",
        "J. Westerweel and F. Scarano, Exp. Fluids 39, 1096-1100, 2005",
    )
    Parameters = Piv2dParameters

    def solve(self, case: ImagePair) -> Velocity:
        """Divide displacements at the windows' middles by the time between the frames."""
        chosen: Piv2dParameters = self.parameters
        sheet = find_sheet(
            case.first.cameras, case.first.grid, chosen.point_mm, chosen.normal, chosen.camera
        )
        around = max(chosen.first_window)
        first, second = (
            light_in_sheet(frame, sheet, around) for frame in (case.first, case.second)
        )
        plan = chosen.plan(
            (1, *sheet.seen.shape),
            (1, *chosen.first_window[::-1]),
            (1, *chosen.window[::-1]),
            (0, *chosen.reach[::-1]),
        )
        return sheet.velocity(evaluate(first, second, plan), case.interval_s)
