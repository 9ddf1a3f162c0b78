from .bayesian_ipr import (
    BayesianIprSettings as BayesianIprSettings,
)
from .bayesian_ipr import (
    reconstruct_most_probable as reconstruct_most_probable,
)
from .common_view import find_fault as find_fault
from .defocusing import find_by_defocusing as find_by_defocusing
from .defocusing import find_unsuitable as find_unsuitable
from .inverse_rendering import (
    InverseRenderingSettings as InverseRenderingSettings,
)
from .inverse_rendering import (
    reconstruct_by_descent as reconstruct_by_descent,
)
from .linking import link as link
from .peak_detection import PeakParameters as PeakParameters
from .ray_triangulation import (
    TriangulationSettings as TriangulationSettings,
)
from .ray_triangulation import (
    fit_cameras as fit_cameras,
)
from .ray_triangulation import (
    triangulate_particles as triangulate_particles,
)
from .shake_the_box import (
    ShakeTheBoxSettings as ShakeTheBoxSettings,
)
from .shake_the_box import (
    track_particles as track_particles,
)
