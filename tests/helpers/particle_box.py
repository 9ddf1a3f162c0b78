"""Four cameras behind glass that see a box, and points in it."""

import numpy as np

from sabench.geometry.camera import Camera, aim
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64
from tests.helpers.cameras import ALONG_Z, make_camera

Maps = VolumePolynomials
WALL = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.5, 6.0),), 1.333)
LOW, HIGH = np.array([-7.0, -5.0, 30.0]), np.array([7.0, 5.0, 42.0])
ROWS, COLUMNS = 160, 200


def camera(x: float, y: float) -> Camera:
    """About 11 px a millimetre; the whole box is on the sensor."""
    plain = make_camera(
        rows=ROWS,
        columns=COLUMNS,
        center_mm=(x, y, -300.0),
        rotation=ALONG_Z,
        principal_distance_mm=36.0,
        principal_point_px=(101.0, 78.0),
        distortion=Distortion(k1=-0.2, p1=1e-3),
        focal_length_mm=32.0,
        wall=WALL,
    )
    return aim(plain, (0.0, 0.0, 36.0))


CAMERAS = [camera(-90.0, -60.0), camera(90.0, -60.0), camera(90.0, 60.0), camera(-90.0, 60.0)]


def unit_points(count: int, seed: int = 1) -> F64:
    """Points of the box, from -1 to 1 along each axis."""
    return np.random.default_rng(seed).uniform(-0.95, 0.95, (count, 3))


def distances(found: F64, points: F64, maps: Maps) -> F64:
    """Distances of points from the nearest position that was found, mm."""
    apart = (points[:, None] - found[None]) * maps.half_mm
    return np.asarray(np.linalg.norm(apart, axis=2).min(axis=1, initial=np.inf))
