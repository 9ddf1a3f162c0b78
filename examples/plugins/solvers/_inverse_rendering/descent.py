"""Particles whose rendered images fit best, by automatic derivatives.

The start is the most probable particles that a search finds (`bayesian_ipr`). A descent moves all
of them and all of their lights until the cost of `images` is least. In its
coordinates each particle's own Gauss-Newton matrix is the unit matrix, so that only overlaps are
left for the quasi-Newton method to learn, and a slope of 1 is a standard deviation.

Source: D. C. Liu and J. Nocedal, On the limited memory BFGS method for large scale optimization,
Math. Programming 45, 503-528, 1989.
"""

from dataclasses import dataclass, field

import numpy as np
from sabench.plugins.solvers._inverse_rendering.images import DifferentiableImages, ImageModel

from sabench.algorithms.particles.bayesian_ipr import BayesianIprSettings, search_frame
from sabench.algorithms.particles.particle_search import ParticleSearch, no_particles
from sabench.api import FoundParticles, Observation
from sabench.geometry.camera import Camera
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64

_PAIRS = 20  # of steps and slopes that the quasi-Newton method keeps
_LEAST_FALL = 1e-13  # of the cost in a step, relative: less is rounding
_FARTHEST_PX = 0.5  # that a particle moves before windows are laid out again


@dataclass(frozen=True)
class InverseRenderingSettings:
    """Settings of the descent.

    Attributes
    ----------
    steps : the most of a descent, before windows are laid out again.
    descents : the most; the last one that moves no particle out of its window's middle is the end.
    slope : largest derivative of the cost that is as good as 0, where a step of 1 is a standard
        deviation of a particle's position or light.
    start : settings of the search for the first particles.
    """

    steps: int = 200
    descents: int = 5
    slope: float = 0.01
    start: BayesianIprSettings = field(default_factory=BayesianIprSettings)


def reconstruct_by_descent(
    case: Observation, maps: VolumePolynomials, settings: InverseRenderingSettings
) -> FoundParticles:
    """Reconstruct the particles of a frame whose rendered images fit best."""
    search = search_frame(case, maps, settings.start)
    if search is None or not len(search.position):
        return no_particles(len(case.cameras))
    descend(search, image_model(search, case, maps), settings)
    return search.found()


def image_model(search: ParticleSearch, case: Observation, maps: VolumePolynomials) -> ImageModel:
    """Make the model of images, with what a search has learned, and exact cameras.

    Parameters
    ----------
    maps : of all cameras, as they were before the search shifted their pixels.
    """
    shown = np.flatnonzero(search.shown)
    return ImageModel(
        [camera for n in shown if isinstance(camera := case.cameras[n], Camera)],
        search.maps.coefficients[:, 0] - maps.coefficients[shown, 0],
        search.images,
        (search.known & ~search.saturated).astype(np.float32) / search.variance,
        search.shapes,
        search.typical,
        np.asarray(np.linalg.inv(search.covariance), dtype=np.float64),
        maps.middle_mm,
        maps.half_mm,
    )


def descend(
    search: ParticleSearch, model: ImageModel, settings: InverseRenderingSettings
) -> list[float]:
    """Move a search's particles to the least cost.

    Returns the costs before the first descent and after each.
    """
    images = DifferentiableImages(model)
    position = search.position * model.half_mm + model.middle_mm
    logs = np.log(search.light / model.typical)
    costs: list[float] = []
    for _ in range(settings.descents):
        images.lay_out(position)
        before, after, step = _descend_once(images, position, logs, settings)
        costs += [after] if costs else [before, after]
        position, logs = position + step[:, :3], logs + step[:, 3:]
        if images.farthest_px(position) < _FARTHEST_PX:
            break
    search.position[:] = np.clip((position - model.middle_mm) / model.half_mm, -1.0, 1.0)
    search.light[:] = model.typical * np.exp(logs)
    search.subtract_all()
    return costs


def _descend_once(
    images: DifferentiableImages, position: F64, logs: F64, settings: InverseRenderingSettings
) -> tuple[float, float, F64]:
    """Find the step (n, 3 + camera) to the least cost, where windows stay.

    Returns the costs before and after it, too.
    """
    from scipy.optimize import minimize  # takes long to load

    factors = np.linalg.cholesky(images.curvatures(position, logs))
    inverse = np.linalg.inv(factors)

    def step_of(whitened: F64) -> F64:
        own = whitened.reshape(inverse.shape[:2])
        return np.asarray(np.einsum("nij,ni->nj", inverse, own))

    def cost(whitened: F64) -> tuple[float, F64]:
        step = step_of(whitened)
        value, by_place, by_log = images.cost_and_slopes(position + step[:, :3], logs + step[:, 3:])
        slopes = np.concatenate([by_place, by_log], axis=1)
        return value, np.einsum("nij,nj->ni", inverse, slopes).ravel()

    start = np.zeros(inverse.shape[:2]).ravel()
    first = cost(start)[0]
    found = minimize(
        cost,
        start,
        jac=True,
        method="L-BFGS-B",
        options={
            "maxcor": _PAIRS,
            "maxiter": settings.steps,
            "gtol": settings.slope,
            "ftol": _LEAST_FALL,
        },
    )
    return first, float(found.fun), step_of(found.x)
