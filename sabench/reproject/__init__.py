"""From images to planes of the world: exact maps of planes onto images, and refocusing along them."""

from sabench.reproject.maps import TOLERANCE_PX, PlaneMap, plane_map, plane_maps
from sabench.reproject.refocus import refocus_by_shifts, refocus_log2, refocus_sum

__all__ = ["TOLERANCE_PX", "PlaneMap", "plane_map", "plane_maps", "refocus_by_shifts", "refocus_log2", "refocus_sum"]
