"""Triangle meshes from STL, PLY, OBJ and GLB files."""

import tempfile
from pathlib import Path

import numpy as np

from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.processes.call import read_isolated

_SUFFIXES = (".stl", ".ply", ".obj", ".glb")
_VERTICES, _FACES = "vertices.npy", "faces.npy"


def read_mesh(path: Path) -> tuple[F64, I64]:
    """Read a mesh: vertices (v, 3), in the unit of the file, and faces (f, 3).

    A limited child process reads the file, which the library may not survive.

    Raises InputError: no such file, another format, a damaged file, a mesh without faces,
    coordinates that are not finite, or faces of vertices that are not there.
    """
    if path.suffix.lower() not in _SUFFIXES:
        got = path.suffix or "no ending"
        raise InputError(
            f"{path}: expected a mesh as STL, PLY, OBJ or GLB, that is a name that ends in "
            f"{', '.join(_SUFFIXES)}, got {got}"
        )
    if not path.is_file():
        raise InputError(f"{path}: expected a mesh file, found none")
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        read_isolated(_store, path, Path(folder))
        vertices, faces = (
            np.load(Path(folder) / name, allow_pickle=False) for name in (_VERTICES, _FACES)
        )
    return _check(path, vertices, faces)


def _store(path: Path, folder: Path) -> None:
    """Read a mesh and store its arrays in a folder; files that it names are not read."""
    import trimesh

    try:
        with path.open("rb") as file:
            mesh = trimesh.load(file, file_type=path.suffix[1:].lower(), force="mesh")
    except MemoryError:
        raise
    except Exception as error:  # trimesh's loaders raise exceptions of any type
        raise InputError(
            f"{path}: expected a mesh as STL, PLY, OBJ or GLB, got {type(error).__name__}: {error}"
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise InputError(f"{path}: expected a mesh with faces, got none")
    np.save(folder / _VERTICES, np.asarray(mesh.vertices, dtype=np.float64))
    np.save(folder / _FACES, np.asarray(mesh.faces, dtype=np.int64))


def _check(path: Path, vertices: F64, faces: I64) -> tuple[F64, I64]:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(
            f"{path}: expected vertices (v, 3) and triangles (f, 3), got {vertices.shape} and "
            f"{faces.shape}"
        )
    wrong = int((~np.isfinite(vertices)).any(axis=1).sum())
    if wrong:
        raise InputError(f"{path}: expected finite coordinates, got {wrong} vertices without")
    outside = int(((faces < 0) | (faces >= len(vertices))).any(axis=1).sum())
    if outside:
        raise InputError(
            f"{path}: expected faces of the {len(vertices)} vertices that the file has, got "
            f"{outside} faces of others"
        )
    return vertices, faces
