"""Visible edges of opaque bodies, and the depth errors of edges found.

An edge is where lines of sight graze a surface: its rim. A camera sees it if light passes outside
of it and none inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from sabench.api.truth import Solid
from sabench.geometry.camera_model import CameraModel
from sabench.metrics.averages import finite_or_none
from sabench.utils.arrays import F64, Bool

LATERAL_MM = 0.3  # distance in X and Y within which an edge found is that of the rim
NEAR_MM = 1.0  # depth error up to which it counts as found
_SUBPIXEL = 4  # bits of a pixel's fraction in which silhouettes are drawn


@dataclass(frozen=True)
class Rim:
    """Points where lines of sight from one eye graze a surface.

    Attributes
    ----------
    position_mm, normal : (n, 3) points and unit outward normals of the surface, world frame.
    """

    position_mm: F64
    normal: F64

    def __getitem__(self, chosen: Bool) -> Rim:
        """Select some of the points."""
        return Rim(self.position_mm[chosen], self.normal[chosen])


def find_rim(solid: Solid, eye_mm: F64) -> Rim:
    """Find the rim of a surface as seen from an eye (3,).

    One point in every face that it crosses. It is where the interpolated normals of the vertices
    are across the line of sight.
    """
    normals = _vertex_normals(solid)
    facing = np.einsum("vi,vi->v", normals, solid.vertices_mm - eye_mm)
    faces = solid.faces[np.ptp(np.sign(facing[solid.faces]), axis=1) > 0.0]
    position, normal = np.zeros((len(faces), 3)), np.zeros((len(faces), 3))
    for first, second in ((0, 1), (1, 2), (2, 0)):  # two of the three sides are crossed
        a, b = faces[:, first], faces[:, second]
        crossed = (facing[a] > 0.0) != (facing[b] > 0.0)
        share = np.where(crossed, facing[a] / np.where(crossed, facing[a] - facing[b], 1.0), 0.0)
        for out, values in ((position, solid.vertices_mm), (normal, normals)):
            between = values[a] + share[:, None] * (values[b] - values[a])
            out += np.where(crossed[:, None], between / 2.0, 0.0)
    return Rim(position, normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None])


def sphere_mesh(matrix: F64, center_mm: F64) -> Solid:
    """Make the image of a unit sphere under a matrix (3, 3), moved to a centre (3,)."""
    import trimesh

    unit = trimesh.creation.icosphere(subdivisions=3)
    vertices = np.asarray(unit.vertices, dtype=np.float64)
    return Solid(vertices @ matrix.T + center_mm, np.asarray(unit.faces, dtype=np.int64))


def _vertex_normals(solid: Solid) -> F64:
    """Compute outward normals (v, 3) of vertices, weighed by areas of faces."""
    corners = solid.vertices_mm[solid.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(solid.vertices_mm)
    for corner in range(3):
        np.add.at(normals, solid.faces[:, corner], across)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None])


def silhouette(camera: CameraModel, solids: Sequence[Solid]) -> Bool:
    """Draw which pixels (rows, columns) of a camera bodies cover."""
    mask = np.zeros((camera.rows, camera.columns), dtype=np.uint8)
    for solid in solids:
        pixels, valid = camera.project(solid.vertices_mm)
        corners = np.round(np.nan_to_num(pixels) * 2**_SUBPIXEL).astype(np.int32)[solid.faces]
        for triangle in corners[valid[solid.faces].all(axis=1)]:
            cv2.fillConvexPoly(mask, triangle, 1, shift=_SUBPIXEL)
    return mask.astype(np.bool_)


def count_views(
    rim: Rim, cameras: Sequence[CameraModel], silhouettes: Sequence[Bool], step_mm: float
) -> F64:
    """Compute the share (n,) of the cameras that see a rim.

    Light passes `step_mm` outside of it and none as far inside.
    """
    views = np.zeros(len(rim.position_mm))
    for camera, mask in zip(cameras, silhouettes, strict=True):
        covered = [
            _look_up(camera, mask, rim.position_mm + sign * step_mm * rim.normal)
            for sign in (1.0, -1.0)
        ]
        views += (covered[0] == 0) & (covered[1] == 1)
    return views / len(cameras)


def _look_up(camera: CameraModel, mask: Bool, points_mm: F64) -> F64:
    """Look up a mask at the pixels of points: 1, 0, or NaN outside of the image."""
    pixels, valid = camera.project(points_mm)
    inside = valid & camera.contains(pixels)
    column, row = np.round(np.where(inside[:, None], pixels, 0.0)).astype(np.int64).T
    return np.where(inside, mask[row, column], np.nan)


def edge_scores(found_mm: F64, truth_mm: F64) -> dict[str, float | None]:
    """Score the depths of edges found against visible edges.

    Parameters
    ----------
    found_mm, truth_mm : (n, 3) and (m, 3) points of edges, world frame; depth is Z.

    Returns
    -------
    located : share of the true points that have an edge found within `LATERAL_MM` in X and Y.
    median_mm, bias_mm : median absolute and median depth error of the edge nearest to each of them
        in X and Y.
    recall : share of all true points whose nearest edge is within `NEAR_MM` in depth.
    precision : share of the edges found with a true point that close.
    """
    names = ("located", "median_mm", "bias_mm", "recall", "precision")
    if not len(truth_mm) or not len(found_mm):
        return dict.fromkeys(names)
    apart, nearest = cKDTree(found_mm[:, :2]).query(truth_mm[:, :2])
    located = apart <= LATERAL_MM
    errors = (found_mm[nearest] - truth_mm)[:, 2]
    off = errors[located]
    scaled = np.array([1.0 / LATERAL_MM, 1.0 / LATERAL_MM, 1.0 / NEAR_MM])
    back, _ = cKDTree(truth_mm * scaled).query(found_mm * scaled, p=np.inf)
    median, bias = (np.median(np.abs(off)), np.median(off)) if len(off) else (np.nan, np.nan)
    return {
        "located": float(located.mean()),
        "median_mm": finite_or_none(median),
        "bias_mm": finite_or_none(bias),
        "recall": float((located & (np.abs(errors) <= NEAR_MM)).mean()),
        "precision": float((back <= 1.0).mean()),
    }
