from .bayesian_ipr import (
    BayesianIprSettings as BayesianIprSettings,
    reconstruct_most_probable as reconstruct_most_probable,
)
from .candidate_search import find_fault as find_fault
from .defocusing import find_by_defocusing as find_by_defocusing, find_unsuitable as find_unsuitable
from .linking import link as link
from .matching import (
    PeakParameters as PeakParameters,
    TriangulationSettings as TriangulationSettings,
    fit_cameras as fit_cameras,
    triangulate_particles as triangulate_particles,
)
from .shake_the_box import (
    ShakeTheBoxSettings as ShakeTheBoxSettings,
    track_particles as track_particles,
)
