"""Calibration of cameras.

Bundle adjustment through a wall, factorisation, camera models, self-calibration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

# at once, because a function has the module's name
from sabench.algorithms.calibration.known_points import (
    known_frames,
    known_points,
    reason_if_edge_on,
    reason_if_flat,
)
from sabench.utils.lazy_names import lazy_names

if TYPE_CHECKING:
    from sabench.algorithms.calibration.alternating import alternate, mean_rotation, select_cameras
    from sabench.algorithms.calibration.factorisation import (
        adjust_factors,
        factorise,
        upgrade_to_euclidean,
    )
    from sabench.algorithms.calibration.input_checks import check_fit
    from sabench.algorithms.calibration.joint_fit import fit_jointly
    from sabench.algorithms.calibration.parameters import FreeParameters, State
    from sabench.algorithms.calibration.plane_parallax import (
        align,
        factorise_parallax,
        fit_depth_scale,
        make_cameras,
        misfit_px,
        plane_homography,
    )
    from sabench.algorithms.calibration.problem import (
        CalibrationProblem,
        lens_unknowns,
        make_anchors,
    )
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
    "align",
    "alternate",
    "check_fit",
    "check_plane_wall",
    "factorise",
    "factorise_parallax",
    "fit_depth_scale",
    "fit_jointly",
    "fit_planes",
    "fit_projective",
    "fit_similarity",
    "fit_soloff",
    "follow_disparities",
    "known_frames",
    "known_points",
    "lens_unknowns",
    "make_anchors",
    "make_cameras",
    "match_particles",
    "mean_rotation",
    "misfit_px",
    "plane_homography",
    "reason_if_edge_on",
    "reason_if_flat",
    "select_cameras",
    "upgrade_to_euclidean",
]

_HOMES = {
    "CalibrationProblem": "problem",
    "FreeParameters": "parameters",
    "Projective": "sabench.geometry.projective_camera",
    "State": "parameters",
    "Tracking": "self_calibration",
    "adjust": "robust",
    "adjust_cameras": "self_calibration",
    "adjust_factors": "factorisation",
    "align": "plane_parallax",
    "alternate": "alternating",
    "check_fit": "input_checks",
    "check_plane_wall": "wall_frame",
    "factorise": "factorisation",
    "factorise_parallax": "plane_parallax",
    "fit_depth_scale": "plane_parallax",
    "fit_jointly": "joint_fit",
    "fit_planes": "sabench.geometry.polynomial_cameras",
    "fit_projective": "sabench.geometry.projective_camera",
    "fit_similarity": "wall_frame",
    "fit_soloff": "sabench.geometry.polynomial_cameras",
    "follow_disparities": "self_calibration",
    "lens_unknowns": "problem",
    "make_anchors": "problem",
    "make_cameras": "plane_parallax",
    "match_particles": "self_calibration",
    "mean_rotation": "alternating",
    "misfit_px": "plane_parallax",
    "plane_homography": "plane_parallax",
    "select_cameras": "alternating",
    "upgrade_to_euclidean": "factorisation",
}
__getattr__ = lazy_names(__name__, _HOMES)
