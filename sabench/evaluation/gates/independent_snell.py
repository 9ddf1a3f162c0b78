"""Independent light paths through coaxial cylinders.

They find errors in the main projection: nothing is taken from `sabench.geometry`. Rays are followed
in the world's frame: each meets the cylinder x^2 + y^2 = r^2 about the axis where a quadratic
equation says, and turns there by Snell's law for vectors. The direction towards a point is found by
Newton's steps with differences.
"""

from __future__ import annotations

import itertools

import numpy as np

from sabench.scenes.wall import CylinderSpec
from sabench.utils.arrays import F64

_STEPS = 40
_DIFFERENCE = 1e-6  # rad


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
    """Find directions (n, 3) in which light leaves a pinhole towards points (n, 3)."""
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


def _dot(one: F64, other: F64) -> F64:
    return np.asarray(np.sum(one * other, axis=-1))
