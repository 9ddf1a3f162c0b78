"""Planar PIV: known motions in sheets of any place, behind glass, and what it refuses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.velocimetry import find_sheet, light_in_sheet, sheet
from sabench.algorithms.velocimetry.windows import Windows, by_shifts
from sabench.api import Camera, Grid, ImagePair, Velocity
from sabench.api.make import make_algorithm
from sabench.geometry.grid import gradient, vorticity
from sabench.geometry.rigid_motion import frame_of_normal, rotation_matrices
from sabench.utils.arrays import F64
from sabench.utils.errors import DeclinedError
from tests.helpers import light_sheets
from tests.helpers.refusals import refused
from tests.helpers.small_particles import rotate_cameras

BOUND_PX = 0.1  # rms error of window correlation: M. Raffel et al., Particle Image Velocimetry
NORMALS = [light_sheets.ALONG_Z, np.array([0.0, 0.6, 0.8]), np.array([-0.48, 0.36, 0.8])]


@pytest.fixture(scope="module")
def camera() -> Camera:
    return light_sheets.tank_camera()


def solved(case: ImagePair, normal: F64 = light_sheets.ALONG_Z, **parameters: Any) -> Velocity:
    given = {"point_mm": light_sheets.POINT.tolist(), "normal": normal.tolist()} | parameters
    solver: Any = make_algorithm("piv2d", given)
    made: Velocity = solver.solve(case)
    return made


def errors_px(field: Velocity, motion: light_sheets.Motion, pixel_mm: float) -> F64:
    """Errors (n, 2) of the valid vectors in the plane, in pixels."""
    exact = motion(field.positions_mm.reshape(-1, 3)).reshape(field.velocity_mm_s.shape)
    away = field.components(field.velocity_mm_s * light_sheets.INTERVAL_S - exact) / pixel_mm
    return np.asarray(away[field.valid][:, :2])


def uniform(*move: float) -> light_sheets.Motion:
    return lambda points: np.tile(move, (len(points), 1))


def rms(errors: F64) -> float:
    return float(np.sqrt((errors**2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("normal", NORMALS)
def test_uniform_flow_is_recovered_in_any_plane(camera: Camera, normal: F64) -> None:
    move = np.array([0.147, -0.109, 0.0]) @ frame_of_normal(normal)  # 2.3 and -1.7 pixels
    motion = uniform(*move)
    field = solved(light_sheets.image_pair((camera,), motion, normal), normal)
    assert field.plane_axes is not None
    assert_allclose(field.axes[2], normal, atol=1e-9)
    assert_allclose((field.positions_mm - light_sheets.POINT) @ normal, 0.0, atol=1e-9)
    assert_allclose(field.velocity_mm_s @ normal, 0.0, atol=1e-9)
    errors = errors_px(field, motion, 0.063)
    assert field.valid.mean() > 0.75
    assert rms(errors) < BOUND_PX / 2.0  # no gradients, no noise
    assert np.abs(errors.mean(axis=0)).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("normal", NORMALS)
def test_a_rotation_is_recovered_in_any_plane(camera: Camera, normal: F64) -> None:
    turn = rotation_matrices(0.05 * normal)

    def motion(points: F64) -> F64:
        return np.asarray((points - light_sheets.POINT) @ (turn - np.eye(3)).T)

    field = solved(light_sheets.image_pair((camera,), motion, normal), normal)
    assert rms(errors_px(field, motion, 0.063)) < BOUND_PX
    own = field.in_own_axes()
    spin = vorticity(gradient(own.velocity_mm_s, own.step_mm))[..., 2][own.valid]
    assert np.median(spin) == pytest.approx(2.0 * np.sin(0.05) / light_sheets.INTERVAL_S, rel=0.02)


@pytest.mark.slow
def test_without_its_wall_a_camera_shows_another_scale(camera: Camera) -> None:
    case = light_sheets.image_pair((camera,), uniform(0.14, 0.0, 0.0))
    bare = replace(camera, wall=None)
    frames = [replace(one, cameras=(bare,)) for one in (case.first, case.second)]
    dry = ImagePair(frames[0], frames[1], light_sheets.INTERVAL_S)
    wet, air = (solved(one) for one in (case, dry))
    assert np.median(wet.velocity_mm_s[..., 0]) == pytest.approx(14.0, rel=0.003)
    assert np.median(air.velocity_mm_s[..., 0]) > 14.0 * 1.03


@pytest.mark.slow
def test_motion_across_the_sheet_costs_pairs(camera: Camera) -> None:
    """F_O = 1 - |dz| / t: R. D. Keane and R. J. Adrian, Appl. Sci. Res. 49 (1992) 191-215."""
    heights, valid = [], []
    for share in (0.0, 0.5, 1.5):
        case = light_sheets.image_pair((camera,), uniform(*(share * 0.5 * light_sheets.ALONG_Z)))
        sheet = find_sheet((camera,), light_sheets.GRID, (0.0, 0.0, 131.5), (0.0, 0.0, 1.0))
        first, second = (light_in_sheet(one, sheet, 64) for one in (case.first, case.second))
        windows = Windows.over((1, *sheet.seen.shape), (1, 32, 32), 0.5)
        heights.append(float(by_shifts(first, second, windows, (0, 1, 1)).height.mean()))
        valid.append(float(solved(case, least_height=0.3).valid.mean()))
    assert heights[0] > 0.95
    assert heights[1] / heights[0] == pytest.approx(0.5, abs=0.08)
    assert valid[0] > 0.75 > valid[2] + 0.5


def test_a_background_that_stands_still_does_not_count(camera: Camera) -> None:
    motion = uniform(0.147, -0.109, 0.0)
    case = light_sheets.image_pair((camera,), motion)
    columns = np.arange(camera.columns) / camera.columns
    glow = (300.0 + 500.0 * columns).astype(np.uint16)
    bright = [replace(one, images=one.images + glow) for one in (case.first, case.second)]
    field = solved(ImagePair(bright[0], bright[1], light_sheets.INTERVAL_S))
    assert rms(errors_px(field, motion, 0.063)) < BOUND_PX / 2.0


def test_the_sheet_lies_as_the_image_shows_it(camera: Camera) -> None:
    """Columns to the right, rows down, pixels as large as the camera's, all that it sees."""
    for angle in (0.0, 90.0, 180.0):
        roll = rotation_matrices(np.array([0.0, 0.0, np.deg2rad(angle)]))
        (rolled,) = rotate_cameras((camera,), roll)
        sheet = find_sheet((rolled,), light_sheets.GRID, (0.0, 0.0, 131.5), (0.0, 0.0, -1.0))
        assert_allclose(sheet.axes @ roll, np.eye(3), atol=1e-9)
        assert sheet.pixel_mm == pytest.approx(0.0628, abs=0.0003)
        seen = sheet.pixels[sheet.seen]
        assert (np.abs(seen - [119.5, 99.5]) < [120.0, 100.0]).all()
        # turned by 90 degrees, the camera sees beyond the grid
        assert np.ptp(seen[:, 0]) > (200.0 if angle == 90.0 else 238.0)
    sheet = find_sheet((camera,), replace(light_sheets.GRID, shape=(3, 64, 80)))
    assert sheet.axes[2].tolist() == [0, 0, 1]


def test_of_several_cameras_the_squarest_or_the_named_one_is_taken(camera: Camera) -> None:
    oblique = light_sheets.tank_camera(
        **{"cameras.layout.places": [{"center_mm": [250.0, 0.0, -580.0]}]}
    )
    pair = (replace(oblique, name="left"), replace(camera, name="front"))
    point, normal = (0.0, 0.0, 131.5), (0.0, 0.0, 1.0)
    assert find_sheet(pair, light_sheets.GRID, point, normal).camera == 1
    assert find_sheet(pair[::-1], light_sheets.GRID, point, normal).camera == 0
    assert find_sheet(pair, light_sheets.GRID, point, normal, "left").camera == 0
    with refused("camera", "left", "front", "right"):
        find_sheet(pair, light_sheets.GRID, point, normal, "right")


def test_a_camera_that_does_not_see_the_sheet_declines(camera: Camera) -> None:
    beyond = Grid((300.0, 0.0, 126.6), (0.2, 0.2, 0.2), (50, 64, 80))
    with refused("camera_00", kind=DeclinedError):
        find_sheet((camera,), beyond, (305.0, 5.0, 131.5), (0.0, 0.0, 1.0))
    with refused("2", kind=DeclinedError):
        find_sheet((camera, camera), beyond, (305.0, 5.0, 131.5), (0.0, 0.0, 1.0))
    with refused("camera_00", kind=DeclinedError):
        find_sheet((camera,), light_sheets.GRID, (0.0, 0.0, 131.5), (1.0, 0.0, 0.0))


def test_a_grid_of_one_plane_is_the_sheet_however_thick(camera: Camera) -> None:
    thick = Grid((-3.0, -3.0, 131.5), (0.1, 0.1, 10.0), (1, 60, 60))
    sheet = find_sheet((camera,), thick)
    assert sheet.axes[2].tolist() == [0.0, 0.0, 1.0]
    assert sheet.depth_mm == 10.0


def test_points_on_a_face_are_in_the_box() -> None:
    """A plane may coincide with a face; rounding puts its points on either side."""
    grid = Grid((0.1, -0.3, 7.7), (0.3, 0.3, 0.1), (5, 6, 7))
    low, high = grid.box_mm
    assert sheet._in_box(grid, np.array([low, high, low - 1e-10, high + 1e-10])).all()
    assert not sheet._in_box(grid, np.array([low - 1e-6, high + 1e-6])).any()
