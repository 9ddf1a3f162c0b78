"""Image pairs of particles in a light sheet of any place, without the simulation."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sabench.api import Camera, Grid, ImagePair, Observation
from sabench.evaluation.suite_loading import override
from sabench.scenes import build_rig, load_scene
from sabench.utils.arrays import F64, U16

POINT = np.array([0.0, 0.0, 131.5])
ALONG_Z = np.array([0.0, 0.0, 1.0])
GRID = Grid((-7.9, -6.3, 126.6), (0.2, 0.2, 0.2), (50, 64, 80))
INTERVAL_S = 0.01
Motion = Callable[[F64], F64]  # displacements (n, 3) of points (n, 3) in the interval


def tank_camera(**changes: Any) -> Camera:
    values = {"cameras.rows": 200, "cameras.columns": 240}
    scene = override(load_scene("vortex-ring-sheet"), values | changes, "sheet")
    return build_rig(scene, "sheet").cameras[0]


def image_pair(
    cameras: tuple[Any, ...],
    motion: Motion,
    normal: F64 = ALONG_Z,
    *,
    point_mm: F64 = POINT,
    grid: Grid = GRID,
    thickness_mm: float = 0.5,
    per_mm3: float = 12.0,
    seed: int = 0,
) -> ImagePair:
    """Photograph particles that a top-hat sheet lights, before and after a motion."""
    rng = np.random.default_rng(seed)
    size = 26.0
    count = round(per_mm3 * size**3 * (8.0 * thickness_mm / size))
    flat = rng.uniform(-size / 2.0, size / 2.0, (count, 3))
    away = rng.uniform(-4.0 * thickness_mm, 4.0 * thickness_mm, count)
    middle = point_mm + flat - np.outer(flat @ normal, normal) + np.outer(away, normal)
    move = motion(middle)
    frames = []
    for share in (-0.5, 0.5):
        places = middle + share * move
        lit = np.abs((places - point_mm) @ normal) <= thickness_mm / 2.0
        images = np.stack([photograph(camera, places[lit]) for camera in cameras])
        frames.append(Observation(images, cameras, grid, 0.0, 65535.0))
    return ImagePair(frames[0], frames[1], INTERVAL_S)


def photograph(camera: Any, points_mm: F64, peak_dn: float = 2000.0, sigma_px: float = 1.0) -> U16:
    image = np.zeros((camera.rows, camera.columns))
    pixels, valid = camera.project(points_mm)
    for column, row in pixels[valid & camera.contains(pixels, 5.0)]:
        rows = np.arange(max(round(row) - 5, 0), min(round(row) + 6, camera.rows))
        columns = np.arange(max(round(column) - 5, 0), min(round(column) + 6, camera.columns))
        down, across = (
            np.exp(-0.5 * ((part - at) / sigma_px) ** 2)
            for part, at in ((rows, row), (columns, column))
        )
        image[np.ix_(rows, columns)] += peak_dn * np.outer(down, across)
    return np.minimum(np.rint(image), 65535.0).astype(np.uint16)
