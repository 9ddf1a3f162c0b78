from .alignment import fit_alignment as fit_alignment
from .bubble_detection import detection_scores as detection_scores
from .calibration_error import (
    calibration_scores as calibration_scores,
)
from .calibration_error import (
    held_out_scores as held_out_scores,
)
from .calibration_error import (
    point_scores as point_scores,
)
from .calibration_error import (
    self_calibration_scores as self_calibration_scores,
)
from .calibration_error import (
    spacing_error as spacing_error,
)
from .calibration_error import (
    wall_scores as wall_scores,
)
from .code_reading import (
    read_volume as read_volume,
)
from .code_reading import (
    reading as reading,
)
from .code_reading import (
    single_views as single_views,
)
from .particle_detection import (
    count_challenge as count_challenge,
)
from .particle_detection import (
    count_thesis as count_thesis,
)
from .particle_detection import (
    detect as detect,
)
from .particle_detection import (
    detect_peaks as detect_peaks,
)
from .plunging_jet import analyse as analyse
from .quality_factor import quality as quality
from .reconstruction_error import score_frame as score_frame
from .size_distributions import (
    counts_per_frame as counts_per_frame,
)
from .size_distributions import (
    sauter_mm as sauter_mm,
)
from .size_distributions import (
    size_scores as size_scores,
)
from .synthesised_field import brightness as brightness
from .synthesised_field import true_field as true_field
from .trajectories import (
    link_scores as link_scores,
)
from .trajectories import (
    trajectory_scores as trajectory_scores,
)
from .trajectories import (
    vector_scores as vector_scores,
)
from .velocity_error import (
    precision_interval as precision_interval,
)
from .velocity_error import (
    response as response,
)
from .velocity_error import (
    velocity_scores as velocity_scores,
)
from .vortex_rings import circulation as circulation
