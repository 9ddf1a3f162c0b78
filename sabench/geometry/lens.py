"""Lens distortion after Brown and Conrady, sensors tilted after Scheimpflug.

A tilted sensor is turned about the point where the optical axis meets it: about the lens's X axis
by the first angle, then about its own Y axis by the second. Light is distorted by the lens first
and meets the sensor then, so that the order is that of OpenCV's tilted model (tau_x and tau_y).

Lengths are in units of the principal distance. Image coordinates are those on the upright plane
through the turning point; sensor coordinates have the same origin and lie along the tilted rows and
columns. Behind the lens all is turned by half a turn, so that both have the signs of the scene.
"""

import functools
from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64, Bool

NEWTON = 30  # most steps of an iteration; few are enough where it converges


@dataclass(frozen=True)
class Distortion:
    """Brown-Conrady coefficients of distortion.

    They are dimensionless and act on ideal image coordinates x/z, y/z. All zero means none.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0


@functools.cache
def _fold_square(lens: Distortion) -> float:
    """Find the squared ideal radius beyond which two points share a pixel."""
    roots = np.roots([7.0 * lens.k3, 5.0 * lens.k2, 3.0 * lens.k1, 1.0])
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
    return float(real.min()) if len(real) else float("inf")


def distort(lens: Distortion, ideal: F64) -> tuple[F64, Bool, tuple[F64, F64, F64]]:
    """Compute distorted image coordinates, validity and Jacobian.

    Valid is where the map is one to one: inside the radial fold, with a positive determinant.

    The Jacobian is symmetric: (du/dx, du/dy, dv/dy).
    """
    x, y = ideal[:, 0], ideal[:, 1]
    s = x * x + y * y
    radial = 1.0 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))
    slope = lens.k1 + s * (2.0 * lens.k2 + 3.0 * lens.k3 * s)
    u = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (s + 2.0 * x * x)
    v = y * radial + lens.p1 * (s + 2.0 * y * y) + 2.0 * lens.p2 * x * y
    ux = radial + 2.0 * x * x * slope + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x
    uy = 2.0 * x * y * slope + 2.0 * lens.p1 * x + 2.0 * lens.p2 * y
    vy = radial + 2.0 * y * y * slope + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x
    one_to_one = (ux * vy - uy * uy > 0.0) & (s < _fold_square(lens))
    return np.column_stack([u, v]), np.asarray(one_to_one), (ux, uy, vy)


def undistort(lens: Distortion, distorted: F64) -> tuple[F64, Bool]:
    """Invert `distort` by Newton's iteration with the exact residual as its test."""
    if lens == Distortion():
        return distorted, np.asarray(np.isfinite(distorted).all(axis=1))
    ideal, residual = distorted.copy(), np.zeros_like(distorted)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON):
            image, _, (ux, uy, vy) = distort(lens, ideal)
            residual = distorted - image
            if np.all(np.abs(residual) < 1e-15):
                break
            a, b = residual.T
            step = np.column_stack([vy * a - uy * b, ux * b - uy * a])
            ideal = ideal + step / (ux * vy - uy * uy)[:, None]
        valid = (np.abs(residual).max(axis=1) < 1e-12) & distort(lens, ideal)[1]
    return ideal, np.asarray(valid)


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
    lens : (2,) point of the aperture on its path; by default the middle.

    Returns sensor coordinates (n, 2), and whether the light meets the sensor behind the lens.
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
    points = sensor @ sensor_axes(tilt_deg)[:2] + [0.0, 0.0, 1.0]
    valid = np.asarray(points[:, 2] > 1e-9)
    return points[:, :2] / np.where(valid, points[:, 2], 1.0)[:, None], valid


def focus_slope(tilt_deg: Tilt) -> F64:
    """Compute how the inverse of the sharp depth falls with image coordinates (2,).

    In units of the inverse principal distance. A plane behind a thin lens is the image of another;
    both, and the plane of the lens, meet in one line (Scheimpflug's rule).
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
