"""Body from a mesh file."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from sabench.api import FileParameters, Solid, SolidGenerator, SolidParameters
from sabench.worlds.library.mesh_files import read_mesh

_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}


class MeshFileParameters(SolidParameters, FileParameters):
    """File (STL, PLY, OBJ or GLB) and its unit, which such files do not state."""

    unit: Literal["mm", "cm", "m", "inch"] = Field(
        description="unit of the file's coordinates", examples=["mm"]
    )


class MeshFile(SolidGenerator):
    """Closed triangle mesh made by another program."""

    name = "mesh_file"
    Parameters = MeshFileParameters

    def body(self, seed: int) -> Solid:
        """Return the body as in the file, in mm."""
        vertices, faces = read_mesh(Path(self.parameters.file))
        return Solid(vertices * _MM[self.parameters.unit], faces)
