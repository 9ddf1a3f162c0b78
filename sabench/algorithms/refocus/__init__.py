"""Synthetic aperture refocusing.

Images of all cameras are summed or multiplied on planes of the world, or on other surfaces.
"""

from sabench.algorithms.refocus.edges import Edges, find_edges
from sabench.algorithms.refocus.surface import Join, SurfaceImage, find_edge_on, refocus_on_surface
from sabench.algorithms.refocus.synthetic_aperture import (
    count_views,
    refocus_by_shifts,
    refocus_log2,
    refocus_sum,
    typical_where_covered,
)
from sabench.algorithms.refocus.thresholding import (
    ExtractionParameters,
    auto_k,
    extract,
    extract_particles,
    occupancy,
)

__all__ = [
    "Edges",
    "ExtractionParameters",
    "Join",
    "SurfaceImage",
    "auto_k",
    "count_views",
    "extract",
    "extract_particles",
    "find_edge_on",
    "find_edges",
    "occupancy",
    "refocus_by_shifts",
    "refocus_log2",
    "refocus_on_surface",
    "refocus_sum",
    "typical_where_covered",
]
