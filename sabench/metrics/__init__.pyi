from .bubble_detection import (
    counts_per_frame as counts_per_frame,
    detection_scores as detection_scores,
    sauter_mm as sauter_mm,
    size_scores as size_scores,
)
from .calibration_error import (
    calibration_scores as calibration_scores,
    fit_alignment as fit_alignment,
    held_out_scores as held_out_scores,
    point_scores as point_scores,
    self_calibration_scores as self_calibration_scores,
    spacing_error as spacing_error,
    wall_scores as wall_scores,
)
from .code_reading import (
    read_volume as read_volume,
    reading as reading,
    single_views as single_views,
)
from .particle_detection import (
    count_challenge as count_challenge,
    count_thesis as count_thesis,
    detect as detect,
    detect_peaks as detect_peaks,
)
from .plunging_jet import analyse as analyse
from .quality_factor import quality as quality
from .reconstruction_error import (
    brightness as brightness,
    score_frame as score_frame,
    true_field as true_field,
)
from .trajectories import (
    link_scores as link_scores,
    trajectory_scores as trajectory_scores,
)
from .velocity_error import (
    precision_interval as precision_interval,
    response as response,
    velocity_scores as velocity_scores,
)
