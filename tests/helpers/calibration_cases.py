"""Arrays and boards that the tests of calibrations share."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import BoardImages, residuals
from sabench.algorithms.calibration.parameters import State
from sabench.api import CalibrationCase
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.scenes import Scene, build_rig, load_scene, parse_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.utils.arrays import F64
from sabench.worlds.calibration_targets import exact_pixels, found_pixels, pose_target, prior


def calibration_scene(**changes: Any) -> Scene:
    """The bundled scene with some tables changed; a table of None is left out."""
    values = load_scene("calibration").to_dict()
    for key, value in changes.items():
        if value is None:
            values.pop(key, None)
        elif isinstance(value, dict):
            values[key] = values.get(key, {}) | value
        else:
            values[key] = value
    return parse_scene(values, "test")


def case_of(scene: Scene, seed: int = 1) -> tuple[CalibrationCase, tuple[Camera, ...], F64, F64]:
    """Return a case, the cameras, points (frame, point, 3) in mm, and exact pixels by camera."""
    cameras, placed = build_rig(scene).cameras, pose_target(scene, seed)
    exact = np.stack([exact_pixels(camera, placed.points_mm) for camera in cameras])
    pixels = np.stack(
        [found_pixels(scene.detection, own, seed, number)[0] for number, own in enumerate(exact)]
    )
    known = prior(scene, placed, seed)
    nominal = nominal_cameras(scene, cameras, seed)
    case = CalibrationCase(
        placed.target,
        pixels,
        nominal,
        known.initial_mm,
        known.known_mm,
        known.known_sigma_mm,
        scene.unknown,
        bool(scene.calibration and scene.calibration.known_cameras),
    )
    return case, cameras, placed.points_mm, exact


def board_images(case: CalibrationCase, pixels: F64) -> BoardImages:
    """The images of a case's points, with other pixels; NaN is not seen."""
    weights = np.asarray(np.isfinite(pixels).all(axis=-1), dtype=np.float64)
    return BoardImages(case.target.points_mm, np.nan_to_num(pixels), weights)


def misses(state: State, seen: BoardImages) -> F64:
    """Residuals (n, 2) of the points that are seen, px."""
    return np.asarray(residuals(state, seen)[seen.weights > 0.0])


def true_error_px(cameras: Any, points_mm: F64, exact: F64) -> float:
    """Mean distance of points' projections from where they truly are."""
    flat = points_mm.reshape(-1, 3)
    again = np.stack([camera.project(flat)[0] for camera in cameras]).reshape(exact.shape)
    return float(np.nanmean(np.linalg.norm(again - exact, axis=-1)))


def write_points(path: Path, pixels: F64, cameras: tuple[CameraModel, ...]) -> None:
    """Write found points (camera, frame, point, 2) as `sabench calibrate` reads them."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["camera", "frame", "point", "column", "row"])
        for c, k, i in np.argwhere(np.isfinite(pixels[..., 0])).tolist():
            writer.writerow([cameras[c].name, k, i, *pixels[c, k, i]])
