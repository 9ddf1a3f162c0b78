"""Metrics: functions of an estimate and the truth, usable without a data set.

A name is imported from its module when it is first used, so that `import sabench.metrics` needs no
heavy library.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sabench.utils.lazy_names import lazy_names

if TYPE_CHECKING:
    from sabench.metrics.alignment import fit_alignment
    from sabench.metrics.bubble_detection import detection_scores
    from sabench.metrics.calibration_error import (
        calibration_scores,
        held_out_scores,
        point_scores,
        self_calibration_scores,
        spacing_error,
        wall_scores,
    )
    from sabench.metrics.code_reading import read_volume, reading, single_views
    from sabench.metrics.particle_detection import (
        count_challenge,
        count_thesis,
        detect,
        detect_peaks,
    )
    from sabench.metrics.plunging_jet import analyse
    from sabench.metrics.quality_factor import quality
    from sabench.metrics.reconstruction_error import score_frame
    from sabench.metrics.size_distributions import counts_per_frame, sauter_mm, size_scores
    from sabench.metrics.synthesised_field import brightness, true_field
    from sabench.metrics.trajectories import link_scores, trajectory_scores, vector_scores
    from sabench.metrics.velocity_error import precision_interval, response, velocity_scores
    from sabench.metrics.vortex_rings import circulation

__all__ = [
    "analyse",
    "brightness",
    "calibration_scores",
    "circulation",
    "count_challenge",
    "count_thesis",
    "counts_per_frame",
    "detect",
    "detect_peaks",
    "detection_scores",
    "fit_alignment",
    "held_out_scores",
    "link_scores",
    "point_scores",
    "precision_interval",
    "quality",
    "read_volume",
    "reading",
    "response",
    "sauter_mm",
    "score_frame",
    "self_calibration_scores",
    "single_views",
    "size_scores",
    "spacing_error",
    "trajectory_scores",
    "true_field",
    "vector_scores",
    "velocity_scores",
    "wall_scores",
]

_HOMES = {
    "analyse": "plunging_jet",
    "brightness": "synthesised_field",
    "calibration_scores": "calibration_error",
    "circulation": "vortex_rings",
    "count_challenge": "particle_detection",
    "count_thesis": "particle_detection",
    "counts_per_frame": "size_distributions",
    "detect": "particle_detection",
    "detect_peaks": "particle_detection",
    "detection_scores": "bubble_detection",
    "fit_alignment": "alignment",
    "held_out_scores": "calibration_error",
    "link_scores": "trajectories",
    "point_scores": "calibration_error",
    "precision_interval": "velocity_error",
    "quality": "quality_factor",
    "read_volume": "code_reading",
    "reading": "code_reading",
    "response": "velocity_error",
    "sauter_mm": "size_distributions",
    "score_frame": "reconstruction_error",
    "self_calibration_scores": "calibration_error",
    "single_views": "code_reading",
    "size_scores": "size_distributions",
    "spacing_error": "calibration_error",
    "trajectory_scores": "trajectories",
    "vector_scores": "trajectories",
    "true_field": "synthesised_field",
    "velocity_scores": "velocity_error",
    "wall_scores": "calibration_error",
}


def __dir__() -> list[str]:
    """List the public functions, for tab completion."""
    return list(__all__)


__getattr__ = lazy_names(__name__, _HOMES)
