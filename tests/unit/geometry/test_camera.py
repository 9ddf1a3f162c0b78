"""The pinhole camera with distortion against OpenCV and closed forms."""

import itertools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.testing import assert_allclose, assert_array_equal

from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall, trace_to_points
from sabench.scenes.cameras import CrossLayout, RingLayout, offsets_of
from sabench.scenes.focusing import apparent_distance_mm
from sabench.utils.arrays import F64, triple
from tests.helpers.cameras import make_camera

BROWN = Distortion(-0.12, 0.03, 2e-3, -3e-3, 0.01)
LAYERS = (Layer("glass", 1.52, 5.0), Layer("gap", 1.1, 2.0))
GLASS = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, LAYERS, 1.333)
TILTED = replace(GLASS, normal=(0.28, 0.0, 0.96))


def seen_by_opencv(camera: Camera, points: F64) -> F64:
    lens, rotation = camera.distortion, np.asarray(camera.rotation)
    matrix = np.diag([camera.focal_px, camera.focal_px, 1.0])
    matrix[:2, 2] = camera.principal_point_px
    tilt = np.deg2rad(camera.tilt_deg)
    coefficients = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3, *[0.0] * 7, *tilt])
    turn, shift = cv2.Rodrigues(rotation)[0], -rotation @ np.asarray(camera.center_mm)
    pixels = cv2.projectPoints(points, turn, shift, matrix, coefficients)[0]
    return np.asarray(pixels).reshape(-1, 2)


@pytest.mark.parametrize("lens", [Distortion(), BROWN])
def test_projection_is_that_of_opencv(lens: Distortion) -> None:
    camera = make_camera(distortion=lens)
    points = np.random.default_rng(1).uniform([-100.0, -60.0, 0.0], [100.0, 60.0, 90.0], (200, 3))
    pixels, valid = camera.project(points)
    assert valid.all()
    assert_allclose(pixels, seen_by_opencv(camera, points), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "lens", [BROWN, Distortion(k1=0.2), Distortion(k1=-0.25), Distortion(p1=0.02, p2=-0.03)]
)
def test_undistorting_inverts_distorting(lens: Distortion) -> None:
    camera = make_camera(distortion=lens)
    ideal = np.random.default_rng(2).uniform([-0.45, -0.3], [0.45, 0.3], (300, 2))
    axes, center = np.asarray(camera.rotation), np.asarray(camera.center_mm)
    pixels, valid = camera.project(center + 50.0 * (np.column_stack([ideal, np.ones(300)]) @ axes))
    back, valid_back = camera.ideal(pixels)
    assert valid.all()
    assert valid_back.all()
    assert_allclose(back, ideal, rtol=0, atol=1e-11)


@pytest.mark.parametrize("share", [0.5, 0.99])
def test_undistorting_works_up_to_the_fold(share: float) -> None:
    camera, turn = make_camera(distortion=Distortion(k1=-0.3)), np.linspace(0.0, 6.0, 25)
    radius = share / math.sqrt(3.0 * 0.3)
    ideal = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pixels = 600.0 * ideal * (1.0 - 0.3 * radius**2) + np.array(camera.principal_point_px)
    found, valid = camera.ideal(pixels)
    assert valid.all()
    assert_allclose(found, ideal, rtol=0, atol=1e-11)


@pytest.mark.parametrize("radius", [0.99, 1.01, 1.6, 2.5])
def test_points_past_the_fold_of_the_lens_are_not_valid(radius: float) -> None:
    fold = 1.0 / math.sqrt(3.0 * 0.3)  # where r (1 - 0.3 r^2) turns back
    camera = make_camera(distortion=Distortion(k1=-0.3))
    local = np.array([[0.6 * radius * fold, 0.8 * radius * fold, 1.0]])
    points = np.asarray(camera.center_mm) + 30.0 * local @ np.asarray(camera.rotation)
    assert camera.project(points)[1][0] == (radius < 1.0)


def test_pixel_without_an_ideal_point_is_not_valid() -> None:
    camera = make_camera(distortion=Distortion(k1=-0.3))
    reach = 2.0 / 3.0 / math.sqrt(0.9) * camera.focal_px  # of the lens from the principal point
    pixels = np.array([260.0, 140.0]) + reach * np.array([[0.9, 0.0], [1.01, 0.0], [0.0, -1.5]])
    pixels = np.append(pixels, [[math.nan, 0.0]], axis=0)
    assert camera.ideal(pixels)[1].tolist() == [True, False, False, False]
    assert camera.back_project(pixels).valid.tolist() == [True, False, False, False]


def test_points_behind_the_camera_are_not_valid() -> None:
    camera = make_camera()
    forward, center = np.asarray(camera.rotation)[2], np.asarray(camera.center_mm)
    valid = camera.project(center + np.array([[1.0], [-1.0], [0.0]]) * forward)[1]
    assert valid.tolist() == [True, False, False]


def test_pixel_zero_is_the_centre_of_the_top_left_pixel() -> None:
    camera = make_camera(principal_point_px=(0.0, 0.0))
    assert_allclose(camera.directions([[0.0, 0.0]])[0][0], camera.rotation[2], rtol=0, atol=1e-15)
    inside = np.array([[-0.5, -0.5], [499.499, 299.499], [299.9, 299.4]])
    border = np.array([[-0.501, 0.0], [0.0, -0.501], [499.5, 0.0], [0.0, 299.5]])
    assert camera.contains(inside).all()
    assert not camera.contains(border).any()
    assert camera.contains(np.concatenate([inside, border]), 0.01).all()
    assert not camera.contains(np.array([[math.nan, 0.0]]), 0.01).any()


@pytest.mark.parametrize(
    "forward",
    [(0.0, 0.0, 1.0), (0.3, -0.2, 0.9), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 1e-3, 0.0)],
)
def test_aimed_rotation_is_a_rotation(forward: tuple[float, float, float]) -> None:
    axes = np.asarray(aimed_rotation(np.asarray(forward)))
    assert_allclose(axes @ axes.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert_allclose(axes[2], np.asarray(forward) / np.linalg.norm(forward), rtol=0, atol=1e-15)
    assert axes[0] @ [0.0, 1.0, 0.0] == pytest.approx(0.0, abs=1e-14)
    assert axes[1] @ [0.0, 1.0, 0.0] >= 0.0


@pytest.mark.parametrize("wall", [None, TILTED])
@pytest.mark.parametrize("lens", [Distortion(), BROWN])
def test_aiming_puts_the_target_on_the_principal_point(wall: Wall | None, lens: Distortion) -> None:
    plain = make_camera(wall=wall, distortion=lens, center_mm=(150.0, -90.0, -300.0))
    camera = aim(plain, (3.0, 4.0, 40.0))
    expected = camera.principal_point_px
    assert_allclose(camera.project([[3.0, 4.0, 40.0]])[0][0], expected, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_pixels_that_the_lens_does_not_reach_collect_nothing() -> None:
    size = {"rows": 400, "columns": 600, "pixel_mm": 0.02, "principal_point_px": (310.0, 190.0)}
    found = make_camera(distortion=Distortion(k1=-0.3), **size).etendue()
    row, column = np.mgrid[0:400, 0:600]
    fold = 300.0 * 2.0 / 3.0 / math.sqrt(0.9)  # of r (1 - 0.3 r^2), px
    reached = np.hypot(column - 310.0, row - 190.0) / fold
    assert np.isfinite(found).all()
    assert (found[reached < 0.98] > 0.0).all()
    assert not found[reached > 1.01].any()


@pytest.mark.parametrize("lens", [Distortion(), BROWN])
def test_etendue_of_one_pixel_is_an_integral_over_it(lens: Distortion) -> None:
    """Gauss-Legendre, with the ideal coordinates' Jacobian from differences."""
    camera = make_camera(distortion=lens)
    etendue, (nodes, weights) = camera.etendue(), leggauss(3)
    assert etendue.shape == (300, 500)
    around = 1e-3 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [0.0, 0.0]])
    for row, column in ((0, 0), (299, 499), (17, 480), (140, 260)):
        total = 0.0
        for i, j in itertools.product(range(3), repeat=2):
            place = np.array([column + nodes[i] / 2.0, row + nodes[j] / 2.0])
            left, right, up, down, middle = camera.ideal(place + around)[0]
            jacobian = abs(np.linalg.det(np.stack([left - right, up - down]) / 2e-3))
            total += weights[i] * weights[j] / 4.0 * jacobian / (1.0 + middle @ middle) ** 2
        expected = math.pi * camera.aperture_radius_mm**2 * total
        assert etendue[row, column] == pytest.approx(expected, rel=1e-5)


def coddington(wall: Wall, before: float, behind: float, sine: float) -> float:
    """Mean of the tangential and the sagittal image's distance of a point seen at an angle."""
    depths = np.array([before, *(layer.thickness_mm for layer in wall.layers), behind])
    roots = np.sqrt(wall.indices**2 - (wall.air_index * sine) ** 2)
    sagittal = np.sum(depths * wall.air_index / roots)
    tangential = np.sum(depths * wall.air_index * wall.indices**2 / roots**3) * (1.0 - sine**2)
    return float(2.0 / (1.0 / sagittal + 1.0 / tangential))


@pytest.mark.parametrize("sine", [0.0, 0.2, 0.45, 0.6])
def test_apparent_distance_is_that_of_the_pencil(sine: float) -> None:
    before, behind = 350.0, 45.0
    reach = sum(
        d * sine / math.sqrt(n * n - sine**2)
        for d, n in zip([before, 5.0, 2.0, behind], GLASS.indices, strict=True)
    )
    target = np.array([reach, 0.0, 7.0 + behind])
    camera = aim(make_camera(wall=GLASS, center_mm=(0.0, 0.0, -before), f_number=200.0), target)
    expected = coddington(GLASS, before, behind, sine)
    assert apparent_distance_mm(camera, target) == pytest.approx(expected, rel=1e-6)


def test_apparent_distance_is_plain_in_air() -> None:
    plain = aim(make_camera(center_mm=(40.0, 30.0, -350.0), distortion=BROWN), [0.0, 0.0, 52.0])
    found = apparent_distance_mm(plain, np.array([0.0, 0.0, 52.0]))
    assert found == pytest.approx(math.hypot(40.0, 30.0, 402.0), rel=1e-12)


def test_focus_is_the_thin_lens_conjugate() -> None:
    camera = make_camera(principal_distance_mm=60.0, focal_length_mm=50.0)
    assert camera.focus_mm == pytest.approx(300.0)  # 1/50 = 1/60 + 1/300
    assert camera.aperture_radius_mm == 50.0 / 16.0
    assert camera.focal_px == pytest.approx(6000.0)


@pytest.mark.parametrize("count", [1, 3, 8])
def test_ring_keeps_radius_and_chord(count: int) -> None:
    layout = RingLayout(kind="ring", count=count, radius_mm=12.0, start_deg=math.degrees(0.3))
    offsets = offsets_of(layout)
    assert offsets.shape == (count, 2)
    assert_allclose(np.hypot(*offsets.T), 12.0)
    assert_allclose(offsets[0], [12.0 * math.cos(0.3), 12.0 * math.sin(0.3)])
    chords = np.linalg.norm(offsets - np.roll(offsets, 1, axis=0), axis=1)
    assert_allclose(chords, 24.0 * math.sin(math.pi / count), atol=1e-12)
    turn = offsets[0, 0] * offsets[-1, 1] - offsets[0, 1] * offsets[-1, 0]
    assert count < 3 or turn < 0.0  # the last one lies before the first: from +X towards +Y


def test_cross_has_a_centre_and_four_equal_arms() -> None:
    offsets = offsets_of(CrossLayout(kind="cross", arm=2, spacing_mm=3.0))
    arms = [(3.0 * k, 0.0) for k in range(-2, 3)] + [(0.0, 3.0 * k) for k in range(-2, 3)]
    assert len(offsets) == 9
    assert {(float(x), float(y)) for x, y in offsets} == {*arms}


@pytest.mark.slow_but_first
@pytest.mark.parametrize("layers", range(4))
def test_the_projection_kernel_and_the_traced_path_agree(layers: int) -> None:
    """For any order of indices, and for points outside the fluid."""
    rng = np.random.default_rng(layers)
    normal = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])
    air, *indices, fluid = rng.uniform(1.0, 2.4, layers + 2).tolist()
    stack = tuple(Layer("layer", index, float(rng.uniform(0.01, 20.0))) for index in indices)
    wall = Wall((3.0, -4.0, 5.0), triple(normal), air, stack, fluid)
    lens = {"principal_distance_mm": 85.0, "distortion": Distortion(k1=0.02, p2=-0.01)}
    place = {"center_mm": (1.0, 2.0, -400.0), "rotation": aimed_rotation(normal)}
    camera = make_camera(wall=wall, **lens, **place)
    points = rng.uniform(-150.0, 150.0, (3000, 3)) + np.array([0.0, 0.0, 100.0])
    points[7] = np.nan
    paths = trace_to_points(wall, np.asarray(camera.center_mm), points)
    expected, valid = camera.pixels_of(paths.leaving, paths.valid)
    pixels, also = camera.project(points)
    assert_array_equal(also, valid)
    assert 0.1 < valid.mean() < 1.0
    assert_allclose(pixels[valid], expected[valid], rtol=0.0, atol=1e-8)
    assert not replace(camera, center_mm=(1.0, 2.0, 80.0)).project(points)[1].any()
