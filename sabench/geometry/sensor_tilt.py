"""Tilt of a sensor against its lens, after Scheimpflug.

The sensor is turned about the point where the optical axis meets it: about the lens's X axis by the
first angle, then about its own Y axis by the second. Light is distorted by the lens first and meets
the sensor then, so that the order is that of OpenCV's tilted model (its tau_x and tau_y).

Lengths are in units of the principal distance. Image coordinates are those on the upright plane
through the turning point; sensor coordinates have the same origin and lie along the tilted rows and
columns. Behind the lens all is turned by half a turn, so that both have the signs of the scene.
"""

from __future__ import annotations

import functools

import numpy as np

from sabench.utils.arrays import F64, Bool

Tilt = tuple[float, float]
UPRIGHT: Tilt = (0.0, 0.0)


@functools.lru_cache(maxsize=256)
def sensor_axes(tilt_deg: Tilt) -> F64:
    """Compute the sensor's axes (3, 3) in the lens's frame.

    Rows are right, down and the normal away from the lens.
    """
    x, y = np.deg2rad(tilt_deg)
    about_x = [[1.0, 0.0, 0.0], [0.0, np.cos(x), np.sin(x)], [0.0, -np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0.0, -np.sin(y)], [0.0, 1.0, 0.0], [np.sin(y), 0.0, np.cos(y)]]
    axes = np.array(about_y) @ np.array(about_x)
    axes.flags.writeable = False
    return axes


def onto_sensor(tilt_deg: Tilt, image: F64, lens: F64 | None = None) -> tuple[F64, Bool]:
    """Intersect light with the sensor.

    Parameters
    ----------
    image : (n, 2) image coordinates, where the light crosses the upright plane.
    lens : (2,) point of the aperture through which it comes; by default its middle.

    Returns
    -------
    Sensor coordinates (n, 2), and whether the light meets the sensor behind the lens.
    """
    axes, start = sensor_axes(tilt_deg), np.zeros(2) if lens is None else -lens
    along = image - start  # from the lens to the upright plane, where the depth is 1
    normal, deep = axes[2, :2], axes[2, 2]
    approach = along @ normal + deep
    valid = np.asarray(approach > 1e-9)
    depth = (deep - start @ normal) / np.where(valid, approach, 1.0)
    offset = np.column_stack([start + depth[:, None] * along, depth - 1.0])
    return np.asarray(offset @ axes[:2].T), valid


def from_sensor(tilt_deg: Tilt, sensor: F64) -> tuple[F64, Bool]:
    """Invert `onto_sensor` for light through the middle of the lens."""
    places = sensor @ sensor_axes(tilt_deg)[:2] + [0.0, 0.0, 1.0]
    valid = np.asarray(places[:, 2] > 1e-9)
    return places[:, :2] / np.where(valid, places[:, 2], 1.0)[:, None], valid


def focus_slope(tilt_deg: Tilt) -> F64:
    """Compute how the inverse of the sharp depth falls with image coordinates (2,).

    In units of the inverse principal distance. A plane behind a thin lens is the image of the plane
    in which both, and the plane of the lens, meet in one line (Scheimpflug's rule).
    """
    axes = sensor_axes(tilt_deg)
    return np.asarray(axes[2, :2] / axes[2, 2])


def stretch(tilt_deg: Tilt, image: F64) -> F64:
    """Compute the shape of a round cone of light on the sensor.

    The light comes through the lens's middle.

    Variances along columns and rows, and their covariance (n, 3), where they are 1, 1 and 0 on the
    upright plane.
    """
    axes = sensor_axes(tilt_deg)
    rays = np.column_stack([image, np.ones(len(image))])
    approach = rays @ axes[2]
    tangents = (rays @ axes[:2].T) / approach[:, None]
    scale = (axes[2, 2] / approach)[:, None, None]
    slopes = scale * (axes[:2, :2] - tangents[:, :, None] * axes[2, :2])
    both = slopes @ slopes.transpose(0, 2, 1)
    return np.stack([both[:, 0, 0], both[:, 1, 1], both[:, 0, 1]], axis=1)
