"""Figures of the calibration: how far nominal cameras are off in the images."""

from __future__ import annotations

import numpy as np

from sabench.evaluation.planning.quantities import Quantity, Section
from sabench.evaluation.planning.viewing import Viewing
from sabench.geometry.common_view import lattice_of
from sabench.scenes import Scene
from sabench.scenes.nominal_cameras import nominal_cameras


def calibration_error_px(scene: Scene, view: Viewing) -> float:
    """Compute the RMS distance in the images between nominal and true cameras.

    Over a lattice of the volume and over all cameras, for seed 0.
    """
    points = lattice_of(view.rig.grid, 5)
    apart = [
        nominal.project(points)[0] - true.project(points)[0]
        for nominal, true in zip(
            nominal_cameras(scene, view.rig.cameras, 0), view.rig.cameras, strict=True
        )
    ]
    return float(np.sqrt(np.nanmean(np.sum(np.square(apart), axis=2))))


def plan_calibration(scene: Scene, view: Viewing) -> Section:
    """Compute the calibration error that the scene has."""
    error = calibration_error_px(scene, view)
    given = Quantity("calibration_px", error, "RMS error of nominal cameras", "calibration")
    return Section("calibration", (given,))
