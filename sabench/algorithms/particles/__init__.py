"""Particles in three dimensions.

The package holds triangulation of image peaks, iterative reconstruction (IPR), and linking.
"""

from sabench.algorithms.particles.ipr import (
    IprSettings,
    fit_cameras,
    reconstruct_particles,
    triangulate_particles,
)
from sabench.algorithms.particles.linking import link

__all__ = [
    "IprSettings",
    "fit_cameras",
    "link",
    "reconstruct_particles",
    "triangulate_particles",
]
