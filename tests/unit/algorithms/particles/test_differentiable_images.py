"""Differentiable cameras, images and costs against exact cameras, formulas and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import hermite_e

from sabench.algorithms.particles.differentiable_images import DifferentiableImages, ImageModel
from sabench.algorithms.particles.differentiable_projection import DifferentiableCamera
from sabench.algorithms.particles.image_model import (
    MOST_FLAT,
    SUMS,
    make_room,
    paint_all,
    sum_up,
    with_margins,
)
from sabench.algorithms.particles.joint_fit import even_covariance
from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.lens_distortion import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64
from sabench.utils.backend import choose, drjit
from tests.helpers.image_model import SIGMA, TYPICAL, model_of, particles_of, profile
from tests.unit.algorithms.particles.test_matching import (
    CAMERAS,
    COLUMNS,
    HIGH,
    LOW,
    ROWS,
    maps,
    unit_points,
)

__all__ = ["maps"]
MIDDLE, HALF = (LOW + HIGH) / 2.0, (HIGH - LOW) / 2.0
LENS = Distortion(k1=-0.4, k2=3.0, p1=0.004, p2=-0.003, k3=20.0)
GLASS, GAP = Layer("glass", 1.52, 5.0), Layer("gap", 1.1, 2.0)
TILTED = (0.6 / 7.0, -0.4 / 7.0, float(np.sqrt(49.0 - 0.52) / 7.0))
WALLS = {
    "air": None,
    "surface": Wall((0.0, 0.0, 3.0), (0.0, 0.0, 1.0), 1.0, (), 1.33),
    "glass": Wall((0.0, 0.0, 3.0), (0.0, 0.0, 1.0), 1.0, (GLASS,), 1.33),
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


def make_camera(wall: Wall | CylinderWall | None, center: tuple[float, float, float]) -> Camera:
    rotation, middle = aimed_rotation(np.array([0.05, -0.1, 1.0])), (160.0, 118.0)
    plain = Camera("one", 240, 320, center, rotation, 88.0, 0.01, middle, LENS, 85.0, 16.0, wall)
    return aim(plain, (0.0, 0.0, 30.0))


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (8.0, -11.0)])
@pytest.mark.parametrize("name", WALLS)
def test_projects_as_cameras_do(name: str, tilt: tuple[float, float]) -> None:
    points = np.random.default_rng(4).uniform([-8.0, -6.0, 20.0], [8.0, 6.0, 40.0], (200, 3))
    one = replace(make_camera(WALLS[name], (-20.0, 40.0, -490.0)), tilt_deg=tilt)
    exact, valid = one.project(points)
    found = DifferentiableCamera(one, (0.25, -0.5)).project(*arrays_of(points))
    assert valid.all()
    columns = np.column_stack([coordinate.numpy() for coordinate in found])
    np.testing.assert_allclose(columns - [0.25, -0.5], exact, rtol=0.0, atol=1e-9)


def test_flat_light_is_projected_as_cameras_do() -> None:
    """65 to 80 degrees from the normal, through a thin gap of the rarest medium."""
    wall = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.3, (GLASS, GAP), 1.4)
    one = replace(make_camera(wall, (-60.0, 0.0, -10.0)), distortion=Distortion())
    points = np.column_stack([np.linspace(-20.0, 20.0, 9), np.ones(9), np.full(9, 20.0)])
    exact, valid = one.project(points)
    found = DifferentiableCamera(one).project(*arrays_of(points))
    assert valid.all()
    columns = np.column_stack([coordinate.numpy() for coordinate in found])
    np.testing.assert_allclose(columns, exact, rtol=1e-12, atol=1e-8)


@pytest.mark.parametrize("name", WALLS)
def test_derivatives_of_pixels_are_those_of_cameras(name: str) -> None:
    dr, _ = drjit()
    points = np.random.default_rng(4).uniform([-8.0, -6.0, 20.0], [8.0, 6.0, 40.0], (20, 3))
    one = make_camera(WALLS[name], (-20.0, 40.0, -490.0))
    exact = DifferentiableCamera(one)
    for axis, step in enumerate(1e-3 * np.eye(3)):
        difference = (one.project(points + step)[0] - one.project(points - step)[0]) / 2e-3
        place = arrays_of(points)
        dr.enable_grad(place[axis])
        pixel = exact.project(*place)
        dr.forward(place[axis])
        slopes = np.column_stack([dr.grad(coordinate).numpy() for coordinate in pixel])
        np.testing.assert_allclose(slopes, difference, rtol=digits(), atol=1e-6)


def test_a_curved_wall_is_refused() -> None:
    cylinder = CylinderWall((0.0, 0.0, 60.0), (0.0, 1.0, 0.0), 60.0, 1.0, (GLASS,), 1.33)
    one = replace(make_camera(None, (0.0, 0.0, -300.0)), wall=cylinder)
    with pytest.raises(ValueError, match="camera one: expected a plane wall, got another shape"):
        DifferentiableCamera(one)


def shapes_of(change: float) -> F64:
    """Widths that grow along x, shrink along y and do not change along z.

    If they change, images of two cameras are tilted, and of two are flat.
    """
    rates = change * np.array([0.1, -0.2, 0.0])
    shapes = np.tile([[one, *(one * rates)] for one in (*SIGMA, 0.0, 0.0)], (4, 1, 1))
    shapes[1:3, 2] = change * np.array([0.1, -0.02, 0.01, 0.03])
    shapes[2:, 3] = change * np.array([0.04, 0.01, -0.02, 0.02])
    return shapes


def make_model(images: F64, change: float = 0.0) -> ImageModel:
    weight = np.random.default_rng(6).uniform(0.2, 1.0, images.shape)
    weight[:, 50:60, 60:90] = 0.0  # unknown
    return ImageModel(
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
    """Positions (mm) that overlap and stick out of the images, and logarithms of light."""
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
    """Images by exact cameras and the error function."""
    terms = np.column_stack([np.ones(COUNT), (position - MIDDLE) / HALF])
    images = []
    for camera, shift, shapes, log in zip(CAMERAS, SHIFTS, shapes_of(change), logs.T, strict=True):
        pixels = camera.project(position)[0] + shift
        *sigma, tilt, flat = shapes @ terms.T
        x, y = (
            _derivatives(pixels[:, k], sigma[k], count) for k, count in ((0, COLUMNS), (1, ROWS))
        )
        flat = np.clip(flat, 0.0, MOST_FLAT)
        across, down = sigma[0] ** 2, sigma[1] ** 2
        factors = {(0, 0): np.ones(COUNT), (1, 1): tilt, (3, 0): -flat * across**2}
        factors |= {(2, 2): 0.5 * tilt**2 - 2.0 * flat * across * down, (0, 3): -flat * down**2}
        images.append(np.zeros((ROWS, COLUMNS)))
        for (i, j), factor in factors.items():
            light = factor * TYPICAL * np.exp(log)
            images[-1] += np.einsum("n,nr,nc->rc", light, y[j], x[i])
    return np.array(images)


def prepared(change: float) -> tuple[DifferentiableImages, F64, F64, F64]:
    """A renderer of noisy images, particles next to the true ones, and the images."""
    rng = np.random.default_rng(4)
    position, logs = particles(rng)
    images = painted(position, logs, change) + rng.standard_normal((4, ROWS, COLUMNS))
    renderer = DifferentiableImages(make_model(images, change))
    position = position + 0.02 * rng.standard_normal(position.shape)
    renderer.lay_out(position)
    return renderer, position, logs + 0.1 * rng.standard_normal(logs.shape), images


@pytest.mark.parametrize("change", [0.0, 1.0])
def test_images_and_cost_are_those_of_the_formula(change: float) -> None:
    renderer, position, logs, images = prepared(change)
    exact = painted(position, logs, change)
    np.testing.assert_allclose(renderer.render(position, logs), exact, rtol=0.0, atol=2e-3)
    model = make_model(images, change)
    squares = np.sum(model.weight * (model.images - exact) ** 2)
    prior = np.einsum("ni,ij,nj->", logs, model.precision, logs)
    cost = renderer.cost_and_slopes(position, logs)[0]
    assert cost == pytest.approx(0.5 * (squares + prior), rel=1e-6)


@pytest.mark.parametrize("change", [0.0, 1.0])
def test_slopes_are_those_of_central_differences(change: float) -> None:
    renderer, position, logs, _ = prepared(change)
    _, by_place, by_log = renderer.cost_and_slopes(position, logs)
    rng = np.random.default_rng(5)
    for _ in range(6):
        aside = rng.standard_normal((COUNT, 7)) * [0.01, 0.01, 0.01, 1.0, 1.0, 1.0, 1.0]
        step = 1e-4 * aside
        ends = [
            renderer.cost_and_slopes(position + sign * step[:, :3], logs + sign * step[:, 3:])[0]
            for sign in (1.0, -1.0)
        ]
        parts = np.hstack([by_place, by_log]) * aside
        near = (1e-7 + digits()) * np.abs(parts).sum()  # their sum may be close to 0
        assert parts.sum() == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=0.0, abs=near)


def test_slopes_and_curvatures_are_those_of_the_kernels(maps: VolumePolynomials) -> None:
    """The sums of `joint_fit`, by formulas, of cameras as polynomials."""
    renderer, position, logs, images = prepared(0.0)
    weight = make_model(images).weight
    _, by_place, by_log = renderer.cost_and_slopes(position, logs)
    blocks = renderer.curvatures(position, logs)
    shifted = maps._replace(coefficients=maps.coefficients.copy())
    shifted.coefficients[:, 0] += SHIFTS
    model = model_of(shifted, images)._replace(
        weight=with_margins(weight), precision=make_model(images).precision
    )
    unit, light = (position - MIDDLE) / HALF, TYPICAL * np.exp(logs)
    room = make_room(np.tile(np.array(SIGMA) + 0.4, (4, 1)))  # windows as wide as the renderer's
    paint_all(model, room, particles_of(unit, light), -1.0)
    own, bends = np.zeros((COUNT, 7)), np.zeros((COUNT, 7, 7))
    for n in range(COUNT):
        sum_up(model, room, unit[n], light[n])
        for camera in range(4):
            square, pull, xx, xy, yy, x, y, given = room.sums[camera]
            assert given == 0.0
            slope, own_light = room.slope[camera] / HALF, light[n, camera]
            own[n, :3] -= own_light * slope.T @ [x, y]
            own[n, 3 + camera] -= own_light * pull
            bend = own_light**2 * slope.T @ np.array([[xx, xy], [xy, yy]]) @ slope
            bends[n, :3, :3] += bend
            bends[n, 3 + camera, 3 + camera] += own_light**2 * square
    own[:, 3:] += logs @ model.precision
    bends[:, 3:, 3:] += model.precision
    bends[:, :3, :3] += np.diag(3.0 / HALF**2)
    assert SUMS == 8
    scale = np.abs(own).max(axis=0)
    np.testing.assert_allclose(by_place, own[:, :3], rtol=0.0, atol=2e-3 * scale[:3].max())
    np.testing.assert_allclose(by_log, own[:, 3:], rtol=0.0, atol=2e-3 * scale[3:].max())
    for part in (slice(3), slice(3, 7)):
        block = bends[:, part, part]
        np.testing.assert_allclose(
            blocks[:, part, part], block, rtol=0.0, atol=2e-3 * np.abs(block).max()
        )


def test_windows_say_how_far_particles_have_moved() -> None:
    renderer, position, _, _ = prepared(0.0)
    assert renderer.farthest_px(position) <= 0.5
    there = position + np.array([0.3, 0.0, 0.0])
    moved = CAMERAS[0].project(there)[0] - CAMERAS[0].project(position)[0]
    farthest = renderer.farthest_px(there)
    assert abs(farthest - np.abs(moved).max()) < 0.6


def test_particles_that_no_camera_sees_cost_only_their_light() -> None:
    images = np.zeros((4, ROWS, COLUMNS))
    model = make_model(images)
    renderer = DifferentiableImages(model)
    position, logs = MIDDLE + np.array([[60.0, 0.0, 0.0]]), np.full((1, 4), 0.2)
    renderer.lay_out(position)
    cost, by_place, by_log = renderer.cost_and_slopes(position, logs)
    assert cost == pytest.approx(0.5 * float(np.sum(0.04 * model.precision)), rel=1e-12)
    assert not by_place.any()
    np.testing.assert_allclose(by_log[0], model.precision @ logs[0], rtol=1e-12)
