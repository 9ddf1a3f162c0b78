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
    """Return the rotation (..., 3, 3) to the axes of bubbles (..., 7).

    It is from the world; the second row is the short axis.
    """
    a, b = parameters[..., 5], parameters[..., 6]
    x, y, z = np.sin(a) * np.cos(b), -np.cos(a) * np.cos(b), np.sin(b)
    length = np.hypot(x, y)
    right, ahead, level = y / length, -x / length, np.zeros_like(x)
    rows = [right, ahead, level, x, y, z, ahead * z, -right * z, right * y - ahead * x]
    return np.stack(rows, axis=-1).reshape(*x.shape, 3, 3)


def semi_axes_of(parameters: F64) -> F64:
    """Compute the semi-axes (..., 3) along the rows of `turn_of`."""
    long, short = np.exp(parameters[..., 3]), np.exp(parameters[..., 4])
    return np.stack([long, short, long], axis=-1)


def images_of(linear: tuple[F64, F64, F64], parameters: F64) -> F64:
    """Compute the ellipses (camera, ..., 5) of bubbles (..., 7).

    Centre column and row, and the inverse of its shape matrix as xx, xy, yy.

    Parameters
    ----------
    linear : from `linearise`: a position, its pixels (camera, 2) and their derivatives (camera, 2,
        3).
    """
    position, pixels, jacobians = linear
    among = parameters.ndim - 1
    pixels = pixels.reshape(-1, *(1,) * among, 2)
    jacobians = jacobians.reshape(-1, *(1,) * among, 2, 3)
    rotation, axes = turn_of(parameters), semi_axes_of(parameters)
    half = jacobians @ (rotation.swapaxes(-1, -2) * axes[..., None, :])  # (camera, ..., 2, 3)
    xx, yy = np.sum(half[..., 0, :] ** 2, axis=-1), np.sum(half[..., 1, :] ** 2, axis=-1)
    xy = np.sum(half[..., 0, :] * half[..., 1, :], axis=-1)
    out = np.empty((*half.shape[:-2], 5))
    offset = parameters[..., :3] - position
    out[..., :2] = pixels + np.sum(jacobians * offset[..., None, :], axis=-1)
    determinant = xx * yy - xy**2
    out[..., 2], out[..., 3], out[..., 4] = yy / determinant, -xy / determinant, xx / determinant
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
