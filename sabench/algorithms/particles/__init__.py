"""Particles in three dimensions.

The package holds triangulation of image peaks, reconstruction of the most probable particles
(Bayesian IPR), tracking (Shake-The-Box), and linking.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sabench.utils.lazy_names import lazy_names

if TYPE_CHECKING:
    from sabench.algorithms.particles.bayesian_ipr import (
        BayesianIprSettings,
        reconstruct_most_probable,
    )
    from sabench.algorithms.particles.candidate_search import find_fault
    from sabench.algorithms.particles.defocusing import find_by_defocusing, find_unsuitable
    from sabench.algorithms.particles.linking import link
    from sabench.algorithms.particles.matching import (
        PeakParameters,
        TriangulationSettings,
        fit_cameras,
        triangulate_particles,
    )
    from sabench.algorithms.particles.shake_the_box import ShakeTheBoxSettings, track_particles

__all__ = [
    "BayesianIprSettings",
    "PeakParameters",
    "ShakeTheBoxSettings",
    "TriangulationSettings",
    "find_by_defocusing",
    "find_fault",
    "find_unsuitable",
    "fit_cameras",
    "link",
    "reconstruct_most_probable",
    "track_particles",
    "triangulate_particles",
]

_HOMES = {
    "BayesianIprSettings": "bayesian_ipr",
    "PeakParameters": "matching",
    "ShakeTheBoxSettings": "shake_the_box",
    "TriangulationSettings": "matching",
    "find_by_defocusing": "defocusing",
    "find_fault": "candidate_search",
    "find_unsuitable": "defocusing",
    "fit_cameras": "matching",
    "link": "linking",
    "reconstruct_most_probable": "bayesian_ipr",
    "track_particles": "shake_the_box",
    "triangulate_particles": "matching",
}
__getattr__ = lazy_names(__name__, _HOMES)
