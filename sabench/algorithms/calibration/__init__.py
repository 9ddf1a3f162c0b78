"""Calibration of cameras.

Bundle adjustment through a wall, factorisation, camera models, self-calibration.
"""

from sabench.algorithms.calibration.alternating import alternate, mean_rotation, select_cameras
from sabench.algorithms.calibration.factorisation import (
    adjust_factors,
    factorise,
    upgrade_to_euclidean,
)
from sabench.algorithms.calibration.input_checks import check_fit
from sabench.algorithms.calibration.known_points import known_frames, known_points, reason_if_flat
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.algorithms.calibration.problem import CalibrationProblem, make_anchors
from sabench.algorithms.calibration.robust import adjust
from sabench.algorithms.calibration.self_calibration import (
    Tracking,
    adjust_cameras,
    follow_disparities,
    match_particles,
)
from sabench.algorithms.calibration.wall_frame import check_plane_wall, fit_similarity
from sabench.geometry.polynomial_cameras import fit_planes, fit_soloff
from sabench.geometry.projective_camera import Projective, fit_projective

__all__ = [
    "CalibrationProblem",
    "FreeParameters",
    "Projective",
    "State",
    "Tracking",
    "adjust",
    "adjust_cameras",
    "adjust_factors",
    "alternate",
    "check_fit",
    "check_plane_wall",
    "factorise",
    "fit_planes",
    "fit_projective",
    "fit_similarity",
    "fit_soloff",
    "follow_disparities",
    "known_frames",
    "known_points",
    "make_anchors",
    "match_particles",
    "mean_rotation",
    "reason_if_flat",
    "select_cameras",
    "upgrade_to_euclidean",
]
