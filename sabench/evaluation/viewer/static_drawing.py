"""Drawings of a rig that need no script, along two edges of the volume."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from sabench.evaluation.viewer.surroundings import Surroundings
from sabench.plotting.outlines import Outline, draw_outlines
from sabench.utils.arrays import F64

_MARGIN, _CAMERA = 0.06, 0.03  # of the drawing's larger side
_NAMES = ("x", "y", "z")
_ARC = np.linspace(0.0, 2.0 * np.pi, 73)[:, None]
_SIGNS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))


def draw_surroundings(around: Surroundings) -> list[str]:
    """Draw a rig as two SVG elements."""
    rig = around.describe()
    centers = np.array([one.center_mm for one in around.cameras])
    axis = int(np.argmax(np.abs(centers.mean(axis=0) - around.center_mm)))
    planes = [[axis, vertical] for vertical in range(3) if vertical != axis]
    return [_draw(rig, plane) for plane in planes]


def _draw(rig: dict[str, Any], plane: list[int]) -> str:
    """Draw everything in a plane of two axes."""
    shapes = [Outline("volume", _hull(_corners(rig), plane), closed=True)]
    for wall in rig["walls"]:
        shapes += [Outline("wall", _hull(face, plane), closed=True) for face in _faces(wall)]
    for camera in rig["cameras"]:
        shapes += [Outline("ray", path[:, plane]) for path in _edges(camera, rig["side"])]
    ends = np.concatenate([one.points_mm for one in shapes])
    margin = _MARGIN * float(np.ptp(ends, axis=0).max())
    low, high = ends.min(axis=0) - margin, ends.max(axis=0) + margin
    length = _CAMERA * float((high - low).max())
    shapes += [_symbol(camera, plane, length) for camera in rig["cameras"]]
    if rig["sheet"] is not None:
        shapes.append(Outline("sheet", _hull(_box(rig["sheet"]), plane), closed=True))
    names = _NAMES[plane[0]], _NAMES[plane[1]]
    return draw_outlines(f"Rig along {names[0]} and {names[1]}", shapes, low, high, names)


def _corners(rig: dict[str, Any]) -> F64:
    low, high = np.array(rig["volume"])
    return np.asarray((low + high) / 2.0 + _SIGNS * (high - low))


def _box(sheet: dict[str, Any]) -> F64:
    return np.asarray(sheet["center"] + (_SIGNS * sheet["size"]) @ np.array(sheet["axes"]))


def _faces(wall: dict[str, Any]) -> Iterator[F64]:
    """Yield points (n, 3) at the rim of each face."""
    if wall["kind"] == "plane":
        ends = np.array([wall["low"], wall["high"]])
        across = np.array(list(itertools.product(*ends.T))) @ np.array(wall["axes"])
        for depth in wall["depths"]:
            yield wall["point"] + across + depth * np.array(wall["normal"])
        return
    axis = np.array(wall["axis"])
    first = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    first = first / np.linalg.norm(first)
    around = np.cos(_ARC) * first + np.sin(_ARC) * np.cross(axis, first)
    for radius in wall["radii"]:
        rims = [radius * around + end * axis for end in (wall["low"], wall["high"])]
        yield wall["point"] + np.concatenate(rims)


def _edges(camera: dict[str, Any], side: int) -> Iterator[F64]:
    """Yield the light paths (n, 3) of an image's corners."""
    for path in camera["paths"][::side]:
        if path[0][0] is not None:
            yield np.array(path)


def _symbol(camera: dict[str, Any], plane: list[int], length_mm: float) -> Outline:
    """Draw a camera as a triangle whose tip is the pinhole."""
    tip, forward = np.array(camera["center"])[plane], np.array(camera["axes"][2])[plane]
    side = np.array([-forward[1], forward[0]])
    back = tip - length_mm * forward
    half = length_mm / 2.0 * side
    return Outline("camera", np.array([tip, back + half, back - half]), closed=True)


def _hull(points_mm: F64, plane: list[int]) -> F64:
    """Find the rim (n, 2) of points (n, 3) in a plane, or the ends of a line."""
    flat = points_mm[:, plane]
    try:
        return np.asarray(flat[ConvexHull(flat).vertices])
    except QhullError:
        order = np.lexsort(flat.T)
        return np.asarray(flat[order[[0, -1]]])
