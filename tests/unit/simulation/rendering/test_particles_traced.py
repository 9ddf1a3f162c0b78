"""Renderer of particles by rays, next to the formulas."""

from dataclasses import replace

import numpy as np
import pytest

from sabench.geometry.camera import Camera
from sabench.geometry.lens import Distortion
from sabench.scenes import build_rig
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import ParticleImages, image_particles
from sabench.simulation.rendering.particles_traced import render
from sabench.utils.arrays import F64, I64
from tests.helpers.particle_scenes import (
    SMALL,
    VARIANTS,
    assert_same_picture,
    cloud,
    isolated,
    make_scene,
    moments,
    oblique_camera,
)


@pytest.mark.parametrize("number", [0, 3])
@pytest.mark.parametrize("variant", VARIANTS)
def test_rays_and_formulas_make_the_same_picture(variant: str, number: int) -> None:
    scene = make_scene(**VARIANTS[variant])
    camera = build_rig(scene).cameras[number]
    depth = (27.0, 33.0) if variant != "wide-open" else (29.5, 30.5)
    positions, pixels = isolated(camera, depth, 13, number)
    assert len(positions) >= 70
    assert_same_picture(scene, camera, positions, pixels)


def crowd(camera: Camera) -> tuple[F64, ParticleImages]:
    """Make images of 600 particles in a layer of a micrometre, eight of them in each pixel."""
    rng = np.random.default_rng(6)
    rays = camera.back_project(rng.uniform([20.0, 15.0], [29.0, 23.0], (600, 2)))
    z = rng.uniform(30.0, 30.001, 600)
    along = (z - rays.origins_mm[:, 2]) / rays.directions[:, 2]
    positions = rays.origins_mm + rays.directions * along[:, None]
    return positions, image_particles(make_scene(), camera, cloud(positions), None)


def test_no_particle_hides_another() -> None:
    camera = build_rig(make_scene()).cameras[1]
    positions, images = crowd(camera)
    traced = render(camera, images, positions, 49) * camera.etendue()
    formula = particles_splatted.render(camera, images)
    assert traced.sum() == pytest.approx(formula.sum(), rel=1e-4)
    np.testing.assert_allclose(traced, formula, rtol=0.0, atol=0.003 * formula.max())


def test_portions_of_a_cloud_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded by rendering some particles at a time."""
    camera = build_rig(make_scene()).cameras[1]
    positions, images = crowd(camera)
    whole = render(camera, images, positions, 4)
    monkeypatch.setattr("sabench.simulation.rendering.particles_traced.AT_ONCE", 5000)
    np.testing.assert_allclose(render(camera, images, positions, 4), whole, rtol=1e-5)


WIDE = replace(SMALL, principal_distance_mm=1.7, focal_length_mm=1.65)


def both_moments(
    camera: Camera, positions: F64, pixels: I64, half: int
) -> tuple[tuple[F64, F64], tuple[F64, F64]]:
    """Moments of traced and of splatted images of large particles."""
    scene = make_scene(wall=None, illumination={"thickness_mm": 1e4})
    images = image_particles(scene, camera, cloud(positions, 0.8), None)
    traced = render(camera, images, positions, 16) * camera.etendue()
    formula = particles_splatted.render(camera, images)
    return moments(traced, pixels, half), moments(formula, pixels, half)


def test_rays_carry_the_light_of_near_and_large_particles() -> None:
    """A ball of glow begins far in front of its centre here (0.7 of 40 mm)."""
    camera = replace(WIDE, rows=70, columns=110, principal_point_px=(54.5, 34.5))
    traced, formula = both_moments(camera, *isolated(camera, (39.0, 41.0), 16, 4), 6)
    assert traced[0].sum() == pytest.approx(formula[0].sum(), rel=2e-3)


@pytest.mark.slow
def test_rays_of_a_strongly_distorted_lens_meet_the_formulas() -> None:
    straight = replace(WIDE, rows=110, columns=300, principal_point_px=(149.5, 55.0))
    plain = isolated(straight, (50.0, 60.0), 16, 3)[0]
    lens = Distortion(k1=-0.3)
    camera = replace(straight, columns=215, principal_point_px=(107.0, 55.0), distortion=lens)
    nodes = np.rint(camera.project(plain)[0])
    inside = camera.project(plain)[1] & camera.contains(nodes, -7.0)
    positions, pixels = plain[inside], nodes[inside].astype(np.int64)
    traced, formula = both_moments(camera, positions, pixels, 5)
    assert len(positions) > 50
    assert np.abs(pixels[:, 0] - 107).max() > 90
    assert np.abs(traced[1] - formula[1]).max() < 0.02
    np.testing.assert_allclose(traced[0], formula[0], rtol=0.02)


def test_corners_that_the_lens_does_not_reach_are_dark() -> None:
    near = replace(SMALL, principal_distance_mm=0.4, focal_length_mm=0.39)
    camera = replace(near, rows=90, columns=130, principal_point_px=(66.0, 44.0))
    camera = replace(camera, distortion=Distortion(k1=-0.3))
    positions = np.random.default_rng(8).uniform([-40.0, -40.0, 40.0], [40.0, 40.0, 60.0], (60, 3))
    scene = make_scene(wall=None, illumination={"thickness_mm": 1e4})
    images = image_particles(scene, camera, cloud(positions, 3.0), None)
    picture = render(camera, images, positions, 4)
    corner = np.hypot(*np.mgrid[-44:46, -66:64]) > 32.0
    assert np.isfinite(picture).all()
    assert picture.max() > 0.0
    assert not picture[corner].any()


def test_render_of_nothing_is_dark() -> None:
    scene = make_scene()
    camera = build_rig(scene).cameras[0]
    empty = cloud(np.empty((0, 3)))
    picture = render(camera, image_particles(scene, camera, empty, None), empty.position_mm, 4)
    assert picture.shape == (110, 170)
    assert not picture.any()


@pytest.mark.slow
@pytest.mark.parametrize("z_mm", [191.0, 200.0, 212.0])
def test_rays_and_formulas_make_the_same_ellipses(z_mm: float) -> None:
    scene, camera = oblique_camera(8.0)
    position = np.array([[0.4, -0.3, z_mm]])
    images = image_particles(scene, camera, cloud(position), None)
    traced = render(camera, images, position, 100) * camera.etendue()
    formula = particles_splatted.render(camera, images)
    rows, columns = np.mgrid[: camera.rows, : camera.columns]
    found = []
    for image in (traced, formula):
        weights = image / image.sum()
        x, y = columns - (weights * columns).sum(), rows - (weights * rows).sum()
        found.append([(weights * term).sum() for term in (x * x, y * y, x * y)])
        np.testing.assert_allclose(
            [(weights * columns).sum(), (weights * rows).sum()], images.pixel[0], atol=2e-3
        )
    np.testing.assert_allclose(found[0], found[1], atol=2e-3 * max(found[1]))
    assert traced.sum() == pytest.approx(formula.sum(), rel=2e-3)
    assert z_mm == 200.0 or abs(images.spread_px2[0, 2]) > 0.2
