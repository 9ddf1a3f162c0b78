"""Round cylinder."""

import numpy as np
from pydantic import Field

from sabench.api import Solid, SolidGenerator, SolidParameters


class CylinderParameters(SolidParameters):
    """Size of the cylinder; its axis is Y before rotation."""

    radius_mm: float = Field(5.0, gt=0.0, description="radius of the cylinder")
    length_mm: float = Field(40.0, gt=0.0, description="length along its axis")
    sections: int = Field(256, ge=8, le=4096, description="number of plane faces around its axis")


class Cylinder(SolidGenerator):
    """Closed cylinder, for instance as an obstacle in a flow."""

    name = "cylinder"
    Parameters = CylinderParameters

    def body(self, seed: int) -> Solid:
        """Make an upright cylinder around its own origin."""
        import trimesh

        chosen: CylinderParameters = self.parameters
        mesh = trimesh.creation.cylinder(
            chosen.radius_mm, chosen.length_mm, sections=chosen.sections
        )
        upright = np.asarray(mesh.vertices)[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
        return Solid(upright, np.asarray(mesh.faces, dtype=np.int64))
