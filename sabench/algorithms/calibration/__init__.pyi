from .alternating import (
    alternate as alternate,
    mean_rotation as mean_rotation,
    select_cameras as select_cameras,
)
from .factorisation import (
    adjust_factors as adjust_factors,
    factorise as factorise,
    upgrade_to_euclidean as upgrade_to_euclidean,
)
from .input_checks import check_fit as check_fit
from .joint_fit import fit_jointly as fit_jointly
from .known_points import (
    Projective as Projective,
    fit_planes as fit_planes,
    fit_projective as fit_projective,
    fit_soloff as fit_soloff,
    known_frames as known_frames,
    known_points as known_points,
    reason_if_edge_on as reason_if_edge_on,
    reason_if_flat as reason_if_flat,
)
from .parameters import FreeParameters as FreeParameters, State as State
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
    lens_unknowns as lens_unknowns,
    make_anchors as make_anchors,
)
from .robust import adjust as adjust
from .self_calibration import (
    Tracking as Tracking,
    adjust_cameras as adjust_cameras,
    follow_disparities as follow_disparities,
    match_particles as match_particles,
)
from .wall_frame import check_plane_wall as check_plane_wall, fit_similarity as fit_similarity
