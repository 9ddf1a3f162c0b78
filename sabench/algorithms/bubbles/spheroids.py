"""Spheroids as parameters, and the ellipses that they are in images.

Parameters are x, y, z of the centre, the logarithms of the long and of the short semi-axis, and the
tilts of the short axis about z and about x. The image in a camera is an ellipse, since a camera is
almost linear over so small an object.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.geometry.camera import Camera
from sabench.utils.arrays import F64


def start_of(center_mm: F64, radius_mm: float, aspect: float = 1.0) -> F64:
    """Return parameters of a ball, or of a spheroid that lies flat."""
    return np.array([*center_mm, np.log(radius_mm), np.log(aspect * radius_mm), 0.0, 0.0])


def turn_of(parameters: F64) -> F64:
    """Return the rotation to a bubble's axes.

    It is from the world; the second row is the short axis.
    """
    a, b = parameters[5], parameters[6]
    short = np.array([np.sin(a) * np.cos(b), -np.cos(a) * np.cos(b), np.sin(b)])
    first = np.cross(short, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    return np.stack([first, short, np.cross(first, short)])


def semi_axes_of(parameters: F64) -> F64:
    """Compute the semi-axes along the rows of `turn_of`."""
    long, short = np.exp(parameters[3]), np.exp(parameters[4])
    return np.array([long, short, long])


def images_of(cameras: Sequence[Camera], linear: tuple[F64, F64, F64], parameters: F64) -> F64:
    """Compute ellipses (camera, 5) of a bubble.

    Centre column and row, and the inverse of its shape matrix as xx, xy, yy.

    Parameters
    ----------
    linear : from `linearise`: a position, its pixels (camera, 2) and their derivatives (camera, 2,
        3).
    """
    position, pixels, jacobians = linear
    rotation, axes = turn_of(parameters), semi_axes_of(parameters)
    shape = rotation.T @ (axes[:, None] ** 2 * rotation)
    out = np.empty((len(cameras), 5))
    out[:, :2] = pixels + jacobians @ (parameters[:3] - position)
    flat = jacobians @ shape @ jacobians.transpose(0, 2, 1)
    determinant = flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] ** 2
    out[:, 2], out[:, 3], out[:, 4] = (
        flat[:, 1, 1] / determinant,
        -flat[:, 0, 1] / determinant,
        flat[:, 0, 0] / determinant,
    )
    return out


def linearise(cameras: Sequence[Camera], position: F64) -> tuple[F64, F64, F64]:
    """Linearise every camera around a position."""
    step = 0.05
    points = np.concatenate(
        [position[None], position + step * np.eye(3), position - step * np.eye(3)]
    )
    pixels = np.stack([camera.project(points)[0] for camera in cameras])
    return (
        position.copy(),
        pixels[:, 0],
        np.asarray((pixels[:, 1:4] - pixels[:, 4:7]).transpose(0, 2, 1) / (2.0 * step)),
    )
