"""Particles in three dimensions.

The package holds triangulation of image peaks, iterative reconstruction (IPR), and linking.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sabench.utils.lazy_names import lazy_names

if TYPE_CHECKING:
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

_HOMES = {
    "IprSettings": "ipr",
    "fit_cameras": "ipr",
    "link": "linking",
    "reconstruct_particles": "ipr",
    "triangulate_particles": "ipr",
}
__getattr__ = lazy_names(__name__, _HOMES)
