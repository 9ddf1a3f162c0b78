"""Rigs in space: cameras, light paths, walls, diffuser and volume in perspective."""

from typing import Any

import numpy as np
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from sabench.apps.viewer.surroundings import Surroundings
from sabench.utils.arrays import F64

INK, RAY, GLASS, WATER, VOLUME = "#1b1f24", "#8a94a0", "#2a6f97", "#cfe6f5", "#f0c419"
_LIGHT, _LAMP = "#fff3c4", "#c9a227"
_BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


class Eye:
    """Perspective from a point towards another, Y down."""

    def __init__(self, place_mm: Any, target_mm: Any) -> None:
        self.place = np.array(place_mm)
        ahead = np.array(target_mm) - self.place
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross([0.0, 1.0, 0.0], ahead)
        right = right / np.linalg.norm(right)
        self.axes = np.array([right, np.cross(ahead, right), ahead])

    def __call__(self, points_mm: Any) -> F64:
        """Project points (..., 3) to (..., 2)."""
        seen = (np.asarray(points_mm, dtype=np.float64) - self.place) @ self.axes.T
        return np.asarray(seen[..., :2] / seen[..., 2:])


def box(axes: Any, eye: Eye, low: Any, high: Any, own: Any = None, **style: Any) -> None:
    """Draw the faces of a box, the far ones first; `own` are its axes and its origin."""
    corners = np.asarray(low) + _BOX * (np.asarray(high) - np.asarray(low))
    if own is not None:
        corners = np.asarray(own[1]) + corners @ np.asarray(own[0])
    faces = [corners[list(face)] for face in _FACES]
    for face in sorted(
        faces, key=lambda face: -float(np.linalg.norm(face.mean(axis=0) - eye.place))
    ):
        axes.add_patch(Polygon(eye(face), **style))


def draw_rig(axes: Any, eye: Eye, around: Surroundings, size: float = 1.0, lw: float = 1.0) -> None:
    """Draw a rig: cameras of `size` x 83 mm, lines `lw` times as wide."""
    rig = around.describe()
    if rig["backlight"] is not None:
        plate = rig["backlight"]
        half = np.array([*plate["size"], 0.0]) / 2.0
        box(axes, eye, -half, half, (plate["axes"], plate["center"]), fc=_LIGHT, ec=_LAMP, lw=lw)
    for wall in rig["walls"]:
        draw_wall(axes, eye, wall, rig["volume"], {"lw": 1.5 * lw, "alpha": 0.45})
    for camera in rig["cameras"]:
        for path in camera["paths"][:: rig["side"]]:
            if path[0][0] is not None:
                axes.plot(*eye(path).T, color=RAY, lw=1.3 * lw)
    for disc in rig["discs"]:
        half = np.full(3, disc["radius"]) * [1.0, 1.0, 0.05]
        box(axes, eye, -half, half, (np.eye(3), disc["center"]), fc=INK, ec=INK)
    for camera in rig["cameras"]:
        own = np.array(camera["axes"]), np.array(camera["center"])
        for low, high in (([-22, -22, -75], [22, 22, -20]), ([-13, -13, -20], [13, 13, 8])):
            ends = np.array([low, high]) * size
            box(axes, eye, *ends, own, fc="#5b6672", ec=INK, lw=1.0 * lw, zorder=3)
    box(axes, eye, *rig["volume"], fc=VOLUME, ec=INK, lw=1.5 * lw, alpha=0.8)


def draw_wall(axes: Any, eye: Eye, wall: dict[str, Any], volume: Any, style: Any) -> None:
    """Draw a wall and the fluid behind it, as far as its back wall or the volume reaches."""
    water, glass = style | {"fc": WATER, "ec": GLASS}, style | {"fc": GLASS, "ec": GLASS}
    if wall["kind"] == "plane":
        own = np.array([*wall["axes"], wall["normal"]]), np.array(wall["point"])
        inner, (low, high) = wall["depths"][-1], (wall["low"], wall["high"])
        far = (np.array(volume) - own[1]) @ own[0][2]
        box(axes, eye, [*low, inner], [*high, wall["back"] or far.max()], own, **water)
        box(axes, eye, [*low, 0.0], [*high, inner], own, **glass)
        return
    axis, angles = np.array(wall["axis"]), np.linspace(0.0, 2.0 * np.pi, 73)[:, None]
    first, second = np.linalg.svd(axis[None])[2][1:]
    for radius, kind in ((max(wall["radii"]), glass), (min(wall["radii"]), water)):
        around = radius * (np.cos(angles) * first + np.sin(angles) * second)
        rims = [wall["point"] + around + end * axis for end in (wall["low"], wall["high"])]
        outline = eye(np.concatenate(rims))
        axes.add_patch(Polygon(outline[ConvexHull(outline).vertices], **kind))
