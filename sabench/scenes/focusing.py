"""Focus of a scene's cameras: principal distances, and tilts of sensors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.geometry.rigid_motion import frame_of_normal
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_STEP_MM = 0.1  # in the plane in focus: far above rounding, far below any curvature
_MOST_DEG = 60.0  # of a tilt that follows from a plane: beyond, the camera looks along the plane


def focus(camera: Camera, target: F64, focus_mm: float | None) -> Camera:
    """Move the image plane so that a point is sharp.

    The point is `focus_mm` or else the target.
    """
    distance = focus_mm or apparent_distance_mm(camera, target)
    if not distance > camera.focal_length_mm:
        expected = f"expected more than the focal length {camera.focal_length_mm:g} mm"
        raise InputError(f"cameras.focus_mm: {camera.name}: {expected}, got {distance:.4g}")
    inverse = 1.0 / camera.focal_length_mm - 1.0 / distance
    return replace(camera, principal_distance_mm=1.0 / inverse)


def apparent_distance_mm(camera: Camera, target_mm: F64) -> float:
    """Compute the apparent distance of a target seen through the wall.

    The distance is along the axis. A point in plain air at this distance shows the same parallax.
    Refraction makes it astigmatic: the mean over the aperture's two axes is taken.
    """
    plain = replace(camera, distortion=Distortion(), tilt_deg=UPRIGHT)
    step = camera.aperture_radius_mm
    moves = []
    for axis, (right, down) in enumerate(((step, 0.0), (0.0, step))):
        there, valid = plain.shifted(right, down).project(target_mm[None])
        back, valid_back = plain.shifted(-right, -down).project(target_mm[None])
        if not (valid[0] and valid_back[0]):
            return math.nan
        moves.append(abs(there[0, axis] - back[0, axis]) / (2.0 * step * plain.focal_px))
    mean = float(np.mean(moves))
    return 1.0 / mean if mean else math.inf


def tilt_sensor(camera: Camera, target_mm: F64, normal: F64) -> Camera:
    """Tilt a sensor so that a plane is in focus.

    The plane passes through a target on the optical axis and has a unit normal, both in the world.
    It appears bent behind a wall; the tilt is that of its tangent at the target.

    Raises
    ------
    InputError
        A plane that the camera looks along.
    """
    right, down, _ = frame_of_normal(normal)
    image, inverse = [], []
    for step in (right, down):
        ends = [target_mm + sign * _STEP_MM * step for sign in (1.0, -1.0)]
        plain = replace(camera, distortion=Distortion(), tilt_deg=UPRIGHT)
        pixels = plain.project(np.array(ends))[0] / camera.focal_px
        image.append(pixels[0] - pixels[1])
        near = [1.0 / apparent_distance_mm(camera, end) for end in ends]
        inverse.append(near[0] - near[1])
    try:
        slopes = -camera.principal_distance_mm * np.linalg.solve(np.array(image), inverse)
    except np.linalg.LinAlgError:
        slopes = np.full(2, np.inf)
    about_x = -math.atan(slopes[1])
    tilt = math.degrees(about_x), math.degrees(math.atan(slopes[0] * math.cos(about_x)))
    if not max(map(abs, tilt)) < _MOST_DEG:
        raise InputError(
            f"cameras.focus_normal: {camera.name}: expected a plane that the camera does not look "
            f"along, got one that needs a tilt of {max(map(abs, tilt)):.3g} degrees"
        )
    return replace(camera, tilt_deg=tilt)
