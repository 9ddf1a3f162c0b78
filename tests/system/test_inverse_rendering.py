"""Descent of all particles to the least cost, on small noisy scenes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sabench.algorithms.particles import fit_cameras
from sabench.algorithms.particles.bayesian_ipr import BayesianIprSettings, search_frame
from sabench.algorithms.particles.differentiable_images import ImageModel
from sabench.algorithms.particles.inverse_rendering import (
    InverseRenderingSettings,
    descend,
    image_model,
)
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.api import Camera, CameraModel, ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.projective_camera import fit_projective
from sabench.geometry.refraction import Layer
from sabench.geometry.volume_polynomials import points_in_mm
from sabench.utils.arrays import F64
from tests.system.test_bayesian_ipr import make_shot

PIXEL_MM = 0.05
SETTINGS = InverseRenderingSettings()
Searched = tuple[ParticleSearch, ImageModel, F64]


@pytest.fixture
def searched() -> Searched:
    """What `bayesian_ipr` finds, its model of images, and the true positions."""
    shot = make_shot(21, particles={"per_pixel": 0.03})
    maps = fit_cameras(shot.observation)
    search = search_frame(shot.observation, maps, BayesianIprSettings())
    assert search is not None
    model = image_model(search, shot.observation, maps)
    return search, model, shot.particles.position_mm


def rms_px(search: ParticleSearch, true: F64) -> tuple[float, float]:
    """Share of the particles next to a true one, and their distance."""
    apart = points_in_mm(search.maps, search.position)[:, None] - true
    nearest = np.linalg.norm(apart, axis=2).min(axis=1) / PIXEL_MM
    near = nearest < 1.0
    return float(near.mean()), float(np.sqrt(np.mean(nearest[near] ** 2)))


def perturb(search: ParticleSearch) -> None:
    """Move particles by 0.3 px along every axis, and change their light by 20 %."""
    rng = np.random.default_rng(5)
    step_mm = 0.3 * PIXEL_MM * rng.standard_normal(search.position.shape)
    search.position[:] = np.clip(search.position + step_mm / search.maps.half_mm, -1.0, 1.0)
    search.light *= np.exp(0.2 * rng.standard_normal(search.light.shape))


def cost_of(search: ParticleSearch, model: ImageModel) -> float:
    """Minus the logarithm of the probability of images and lights, from what is left."""
    logs = np.log(search.light / model.typical)
    prior = np.einsum("ni,ij,nj->", logs, model.precision, logs)
    return 0.5 * float(np.sum(model.weight * np.square(search.left, dtype=np.float64)) + prior)


def test_a_descent_from_a_start_that_is_off_is_as_good_as_bayesian_ipr(
    searched: Searched,
) -> None:
    search, model, true = searched
    share, rms = rms_px(search, true)
    cost = cost_of(search, model)
    perturb(search)
    assert rms_px(search, true)[1] > 4.0 * rms
    costs = descend(search, model, SETTINGS)
    found = rms_px(search, true)
    assert len(search.position) > 90
    assert share > 0.98
    assert found[0] >= share
    assert found[1] < 1.02 * rms
    assert costs[0] > 5.0 * cost
    assert costs[-1] <= cost
    assert cost_of(search, model) == pytest.approx(costs[-1], abs=0.05)  # maps are not exact


def test_both_starts_end_in_one_place(searched: Searched) -> None:
    search, model, _ = searched
    descend(search, model, replace(SETTINGS, slope=1e-3))
    position, light = search.position.copy(), search.light.copy()
    perturb(search)
    descend(search, model, replace(SETTINGS, slope=1e-3))
    apart = np.abs(search.position - position) * search.maps.half_mm / PIXEL_MM
    assert np.median(apart.max(axis=1)) < 1e-4
    assert np.mean(apart.max(axis=1) > 0.01) < 0.03
    assert np.median(np.abs(np.log(search.light / light))) < 1e-5


def reason(case: Observation, first: CameraModel | None, cameras: int) -> str | None:
    """Say why the solver skips a case of so many cameras with another first one."""
    own = (first or case.cameras[0], *case.cameras[1:cameras])
    other = replace(case, cameras=own, images=case.images[:cameras])
    solver: Any = make_algorithm("inverse_rendering", {})
    skipped: str | None = solver.skip(ImageSequence.of([other]))
    return skipped


def test_cameras_that_cannot_be_rendered_are_skipped() -> None:
    case = make_shot(22, particles={"per_pixel": 0.001}).observation
    first = case.cameras[0]
    assert isinstance(first, Camera)
    glass = Layer("glass", 1.52, 5.0)
    cylinder = CylinderWall((0.0, 0.0, 60.0), (0.0, 1.0, 0.0), 60.0, 1.0, (glass,), 1.33)
    points = np.random.default_rng(1).uniform([-2.0, -2.0, 18.0], [2.0, 2.0, 22.0], (20, 3))
    pixels = first.project(points)[0]
    linear = fit_projective("flat", first.rows, first.columns, points, pixels)
    curved = f"{first.name} looks through a wall that is not plane"
    assert reason(case, replace(first, wall=cylinder), 4) == curved
    assert reason(case, linear, 4) == "flat is no pinhole"
    assert reason(case, None, 2) == "it needs three cameras"
    assert reason(case, None, 4) is None
