"""Records of cameras, and polynomials that stand for cameras."""

import math

import numpy as np
import pytest

from sabench.geometry.camera import Camera, aim
from sabench.geometry.camera_records import read_camera, record_camera
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.volume_polynomials import fit_volume_polynomials, project_points
from tests.helpers.cameras import make_camera
from tests.helpers.refusals import refused

WALL = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.5, 6.0),), 1.333)
LOW, HIGH = np.array([-25.0, -15.0, 10.0]), np.array([25.0, 15.0, 60.0])


def camera(k1: float = 0.0) -> Camera:
    """An oblique view of the box, 800 px wide."""
    size = {"rows": 800, "columns": 1000, "principal_point_px": (500.0, 400.0)}
    lens = {"principal_distance_mm": 60.0, "distortion": Distortion(k1=k1, p1=1e-3)}
    plain = make_camera(center_mm=(120.0, -90.0, -300.0), wall=WALL, **size, **lens)
    return aim(plain, (0.0, 0.0, 36.0))


@pytest.mark.parametrize("k1", [0.0, -0.3, -1.5, 4.0])
def test_polynomials_are_the_camera_in_all_of_the_box(k1: float) -> None:
    exact = camera(k1)
    maps = fit_volume_polynomials([exact], LOW, HIGH)
    axis = np.linspace(-1.0, 1.0, 9)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    expected = exact.project(maps.middle_mm + maps.half_mm * points)[0]
    assert np.abs(project_points(maps, 0, points) - expected).max() < 1e-3


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_million_kilometres_are_the_largest_length(sign: float) -> None:
    record = record_camera(camera())
    far = {**record, "center_mm": (0.0, 0.0, sign * 1e12)}
    assert record_camera(read_camera(far, "cameras.json")) == far
    beyond = {**record, "center_mm": (0.0, 0.0, sign * math.nextafter(1e12, math.inf))}
    with refused("cameras.json", "center_mm"):
        read_camera(beyond, "cameras.json")
