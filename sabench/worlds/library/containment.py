"""Points in closed bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench.api.truth import Solid
from sabench.utils.arrays import F64, Bool
from sabench.utils.compiled import numba


def contains(body: Solid, points_mm: F64) -> Bool:
    """Find which points (n, 3) a closed body contains, by its solid angle.

    Source: Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126.
    """
    low, high = body.vertices_mm.min(axis=0), body.vertices_mm.max(axis=0)
    near = np.flatnonzero(((points_mm >= low) & (points_mm <= high)).all(axis=1))
    angles = np.empty(len(near))
    _solid_angles(np.ascontiguousarray(points_mm[near]), body.vertices_mm, body.faces, angles)
    out = np.zeros(len(points_mm), dtype=np.bool_)
    out[near] = np.abs(angles) > 2.0 * np.pi
    return out


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _solid_angles(points: Any, vertices: Any, faces: Any, out: Any) -> None:
    """Sum the signed solid angles of all faces as seen from each point."""
    for n in numba.prange(len(points)):
        total = 0.0
        for f in range(len(faces)):
            ax = vertices[faces[f, 0], 0] - points[n, 0]
            ay = vertices[faces[f, 0], 1] - points[n, 1]
            az = vertices[faces[f, 0], 2] - points[n, 2]
            bx = vertices[faces[f, 1], 0] - points[n, 0]
            by = vertices[faces[f, 1], 1] - points[n, 1]
            bz = vertices[faces[f, 1], 2] - points[n, 2]
            cx = vertices[faces[f, 2], 0] - points[n, 0]
            cy = vertices[faces[f, 2], 1] - points[n, 1]
            cz = vertices[faces[f, 2], 2] - points[n, 2]
            a = np.sqrt(ax * ax + ay * ay + az * az)
            b = np.sqrt(bx * bx + by * by + bz * bz)
            c = np.sqrt(cx * cx + cy * cy + cz * cz)
            triple = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            below = (
                a * b * c
                + (ax * bx + ay * by + az * bz) * c
                + (ax * cx + ay * cy + az * cz) * b
                + (bx * cx + by * cy + bz * cz) * a
            )
            total += 2.0 * np.arctan2(triple, below)
        out[n] = total
