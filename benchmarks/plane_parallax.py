"""Error of `plane_parallax` against what it cannot model, over seeds.

Run python benchmarks/plane_parallax.py [SEEDS]. Nine cameras of the scene `calibration`, a board of
11 x 11 points on seven level planes, 0.1 px of noise: mean true reprojection error in px with its
95 % interval, and how many runs warned.
"""

import sys
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.api import CalibrationCase, Camera
from sabench.api.make import make_algorithm
from sabench.geometry.camera import aim
from sabench.geometry.lens import Distortion
from sabench.scenes import build_rig, load_scene, parse_scene
from sabench.utils.confidence import mean_of
from sabench.worlds.calibration_targets import exact_pixels, pose_target

NOISE_PX, AIM = 0.1, (0.0, 0.0, 35.0)
LEVEL = {"tilt_deg": 0.0, "roll_deg": 0.0, "wander": 0.3}


def make_case(
    seed: int, *, wall: bool = False, off_mm: float = 0.0, k1: float = 0.0
) -> tuple[CalibrationCase, np.ndarray, np.ndarray]:
    """Make a case with cameras off their plane at random, a wall, or distortion."""
    values: dict[str, Any] = load_scene("calibration").to_dict() | {"frames": 7}
    values["targets"] |= LEVEL
    if not wall:
        values.pop("wall")
    scene, rng = parse_scene(values, "benchmark"), np.random.default_rng(seed)
    cameras = [move(one, off_mm * rng.standard_normal(), k1) for one in build_rig(scene).cameras]
    placed = pose_target(scene, seed)
    exact = np.stack([exact_pixels(camera, placed.points_mm) for camera in cameras])
    pixels = exact + NOISE_PX * rng.standard_normal(exact.shape)
    nothing = np.full(placed.points_mm.shape, np.nan)
    case = CalibrationCase(
        placed.target, pixels, tuple(cameras), placed.points_mm, nothing, nothing
    )
    return case, placed.points_mm, exact


def move(camera: Camera, off_mm: float, k1: float) -> Camera:
    """Move a camera along Z, aim it again, and distort its lens."""
    x, y, z = camera.center_mm
    moved = replace(camera, center_mm=(x, y, z + off_mm))
    return replace(aim(moved, AIM), distortion=Distortion(k1, 0.0, 0.0, 0.0, 0.0))


def measure(name: str, seeds: range, **departure: Any) -> None:
    """Print one line of the table for each solver."""
    for solver in ("plane_parallax", "pinhole_linear"):
        errors, warned = [], 0
        for seed in seeds:
            case, points, exact = make_case(seed, **departure)
            algorithm: Any = make_algorithm(solver, {})
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                answer = algorithm.solve(case)
            warned += bool(caught)
            again = [one.project(points.reshape(-1, 3))[0] for one in answer.cameras]
            off = np.stack(again).reshape(exact.shape) - exact
            errors.append(float(np.nanmean(np.linalg.norm(off, axis=-1))))
        mean = mean_of(errors)
        assert mean is not None
        print(
            f"{name:<30} {solver:<15} {mean.mean:8.4f} +- {mean.half_width or 0.0:.4f} px, "
            f"warned {warned} of {len(seeds)}",
            flush=True,
        )


def main(count: int) -> None:
    """Measure all departures."""
    seeds = range(1, count + 1)
    measure("none", seeds)
    for off in (1.0, 3.0, 10.0, 30.0):
        measure(f"cameras off the plane, {off:g} mm", seeds, off_mm=off)
    for k1 in (-0.05, -0.2, -0.8):
        measure(f"distortion k1 = {k1:g}", seeds, k1=k1)
    measure("5 mm of glass, then water", seeds, wall=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
