"""Plate with a code of dark cells, flat or bent."""

import numpy as np
from pydantic import Field

from sabench.api import F64, Bool, Code, CodeGenerator, Solid, SolidParameters, bend, stream

_FACES = np.array(
    [
        [0, 2, 1],
        [0, 3, 2],
        [4, 5, 6],
        [4, 6, 7],
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
    ]
)
_PRINTED = 0.96  # of a cell's edge: cells that touched would not be closed bodies
_READ, _POINTS = 0.5, 5  # middle part of a cell's edges that is read, and points along each


class CodePlateParameters(SolidParameters):
    """Layout of the cells in the plane Z = 0 of the plate's own frame.

    Columns lie along X, rows along Y. The plate itself has no surface.
    """

    columns: int = Field(16, ge=2, le=200, description="number of cells along X")
    rows: int = Field(12, ge=2, le=200, description="number of cells along Y")
    cell_mm: float = Field(2.0, gt=0.0, description="edge of a cell")
    thickness_mm: float = Field(0.1, gt=0.0, description="thickness of the dark cells")
    bend_radius_mm: float | None = Field(
        None,
        description="radius of the cylinder on which the plate lies, around an axis along Y at "
        "this Z of its own frame; flat by default",
    )


class CodePlate(CodeGenerator):
    """Random code of dark and clear square cells in front of the light.

    Half of them are dark. The part of the code that is read measures the view through the flow.
    """

    name = "code_plate"
    Parameters = CodePlateParameters

    def body(self, seed: int) -> Solid:
        """Make a flat box for every dark cell."""
        chosen: CodePlateParameters = self.parameters
        side = 0.5 * _PRINTED * chosen.cell_mm
        half = np.array([side, side, 0.5 * chosen.thickness_mm])
        corners = (
            np.array(
                [
                    [-1, -1, -1],
                    [1, -1, -1],
                    [1, 1, -1],
                    [-1, 1, -1],
                    [-1, -1, 1],
                    [1, -1, 1],
                    [1, 1, 1],
                    [-1, 1, 1],
                ]
            )
            * half
        )
        middles = self._middles()[self._dark(seed)]
        faces = _FACES + 8 * np.arange(len(middles))[:, None, None]
        vertices = (middles[:, None] + corners).reshape(-1, 3)
        return Solid(self._bend(vertices), faces.reshape(-1, 3).astype(np.int64))

    def code(self, seed: int) -> Code:
        """Cover the middle quarter of every cell."""
        across = (np.arange(_POINTS) / (_POINTS - 1) - 0.5) * _READ * self.parameters.cell_mm
        x, y = np.meshgrid(across, across)
        points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        return Code(self._bend(self._middles()[:, None] + points), self._dark(seed))

    def _bend(self, points_mm: F64) -> F64:
        """Lay points (..., 3) of the flat plate on the cylinder."""
        radius = self.parameters.bend_radius_mm
        return points_mm if radius is None else bend(points_mm, radius)

    def _middles(self) -> F64:
        """List the cells' middles (n, 3), row by row."""
        chosen: CodePlateParameters = self.parameters
        x, y = np.meshgrid(
            *(
                (np.arange(count) - (count - 1) / 2.0) * chosen.cell_mm
                for count in (chosen.columns, chosen.rows)
            )
        )
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])

    def _dark(self, seed: int) -> Bool:
        """Mark dark cells (n,): half of them."""
        count = self.parameters.columns * self.parameters.rows
        return np.asarray(stream(seed, "code").permutation(count) < count // 2)
