"""Bubbles: outlines, feature potentials and fits of backlit images."""

from sabench.algorithms.bubbles.backlit_images import Profile, transmission
from sabench.algorithms.bubbles.ellipse_detection import (
    find_edges,
    find_ellipses,
    radii_between,
    vote,
)
from sabench.algorithms.bubbles.feature_peaks import (
    PLANES,
    STEP,
    FeaturePeaks,
    drop_duplicates,
    find_depth,
)
from sabench.algorithms.bubbles.feature_potential import (
    WINDOW,
    attenuate,
    darkness,
    feature_potential,
    find_blots,
    find_outlines,
    merge_overlaps,
    minimum_images,
)
from sabench.algorithms.bubbles.phases import (
    SeparatedPhases,
    image_diameter_px,
    separate_phases,
)
from sabench.algorithms.bubbles.search import (
    Limits,
    find_hypotheses,
    join_hypotheses,
    px_per_mm,
    search_bubbles,
)
from sabench.geometry.turned_cameras import turn_camera, turn_grid, viewing_axes

__all__ = [
    "PLANES",
    "STEP",
    "WINDOW",
    "FeaturePeaks",
    "Limits",
    "Profile",
    "SeparatedPhases",
    "attenuate",
    "darkness",
    "drop_duplicates",
    "feature_potential",
    "find_blots",
    "find_depth",
    "find_edges",
    "find_ellipses",
    "find_hypotheses",
    "find_outlines",
    "image_diameter_px",
    "join_hypotheses",
    "merge_overlaps",
    "minimum_images",
    "px_per_mm",
    "radii_between",
    "search_bubbles",
    "separate_phases",
    "transmission",
    "turn_camera",
    "turn_grid",
    "viewing_axes",
    "vote",
]
