"""True images of particles with recorded noise, for bounds of positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.api.truth import View
from sabench.geometry.camera import Camera
from sabench.images.position_bounds import ParticleSpots
from sabench.scenes.sensor import Sensor
from sabench.utils.arrays import F64, U16

_STEP_MM = 1e-3


def true_spots(
    position_mm: F64,
    views: Sequence[View],
    cameras: Sequence[Camera],
    recorded: Sequence[U16],
    sensors: Sensor,
) -> list[ParticleSpots]:
    """Make the images of particles (n, 3) in electrons.

    The noise of a pixel is that of the electrons which its recorded grey value stands for, of
    reading and of rounding. Pixels that are full or white tell nothing.
    """
    spots = []
    for number, (view, camera, grey) in enumerate(zip(views, cameras, recorded, strict=True)):
        sensor = sensors.of_camera(number)
        exposure = 1.0 if sensors.camera_exposure is None else sensors.camera_exposure[number]
        electrons = np.maximum(grey.astype(np.float64) - sensor.black_level_dn, 0.0)
        electrons /= sensor.gain_dn_e
        variance = sensor.read_noise_e**2 + sensor.gain_dn_e**-2.0 / 12.0
        full = (grey >= sensor.white_dn) | (electrons >= sensor.full_well_e)
        there = np.isfinite(view.pixel).all(axis=1)
        spots.append(
            ParticleSpots(
                view.pixel,
                _slopes(camera, position_mm),
                sensor.quantum_efficiency * exposure * np.where(there, view.photons, 0.0),
                view.sigma_px,
                np.where(full, np.inf, variance + (electrons if sensor.shot_noise else 0.0)),
            )
        )
    return spots


def _slopes(camera: Camera, position_mm: F64) -> F64:
    """Differentiate pixels (n, 2, 3) by positions, px/mm, by central differences."""
    ends = [
        camera.project(position_mm + step)[0] - camera.project(position_mm - step)[0]
        for step in _STEP_MM * np.eye(3)
    ]
    return np.nan_to_num(np.stack(ends, axis=2) / (2.0 * _STEP_MM))
