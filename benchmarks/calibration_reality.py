"""Calibrations of tanks whose lenses, walls and boards have errors that the model does not have.

`OPENBLAS_NUM_THREADS=1 python benchmarks/calibration_reality.py [starts] [tanks] [record.json]`
prints JSON, or writes it. Points are projected, not rendered: four cameras of 1200 x 1200 pixels
behind 10 mm of glass, ten boards of 7 x 7 points, 0.05 px of noise. Every start has a tank and an
initial guess of its own, as of a ruler: cameras off by 30 mm along each axis and 1 degree,
principal distances by 5 %, the target by up to 20 mm. `tables record.json` prints the tables of the
docs.

- `starts`: how often the end state is right, with few unknowns and with many: the one of the same
  fit from the true poses.
- `tanks`: errors of held-out points with few unknowns, with those that held-out boards recommend,
  and the best of two fits of many unknowns from the true poses; and the error that the report
  expects over the true one.
"""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.algorithms.calibration.resection import place_boards
from sabench.algorithms.calibration.unknown_selection import select_unknowns
from sabench.api import Calibration, CalibrationCase
from sabench.api.make import make_algorithm
from sabench.api.truth import Target
from sabench.apps.own_calibration.folder import Recording
from sabench.apps.own_calibration.held_out import hold_out
from sabench.apps.own_calibration.report import report_on
from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.rigid_motion import fit_lateral_motion, rotation_matrices
from sabench.geometry.triangulation import triangulate
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json
from sabench.utils.progress import progress_bar
from sabench.utils.validation import Unknown

NOISE_PX = 0.05
_BOARDS = 10
_TARGET = Target("checkerboard", 7, 7, 9.0, 0.0)
_MIDDLE = np.array([0.0, 0.0, 80.0])
_HALF = np.array([35.0, 35.0, 35.0])  # of the volume of held-out points
WALL = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.5, 10.0),), 1.333)
_RIGHT = 1.5  # times the error of the same fit from the true poses: below, an end state is right
_MANY: tuple[Unknown, ...] = ("k1", "k2", "p1", "p2", "tilt", "bend")
_ALL: tuple[Unknown, ...] = (*_MANY, "principal_point", "k3")


@dataclass(frozen=True)
class Errors:
    """Errors that a tank has and a model may not have.

    Attributes
    ----------
    k3, tilt_deg : of the lenses and sensors; signs are drawn.
    wall_mm : by which the nominal wall is too near to the cameras.
    bend_mm : of the middle of a board against its corners.
    places : whether all places of the target are known to 0.01 mm; else one depth is, to 0.05 mm.
    near_mm : by which boards are nearer to the wall, with no depth known.
    """

    k3: float = 0.0
    tilt_deg: float = 0.0
    wall_mm: float = 0.0
    bend_mm: float = 0.0
    places: bool = False
    near_mm: float = 0.0


TANKS = {
    "ideal": Errors(),
    "k3": Errors(k3=400.0),
    "tilted sensor": Errors(tilt_deg=0.7),
    "board bent by 0.2 mm": Errors(bend_mm=0.2),
    "all of these": Errors(400.0, 0.7, 0.0, 0.2),
    "all of these, near the wall, depth unknown": Errors(400.0, 0.7, 0.0, 0.2, near_mm=30.0),
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
    """Make a tank by chance: its cameras, its boards and their images."""
    rng = np.random.default_rng([seed, 1])
    cameras = tuple(_camera(number, errors, rng) for number in range(4))
    points = _place_boards(errors, rng)
    pixels = np.stack([camera.project(points.reshape(-1, 3))[0] for camera in cameras])
    pixels += NOISE_PX * rng.standard_normal(pixels.shape)
    for camera, own in zip(cameras, pixels, strict=True):
        own[~camera.contains(own)] = np.nan
    known, sigma = _measure_places(errors, points, rng)
    wall = replace(WALL, point_mm=(0.0, 0.0, -errors.wall_mm))
    nominal = tuple(_nominal(camera, wall) for camera in cameras)
    shape = (len(cameras), *points.shape[:2], 2)
    case = CalibrationCase(_TARGET, pixels.reshape(shape), nominal, known, known, sigma)
    return Tank(cameras, points, case)


def _place_boards(errors: Errors, rng: np.random.Generator) -> F64:
    """Place bent boards at ten depths; returns their points (frame, point, 3)."""
    board = _TARGET.points_mm.copy()
    half = float(np.abs(board).max())
    board[:, 2] = errors.bend_mm * (1.0 - (board[:, 0] ** 2 + board[:, 1] ** 2) / half**2 / 2.0)
    places = []
    for depth in rng.permutation(np.linspace(-25.0, 25.0, _BOARDS)).tolist():
        turn = rotation_matrices(np.deg2rad([20.0, 20.0, 10.0]) * rng.uniform(-1.0, 1.0, 3))
        shift = _MIDDLE + np.append(rng.uniform(-8.0, 8.0, 2), depth - errors.near_mm)
        places.append(board @ turn.T + shift)
    return np.stack(places)


def _measure_places(errors: Errors, points: F64, rng: np.random.Generator) -> tuple[F64, F64]:
    """Measure all places, one depth, or nothing; also the standard deviations."""
    known, sigma = np.full(points.shape, np.nan), np.full(points.shape, np.nan)
    if errors.places:
        return points + 0.01 * rng.standard_normal(points.shape), np.full(points.shape, 0.01)
    if not errors.near_mm:
        known[0, 24, 2], sigma[0, 24, 2] = points[0, 24, 2] + 0.05 * rng.standard_normal(), 0.05
    return known, sigma


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
        WALL,
        (float(tilt[0]), float(tilt[1])),
    )
    return aim(made, _MIDDLE + 5.0 * rng.standard_normal(3))


def _nominal(camera: Camera, wall: Wall) -> Camera:
    """Give what an experimenter knows of a camera before `guess` perturbs it."""
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
    """Start from the true poses, and nominal lenses and wall: a fit that cannot get lost."""
    cameras = tuple(
        replace(own, center_mm=true.center_mm, rotation=true.rotation)
        for own, true in zip(tank.case.cameras, tank.cameras, strict=True)
    )
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


def solve(case: CalibrationCase, unknown: tuple[Unknown, ...]) -> Calibration:
    """Calibrate with some unknowns."""
    solver: Any = make_algorithm("refractive_autocal", {})
    answer: Calibration = solver.solve(replace(case, unknown=unknown))
    return answer


def with_wall(unknown: tuple[Unknown, ...], errors: Errors) -> tuple[Unknown, ...]:
    """Add the wall's place where known places show it."""
    return (*unknown, "wall") if errors.places else unknown


def count_right(
    name: str, errors: Errors, starts: int, unknown: tuple[Unknown, ...]
) -> dict[str, Any]:
    """Count right end states over random starts."""
    right, wrong, refused, seconds = 0, [], [], []
    for seed in progress_bar(range(starts), name):
        tank = make_tank(errors, seed)
        try:
            reference = held_out_mm(solve(from_truth(tank), unknown), tank, world=errors.places)
            begun = time.perf_counter()
            answer = solve(guess(tank.case, seed), unknown)
        except InputError as error:
            refused.append(f"{seed}: {error}")
            continue
        seconds.append(time.perf_counter() - begun)
        found = held_out_mm(answer, tank, world=errors.places)
        if found <= _RIGHT * reference:
            right += 1
        else:
            wrong.append([seed, round(found, 5), round(reference, 5)])
    return {
        "tank": name,
        "unknown": list(unknown),
        "starts": starts,
        "right": right,
        "wrong": wrong,
        "refused": refused,
        "median_s": round(float(np.median(seconds)), 2) if seconds else None,
    }


def measure_errors(name: str, errors: Errors, tanks: int) -> dict[str, Any]:
    """Measure errors of held-out points by the choice of unknowns, and those expected."""
    rows: dict[str, list[float]] = {}
    chosen: dict[str, int] = {}
    for seed in progress_bar(range(tanks), name):
        tank = make_tank(errors, seed)
        case = guess(tank.case, seed)
        auto, _ = select_unknowns(case)
        for unknown in auto:
            chosen[unknown] = chosen.get(unknown, 0) + 1
        fits = [solve(from_truth(tank), with_wall(free, errors)) for free in (_MANY, _ALL)]
        best = min(held_out_mm(fit, tank, world=errors.places) for fit in fits)
        rows.setdefault("best_mm", []).append(best)
        for label, free in (("few", ()), ("auto", auto)):
            true, expected, noise = _true_and_expected(tank, replace(case, unknown=free), errors)
            rows.setdefault(f"{label}_mm", []).append(true)
            rows.setdefault(f"{label}_expected_ratio", []).append(expected / true)
            rows.setdefault(f"{label}_noise_alone_ratio", []).append(noise / true)
    medians = {key: float(f"{np.median(values):.4g}") for key, values in rows.items()}
    ratios = np.array(rows["few_expected_ratio"] + rows["auto_expected_ratio"])
    within = float(np.mean((ratios > 0.5) & (ratios < 2.0)))
    return {"tank": name, "tanks": tanks, **medians, "within_2": within, "chosen": chosen}


def _true_and_expected(
    tank: Tank, case: CalibrationCase, errors: Errors
) -> tuple[float, float, float]:
    """Measure the true error, that of the report and that of noise alone, mm."""
    solver: Any = make_algorithm("refractive_autocal", {})
    answer = solver.solve(case)
    frames, points = case.pixels.shape[1:3]
    recording = Recording(case, np.arange(frames), np.tile(np.arange(points), (frames, 1)))
    report, _, _ = report_on(recording, answer, hold_out(solver, case, answer))
    if report.std_mm is None or report.noise_std_mm is None:
        raise ValueError("expected frames to hold out")
    true = held_out_mm(answer, tank, world=errors.places)
    lengths = [float(np.linalg.norm(std)) for std in (report.std_mm, report.noise_std_mm)]
    return true, lengths[0], lengths[1]


def measure(starts: int, tanks: int) -> dict[str, Any]:
    """Measure all tanks."""
    counts = []
    for name, errors in TANKS.items():
        for unknown in ((), _MANY):
            counts.append(count_right(name, errors, starts, with_wall(unknown, errors)))
            print(json.dumps(counts[-1]), file=sys.stderr)
    rows = [measure_errors(name, errors, tanks) for name, errors in TANKS.items()]
    return {"noise_px": NOISE_PX, "starts": counts, "errors": rows}


def tables(record: dict[str, Any]) -> Iterator[str]:
    """Format a record as the tables of docs/results/by-suite.md."""
    yield "| tank | few unknowns: right of 100 | many unknowns: right of 100 | refused |"
    yield "|---|---|---|---|"
    for few, many in zip(record["starts"][::2], record["starts"][1::2], strict=True):
        refused = len(few["refused"]) + len(many["refused"])
        yield f"| {few['tank']} | {few['right']} | {many['right']} | {refused} |"
    yield ""
    yield "| tank | best, mm | few, mm | auto, mm | expected over true, few | auto | noise, few |"
    yield "|---|---|---|---|---|---|---|"
    for row in record["errors"]:
        errors = " | ".join(f"{row[key]:.4f}" for key in ("best_mm", "few_mm", "auto_mm"))
        keys = ("few_expected_ratio", "auto_expected_ratio", "few_noise_alone_ratio")
        ratios = " | ".join(f"{row[key]:.2f}" for key in keys)
        yield f"| {row['tank']} | {errors} | {ratios} |"


if __name__ == "__main__" and sys.argv[1:2] == ["tables"]:
    print("\n".join(tables(json.loads(Path(sys.argv[2]).read_text(encoding="utf-8")))))
elif __name__ == "__main__":
    numbers = [int(value) for value in sys.argv[1:3]]
    result = measure(*numbers, *[5, 2][len(numbers) :])
    if len(sys.argv) > 3:
        Path(sys.argv[3]).write_text(canonical_json(result), encoding="utf-8")
    else:
        print(json.dumps(result, indent=1))
