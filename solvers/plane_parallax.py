"""Plane and parallax for cameras on one plane, without known optics."""

import warnings

import numpy as np

from sabench.algorithms.calibration import (
    align,
    factorise_parallax,
    fit_depth_scale,
    make_cameras,
    misfit_px,
    plane_homography,
    reason_if_flat,
)
from sabench.api import F64, Calibration, CalibrationCase, CalibrationSolver, Camera, CameraModel

_LEVEL = 0.02  # largest range of Z in the reference frame, as a part of its width
_SMALL_PX = 0.02  # largest misfit without a warning


class PlaneParallax(CalibrationSolver):
    """Homographies of one plane, and cameras' places by the parallax of others.

    For cameras on one plane, without refraction and distortion. Nothing of the nominal cameras is
    used. The reference plane is a frame of the target at one Z, parallel to the cameras' plane. The
    places are found up to a factor by a factorisation of rank one; the factor, the distance and the
    depth scale follow from the target's nominal positions at other depths, taken as exact.
    """

    name = "plane_parallax"
    needs_places = True
    references = (
        "Vaish et al., Using plane + parallax for calibrating dense camera arrays, CVPR 2004",
        "J. Belden, PhD thesis, MIT 2011, section 2.2.3",
    )

    def skip(self, case: CalibrationCase) -> str | None:
        """Skip a single camera, positions in one plane, and no frame of one Z."""
        if len(case.cameras) < 2:
            return "it needs two cameras"
        if reason := reason_if_flat(case):
            return reason
        best = case.initial_mm[_reference(case)]
        spread = np.nanmax(best, axis=0) - np.nanmin(best, axis=0)
        if spread[2] <= _LEVEL * spread[0]:
            return None
        return f"expected a frame of one Z, got a range of {spread[2]:.3g} mm in the most level one"

    def solve(self, case: CalibrationCase) -> Calibration:
        """Align all images on the reference plane, factorise, and scale the depths."""
        reference, count = _reference(case), len(case.cameras)
        places = case.initial_mm.reshape(-1, 3)
        plane_z = float(np.nanmean(case.initial_mm[reference, :, 2]))
        homographies = np.stack(
            [
                _homography(camera, case.initial_mm[reference], pixels[reference])
                for camera, pixels in zip(case.cameras, case.pixels, strict=True)
            ]
        )
        aligned = np.stack(
            [
                align(homography, camera_pixels.reshape(-1, 2))
                for homography, camera_pixels in zip(homographies, case.pixels, strict=True)
            ]
        )
        detected = case.found.reshape(count, -1)
        used = (detected.sum(axis=0) >= 2) & np.isfinite(places).all(axis=1)
        factors = factorise_parallax(aligned[:, used], detected[:, used])
        scale = fit_depth_scale(factors, places[used] - [0.0, 0.0, plane_z])
        sizes = [(camera.name, camera.rows, camera.columns) for camera in case.cameras]
        cameras = make_cameras(sizes, homographies, factors, scale, plane_z)
        _warn_of_misfit(cameras, case)
        return Calibration(cameras)


def _reference(case: CalibrationCase) -> int:
    """Find the most level frame; of equal ones, the nearest to the middle depth."""
    z = case.initial_mm[..., 2]
    ranges = np.nanmax(z, axis=1) - np.nanmin(z, axis=1)
    width = float(np.nanmax(case.initial_mm[..., 0]) - np.nanmin(case.initial_mm[..., 0]))
    level = ranges <= max(float(ranges.min()), _LEVEL * width)
    off = np.abs(np.nanmean(z, axis=1) - np.nanmean(z))
    return int(np.where(level, off, np.inf).argmin())


def _homography(camera: Camera, places: F64, pixels: F64) -> F64:
    finite = np.isfinite(places).all(axis=1) & np.isfinite(pixels).all(axis=1)
    return plane_homography(camera.name, places[finite, :2], pixels[finite])


def _warn_of_misfit(cameras: tuple[CameraModel, ...], case: CalibrationCase) -> None:
    """Say in one sentence that the errors are not those of detection."""
    flat = case.initial_mm.reshape(-1, 3)
    errors = np.stack([camera.project(flat)[0] for camera in cameras]).reshape(case.pixels.shape)
    shared, noise = misfit_px(errors - case.pixels, case.target.points_mm)
    if shared > max(noise, _SMALL_PX):
        warnings.warn(
            f"plane_parallax: neighbouring points share errors of {shared:.3g} px, more than the "
            f"{noise:.3g} px of noise: it cannot model cameras off one plane parallel to the "
            "boards, refraction or distortion, or nominal positions are wrong",
            stacklevel=2,
        )
