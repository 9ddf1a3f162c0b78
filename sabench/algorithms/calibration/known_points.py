"""Nominal positions of a target's points, taken as known.

Classical calibrations fit each camera to them.
"""

from __future__ import annotations

import numpy as np

from sabench.api import CalibrationCase
from sabench.geometry.polynomial_cameras import fit_planes as fit_planes, fit_soloff as fit_soloff
from sabench.geometry.projective_camera import (
    Projective as Projective,
    fit_projective as fit_projective,
)
from sabench.utils.arrays import F64

_FLAT = 1e-6  # thickness over width of places in one plane
_FLATTEST_DEGREES = 15.0  # between a line of sight and planes of constant Z


def known_points(case: CalibrationCase, camera: int) -> tuple[F64, F64]:
    """Return positions (n, 3) and pixels (n, 2) of all points that a camera found."""
    points, pixels = known_frames(case, camera)
    return np.vstack(points), np.vstack(pixels)


def known_frames(case: CalibrationCase, camera: int) -> tuple[list[F64], list[F64]]:
    """Split known points and pixels by frame.

    Frames of which the camera found nothing are left out.
    """
    points, pixels = [], []
    for initial, found in zip(case.initial_mm, case.pixels[camera], strict=True):
        there = np.isfinite(initial).all(axis=1) & np.isfinite(found).all(axis=1)
        if there.any():
            points.append(initial[there])
            pixels.append(found[there])
    return points, pixels


def reason_if_flat(case: CalibrationCase) -> str | None:
    """Explain why a case is refused whose nominal positions lie in one plane.

    Returns None if they do not.
    """
    nominal = case.initial_mm[np.isfinite(case.initial_mm).all(axis=-1)]
    spread = np.linalg.svd(nominal - nominal.mean(axis=0), compute_uv=False)
    return (
        "expected nominal positions at different depths, got all of them in one plane"
        if spread[2] <= _FLAT * spread[0]
        else None
    )


def reason_if_edge_on(case: CalibrationCase) -> str | None:
    """Say which camera sees planes of constant Z edge-on; None if none does."""
    for camera in case.cameras:
        angle = float(np.rad2deg(np.arcsin(min(abs(camera.rotation[2][2]), 1.0))))
        if angle < _FLATTEST_DEGREES:
            return (
                f"its polynomial is quadratic along Z, and {camera.name} looks {angle:.0f} degrees "
                f"from planes of constant Z (at least {_FLATTEST_DEGREES:.0f}): turn the world so "
                "that Z is the viewing direction"
            )
    return None
