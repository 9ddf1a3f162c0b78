"""Small tanks for tests of calibrations: three cameras, six boards, errors as asked for."""

from dataclasses import replace
from typing import Any

import numpy as np

from sabench.algorithms.calibration.resection import place_boards
from sabench.api import Calibration, CalibrationCase
from sabench.api.make import make_algorithm
from sabench.api.truth import Target
from sabench.geometry.camera import Camera, aim
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.utils.arrays import F64, triple
from tests.helpers.cameras import ALONG_Z, make_camera
from tests.helpers.small_particles import rotate_cameras

BOARD = Target("checkerboard", 6, 5, 10.0, 0.0)
MIDDLE = np.array([0.0, 0.0, 70.0])
WALL = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.5, 8.0),), 1.333)
_CENTERS = ((-180.0, -60.0, -430.0), (190.0, -50.0, -450.0), (10.0, 170.0, -440.0))


def make_tank(
    *, k1: float = 0.0, bend_mm: float = 0.0, noise_px: float = 0.05, seed: int = 1
) -> tuple[CalibrationCase, tuple[Camera, ...], F64]:
    """Return a case, the true cameras and the true places (frame, point, 3). The nominal cameras
    are off by about 10 mm, and the boards all at one nominal place."""
    rng = np.random.default_rng(seed)
    cameras = tuple(_camera(number, center, k1) for number, center in enumerate(_CENTERS))
    board = BOARD.points_mm.copy()
    board[:, 2] = bend_mm * (1.0 - (board[:, 0] ** 2 + board[:, 1] ** 2) / 25.0**2)
    points = []
    for depth in rng.permutation(np.linspace(-20.0, 20.0, 6)).tolist():
        turn = rotation_matrices(np.deg2rad([25.0, 25.0, 15.0]) * rng.uniform(-1.0, 1.0, 3))
        points.append(board @ turn.T + MIDDLE + [*rng.uniform(-8.0, 8.0, 2), depth])
    places = np.stack(points)
    pixels = np.stack([camera.project(places.reshape(-1, 3))[0] for camera in cameras])
    pixels += noise_px * rng.standard_normal(pixels.shape)
    nominal = tuple(
        aim(
            replace(
                camera,
                center_mm=triple(np.asarray(camera.center_mm) + 10.0 * rng.standard_normal(3)),
                distortion=Distortion(),
            ),
            MIDDLE,
        )
        for camera in cameras
    )
    unknown = np.full(places.shape, np.nan)
    initial = np.tile(BOARD.points_mm + MIDDLE, (6, 1, 1))
    shape = (3, 6, 30, 2)
    case = CalibrationCase(BOARD, pixels.reshape(shape), nominal, initial, unknown, unknown.copy())
    return case, cameras, places


def with_places(case: CalibrationCase, places: F64, sigma_mm: float = 0.01) -> CalibrationCase:
    noise = sigma_mm * np.random.default_rng(3).standard_normal(places.shape)
    return replace(case, known_mm=places + noise, known_sigma_mm=np.full(places.shape, sigma_mm))


def off_wall(case: CalibrationCase, shift_mm: float) -> CalibrationCase:
    wall = replace(WALL, point_mm=(0.0, 0.0, shift_mm))
    return replace(case, cameras=tuple(replace(camera, wall=wall) for camera in case.cameras))


def solve(case: CalibrationCase, **parameters: Any) -> Calibration:
    solver: Any = make_algorithm("refractive_autocal", parameters)
    answer: Calibration = solver.solve(replace(case, initial_mm=place_boards(case)))
    return answer


def rotated(case: CalibrationCase, rotation: F64) -> CalibrationCase:
    return replace(
        case,
        cameras=rotate_cameras(case.cameras, rotation),
        initial_mm=case.initial_mm @ rotation.T,
        known_mm=case.known_mm @ rotation.T,
    )


def _camera(number: int, center: tuple[float, float, float], k1: float) -> Camera:
    camera = make_camera(
        name=f"camera_{number:02d}",
        rows=800,
        columns=900,
        center_mm=center,
        rotation=ALONG_Z,
        principal_distance_mm=50.0 + number,
        principal_point_px=(449.5, 399.5),
        distortion=Distortion(k1=k1),
        focal_length_mm=50.0,
        f_number=11.0,
        wall=WALL,
    )
    return aim(camera, MIDDLE + np.array([3.0, -2.0, 5.0]))
