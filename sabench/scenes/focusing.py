"""Focus of a scene's cameras, tilts of sensors, and nominal cameras.

Nominal cameras are the true ones perturbed by the scene's calibration error.
"""

import math
from dataclasses import replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import frame_of_normal, rotation_matrices
from sabench.scenes.calibration import Calibration
from sabench.scenes.scene import Scene
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.rng import stream

_STEP_MM = 0.1  # in the plane in focus: far above rounding, far below any curvature
_MOST_DEG = 60.0  # of a tilt that follows from a plane: beyond, the camera looks along the plane


def focus(camera: Camera, target: F64, focus_mm: float | None) -> Camera:
    """Move the image plane so that `focus_mm`, or else the target, is sharp."""
    distance = focus_mm or apparent_distance_mm(camera, target)
    if not distance > camera.focal_length_mm:
        place = f": {camera.name} at {list(camera.center_mm)} mm"
        where = f".focus_mm: {camera.name}" if focus_mm else place
        expected = f"expected a focus farther than the focal length {camera.focal_length_mm:g} mm"
        got = f"{distance:.4g} mm" if distance > 0.0 else "none"
        raise InputError(f"cameras{where}: {expected}, got {got}")
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
        ahead, valid = plain.shifted(right, down).project(target_mm[None])
        back, valid_back = plain.shifted(-right, -down).project(target_mm[None])
        if not (valid[0] and valid_back[0]):
            return math.nan
        moves.append(abs(ahead[0, axis] - back[0, axis]) / (2.0 * step * plain.focal_px))
    mean = float(np.mean(moves))
    return 1.0 / mean if mean else math.inf


def tilt_sensor(camera: Camera, target_mm: F64, normal: F64) -> Camera:
    """Tilt a sensor so that a plane is in focus.

    The plane passes through a target on the optical axis and has a unit normal, both in the world.
    It appears bent behind a wall; the tilt is that of its tangent at the target.

    Raises InputError: a plane that the camera looks along.
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


def nominal_cameras(scene: Scene, cameras: tuple[Camera, ...], seed: int) -> tuple[Camera, ...]:
    """Perturb the true cameras by the scene's calibration error.

    A shift on the image moves the projections of all points equally. Source: thesis section 2.2.4,
    the error eps_RP of figure 2-7b, with the same length for all cameras and a random
    direction. Unmeasured coefficients of distortion become zero.
    """
    spec = scene.calibration
    if spec is None:
        return cameras
    if spec.errs_in_wall and isinstance(wall := cameras[0].wall, Wall):
        drawn = draw_nominal_wall(wall, spec, seed)
        cameras = tuple(replace(camera, wall=drawn) for camera in cameras)
    nominal = []
    for number, camera in enumerate(cameras):
        angle = stream(seed, "calibration", number).uniform(0.0, 2.0 * np.pi)
        right, down = spec.shift_px * float(np.cos(angle)), spec.shift_px * float(np.sin(angle))
        column, row = camera.principal_point_px
        unmeasured = {name: 0.0 for name in spec.unknown or () if name in vars(camera.distortion)}
        rng = stream(seed, "rough cameras", number)
        center = np.asarray(camera.center_mm) + spec.center_mm * rng.standard_normal(3)
        turn = rotation_matrices(np.deg2rad(spec.turn_deg) * rng.standard_normal(3))
        rotation = turn @ np.asarray(camera.rotation)
        error = spec.focal_percent / 100.0 * float(rng.standard_normal())
        tilt = np.asarray(camera.tilt_deg) + (spec.tilt_deg or 0.0) * rng.standard_normal(2)
        nominal.append(
            replace(
                camera,
                distortion=replace(camera.distortion, **unmeasured),
                principal_point_px=(column + right, row + down),
                tilt_deg=(float(tilt[0]), float(tilt[1])),
                center_mm=triple(center),
                rotation=(triple(rotation[0]), triple(rotation[1]), triple(rotation[2])),
                principal_distance_mm=camera.principal_distance_mm * (1.0 + error),
            )
        )
    return tuple(nominal)


def draw_nominal_wall(wall: Wall, spec: Calibration, seed: int) -> Wall:
    """Draw a wall off in place, tilt about the true point, thickness and indices."""
    rng = stream(seed, "nominal wall")
    axes = frame_of_normal(np.asarray(wall.normal))
    along, right, down, fluid = rng.standard_normal(4)
    turn = rotation_matrices(np.deg2rad(spec.wall_deg or 0.0) * np.array([right, down, 0.0]))
    thicker, denser = rng.standard_normal((2, len(wall.layers)))
    percent = spec.thickness_percent or 0.0
    layers = []
    for layer, thick, dense in zip(wall.layers, thicker.tolist(), denser.tolist(), strict=True):
        index = layer.index + (spec.layer_index or 0.0) * dense
        thickness_mm = layer.thickness_mm * (1.0 + percent / 100.0 * thick)
        layers.append(replace(layer, thickness_mm=thickness_mm, index=index))
    return replace(
        wall,
        point_mm=triple(np.asarray(wall.point_mm) + (spec.wall_mm or 0.0) * along * axes[2]),
        normal=triple(axes.T @ turn[:, 2]),
        layers=tuple(layers),
        fluid_index=wall.fluid_index + (spec.fluid_index or 0.0) * float(fluid),
    )
