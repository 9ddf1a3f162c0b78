"""Particles in three dimensions.

The package holds triangulation of image peaks, iterative reconstruction (IPR), reconstruction of
the most probable particles (Bayesian IPR), inverse rendering, tracking (Shake-The-Box), and
linking.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sabench.utils.lazy_names import lazy_names

if TYPE_CHECKING:
    from sabench.algorithms.particles.bayesian_ipr import (
        BayesianIprSettings,
        reconstruct_most_probable,
    )
    from sabench.algorithms.particles.inverse_rendering import (
        InverseRenderingSettings,
        reconstruct_by_descent,
    )
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
    "InverseRenderingSettings",
    "IprSettings",
    "ShakeTheBoxSettings",
    "fit_cameras",
    "link",
    "reconstruct_by_descent",
    "reconstruct_most_probable",
    "reconstruct_particles",
    "track_particles",
    "triangulate_particles",
]

_HOMES = {
    "BayesianIprSettings": "bayesian_ipr",
    "InverseRenderingSettings": "inverse_rendering",
    "IprSettings": "ipr",
    "ShakeTheBoxSettings": "shake_the_box",
    "fit_cameras": "ipr",
    "link": "linking",
    "reconstruct_by_descent": "inverse_rendering",
    "reconstruct_most_probable": "bayesian_ipr",
    "reconstruct_particles": "ipr",
    "track_particles": "shake_the_box",
    "triangulate_particles": "ipr",
}
__getattr__ = lazy_names(__name__, _HOMES)
