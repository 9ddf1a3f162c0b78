"""A camera in air whose values tests change."""

from dataclasses import replace
from typing import Any

import numpy as np

from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.lens import Distortion

ALONG_Z = aimed_rotation(np.array([0.0, 0.0, 1.0]))


def make_camera(**changes: Any) -> Camera:
    """A small oblique camera with a wide view, with some values changed."""
    camera = Camera(
        name="camera_00",
        rows=300,
        columns=500,
        center_mm=(13.0, -27.0, -400.0),
        rotation=aimed_rotation(np.array([0.1, -0.05, 1.0])),
        principal_distance_mm=6.0,
        pixel_mm=0.01,
        principal_point_px=(260.0, 140.0),
        distortion=Distortion(),
        focal_length_mm=5.0,
        f_number=8.0,
    )
    return replace(camera, **changes)
