from .factorisation import (
    adjust_factors as adjust_factors,
    factorise as factorise,
    upgrade_to_euclidean as upgrade_to_euclidean,
)
from .joint_fit import (
    adjust as adjust,
    alternate as alternate,
    fit_jointly as fit_jointly,
    mean_rotation as mean_rotation,
    select_cameras as select_cameras,
)
from .parameters import (
    FreeParameters as FreeParameters,
    State as State,
    check_plane_wall as check_plane_wall,
    fit_similarity as fit_similarity,
)
from .plane_parallax import (
    align as align,
    factorise_parallax as factorise_parallax,
    fit_depth_scale as fit_depth_scale,
    make_cameras as make_cameras,
    misfit_px as misfit_px,
    plane_homography as plane_homography,
)
from .problem import (
    CalibrationProblem as CalibrationProblem,
    check_fit as check_fit,
    lens_unknowns as lens_unknowns,
    make_anchors as make_anchors,
)
from .resection import (
    Projective as Projective,
    fit_planes as fit_planes,
    fit_projective as fit_projective,
    fit_soloff as fit_soloff,
    known_frames as known_frames,
    known_points as known_points,
    reason_if_edge_on as reason_if_edge_on,
    reason_if_flat as reason_if_flat,
)
from .self_calibration import (
    Tracking as Tracking,
    adjust_cameras as adjust_cameras,
    follow_disparities as follow_disparities,
    match_particles as match_particles,
)
