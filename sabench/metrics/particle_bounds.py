"""Errors of particle positions against bounds and claimed errors."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import gammaincinv

from sabench.api.truth import ParticleView
from sabench.geometry.camera import Camera
from sabench.images.position_bounds import ParticleSpots
from sabench.scenes.sensor import Sensor
from sabench.utils.arrays import F64, U16, Bool

_STEP_MM = 1e-3


def true_spots(
    position_mm: F64,
    views: Sequence[ParticleView],
    cameras: Sequence[Camera],
    recorded: Sequence[U16],
    sensors: Sensor,
) -> list[ParticleSpots]:
    """Make the images of particles (n, 3) in electrons.

    The noise of a pixel is that of the electrons which its recorded grey value stands for, of
    reading and of rounding. Pixels that are full or white give none.
    """
    spots = []
    for number, (view, camera, grey) in enumerate(zip(views, cameras, recorded, strict=True)):
        sensor = sensors.of_camera(number)
        exposure = 1.0 if sensors.camera_exposure is None else sensors.camera_exposure[number]
        electrons = np.maximum(grey.astype(np.float64) - sensor.black_level_dn, 0.0)
        electrons /= sensor.gain_dn_e
        variance = sensor.read_noise_e**2 + sensor.gain_dn_e**-2.0 / 12.0
        full = (grey >= sensor.white_dn) | (electrons >= sensor.full_well_e)
        visible = np.isfinite(view.pixel).all(axis=1)
        spots.append(
            ParticleSpots(
                view.pixel,
                _slopes(camera, position_mm),
                sensor.quantum_efficiency * exposure * np.where(visible, view.photons, 0.0),
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


def squared_distance(error: F64, covariance: F64) -> F64:
    """Compute squared Mahalanobis distances (n,) of errors (n, 3)."""
    solved = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    distance: F64 = np.einsum("na,na->n", error, solved)
    return distance


def rms_over_bound(error: F64, bound: F64) -> float:
    """Compute the root mean square of errors (n, 3) over bounds (n, 3, 3).

    It is 1 at the bound. Errors of particles without a bound (NaN) are left out; NaN without
    others.
    """
    finite = np.isfinite(bound).all(axis=(1, 2))
    if not finite.any():
        return math.nan
    return math.sqrt(float(squared_distance(error[finite], bound[finite]).mean()) / 3.0)


def coverage(error: F64, covariance: F64, nominal: float) -> float:
    """Compute the share of errors (n, 3) that claimed ellipsoids hold, over nominal.

    Covariances (n, 3, 3) are those of a normal distribution. NaN without errors.
    """
    if not len(error):
        return math.nan
    limit = 2.0 * float(gammaincinv(1.5, nominal))  # quantile of chi square, three degrees
    return float((squared_distance(error, covariance) <= limit).mean()) / nominal


def brier_score(probability: F64, true: Bool) -> float:
    """Compute the mean square of probabilities (n,) less truth, or NaN.

    Source: G. W. Brier, Monthly Weather Review 78 (1950) 1.
    """
    return float(np.square(probability - true).mean()) if len(true) else math.nan
