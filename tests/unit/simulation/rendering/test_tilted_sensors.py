"""Images of particles and targets on sensors that are tilted against their lenses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.refraction import trace_to_points
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.rendering.particle_images import diffraction_px, image_particles
from sabench.utils.arrays import F64
from tests.helpers.particle_scenes import TILT, assert_same_picture, cloud, isolated, make_scene

LENS = {"k1": -60.0, "k2": 2000.0, "p1": 0.3, "p2": -0.2, "k3": 0.0}


def tilted_rig(
    tilt: tuple[float, float], wall: bool, f_number: float = 4.0
) -> tuple[Scene, Camera]:
    cameras = {"f_number": f_number, "each": [{"camera": "camera_01", "tilt_deg": list(tilt)}]}
    light = {"thickness_mm": 1e4}
    scene = make_scene(wall=TILT if wall else None, cameras=cameras, illumination=light)
    return scene, build_rig(scene).cameras[1]


def terms(covariance: F64) -> list[float]:
    return [covariance[0, 0], covariance[1, 1], covariance[0, 1]]


def light_on_sensor(camera: Camera, leaving: F64, aperture: F64) -> F64:
    """Follow rays through a point of a thin lens to a tilted plane behind it."""
    local = leaving @ np.asarray(camera.rotation).T
    before = local[:, :2] / local[:, 2:]
    # backwards from the scene: slopes change by the distance from the axis over the focal length
    slopes = -before - aperture / camera.focal_length_mm
    after = np.column_stack([slopes, np.full(len(local), -1.0)])
    turn = Rotation.from_euler("XY", camera.tilt_deg, degrees=True)
    right, down, normal = (turn.apply(axis) for axis in np.eye(3))
    start = np.array([*aperture, 0.0])
    middle = np.array([0.0, 0.0, -camera.principal_distance_mm])
    length = ((middle - start) @ normal) / (after @ normal)
    offset = start + length[:, None] * after - middle
    places = -np.column_stack([offset @ right, offset @ down]) / camera.pixel_mm
    return np.asarray(places + np.asarray(camera.principal_point_px))


@pytest.mark.slow
@pytest.mark.parametrize("wall", [False, True])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (8.0, -11.0), (0.0, 25.0)])
def test_the_blur_is_that_of_thin_lens_rays(tilt: tuple[float, float], wall: bool) -> None:
    scene, camera = tilted_rig(tilt, wall)
    points = np.array([[1.5, -1.0, 27.0], [-2.0, 1.2, 33.0], [0.5, 0.5, 30.0], [-2.5, -1.0, 29.0]])
    disc = np.random.default_rng(3).uniform(-1.0, 1.0, (8000, 2))
    disc = disc[np.hypot(*disc.T) < 1.0]
    disc = np.vstack([disc, -disc, disc[:, ::-1], -disc[:, ::-1]])
    disc *= 0.5 / np.sqrt(np.mean(disc**2, axis=0))  # exactly the variance of a disc
    hits = []
    for aperture in disc[::7] * camera.aperture_radius_mm:
        moved = camera.shifted(*aperture)
        paths = trace_to_points(camera.wall, np.asarray(moved.center_mm), points)
        hits.append(light_on_sensor(camera, paths.leaving, aperture))
    images = image_particles(scene, camera, cloud(points, 1e-6), None)
    chief = trace_to_points(camera.wall, np.asarray(camera.center_mm), points).leaving
    expected = light_on_sensor(camera, chief, np.zeros(2))
    np.testing.assert_allclose(images.pixel, expected, rtol=0, atol=1e-9)
    narrow = replace(camera, f_number=1e3 * camera.f_number)
    sharp = image_particles(scene, narrow, cloud(points, 1e-6), None)
    round_part = sharp.spread_px2 / 1e6  # diffraction grows with the f-number
    for k in range(len(points)):
        found, exact = images.spread_px2[k] - round_part[k], terms(np.cov(np.array(hits)[:, k].T))
        np.testing.assert_allclose(found, exact, rtol=0, atol=0.03 * max(exact) + 1e-4)


@pytest.mark.parametrize("tilt", [(10.0, 0.0), (-7.0, 15.0)])
def test_particles_in_the_tilted_plane_of_focus_are_sharp(tilt: tuple[float, float]) -> None:
    """Points that a thin lens images onto the sensor's plane, in air; others are blurred."""
    scene, camera = tilted_rig(tilt, wall=False, f_number=2.0)
    camera = replace(camera, rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])))
    turn = Rotation.from_euler("XY", tilt, degrees=True)
    offsets = np.random.default_rng(1).uniform(-0.7, 0.7, (40, 2))
    places = turn.apply(np.column_stack([offsets, np.zeros(40)]))  # on the sensor, mm
    places[:, 2] -= camera.principal_distance_mm
    depth = 1.0 / (1.0 / camera.focal_length_mm + 1.0 / places[:, 2])
    points = places * (depth / places[:, 2])[:, None] + np.asarray(camera.center_mm)
    assert np.ptp(points[:, 2]) > 1.0
    images = image_particles(scene, camera, cloud(points, 1e-6), None)
    expected = -offsets / camera.pixel_mm + camera.principal_point_px
    np.testing.assert_allclose(images.pixel, expected, rtol=0, atol=1e-9)
    airy = diffraction_px(camera, scene.light.wavelength_nm)
    np.testing.assert_allclose(images.sigma_px, airy, rtol=0.05)
    flat = image_particles(scene, replace(camera, tilt_deg=(0.0, 0.0)), cloud(points, 1e-6), None)
    assert flat.sigma_px.max() > 3.0 * airy


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_rays_and_formulas_make_the_same_picture_on_tilted_sensors(number: int) -> None:
    own = [
        {"camera": "camera_00", "tilt_deg": [6.0, 9.0], "distortion": LENS},
        {"camera": "camera_01", "tilt_deg": [0.0, -20.0], "principal_point_px": [80.0, 60.0]},
    ]
    scene = make_scene(wall=TILT, cameras={"each": own})
    camera = build_rig(scene).cameras[number]
    positions, pixels = isolated(camera, (27.0, 33.0), 13, number)
    assert len(positions) >= 70
    assert_same_picture(scene, camera, positions, pixels)


@pytest.mark.parametrize("number", [0, 3])
def test_a_scene_s_plane_of_focus_is_sharp_through_its_walls(number: int) -> None:
    """Refraction at 45 degrees is in the tilt; what is left is the bend of the plane."""
    scene = load_scene("scheimpflug")
    camera = build_rig(scene).cameras[number]
    points = np.random.default_rng(1).uniform([-7.0, -5.0, 42.0], [7.0, 5.0, 42.0], (200, 3))
    widths = []
    for tilt in (camera.tilt_deg, (0.0, 0.0)):
        images = image_particles(scene, replace(camera, tilt_deg=tilt), cloud(points), None)
        assert images.visible.mean() > 0.95
        widths.append(images.sigma_px)
    assert np.ptp(widths[0]) < 0.01 * widths[0].mean()
    assert widths[1].max() > 1.3 * widths[0].max()


@pytest.mark.parametrize("tilt", [(20.0, 0.0), (-12.0, 30.0)])
def test_discs_and_diffraction_are_stretched_on_tilted_sensors(tilt: tuple[float, float]) -> None:
    """Circles in a plane parallel to the lens, and cones of light behind it, by their rays."""
    scene, camera = tilted_rig(tilt, wall=False, f_number=8.0)
    axes, circle = np.asarray(camera.rotation), np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    around = np.column_stack([np.cos(circle), np.sin(circle)]) * np.sqrt(2.0)  # unit variances
    points = np.array([[1.5, -1.0, 27.0], [-2.0, 1.2, 33.0]])
    tiny, large = (image_particles(scene, camera, cloud(points, d), None) for d in (1e-6, 0.2))
    narrow = replace(camera, f_number=800.0)
    airy = diffraction_px(narrow, scene.light.wavelength_nm)
    small = image_particles(scene, narrow, cloud(points, 1e-6), None)
    for k, point in enumerate(points):
        disc = np.cov(camera.project(point + (around * 0.2 / 4.0) @ axes[:2])[0].T, bias=True)
        found, exact = large.spread_px2[k] - tiny.spread_px2[k], terms(disc)
        np.testing.assert_allclose(found, exact, rtol=0, atol=0.01 * max(exact))
        chief = (point - np.asarray(camera.center_mm)) @ axes.T
        cone = chief / chief[2] + np.column_stack([around * 1e-5, np.zeros(64)])
        spot = np.cov(light_on_sensor(camera, cone @ axes, np.zeros(2)).T, bias=True)
        exact = terms(spot * (airy / (1e-5 * camera.focal_px)) ** 2)
        np.testing.assert_allclose(small.spread_px2[k], exact, rtol=0, atol=0.01 * max(exact))


def test_large_particles_are_stretched_as_their_outline_is() -> None:
    """Against the projection of two directions across the line of sight."""
    scene, camera = tilted_rig((25.0, -22.0), wall=False)
    place = np.array([[2.0, -1.5, 31.0]])
    large, small = (
        image_particles(scene, camera, cloud(place, diameter), None).spread_px2[0]
        for diameter in (0.5, 0.1)
    )
    sight = place[0] - np.asarray(camera.center_mm)
    across = np.cross(sight, [0.3, 1.0, 0.2])
    both = np.stack([across, np.cross(sight, across)])
    both /= np.linalg.norm(both, axis=1)[:, None]
    ends = [camera.project(place + sign * 1e-4 * both)[0] for sign in (1.0, -1.0)]
    slopes = (ends[0] - ends[1]) / 2e-4
    shape = slopes.T @ slopes * (0.5**2 - 0.1**2) / 16.0
    np.testing.assert_allclose(large - small, terms(shape), rtol=2e-3, atol=1e-3 * shape[0, 0])
