"""Auto-calibration of pinholes by factorisation."""

from dataclasses import replace

import numpy as np

from sabench.algorithms.calibration import (
    Projective,
    adjust_factors,
    factorise,
    fit_similarity,
    upgrade_to_euclidean,
)
from sabench.api import (
    F64,
    Calibration,
    CalibrationCase,
    CalibrationSolver,
    Camera,
    Distortion,
    InputError,
)


class LinearAutocal(CalibrationSolver):
    """Factorisation and Euclidean upgrade for pinholes in a single medium.

    The nominal principal points are kept; the cameras are otherwise unknown. A similarity brings
    the result to the world. Its scale, position and direction come from the target's nominal
    positions, which are used for nothing else.
    """

    name = "linear_autocal"
    references = (
        "T. Svoboda, D. Martinec and T. Pajdla, Presence 14, 2005",
        "J. Belden, PhD thesis, MIT 2011, figures 4-20 and 4-21",
    )

    def solve(self, case: CalibrationCase) -> Calibration:
        """Reconstruct the points that two cameras found, then all the cameras."""
        valid = case.found.reshape(len(case.cameras), -1)
        chosen = (valid.sum(axis=0) >= 2) & np.isfinite(case.initial_mm.reshape(-1, 3)).all(axis=1)
        if len(case.cameras) < 3:
            raise InputError(f"expected 3 cameras or more, got {len(case.cameras)}")
        scales = np.array(
            [_scale(replace(camera, distortion=Distortion()).upright()) for camera in case.cameras]
        )
        images = (
            case.pixels.reshape(len(scales), -1, 2)[:, chosen] - scales[:, None, :2]
        ) / scales[:, None, 2:]
        factors = upgrade_to_euclidean(
            adjust_factors(factorise(images, valid[:, chosen]), images, valid[:, chosen])
        )
        points = factors.points[:, :3] / factors.points[:, 3:]
        world = fit_similarity(points, case.initial_mm.reshape(-1, 3)[chosen])
        matrices = factors.matrices @ np.linalg.inv(world)
        cameras = [
            Projective(
                camera.name,
                camera.rows,
                camera.columns,
                tuple(tuple(row) for row in (_image(scale) @ matrix).tolist()),
            )
            for camera, scale, matrix in zip(case.cameras, scales, matrices, strict=True)
        ]
        return Calibration(tuple(cameras))


def _scale(camera: Camera) -> tuple[float, float, float]:
    return *camera.principal_point_px, camera.focal_px


def _image(scale: F64) -> F64:
    """Make the matrix from scaled coordinates to pixels."""
    return np.array([[scale[2], 0.0, scale[0]], [0.0, scale[2], scale[1]], [0.0, 0.0, 1.0]])
