"""Calibration targets, their points with and without images, and prior knowledge of them."""

import itertools
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import sabench
from sabench.algorithms.calibration.target_detection import detect_target
from sabench.api.truth import Target
from sabench.dataset.verification import verify
from sabench.geometry.camera import Camera, aim
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Layer
from sabench.geometry.rigid_motion import Pose
from sabench.scenes import build_rig
from sabench.scenes.calibration import Detection
from sabench.scenes.illumination import Lighting
from sabench.simulation.rendering.targets_traced import marker_bits, render
from sabench.utils.arrays import F64, U16
from sabench.worlds.calibration_targets import exact_pixels, found_pixels, pose_target, prior
from tests.helpers.calibration_cases import calibration_scene
from tests.helpers.refusals import refused

BOARDS = {
    "checkerboard": Target("checkerboard", 9, 7, 4.0, 0.0),
    "circles": Target("circles", 9, 7, 4.0, 2.0),
    "charuco": Target("charuco", 9, 7, 4.0, 3.0),
    "wand": Target("wand", 3, 1, 12.0, 3.0),
}
PLACES = [-300.0, -100.0, -400.0], [300.0, 100.0, -400.0]
LAMPS = Lighting.model_validate({"lamps": [{"center_mm": place} for place in PLACES]})
MIDDLE = np.array([0.0, 0.0, 35.0])
TURN = np.array([[0.98, -0.1, 0.0], [0.1, 0.98, 0.0], [0.0, 0.0, 1.0]]) / np.hypot(0.98, 0.1)
POSE = Pose(TURN, np.array([1.0, -2.0, 40.0]))
GLASS = (Layer("glass", 1.5, 5.0),)
ROUND = CylinderWall((0.0, 0.0, 90.0), (0.0, 1.0, 0.0), 90.0, 1.0, GLASS, 1.333)


def small_camera(wall: CylinderWall | None = None) -> Camera:
    """A corner camera behind the wall, or another, with images of 400 x 400 pixels."""
    scene = calibration_scene(cameras={"rows": 400, "columns": 400, "pixel_mm": 0.03})
    camera = build_rig(scene).cameras[0]
    return aim(replace(camera, wall=wall), MIDDLE) if wall else camera


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "wall", "spread", "bias"),
    [
        ("checkerboard", None, 0.04, 0.03),
        ("circles", None, 0.05, 0.04),
        ("charuco", None, 0.1, 0.05),
        ("checkerboard", ROUND, 0.04, 0.03),
    ],
)
def test_a_rendered_board_is_found_where_it_is(
    pattern: str, wall: CylinderWall | None, spread: float, bias: float
) -> None:
    """Mitsuba's rays, our projection and OpenCV's detectors agree to hundredths of a pixel."""
    camera, target = small_camera(wall), BOARDS[pattern]
    grey = photographed(render(camera, target, POSE, LAMPS, MIDDLE, 16), noise=3.0)
    errors = detect_target(grey, target) - camera.project(POSE(target.points_mm))[0]
    assert np.isfinite(errors).all()
    assert np.abs(errors.mean(axis=0)).max() < bias
    assert errors.std(axis=0).max() < spread


def photographed(picture: F64, level: float = 0.0, noise: float = 0.0) -> U16:
    grey = np.random.default_rng(0).normal(level + 2800.0 * picture, noise)
    return np.clip(grey, 0.0, 4095.0).astype(np.uint16)


@pytest.mark.slow
def test_a_rendered_wand_is_found_on_its_lit_side() -> None:
    camera, target = small_camera(), BOARDS["wand"]
    grey = photographed(render(camera, target, POSE, LAMPS, MIDDLE, 16))
    assert (
        np.abs(detect_target(grey, target) - camera.project(POSE(target.points_mm))[0]).max() < 0.5
    )


@pytest.mark.slow
def test_small_glowing_balls_are_found_where_they_are() -> None:
    """Uniformly bright balls that cover less than a thousandth of a noisy image."""
    camera, target = small_camera(), Target("wand", 3, 1, 12.0, 1.0)
    picture = render(camera, target, POSE, LAMPS.model_copy(update={"even": 1.0}), MIDDLE, 16)
    assert picture.max() == pytest.approx(0.7, rel=0.05)
    found = detect_target(photographed(picture, 50.0, 5.0), target)
    assert np.abs(found - camera.project(POSE(target.points_mm))[0]).max() < 0.15


def test_exposure_is_what_was_asked_for() -> None:
    """White in the middle of the volume reaches it; black print 4 % of that."""
    camera, target, facing = small_camera(), BOARDS["circles"], Pose(np.eye(3), MIDDLE)
    picture = render(camera, target, facing, LAMPS.model_copy(update={"exposure": 0.5}), MIDDLE, 16)
    assert picture.max() == pytest.approx(0.5, rel=0.05)
    column, row = camera.project(facing(target.points_mm))[0][31].round().astype(int)
    assert picture[row, column] == pytest.approx(0.04 * 0.5, rel=0.1)


def test_our_charuco_board_is_opencv_s() -> None:
    target, cell = BOARDS["charuco"], 16
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    board = cv2.aruco.CharucoBoard((10, 8), target.pitch_mm, target.mark_mm, dictionary)
    drawn = board.generateImage((10 * 8 * cell, 8 * 8 * cell))
    bits, number = marker_bits(target), 0
    for row, column in itertools.product(range(8), range(10)):
        square = drawn.reshape(8, 8 * cell, 10, 8 * cell)[row, :, column]
        if (row + column) % 2 == 0:
            assert square.max() == 0
            continue
        cells = square[cell:-cell, cell:-cell].reshape(6, cell, 6, cell)[:, cell // 2, :, cell // 2]
        assert_array_equal(cells.ravel() > 0, bits[number])
        number += 1
    assert number == len(bits) == 40


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_board_s_points_keep_their_names_however_it_lies(quarters: int) -> None:
    """The initial guess tells rotations of circles apart, which look the same."""
    target = Target("circles", 5, 4, 4.0, 2.0)
    angle = np.deg2rad(90.0 * quarters + 12.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    pixels = target.points_mm[:, :2] @ turn.T * 20.0 + 300.0
    image = np.full((600, 600), 200, dtype=np.uint8)
    for x, y in np.rint(16.0 * pixels).astype(int).tolist():
        cv2.circle(image, (x, y), 20 * 16, 20, -1, cv2.LINE_AA, 4)
    rough = target.points_mm[:, :2] @ turn.T * 17.0 + [120.0, 410.0]
    assert_allclose(detect_target(image.astype(np.uint16) * 10, target, rough), pixels, atol=0.3)


def test_boards_stay_in_the_volume_and_move_through_it() -> None:
    scene = calibration_scene(targets={"pitch_mm": 3.0, "tilt_deg": 20.0}, frames=7)
    points = pose_target(scene, 3).points_mm
    half = np.asarray(scene.volume.size_mm) / 2.0
    assert (np.abs(points - scene.volume.center_mm) <= half + 1e-9).all()
    assert (np.diff(points[..., 2].mean(axis=1)) > 3.0).all()
    assert_array_equal(pose_target(scene, 3).points_mm, points)


def test_what_detection_does_to_points() -> None:
    scene = calibration_scene()
    exact = exact_pixels(build_rig(scene).cameras[0], pose_target(scene, 1).points_mm)
    found, outliers = found_pixels(Detection(noise_px=0.2), exact, 1, 0)
    assert (found - exact).std() == pytest.approx(0.2, rel=0.05)
    assert not outliers.any()
    found, _ = found_pixels(Detection(missing=0.3), exact, 1, 0)
    assert np.isnan(found[..., 0]).mean() == pytest.approx(0.3, abs=0.05)
    assert_array_equal(found[np.isfinite(found)], exact[np.isfinite(found)])
    found, outliers = found_pixels(Detection(outliers=0.2, outlier_px=50.0), exact, 1, 0)
    assert outliers.mean() == pytest.approx(0.2, abs=0.05)
    assert_array_equal(found[~outliers], exact[~outliers])
    mean = np.linalg.norm(found - exact, axis=-1)[outliers].mean()
    assert mean == pytest.approx(50.0 * np.sqrt(np.pi / 2.0), rel=0.2)


def test_something_may_hide_a_part_of_a_board() -> None:
    scene = calibration_scene()
    exact = exact_pixels(build_rig(scene).cameras[0], pose_target(scene, 1).points_mm)
    found, _ = found_pixels(Detection(hidden=0.99), exact, 2, 0)
    seen = np.isfinite(found[..., 0])
    assert seen.mean(axis=1).min() > 0.1
    assert seen.mean(axis=1).max() < 0.95
    for there, points in zip(seen, exact, strict=True):
        inside = cv2.convexHull(points[there].astype(np.float32))
        for x, y in points[~there].tolist():
            assert cv2.pointPolygonTest(inside, (x, y), False) <= 0.0


def test_a_prior_holds_known_points_along_their_axes_only() -> None:
    given = {"frame": 1, "point": 5, "axes": "xz", "sigma_mm": 0.02}
    scene = calibration_scene(calibration={"known": [given]})
    placed = pose_target(scene, 1)
    known = prior(scene, placed, 1)
    assert np.isfinite(known.known_mm).sum() == 2
    assert_allclose(known.known_mm[1, 5, [0, 2]], placed.points_mm[1, 5, [0, 2]], atol=0.1)
    wrong = calibration_scene(calibration={"known": [{"frame": 9, "point": 5}]})
    with refused("calibration.known.0", "5"):
        prior(wrong, pose_target(wrong, 1), 1)


def test_a_target_s_data_set_is_whole_and_holds_what_was_shown(tmp_path: Path) -> None:
    scene = calibration_scene()
    data = sabench.generate(scene, tmp_path / "set", seed=4, backend="splat", name="boards")
    assert verify(data.root) == []
    case, placed = data.calibration_case(), data.placed()
    exact, outliers = data.sightings()
    assert_array_equal(placed.points_mm, pose_target(scene, 4).points_mm)
    assert case.target == placed.target
    errors: F64 = case.pixels - exact
    assert np.nanstd(errors) == pytest.approx(0.1, rel=0.05)
    assert not outliers.any()
    assert data.true_cameras != data.setup.cameras
    with refused("camera_00"):
        data.observation(0)
    (data.root / "points.h5").unlink()
    assert verify(data.root)


def test_a_target_without_lamps_is_not_rendered(tmp_path: Path) -> None:
    with refused("boards: lighting"):
        sabench.generate(calibration_scene(), tmp_path / "set", backend="mitsuba", name="boards")
    assert list(tmp_path.iterdir()) == []
