"""Independent projection of points, to find errors in the main projection.

It is a copy of `geometry.camera` and `geometry.refraction` with other equations, and takes nothing
from `sabench.geometry`: the wall's numbers come from the scene as its author wrote them, the path
from bisection for the invariant n sin(angle) that all its angles share, the lens from the formula
in docs/formats/dataset.md. Behind coaxial cylinders, rays are followed in the world's frame: each
meets the cylinder x^2 + y^2 = r^2 about the axis by a quadratic equation and is refracted by
Snell's law for vectors; Newton's steps with differences find the direction towards a point.

The test test_comparison.py::test_two_implementations_of_a_camera_agree compares both.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sabench.scenes import Scene
from sabench.scenes.wall import CylinderSpec, WallSpec
from sabench.utils.arrays import F64

_STEPS = 40
_DIFFERENCE = np.cbrt(np.finfo(np.float64).eps)  # rad: the best for central differences


def shoot(spec: CylinderSpec, pinhole: F64, directions: F64) -> tuple[F64, F64]:
    """Follow unit directions (n, 3) from a pinhole to the inner face.

    Returns positions and directions there, (n, 3); NaN for a ray that does not get there.
    """
    axis = np.array(spec.axis) / np.linalg.norm(spec.axis)
    indices = [spec.air_index, *(layer.index for layer in spec.layers), spec.fluid_index]
    radius = spec.outer_radius_mm
    at, along = np.broadcast_to(pinhole, directions.shape), directions
    with np.errstate(invalid="ignore", divide="ignore"):
        for number, (before, behind) in enumerate(itertools.pairwise(indices)):
            if number:
                radius = radius - spec.layers[number - 1].thickness_mm
            p = _across(at - np.array(spec.axis_point_mm), axis)
            d = _across(along, axis)
            a, b, c = _dot(d, d), _dot(p, d), _dot(p, p) - radius**2
            at = at + ((-b - np.sqrt(b * b - a * c)) / a)[:, None] * along
            outwards = _across(at - np.array(spec.axis_point_mm), axis) / radius
            turned = np.cross(outwards, along) * (before / behind)  # n (N x d) is conserved
            along = (
                np.cross(turned, outwards) - outwards * np.sqrt(1.0 - _dot(turned, turned))[:, None]
            )
    return at, along


def aim_at(spec: CylinderSpec, pinhole: F64, points: F64) -> F64:
    """Find the directions (n, 3) of light from a pinhole to points (n, 3)."""
    aim = points - pinhole
    aim = aim / np.linalg.norm(aim, axis=1, keepdims=True)
    for _ in range(_STEPS):
        right = np.cross(aim, np.eye(3)[np.argmin(np.abs(aim), axis=1)])
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        down = np.cross(aim, right)
        miss = _miss(spec, pinhole, aim, points)
        slopes = [
            (
                _miss(spec, pinhole, _turn(aim, _DIFFERENCE * side), points)
                - _miss(spec, pinhole, _turn(aim, -_DIFFERENCE * side), points)
            )
            / (2.0 * _DIFFERENCE)
            for side in (right, down)
        ]
        matrix = np.stack(slopes, axis=2)
        normal = matrix.transpose(0, 2, 1) @ matrix
        step = np.linalg.solve(normal, -matrix.transpose(0, 2, 1) @ miss[:, :, None])[:, :, 0]
        aim = _turn(aim, step[:, :1] * right + step[:, 1:] * down)
    return aim


def _miss(spec: CylinderSpec, pinhole: F64, aim: F64, points: F64) -> F64:
    """Compute vectors (n, 3) from points to their rays, at right angles to the rays."""
    at, along = shoot(spec, pinhole, aim)
    offset = at - points
    return np.asarray(offset - _dot(offset, along)[:, None] * along)


def _turn(aim: F64, step: F64) -> F64:
    turned = aim + step
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _across(vectors: F64, axis: F64) -> F64:
    return np.asarray(vectors - (vectors @ axis)[..., None] * axis)


def _dot(vectors: F64, other: F64) -> F64:
    return np.asarray(np.sum(vectors * other, axis=-1))


def retrace(scene: Scene, camera: Any, points_mm: F64) -> F64:
    """Project points (n, 3) in the fluid to pixels (n, 2).

    Parameters
    ----------
    camera : anything with the pinhole's `center_mm`, `rotation`, `principal_distance_mm`,
        `pixel_mm`, `principal_point_px`, `distortion` and `tilt_deg`.
    """
    pinhole, axes = np.array(camera.center_mm), np.array(camera.rotation)
    offset = points_mm - pinhole
    leaving = offset
    if isinstance(scene.wall, CylinderSpec):
        leaving = aim_at(scene.wall, pinhole, points_mm)
    elif scene.wall is not None:
        leaving = _leaving(_face(scene.walls, pinhole, camera.rotation[2]), pinhole, offset)
    right, down, forward = (leaving @ axis for axis in axes)
    x, y, lens = right / forward, down / forward, camera.distortion
    square = x**2 + y**2
    radial = 1.0 + lens.k1 * square + lens.k2 * square**2 + lens.k3 * square**3
    u = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (square + 2.0 * x**2)
    v = y * radial + 2.0 * lens.p2 * x * y + lens.p1 * (square + 2.0 * y**2)
    focal_px = camera.principal_distance_mm / camera.pixel_mm
    hit = _meet_sensor(np.column_stack([u, v]), camera.tilt_deg)
    return np.asarray(hit * focal_px + np.array(camera.principal_point_px))


def _meet_sensor(image: F64, tilt_deg: tuple[float, float]) -> F64:
    """Find where light through (x, y, 1) meets a tilted sensor.

    The sensor is rotated about (0, 0, 1). A position on it is one on an upright sensor after two
    rotations, which has to lie on the light path: two equations.
    """
    turn = Rotation.from_euler("XY", tilt_deg, degrees=True).as_matrix()
    right, down = turn[:, 0], turn[:, 1]
    first = right[:2] - image * right[2]
    second = down[:2] - image * down[2]
    gain = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    column = (image[:, 0] * second[:, 1] - image[:, 1] * second[:, 0]) / gain
    row = (first[:, 0] * image[:, 1] - first[:, 1] * image[:, 0]) / gain
    return np.column_stack([column, row])


def _face(walls: Sequence[Any], pinhole: F64, forward: Any) -> WallSpec:
    """Find the face of a tank that a camera's axis enters last."""

    def distance(wall: WallSpec) -> float:
        normal = np.array(wall.normal)
        along = float(normal @ np.array(forward))
        return float((np.array(wall.point_mm) - pinhole) @ normal) / along if along > 0 else -1.0

    face: WallSpec = max(walls, key=distance)
    return face


def _leaving(wall: WallSpec, pinhole: F64, offset: F64) -> F64:
    """Compute the directions (n, 3) of light from a pinhole to points.

    The points are given by their offsets (n, 3) from the pinhole.
    """
    normal = np.array(wall.normal) / np.linalg.norm(wall.normal)
    before = float((np.array(wall.point_mm) - pinhole) @ normal)
    solid = sum(layer.thickness_mm for layer in wall.layers)
    along = offset @ normal
    sideways = offset - along[:, None] * normal
    radius = np.linalg.norm(sideways, axis=1)
    depths = [
        np.full(len(offset), before),
        *(np.full(len(offset), layer.thickness_mm) for layer in wall.layers),
        along - before - solid,
    ]
    # find the n sin(angle) (n,) of the path that ends at the given radius. The path crosses all
    # depths. The radius grows with n sin(angle), from 0 to infinity
    indices = [wall.air_index, *(layer.index for layer in wall.layers), wall.fluid_index]
    low, high = np.zeros_like(radius), np.full_like(radius, min(indices))
    middle = (low + high) / 2.0
    while ((low < middle) & (middle < high)).any():  # until no number is between
        with np.errstate(divide="ignore"):
            reached = sum(
                depth * middle / np.sqrt(index**2 - middle**2)
                for index, depth in zip(indices, depths, strict=True)
            )
        inside = reached < radius
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        middle = (low + high) / 2.0
    sine = middle / wall.air_index
    return np.asarray(
        np.sqrt(1.0 - sine**2)[:, None] * normal
        + (sine / np.maximum(radius, 1e-300))[:, None] * sideways
    )
