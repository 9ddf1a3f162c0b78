"""From images to planes of the world: exact maps of planes onto images, and refocusing along them."""

from sabench.algorithms.refocus.synthetic_aperture import (
    refocus_by_shifts,
    refocus_log2,
    refocus_sum,
)
from sabench.geometry.plane_polynomials import TOLERANCE_PX, PlaneMap, plane_map, plane_maps

__all__ = [
    "TOLERANCE_PX",
    "PlaneMap",
    "plane_map",
    "plane_maps",
    "refocus_by_shifts",
    "refocus_log2",
    "refocus_sum",
]
