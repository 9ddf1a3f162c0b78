"""Cameras, refraction, frames of reference and voxel grids."""
