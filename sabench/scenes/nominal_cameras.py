"""Nominal cameras: the true ones perturbed by the scene's calibration error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import frame_of_normal, rotation_matrices
from sabench.scenes.calibration import Calibration
from sabench.scenes.scene import Scene
from sabench.utils.arrays import triple
from sabench.utils.rng import stream


def nominal_cameras(scene: Scene, cameras: tuple[Camera, ...], seed: int) -> tuple[Camera, ...]:
    """Perturb the true cameras by the scene's calibration error.

    A shift on the image moves the projections of all points alike. Source: thesis section 2.2.4,
    the error eps_RP of figure 2-7b, whose length is the same for all cameras and whose direction is
    random.
    """
    spec = scene.calibration
    if spec is None:
        return cameras
    if spec.errs_in_wall and isinstance(wall := cameras[0].wall, Wall):
        nominal = draw_nominal_wall(wall, spec, seed)
        cameras = tuple(replace(camera, wall=nominal) for camera in cameras)
    return tuple(
        _perturb(_shift(camera, spec, seed, number), spec, seed, number)
        for number, camera in enumerate(cameras)
    )


def draw_nominal_wall(wall: Wall, spec: Calibration, seed: int) -> Wall:
    """Draw a wall that is off in place, tilt, thickness and indices.

    It turns about the point of the true one.
    """
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


def _shift(camera: Camera, spec: Calibration, seed: int, number: int) -> Camera:
    """Move the principal point, and set unknown coefficients of distortion to zero."""
    angle = stream(seed, "calibration", number).uniform(0.0, 2.0 * np.pi)
    right, down = spec.shift_px * float(np.cos(angle)), spec.shift_px * float(np.sin(angle))
    column, row = camera.principal_point_px
    unmeasured = {name: 0.0 for name in spec.unknown or () if name in vars(camera.distortion)}
    return replace(
        camera,
        distortion=replace(camera.distortion, **unmeasured),
        principal_point_px=(column + right, row + down),
    )


def _perturb(camera: Camera, spec: Calibration, seed: int, number: int) -> Camera:
    rng = stream(seed, "rough cameras", number)
    center = np.asarray(camera.center_mm) + spec.center_mm * rng.standard_normal(3)
    rotation = rotation_matrices(np.deg2rad(spec.turn_deg) * rng.standard_normal(3)) @ np.asarray(
        camera.rotation
    )
    distance = camera.principal_distance_mm * (
        1.0 + spec.focal_percent / 100.0 * float(rng.standard_normal())
    )
    tilt = np.asarray(camera.tilt_deg) + (spec.tilt_deg or 0.0) * rng.standard_normal(2)
    return replace(
        camera,
        tilt_deg=(float(tilt[0]), float(tilt[1])),
        center_mm=triple(center),
        rotation=(triple(rotation[0]), triple(rotation[1]), triple(rotation[2])),
        principal_distance_mm=distance,
    )
