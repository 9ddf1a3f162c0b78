"""Images of known particles by an independent model, for tests of fits to them."""

import math

import numpy as np
from scipy.special import erf

from sabench.algorithms.particles.image_model import (
    ImageModel,
    ModelParticles,
    Room,
    make_room,
    with_margins,
)
from sabench.algorithms.particles.joint_fit import even_covariance, fit_particles
from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.utils.arrays import F64

SIGMA, TYPICAL, NOISE = (0.6, 0.75), 100.0, 1.0


def profile(center: F64, sigma: float, count: int) -> F64:
    edges = (np.arange(count + 1) - 0.5 - center[:, None]) / (sigma * math.sqrt(2.0))
    return np.asarray(0.5 * np.diff(erf(edges), axis=1))


def paint(maps: VolumePolynomials, points: F64, light: F64, rows: int, columns: int) -> F64:
    out = []
    for camera in range(len(maps.coefficients)):
        pixels = project_points(maps, camera, points)
        x, y = profile(pixels[:, 0], SIGMA[0], columns), profile(pixels[:, 1], SIGMA[1], rows)
        out.append(np.einsum("n,nr,nc->rc", light[:, camera], y, x))
    return np.array(out)


def model_of(maps: VolumePolynomials, images: F64, between: float = 0.1) -> ImageModel:
    cameras = len(images)
    precision: F64 = np.linalg.inv(even_covariance(cameras, between, 0.5)).astype(np.float64)
    return ImageModel(
        maps,
        np.tile(np.array([[one, *[0.0] * 4] for one in (*SIGMA, 0.0, 0.0)]), (cameras, 1, 1)),
        np.full(cameras, TYPICAL),
        precision,
        float(np.linalg.slogdet(precision)[1]),
        with_margins(images.astype(np.float32)),
        with_margins(np.full(images.shape, 1.0 / NOISE**2, dtype=np.float32)),
        with_margins(images.astype(np.float32)),
        math.log(30.0 / 8.0),
    )


def particles_of(points: F64, light: F64) -> ModelParticles:
    return ModelParticles(points.copy(), light.copy(), np.ones(len(points), dtype=np.bool_))


def room_of(maps: VolumePolynomials) -> Room:
    return make_room(np.tile(np.array(SIGMA), (len(maps.coefficients), 1)))


def refine_all(model: ImageModel, room: Room, particles: ModelParticles, rounds: int) -> float:
    rows = np.arange(len(particles.position))
    return float(sum(fit_particles(model, room, particles, rows) for _ in range(rounds)))
