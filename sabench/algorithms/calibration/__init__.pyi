from .alternating import (
    alternate as alternate,
)
from .alternating import (
    mean_rotation as mean_rotation,
)
from .alternating import (
    select_cameras as select_cameras,
)
from .factorisation import (
    adjust_factors as adjust_factors,
)
from .factorisation import (
    factorise as factorise,
)
from .factorisation import (
    upgrade_to_euclidean as upgrade_to_euclidean,
)
from .input_checks import check_fit as check_fit
from .joint_fit import fit_jointly as fit_jointly
from .known_points import (
    Projective as Projective,
)
from .known_points import (
    fit_planes as fit_planes,
)
from .known_points import (
    fit_projective as fit_projective,
)
from .known_points import (
    fit_soloff as fit_soloff,
)
from .known_points import (
    known_frames as known_frames,
)
from .known_points import (
    known_points as known_points,
)
from .known_points import (
    reason_if_edge_on as reason_if_edge_on,
)
from .known_points import (
    reason_if_flat as reason_if_flat,
)
from .parameters import FreeParameters as FreeParameters
from .parameters import State as State
from .plane_parallax import (
    align as align,
)
from .plane_parallax import (
    factorise_parallax as factorise_parallax,
)
from .plane_parallax import (
    fit_depth_scale as fit_depth_scale,
)
from .plane_parallax import (
    make_cameras as make_cameras,
)
from .plane_parallax import (
    misfit_px as misfit_px,
)
from .plane_parallax import (
    plane_homography as plane_homography,
)
from .problem import (
    CalibrationProblem as CalibrationProblem,
)
from .problem import (
    lens_unknowns as lens_unknowns,
)
from .problem import (
    make_anchors as make_anchors,
)
from .robust import adjust as adjust
from .self_calibration import (
    Tracking as Tracking,
)
from .self_calibration import (
    adjust_cameras as adjust_cameras,
)
from .self_calibration import (
    follow_disparities as follow_disparities,
)
from .self_calibration import (
    match_particles as match_particles,
)
from .wall_frame import check_plane_wall as check_plane_wall
from .wall_frame import fit_similarity as fit_similarity
