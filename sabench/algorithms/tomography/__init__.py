"""Tomographic reconstruction by lines of sight: a sparse volume, its projections onto the images, and what updates it from their ratio."""
