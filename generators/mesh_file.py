"""Body from a mesh file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from sabench.api import FileParameters, InputError, Solid, SolidGenerator, SolidParameters

_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}


class MeshFileParameters(SolidParameters, FileParameters):
    """File (STL, PLY, OBJ or GLB) and its unit, which such files do not state."""

    unit: Literal["mm", "cm", "m", "inch"] = Field(description="of the file's coordinates")


class MeshFile(SolidGenerator):
    """Closed triangle mesh made by another program."""

    name = "mesh_file"
    Parameters = MeshFileParameters

    def body(self, seed: int) -> Solid:
        """Return the body as in the file, in mm."""
        import trimesh

        path = Path(self.parameters.file)
        try:
            mesh = trimesh.load(path, force="mesh")
        except Exception as error:  # trimesh's loaders raise whatever they like
            raise InputError(
                f"{path}: expected a mesh as STL, PLY, OBJ or GLB, got {type(error).__name__}: "
                f"{error}"
            ) from error
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise InputError(f"{path}: expected a mesh with faces, got none")
        return Solid(
            np.asarray(mesh.vertices, dtype=np.float64) * _MM[self.parameters.unit],
            np.asarray(mesh.faces, dtype=np.int64),
        )
