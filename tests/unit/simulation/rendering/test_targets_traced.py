"""Pictures of calibration targets, against lines of sight and lamps followed by hand."""

import itertools

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sabench.api.truth import Target
from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall, trace_to_points, transmittance
from sabench.geometry.rigid_motion import Pose
from sabench.scenes.illumination import Lamp, Lighting
from sabench.simulation.rendering.lamps import place_lamps
from sabench.simulation.rendering.targets_traced import render
from sabench.utils import backend
from sabench.utils.arrays import F64

GLASS = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.5, 6.0),), 1.333)
CENTER = np.array([0.0, 0.0, 60.0])
LAMPS = Lighting(
    lamps=(Lamp(center_mm=(40.0, -30.0, 20.0)), Lamp(center_mm=(-60.0, 20.0, 10.0), power=2.0)),
    exposure=0.6,
    even=0.3,
)
POSE = Pose(Rotation.from_euler("xyz", [0.2, -0.25, 0.4]).as_matrix(), np.array([1.0, -0.5, 61.0]))
BLACK = 0.04


def camera(wall: Wall | None, rows: int = 90, columns: int = 110) -> Camera:
    rotation = aimed_rotation(np.array([0.03, -0.02, 1.0]))
    middle, center = ((columns - 1) / 2.0, (rows - 1) / 2.0), (-9.0, 6.0, -240.0)
    lens = Distortion(k1=-0.1)
    return Camera(
        "one", rows, columns, center, rotation, 60.0, 0.04, middle, lens, 50.0, 32.0, wall
    )


def on_board(one: Camera, pixels: F64) -> tuple[F64, F64]:
    """World points (n, 3) and the board's x, y (n, 2) where lines of sight meet its plane."""
    rays, normal = one.back_project(pixels), POSE.rotation[:, 2]
    length = ((POSE.position_mm - rays.origins_mm) @ normal) / (rays.directions @ normal)
    places = rays.origins_mm + length[:, None] * rays.directions
    return places, ((places - POSE.position_mm) @ POSE.rotation)[:, :2]


def painted(target: Target, places: F64) -> F64:
    x, y = places.T / target.pitch_mm
    if target.pattern == "circles":
        apart = np.linalg.norm(places[:, None] - target.points_mm[None, :, :2], axis=2)
        black = apart.min(axis=1) < target.mark_mm / 2.0
    else:  # the corner between squares i and i + 1 is point i: the first square is black
        columns, rows = target.columns + 1, target.rows + 1
        i, j = np.floor(x + columns / 2.0), np.floor(y + rows / 2.0)
        black = (i >= 0) & (i < columns) & (j >= 0) & (j < rows) & ((i + j) % 2 == 0)
    half = np.array([target.columns + 1, target.rows + 1]) / 2.0 + 0.75
    outside = (np.abs(places / target.pitch_mm) > half).any(axis=1)
    return np.where(outside, 0.0, np.where(black, BLACK, 1.0))


def light(one: Camera, places: F64, normal: F64) -> F64:
    """Irradiance (n,) on a surface: point lamps' inverse squares, and what is even."""
    lamps = place_lamps(LAMPS, one, CENTER, np.zeros(3))
    total = np.full(len(places), lamps.ambient)
    for position, power in zip(lamps.positions, lamps.powers, strict=True):
        way = position - places
        distance = np.linalg.norm(way, axis=1)
        total += power * np.maximum(np.sum(way * normal, axis=1), 0.0) / distance**3
    return total


@pytest.mark.parametrize("pattern", ["checkerboard", "circles"])
@pytest.mark.parametrize("wall", [None, GLASS])
def test_a_board_is_seen_where_lines_of_sight_meet_it(pattern: str, wall: Wall | None) -> None:
    """Pixels whose surroundings have one reflectance, by it, the lamps and the wall."""
    one = camera(wall)
    diameter_mm = 2.0 if pattern == "circles" else 0.0
    target = Target(pattern, 4, 2, 3.0, diameter_mm)  # type: ignore[arg-type]
    image = render(one, target, POSE, LAMPS, CENTER, 16)
    row, column = np.mgrid[0 : one.rows, 0 : one.columns]
    pixels = np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    steps = itertools.product((-2.0, -1.0, 0.0, 1.0, 2.0), repeat=2)
    around = [painted(target, on_board(one, pixels + np.array(step))[1]) for step in steps]
    sure = np.ptp(around, axis=0) == 0.0
    places, _ = on_board(one, pixels)
    towards = -POSE.rotation[:, 2]  # a board shows its pattern towards its -Z
    pinhole = np.asarray(one.center_mm)
    leaving = trace_to_points(wall, pinhole, places).leaving
    ahead = np.asarray(one.rotation[2] if wall is None else wall.normal)
    passed = transmittance(wall, pinhole, leaving) / transmittance(wall, pinhole, ahead[None])
    share = (one.etendue() / one.etendue().max()).ravel()
    expected = around[12] * light(one, places, np.tile(towards, (len(places), 1))) * passed * share
    for value in (0.0, BLACK, 1.0):
        assert (sure & (around[12] == value)).sum() > 100
    np.testing.assert_allclose(image.ravel()[sure], expected[sure], rtol=0.01, atol=1e-4)


def test_a_white_surface_that_faces_the_wall_has_its_exposure() -> None:
    for wall in (None, GLASS):
        lens = camera(wall)
        facing = np.asarray(lens.rotation[2] if wall is None else wall.normal)
        assert light(lens, CENTER[None], -facing[None]) == pytest.approx([0.6])
        half = place_lamps(LAMPS, lens, CENTER, np.array([1.0, 2.0, 3.0]), scale=0.5)
        whole = place_lamps(LAMPS, lens, CENTER, np.zeros(3))
        assert half.ambient == pytest.approx(0.5 * 0.3 * 0.6)  # 30 % of the light is even
        np.testing.assert_allclose(half.powers, 0.5 * whole.powers)
        np.testing.assert_allclose(half.positions + np.array([1.0, 2.0, 3.0]), whole.positions)


def test_opencv_reads_a_charuco_board() -> None:
    one, target = camera(None, 300, 400), Target("charuco", 4, 3, 12.0, 8.0)
    image = render(one, target, POSE, LAMPS, CENTER, 16)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    board = cv2.aruco.CharucoBoard((5, 4), 12.0, 8.0, dictionary)
    grey = np.clip(image * 255.0, 0.0, 255.0).astype(np.uint8)
    corners, numbers, _, markers = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    assert numbers is not None
    assert sorted(markers.ravel()) == list(range(10))
    order = np.argsort(numbers.ravel())
    exact, _ = one.project(POSE(target.points_mm))
    assert np.sort(numbers.ravel()).tolist() == list(range(12))
    np.testing.assert_allclose(corners.reshape(-1, 2)[order], exact, atol=0.2)


def test_a_wand_is_two_balls_in_the_dark() -> None:
    one, target = camera(GLASS), Target("wand", 2, 1, 8.0, 3.0)
    image = render(one, target, POSE, LAMPS, CENTER, 16)
    row, column = np.mgrid[0 : one.rows, 0 : one.columns]
    rays = one.back_project(np.column_stack([column.ravel(), row.ravel()]).astype(np.float64))
    offset = POSE(target.points_mm)[:, None] - rays.origins_mm
    apart = np.linalg.norm(np.cross(offset, rays.directions), axis=2).min(axis=0)
    lit = image.ravel() > 0.02
    assert lit[apart < 1.3].all()
    assert not lit[apart > 1.75].any()


@pytest.mark.parametrize("part", [0.382, 0.618])
def test_sampling_patterns_are_even(part: float) -> None:
    backend.mitsuba()
    from sabench.simulation.rendering.target_integrator import _spiral, _stride

    for count in (2, 9, 16, 30, 64):
        step = _stride(count, part)
        assert len({step * number % count for number in range(count)}) == count
        assert step > part * count  # neighbours in number are far apart
        points = _spiral(count)
        np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-12)
        assert np.mean(points**2) == pytest.approx(0.25 * (count - count % 2) / count)
