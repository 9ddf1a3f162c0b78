"""Intersections of lines with bodies, by Mitsuba's search for triangles."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sabench.api.truth import Solid
from sabench.utils import backend
from sabench.utils.arrays import F64, I64, Bool

_ODD = np.array([0.8017837, 0.2672612, 0.5345225])  # a direction in which few bodies have edges


def mesh_of(mi: Any, solid: Solid, origin: F64, **how: Any) -> Any:
    """Convert a body to a mesh of Mitsuba's.

    `how` are further arguments of `mi.Mesh`.
    """
    mesh = mi.Mesh("body", len(solid.vertices_mm), len(solid.faces), **how)
    values = mi.traverse(mesh)
    values["vertex_positions"] = (solid.vertices_mm - origin).astype(np.float32).ravel()
    values["faces"] = solid.faces.astype(np.uint32).ravel()
    values.update()
    return mesh


class BodySearch:
    """Search for the first body along many lines."""

    def __init__(self, bodies: Sequence[Solid]) -> None:
        self._mi = mi = backend.mitsuba()
        # single precision: small numbers near the bodies
        middles = [solid.vertices_mm.mean(axis=0) for solid in bodies]
        self._origin = origin = np.asarray(np.mean(middles, axis=0))
        self._radius = max(
            float(np.linalg.norm(solid.vertices_mm - origin, axis=1).max()) for solid in bodies
        )
        meshes = {f"body_{n}": mesh_of(mi, solid, origin) for n, solid in enumerate(bodies)}
        self._scene = mi.load_dict({"type": "scene", **meshes})

    def first(self, starts_mm: F64, directions: F64) -> tuple[F64, I64]:
        """Find the first body along lines.

        Returns the distance (n,), inf for none, and the body's number (n,), -1 for none.
        """
        mi = self._mi
        known = np.asarray(np.isfinite(directions).all(axis=1))
        start = np.where(known[:, None], starts_mm - self._origin, 0.0)
        direction = np.where(known[:, None], directions, [0.0, 0.0, 1.0])
        ahead = np.maximum(-np.sum(start * direction, axis=1) - 1.01 * self._radius, 0.0)
        near = start + ahead[:, None] * direction
        ray = mi.Ray3f(
            mi.Point3f(near.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32))
        )
        met = self._scene.ray_intersect_preliminary(ray, True)
        valid = np.array(met.is_valid()) & known
        which = np.full(len(known), -1, dtype=np.int64)
        for number, shape in enumerate(self._scene.shapes()):
            which[np.array(met.shape == mi.ShapePtr(shape)) & valid] = number
        return np.where(valid, np.array(met.t, dtype=np.float64) + ahead, np.inf), which

    def contains(self, points_mm: F64) -> Bool:
        """Find which points (n, 3) lie in a body.

        A line from such a point to the outside leaves bodies more often than it enters them.
        """
        mi = self._mi
        position = mi.Point3f((points_mm - self._origin).T.astype(np.float32))
        direction = mi.Vector3f(*(float(v) for v in _ODD))
        balance = np.zeros(len(points_mm), dtype=np.int64)
        active = np.ones(len(points_mm), dtype=np.bool_)
        while active.any():
            met = self._scene.ray_intersect(mi.Ray3f(position, direction), mi.Bool(active))
            active &= np.array(met.is_valid())
            along = met.n.x * direction.x + met.n.y * direction.y + met.n.z * direction.z
            outwards = np.array(along) > 0.0
            balance += np.where(active, np.where(outwards, 1, -1), 0)
            position = mi.Point3f(met.spawn_ray(direction).o)
        return np.asarray(balance > 0)
