"""Particles in three dimensions.

The package holds triangulation of image peaks, iterative reconstruction (IPR), reconstruction of
the most probable particles (Bayesian IPR), tracking (Shake-The-Box), and linking.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sabench.utils.lazy_names import lazy_names

if TYPE_CHECKING:
    from sabench.algorithms.particles.bayesian_ipr import (
        BayesianIprSettings,
        reconstruct_most_probable,
    )
    from sabench.algorithms.particles.common_view import find_fault
    from sabench.algorithms.particles.ipr import (
        IprSettings,
        fit_cameras,
        reconstruct_particles,
        triangulate_particles,
    )
    from sabench.algorithms.particles.linking import link
    from sabench.algorithms.particles.shake_the_box import ShakeTheBoxSettings, track_particles

__all__ = [
    "BayesianIprSettings",
    "IprSettings",
    "ShakeTheBoxSettings",
    "find_fault",
    "fit_cameras",
    "link",
    "reconstruct_most_probable",
    "reconstruct_particles",
    "track_particles",
    "triangulate_particles",
]

_HOMES = {
    "BayesianIprSettings": "bayesian_ipr",
    "IprSettings": "ipr",
    "ShakeTheBoxSettings": "shake_the_box",
    "find_fault": "common_view",
    "fit_cameras": "ipr",
    "link": "linking",
    "reconstruct_most_probable": "bayesian_ipr",
    "reconstruct_particles": "ipr",
    "track_particles": "shake_the_box",
    "triangulate_particles": "ipr",
}
__getattr__ = lazy_names(__name__, _HOMES)
