"""The example `inverse_rendering`: exact cameras, images and slopes, and the descent."""

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import hermite_e

from sabench import plugins
from sabench.algorithms.particles import fit_cameras
from sabench.algorithms.particles.bayesian_ipr import BayesianIprSettings, search_frame
from sabench.algorithms.particles.image_model import MOST_FLAT
from sabench.algorithms.particles.joint_fit import even_covariance
from sabench.api import Camera, CameraModel, ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.geometry.camera import aim, aimed_rotation
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.lens import Distortion
from sabench.geometry.projective_camera import fit_projective
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.volume_polynomials import points_in_mm
from sabench.utils.arrays import F64
from sabench.utils.backend import choose, drjit
from tests.conftest import ROOT
from tests.helpers.image_model import SIGMA, TYPICAL, profile
from tests.helpers.particle_box import CAMERAS, COLUMNS, HIGH, LOW, ROWS, unit_points
from tests.helpers.refusals import check_sentence
from tests.system.test_bayesian_ipr import make_shot

PIXEL_MM = 0.05


@pytest.fixture(autouse=True)
def _examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SABENCH_PLUGINS", str(ROOT / "examples/plugins"))
    plugins.load("solvers", "inverse_rendering")


def part(name: str) -> Any:
    return importlib.import_module(f"sabench.plugins.solvers._inverse_rendering.{name}")


MIDDLE, HALF = (LOW + HIGH) / 2.0, (HIGH - LOW) / 2.0
LENS = Distortion(k1=-0.4, k2=3.0, p1=0.004, p2=-0.003, k3=20.0)
GLASS, GAP = Layer("glass", 1.52, 5.0), Layer("gap", 1.1, 2.0)
TILTED = (0.6 / 7.0, -0.4 / 7.0, float(np.sqrt(49.0 - 0.52) / 7.0))
WALLS = {
    "air": None,
    "two tilted layers": Wall((1.0, 2.0, 3.0), TILTED, 1.0, (GLASS, GAP), 1.33),
    "rarer fluid": Wall((0.0, 0.0, 3.0), TILTED, 1.33, (GLASS,), 1.0),
}
COUNT = 40
SHIFTS = np.array([[0.2, -0.1], [0.0, 0.3], [-0.2, 0.1], [0.1, 0.0]])


def digits() -> float:
    """On a GPU, Dr.Jit differentiates quotients by reciprocals of seven digits."""
    return 2e-6 if choose().kind == "cuda" else 0.0


def arrays_of(points: F64) -> list[object]:
    float64 = drjit()[1].ad.Float64
    return [float64(np.ascontiguousarray(column)) for column in points.T]


def make_camera(wall: Wall | None, center: tuple[float, float, float]) -> Camera:
    rotation, middle = aimed_rotation(np.array([0.05, -0.1, 1.0])), (160.0, 118.0)
    plain = Camera("one", 240, 320, center, rotation, 88.0, 0.01, middle, LENS, 85.0, 16.0, wall)
    return aim(plain, (0.0, 0.0, 30.0))


@pytest.mark.parametrize("name", WALLS)
def test_projects_as_cameras_do(name: str) -> None:
    points = np.random.default_rng(4).uniform([-8.0, -6.0, 20.0], [8.0, 6.0, 40.0], (200, 3))
    one = replace(make_camera(WALLS[name], (-20.0, 40.0, -490.0)), tilt_deg=(8.0, -11.0))
    exact, valid = one.project(points)
    found = part("projection").DifferentiableCamera(one, (0.25, -0.5)).project(*arrays_of(points))
    assert valid.all()
    columns = np.column_stack([coordinate.numpy() for coordinate in found])
    np.testing.assert_allclose(columns - [0.25, -0.5], exact, rtol=0.0, atol=1e-9)


def shapes_of(change: float) -> F64:
    """Widths grow along x and away from the middle depth, and shrink along y.

    If so, images are tilted and flat, too.
    """
    rates = change * np.array([0.1, -0.2, 0.0, 0.1])
    shapes = np.tile([[one, *(one * rates)] for one in (*SIGMA, 0.0, 0.0)], (4, 1, 1))
    shapes[1:3, 2] = change * np.array([0.1, -0.02, 0.01, 0.03, 0.02])
    shapes[2:, 3] = change * np.array([0.04, 0.01, -0.02, 0.02, 0.01])
    return shapes


def make_model(images: F64, change: float = 0.0) -> Any:
    weight = np.random.default_rng(6).uniform(0.2, 1.0, images.shape)
    weight[:, 50:60, 60:90] = 0.0  # unknown
    return part("images").ImageModel(
        CAMERAS,
        SHIFTS,
        images.astype(np.float32),
        weight.astype(np.float32),
        shapes_of(change),
        np.full(4, TYPICAL),
        np.asarray(np.linalg.inv(even_covariance(4, 0.1, 0.5)), dtype=np.float64),
        MIDDLE,
        HALF,
    )


def particles(rng: np.random.Generator) -> tuple[F64, F64]:
    place = unit_points(COUNT) * [0.5, 1.1, 0.9]
    place[:4] = unit_points(4, 9) * [0.1, 0.1, 0.9] + [0.99, 0.0, 0.0]
    return MIDDLE + HALF * place, 0.3 * rng.standard_normal((COUNT, 4))


def _derivatives(center: F64, sigma: F64, count: int) -> list[F64]:
    """Profiles (n, pixel), and their first, second and fourth derivatives by the centre."""
    shares = np.array(
        [profile(np.array([at]), one, count)[0] for at, one in zip(center, sigma, strict=True)]
    )
    z = (np.arange(count + 1) - 0.5 - center[:, None]) / sigma[:, None]
    edges = [hermite_e.HermiteE.basis(n)(z) * np.exp(-0.5 * z**2) for n in (0, 1, 3)]
    scale = -1.0 / np.sqrt(2.0 * np.pi)
    return [
        shares,
        *(
            scale * np.diff(edge, axis=1) / sigma[:, None] ** n
            for edge, n in zip(edges, (1, 2, 4), strict=True)
        ),
    ]


def painted(position: F64, logs: F64, change: float) -> F64:
    place = (position - MIDDLE) / HALF
    terms = np.column_stack([np.ones(COUNT), place, place[:, 2] ** 2])
    images = []
    for camera, shift, shapes, log in zip(CAMERAS, SHIFTS, shapes_of(change), logs.T, strict=True):
        pixels = camera.project(position)[0] + shift
        *sigma, tilt, flat = shapes @ terms.T
        x, y = (_derivatives(pixels[:, k], sigma[k], n) for k, n in ((0, COLUMNS), (1, ROWS)))
        flat = np.clip(flat, 0.0, MOST_FLAT)
        across, down = sigma[0] ** 2, sigma[1] ** 2
        factors = {(0, 0): np.ones(COUNT), (1, 1): tilt, (3, 0): -flat * across**2}
        factors |= {(2, 2): 0.5 * tilt**2 - 2.0 * flat * across * down, (0, 3): -flat * down**2}
        images.append(np.zeros((ROWS, COLUMNS)))
        for (i, j), factor in factors.items():
            light = factor * TYPICAL * np.exp(log)
            images[-1] += np.einsum("n,nr,nc->rc", light, y[j], x[i])
    return np.array(images)


def prepared(change: float) -> tuple[Any, F64, F64, F64]:
    rng = np.random.default_rng(4)
    position, logs = particles(rng)
    images = painted(position, logs, change) + rng.standard_normal((4, ROWS, COLUMNS))
    renderer = part("images").DifferentiableImages(make_model(images, change))
    position = position + 0.02 * rng.standard_normal(position.shape)
    renderer.lay_out(position)
    return renderer, position, logs + 0.1 * rng.standard_normal(logs.shape), images


@pytest.mark.slow
def test_images_and_cost_are_those_of_the_formula() -> None:
    renderer, position, logs, images = prepared(1.0)
    exact = painted(position, logs, 1.0)
    np.testing.assert_allclose(renderer.render(position, logs), exact, rtol=0.0, atol=2e-3)
    model = make_model(images, 1.0)
    squares = np.sum(model.weight * (model.images - exact) ** 2)
    prior = np.einsum("ni,ij,nj->", logs, model.precision, logs)
    cost = renderer.cost_and_slopes(position, logs)[0]
    assert cost == pytest.approx(0.5 * (squares + prior), rel=1e-6)


def test_slopes_are_those_of_central_differences() -> None:
    renderer, position, logs, _ = prepared(1.0)
    _, by_place, by_log = renderer.cost_and_slopes(position, logs)
    rng = np.random.default_rng(5)
    for _ in range(3):
        aside = rng.standard_normal((COUNT, 7)) * [0.01, 0.01, 0.01, 1.0, 1.0, 1.0, 1.0]
        step = 1e-4 * aside
        ends = [
            renderer.cost_and_slopes(position + sign * step[:, :3], logs + sign * step[:, 3:])[0]
            for sign in (1.0, -1.0)
        ]
        parts = np.hstack([by_place, by_log]) * aside
        near = (1e-7 + digits()) * np.abs(parts).sum()  # their sum may be close to 0
        assert parts.sum() == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=0.0, abs=near)


@pytest.fixture
def searched() -> Any:
    shot = make_shot(21, particles={"per_pixel": 0.03})
    maps = fit_cameras(shot.observation)
    search = search_frame(shot.observation, maps, BayesianIprSettings())
    assert search is not None
    model = part("descent").image_model(search, shot.observation, maps)
    return search, model, shot.particles.position_mm


def rms_px(search: Any, true: F64) -> tuple[float, float]:
    apart = points_in_mm(search.maps, search.position)[:, None] - true
    nearest = np.linalg.norm(apart, axis=2).min(axis=1) / PIXEL_MM
    near = nearest < 1.0
    return float(near.mean()), float(np.sqrt(np.mean(nearest[near] ** 2)))


def perturb(search: Any) -> None:
    rng = np.random.default_rng(5)
    step_mm = 0.3 * PIXEL_MM * rng.standard_normal(search.position.shape)
    search.position[:] = np.clip(search.position + step_mm / search.maps.half_mm, -1.0, 1.0)
    search.light *= np.exp(0.2 * rng.standard_normal(search.light.shape))


def cost_of(search: Any, model: Any) -> float:
    logs = np.log(search.light / model.typical)
    prior = np.einsum("ni,ij,nj->", logs, model.precision, logs)
    return 0.5 * float(np.sum(model.weight * np.square(search.left, dtype=np.float64)) + prior)


@pytest.mark.slow
def test_a_descent_from_a_start_that_is_off_is_as_good_as_bayesian_ipr(searched: Any) -> None:
    search, model, true = searched
    share, rms = rms_px(search, true)
    cost = cost_of(search, model)
    perturb(search)
    assert rms_px(search, true)[1] > 4.0 * rms
    costs = part("descent").descend(search, model, part("descent").InverseRenderingSettings())
    found = rms_px(search, true)
    assert len(search.position) > 90
    assert share > 0.98
    assert found[0] >= share
    assert found[1] < 1.02 * rms
    assert costs[0] > 5.0 * cost
    assert costs[-1] <= cost
    assert cost_of(search, model) == pytest.approx(costs[-1], abs=0.05)  # maps are not exact


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
    cylinder = CylinderWall((0.0, 0.0, 60.0), (0.0, 1.0, 0.0), 60.0, 1.0, (GLASS,), 1.33)
    points = np.random.default_rng(1).uniform([-2.0, -2.0, 18.0], [2.0, 2.0, 22.0], (20, 3))
    linear = fit_projective("flat", first.rows, first.columns, points, first.project(points)[0])
    check_sentence(reason(case, replace(first, wall=cylinder), 4) or "", first.name)
    check_sentence(reason(case, linear, 4) or "", "flat")
    check_sentence(reason(case, None, 2) or "")
    assert reason(case, None, 4) is None
