"""Calibrations of tanks whose lenses, walls and boards have errors that no model has.

`python benchmarks/calibration_reality.py [starts] [record.json]` prints JSON, or writes it. Points
are projected, not rendered: 0.05 px of noise, four cameras, ten boards of 11 x 11 points. Every
start has an initial guess of its own, as of a ruler: cameras off by 30 mm and 1 degree, principal
distances by 5 %, the target by 20 mm.

For each tank: how often the end state is right, the error of held-out points beside that of the
right model fitted to the same data, and the expected errors of the report beside the true one.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.algorithms.calibration.initial_poses import place_boards
from sabench.api import Calibration, CalibrationCase
from sabench.api.make import make_algorithm
from sabench.api.truth import Target
from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.lens_distortion import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.rigid_motion import fit_lateral_motion, fit_rigid_motion
from sabench.geometry.rotations import rotation_matrices
from sabench.geometry.triangulation import triangulate
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json
from sabench.utils.progress import progress_bar

_NOISE_PX = 0.05
_BOARDS = 10
_TARGET = Target("checkerboard", 11, 11, 6.0, 0.0)
_MIDDLE = np.array([0.0, 0.0, 80.0])
_HALF = np.array([35.0, 35.0, 35.0])  # of the volume of held-out points
_WALL = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.5, 10.0),), 1.333)
_RIGHT = 2.0  # times the error of the same fit from the truth, below which an end state is right
_TRUTH = ("principal_point", "k1", "k2", "p1", "p2", "k3", "tilt")


@dataclass(frozen=True)
class Errors:
    """Errors that a tank has and a model may not have."""

    k3: float = 0.0
    tilt_deg: float = 0.0
    wall_mm: float = 0.0
    bend_mm: float = 0.0
    places: bool = False


TANKS = {
    "ideal": Errors(),
    "k3": Errors(k3=400.0),
    "tilted sensor": Errors(tilt_deg=0.7),
    "board bent by 0.2 mm": Errors(bend_mm=0.2),
    "all of these": Errors(400.0, 0.7, 0.0, 0.2),
    "known places": Errors(places=True),
    "known places, wall off by 50 mm": Errors(wall_mm=50.0, places=True),
    "known places, all of these": Errors(400.0, 0.7, 50.0, 0.2, places=True),
}


@dataclass(frozen=True)
class Tank:
    """A tank and what its cameras saw.

    Attributes
    ----------
    cameras, points_mm : true cameras, and true places (frame, point, 3) of the target's points.
    case : what an experimenter has, without an initial guess.
    """

    cameras: tuple[Camera, ...]
    points_mm: F64
    case: CalibrationCase


def make_tank(errors: Errors, seed: int) -> Tank:
    """Make a tank, its cameras and boards by chance."""
    rng = np.random.default_rng([seed, 1])
    cameras = tuple(_camera(number, errors, rng) for number in range(4))
    board = _TARGET.points_mm.copy()
    half = float(np.abs(board).max())
    board[:, 2] = errors.bend_mm * (1.0 - (board[:, 0] ** 2 + board[:, 1] ** 2) / half**2 / 2.0)
    depths = rng.permutation(np.linspace(-25.0, 25.0, _BOARDS))
    places = []
    for depth in depths.tolist():
        turn = rotation_matrices(np.deg2rad([20.0, 20.0, 10.0]) * rng.uniform(-1.0, 1.0, 3))
        shift = _MIDDLE + [*rng.uniform(-8.0, 8.0, 2), depth]
        places.append(board @ turn.T + shift)
    points = np.stack(places)
    pixels = np.stack([camera.project(points.reshape(-1, 3))[0] for camera in cameras])
    pixels += _NOISE_PX * rng.standard_normal(pixels.shape)
    for camera, own in zip(cameras, pixels, strict=True):
        own[~camera.contains(own)] = np.nan
    known, sigma = np.full(points.shape, np.nan), np.full(points.shape, np.nan)
    if errors.places:
        known, sigma = points + 0.01 * rng.standard_normal(points.shape), np.full(points.shape, 0.01)
    else:
        known[0, 60, 2] = points[0, 60, 2] + 0.05 * rng.standard_normal()
        sigma[0, 60, 2] = 0.05
    wall = replace(_WALL, point_mm=(0.0, 0.0, -errors.wall_mm))
    nominal = tuple(_nominal(camera, wall, rng) for camera in cameras)
    shape = (len(cameras), *points.shape[:2], 2)
    case = CalibrationCase(_TARGET, pixels.reshape(shape), nominal, known, known, sigma)
    return Tank(cameras, points, case)


def _camera(number: int, errors: Errors, rng: np.random.Generator) -> Camera:
    x, y = 200.0 * (-1) ** number, 150.0 * (-1) ** (number // 2)
    center = np.array([x, y, -520.0]) + 20.0 * rng.standard_normal(3)
    tilt = errors.tilt_deg * rng.choice([-1.0, 1.0], 2)
    made = Camera(
        f"camera_{number:02d}",
        1200,
        1200,
        triple(center),
        aimed_rotation(np.array([0.0, 0.0, 1.0])),
        60.0 * (1.0 + 0.02 * float(rng.standard_normal())),
        0.01,
        (599.5 + 10.0 * float(rng.standard_normal()), 599.5 + 10.0 * float(rng.standard_normal())),
        Distortion(
            k1=-0.2 + 0.03 * float(rng.standard_normal()),
            k2=float(rng.standard_normal()),
            p1=0.001 * float(rng.standard_normal()),
            p2=0.001 * float(rng.standard_normal()),
            k3=errors.k3 * float(rng.choice([-1.0, 1.0])),
        ),
        60.0,
        11.0,
        _WALL,
        (float(tilt[0]), float(tilt[1])),
    )
    return aim(made, _MIDDLE + 5.0 * rng.standard_normal(3))


def _nominal(camera: Camera, wall: Wall, rng: np.random.Generator) -> Camera:
    """Give what an experimenter knows of a camera with a ruler: see `guess`."""
    bare = replace(
        camera,
        distortion=Distortion(),
        tilt_deg=(0.0, 0.0),
        principal_point_px=(599.5, 599.5),
        principal_distance_mm=60.0,
        wall=wall,
    )
    return aim(bare, _MIDDLE)


def guess(case: CalibrationCase, seed: int) -> CalibrationCase:
    """Perturb the initial guess of a case by chance, and place the boards from their images."""
    rng = np.random.default_rng([seed, 2])
    middle = _MIDDLE + 20.0 * rng.uniform(-1.0, 1.0, 3)
    cameras = []
    for camera in case.cameras:
        center = np.asarray(camera.center_mm) + 30.0 * rng.standard_normal(3)
        aimed = aim(replace(camera, center_mm=triple(center)), middle)
        turn = rotation_matrices(np.deg2rad(1.0) * rng.standard_normal(3))
        distance = camera.principal_distance_mm * (1.0 + 0.05 * float(rng.standard_normal()))
        rotation = turn @ np.asarray(aimed.rotation)
        rows = (triple(rotation[0]), triple(rotation[1]), triple(rotation[2]))
        cameras.append(replace(aimed, rotation=rows, principal_distance_mm=distance))
    plain = np.tile(case.target.points_mm + middle, (case.pixels.shape[1], 1, 1))
    guessed = replace(case, cameras=tuple(cameras), initial_mm=plain)
    return replace(guessed, initial_mm=place_boards(guessed))


def from_truth(tank: Tank) -> CalibrationCase:
    """Start from the true cameras and places: what a fit finds that cannot get lost."""
    nominal = tank.case.cameras[0].wall
    cameras = tuple(replace(camera, wall=nominal) for camera in tank.cameras)
    return replace(tank.case, cameras=cameras, initial_mm=tank.points_mm)


def held_out_mm(answer: Calibration, tank: Tank, *, world: bool) -> float:
    """Measure the root mean square error of held-out points in the volume, mm.

    Points are triangulated from exact images. Without known places, a shift along the wall and a
    rotation about its normal are taken out, and the depth that one point gives.
    """
    rng = np.random.default_rng(7)
    points = _MIDDLE + _HALF * rng.uniform(-1.0, 1.0, (500, 3))
    pixels = np.stack([camera.project(points)[0] for camera in tank.cameras])
    for camera, own in zip(tank.cameras, pixels, strict=True):
        own[~camera.contains(own)] = np.nan
    found = triangulate(answer.cameras, pixels)
    there = np.isfinite(found).all(axis=1)
    found, points = found[there], points[there]
    if not world:
        found = fit_lateral_motion(found, points)(found)
        found[:, 2] -= (found - points)[:, 2].mean()
    return float(np.sqrt(np.mean(np.sum((found - points) ** 2, axis=1))))


def solve(case: CalibrationCase, unknown: tuple[Any, ...]) -> Calibration:
    """Calibrate with some unknowns."""
    solver: Any = make_algorithm("refractive_autocal", {})
    answer: Calibration = solver.solve(replace(case, unknown=unknown))
    return answer


def measure(name: str, errors: Errors, starts: int, unknown: tuple[str, ...]) -> dict[str, Any]:
    """Count right end states of a tank over random starts, each with a tank of its own."""
    rows, refused, seconds = [], [], []
    for seed in progress_bar(range(starts), name):
        tank = make_tank(errors, seed)
        reference = held_out_mm(solve(from_truth(tank), unknown), tank, world=errors.places)
        begun = time.perf_counter()
        try:
            answer = solve(guess(tank.case, seed), unknown)
        except InputError as error:
            refused.append(f"{seed}: {error}")
            continue
        seconds.append(time.perf_counter() - begun)
        rows.append((held_out_mm(answer, tank, world=errors.places), reference))
    found = np.array(rows).reshape(-1, 2)
    right = found[:, 0] <= _RIGHT * found[:, 1]
    return {
        "tank": name,
        "unknown": unknown,
        "starts": starts,
        "right": int(right.sum()),
        "refused": refused,
        "held_out_mm": float(np.median(found[:, 0])),
        "from_truth_mm": float(np.median(found[:, 1])),
        "wrong": found[~right].tolist(),
        "seconds": float(np.median(seconds)),
    }


if __name__ == "__main__":
    starts = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    for name, errors in TANKS.items():
        for unknown in ((), ("principal_point", "k1"), ("principal_point","k1","k2","p1","p2")):
            u = unknown + (("wall",) if errors.wall_mm else ())
            print(json.dumps(measure(name, errors, starts, u)))
