"""Bubbles and bodies as obstacles of points and lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.api.truth import NOTHING, Bubbles, Sight, Solid
from sabench.geometry.camera import Camera
from sabench.simulation.rendering.mesh_intersection import BodySearch
from sabench.simulation.rendering.pixel_truth import depth_of, meets
from sabench.utils.arrays import F64, Bool


def inside(bubbles: Bubbles, solids: Sequence[Solid], points_mm: F64) -> Bool:
    """Find which points (n, 3) lie in a bubble or a body."""
    if not solids:
        return _in_bubbles(bubbles, points_mm)
    return _in_bubbles(bubbles, points_mm) | BodySearch(solids).contains(points_mm)


def find_obstructed(
    bubbles: Bubbles, solids: Sequence[Solid], points_mm: F64, directions: F64
) -> Bool:
    """Find which lines from points (n, 3) meet a bubble or a body.

    `directions` are unit vectors (n, 3).
    """
    met = meets(bubbles, points_mm, directions)
    if solids:
        met |= BodySearch(solids).first(points_mm, directions)[1] >= 0
    return met


def find_hidden(camera: Camera, points_mm: F64, pixels: F64, sight: Sight) -> Bool:
    """Find which points (n, 3) lie behind what their pixels (n, 2) show first."""
    with np.errstate(invalid="ignore"):
        on_sensor = camera.contains(pixels)
    rounded = np.where(on_sensor[:, None], np.rint(np.nan_to_num(pixels)), 0).astype(np.int64)
    column = np.clip(rounded[:, 0], 0, camera.columns - 1)
    row = np.clip(rounded[:, 1], 0, camera.rows - 1)
    behind = sight.depth_mm[row, column] < depth_of(camera, points_mm)
    return np.asarray(on_sensor & (sight.number[row, column] != NOTHING) & behind)


def _in_bubbles(bubbles: Bubbles, points_mm: F64) -> Bool:
    from scipy.spatial import cKDTree

    found = np.zeros(len(points_mm), dtype=np.bool_)
    if not len(bubbles) or not len(points_mm):
        return found
    near = cKDTree(points_mm).query_ball_point(bubbles.center_mm, bubbles.semi_axes_mm.max(axis=1))
    for number, neighbours in enumerate(near):
        which = np.asarray(neighbours, dtype=np.int64)
        offset = points_mm[which] - bubbles.center_mm[number]
        in_ball = offset @ bubbles.to_ball[number].T
        found[which[np.linalg.norm(in_ball, axis=1) < 1.0]] = True
    return found
