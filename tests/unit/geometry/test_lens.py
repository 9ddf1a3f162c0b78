"""Tilted sensors against a plane in space, OpenCV's tilted model, and laws of the thin lens."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sabench.geometry.camera import Camera
from sabench.geometry.lens import UPRIGHT, Distortion, distort, focus_slope, onto_sensor, stretch
from sabench.geometry.refraction import Wall, trace_to_points
from sabench.utils import backend
from sabench.utils.arrays import F64
from tests.helpers.cameras import make_camera
from tests.helpers.refusals import refused
from tests.unit.geometry.test_camera import BROWN, GLASS, TILTED, seen_by_opencv

TILTS = [(12.0, 0.0), (0.0, -9.0), (18.0, -13.0), (-35.0, 20.0)]


def points_in_view(count: int = 2000) -> F64:
    rng = np.random.default_rng(1)
    return np.asarray(rng.uniform([-60.0, -80.0, 20.0], [110.0, 40.0, 300.0], (count, 3)))


def on_a_plane_in_space(camera: Camera, leaving: F64) -> F64:
    """Let light fall on a sensor behind the lens; places are read off along its own axes. The
    sensor stands upright behind the lens, upside down as images are, and is then turned."""
    axes, pinhole = np.asarray(camera.rotation), np.asarray(camera.center_mm)
    local = leaving @ axes.T
    ideal = local[:, :2] / local[:, 2:]
    bent = np.column_stack([distort(camera.distortion, ideal)[0], np.ones(len(ideal))])
    incoming = -bent @ axes  # behind the lens, world frame
    middle = pinhole - camera.principal_distance_mm * axes[2]
    about_x = Rotation.from_rotvec(np.deg2rad(camera.tilt_deg[0]) * axes[0])
    own_y = about_x.apply(axes[1])
    turn = Rotation.from_rotvec(np.deg2rad(camera.tilt_deg[1]) * own_y) * about_x
    right, down, normal = (turn.apply(axis) for axis in axes)
    length = (middle - pinhole) @ normal / (incoming @ normal)
    offset = pinhole + length[:, None] * incoming - middle
    places = -np.column_stack([offset @ right, offset @ down])
    return np.asarray(places / camera.pixel_mm + np.asarray(camera.principal_point_px))


@pytest.mark.parametrize("wall", [None, GLASS, TILTED])
@pytest.mark.parametrize("tilt", TILTS)
def test_a_pixel_is_where_the_chief_ray_ends(tilt: tuple[float, float], wall: Wall | None) -> None:
    camera, points = make_camera(tilt_deg=tilt, distortion=BROWN, wall=wall), points_in_view()
    paths = trace_to_points(wall, np.asarray(camera.center_mm), points)
    pixels, valid = camera.project(points)
    assert valid.mean() > 0.99
    exact = on_a_plane_in_space(camera, paths.leaving)
    assert_allclose(pixels[valid], exact[valid], rtol=0, atol=1e-9)
    assert_allclose(pixels, camera.pixels_of(paths.leaving, paths.valid)[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("lens", [Distortion(), BROWN])
@pytest.mark.parametrize("tilt", TILTS)
def test_projection_is_opencv_s_tilted_one(tilt: tuple[float, float], lens: Distortion) -> None:
    camera, points = make_camera(tilt_deg=tilt, distortion=lens), points_in_view()
    pixels, valid = camera.project(points)
    assert valid.mean() > 0.99
    there = seen_by_opencv(camera, points)
    assert_allclose(pixels[valid], there[valid], rtol=0, atol=1e-9)
    assert np.abs(replace(camera, tilt_deg=UPRIGHT).project(points)[0] - there)[valid].max() > 4.0


@pytest.mark.parametrize("wall", [None, GLASS, TILTED])
def test_lines_of_sight_pass_through_the_points_that_they_show(wall: Wall | None) -> None:
    camera = make_camera(tilt_deg=(18.0, -13.0), distortion=BROWN, wall=wall)
    points = points_in_view()
    pixels, valid = camera.project(points)
    rays = camera.back_project(pixels[valid])
    assert rays.valid.all()
    offset = points[valid] - rays.origins_mm
    miss = offset - np.einsum("ij,ij->i", offset, rays.directions)[:, None] * rays.directions
    assert np.abs(miss).max() < 1e-9


def test_a_sensor_without_tilt_changes_no_bit() -> None:
    image = np.random.default_rng(2).uniform(-0.6, 0.6, (500, 2))
    assert (onto_sensor(UPRIGHT, image)[0] == image).all()
    camera = make_camera(distortion=BROWN, wall=TILTED)
    nearly = replace(camera, tilt_deg=(1e-12, 0.0))
    points = points_in_view(50)
    assert_allclose(camera.project(points)[0], nearly.project(points)[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("wall", [None, TILTED])
@pytest.mark.parametrize("tilt", TILTS)
def test_without_distortion_a_camera_with_its_axis_normal_to_the_sensor_does_the_same(
    tilt: tuple[float, float], wall: Wall | None
) -> None:
    camera, points = make_camera(tilt_deg=tilt, wall=wall), points_in_view()
    upright = camera.upright()
    assert upright.tilt_deg == UPRIGHT
    pixels, valid = camera.project(points)
    assert_allclose(pixels[valid], upright.project(points)[0][valid], atol=1e-9)
    with refused("camera_00", kind=ValueError):
        replace(camera, distortion=BROWN).upright()


@pytest.mark.parametrize("tilt", TILTS)
def test_the_plane_in_focus_follows_scheimpflug_and_the_hinge(tilt: tuple[float, float]) -> None:
    """Two lines by construction. Object plane, lens and sensor meet in one line; and the plane
    through the lens that is parallel to the sensor meets the object plane in the lens's front focal
    plane."""
    camera = make_camera(tilt_deg=tilt, principal_distance_mm=5.3)
    distance, focal = camera.principal_distance_mm, camera.focal_length_mm
    normal = Rotation.from_euler("XY", tilt, degrees=True).apply([0.0, 0.0, 1.0])
    directions = np.array([[0.1, 0.2], [-0.3, 0.1], [0.05, -0.2]])
    inverse = 1.0 / camera.focus_mm - directions @ focus_slope(tilt) / distance
    sharp = np.column_stack([directions, np.ones(3)]) / inverse[:, None]
    plane = np.append(np.linalg.solve(sharp, np.ones(3)), -1.0)  # a x + b y + c z - 1 = 0
    # the sensor stands at z = -distance: normal . (x + (0, 0, distance)) = 0
    sensor = np.append(normal, normal[2] * distance)
    for other, depth in ((sensor, 0.0), (np.append(normal, 0.0), focal)):
        ours, theirs = ([p[0], p[1], p[2] * depth + p[3]] for p in (plane, other))
        assert_allclose(np.cross(ours, theirs), 0.0, atol=1e-12)


@pytest.mark.parametrize("tilt", TILTS)
def test_a_round_cone_is_stretched_as_its_rays_are(tilt: tuple[float, float]) -> None:
    image, step = np.array([[0.2, -0.3], [0.0, 0.1]]), 1e-6
    turns = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    around = step * np.column_stack([np.cos(turns), np.sin(turns)])
    for place, found in zip(image, stretch(tilt, image), strict=True):
        ends = onto_sensor(tilt, place + around)[0] - onto_sensor(tilt, place[None])[0]
        covariance = 2.0 * ends.T @ ends / len(ends) / step**2
        exact = [covariance[0, 0], covariance[1, 1], covariance[0, 1]]
        assert_allclose(found, exact, rtol=0, atol=1e-5)


def test_renderers_have_the_rays_of_tilted_cameras() -> None:
    mi = backend.mitsuba()
    from sabench.simulation.rendering.camera_rays import lens_rays, pinhole_rays

    lens = Distortion(k1=-0.4, k2=3.0, p1=0.004, p2=-0.003, k3=20.0)
    camera = make_camera(
        tilt_deg=(12.0, -9.0), distortion=lens, principal_distance_mm=88.0, focal_length_mm=80.0
    )
    pixels = np.random.default_rng(2).uniform([0.0, 0.0], [499.0, 299.0], (300, 2))
    column, row = (mi.Float(axis.astype(np.float32)) for axis in pixels.T)
    exact, valid = camera.directions(pixels)
    assert valid.all()
    rays = pinhole_rays(camera, np.asarray(camera.center_mm), column, row)
    assert_allclose(np.array(rays.d).T, exact, rtol=0, atol=2e-6)
    aside = lens_rays(
        camera, np.asarray(camera.center_mm), column, row, (mi.Float(2.0), mi.Float(-1.5))
    )
    forward = exact @ np.asarray(camera.rotation)[2]
    local = exact @ np.asarray(camera.rotation).T
    image = onto_sensor(UPRIGHT, distort(lens, local[:, :2] / local[:, 2:])[0])[0]
    inverse = 1.0 / camera.focus_mm - image @ focus_slope(camera.tilt_deg) / 88.0
    sharp = exact / (forward * inverse)[:, None]  # where all rays of a pixel meet
    offset = sharp - np.array(aside.o).T
    cross = np.cross(offset / np.linalg.norm(offset, axis=1, keepdims=True), np.array(aside.d).T)
    assert np.abs(cross).max() < 5e-6
