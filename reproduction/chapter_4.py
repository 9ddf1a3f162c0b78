"""Common parts of chapter 4's tables: camera array, noisy boards, errors, runs."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.algorithms.calibration.joint_fit import alternate
from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.api import Calibration, CalibrationCase
from sabench.geometry.camera import Camera
from sabench.geometry.triangulation import triangulate
from sabench.metrics.calibration_error import fit_alignment
from sabench.plotting.drawing import Curve, Figure, Panel
from sabench.scenes import Scene, build_rig, load_scene, parse_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.simulation.camera_view import render_camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.rendering.sensor import expose
from sabench.utils.arrays import F64, U16
from sabench.utils.progress import progress_bar
from sabench.utils.rng import stream
from sabench.worlds.calibration_targets import exact_pixels, found_pixels, pose_target, prior

from .common import run

# mm of the volume's middle that a pixel of the central camera sees, as the thesis gives it
D_PIX = 0.052
CAMERAS = (3, 7, 13)
NOISES = (0.1, 0.5, 1.0, 2.0)
EVERY_NOISE = (0.0, *NOISES)
STARTS = (0.001, 0.005, 0.01, 0.1, 0.2)
BASELINE = 0.3
SOLVERS = {"alternating": "refractive_autocal_alternating", "joint": "refractive_autocal"}
_INNER = ((-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1))
_OUTER = ((-2, 0), (2, 0), (0, -2), (0, 2))
_CHOSEN = {
    3: (3, 4, 8),
    7: (0, 2, 3, 4, 5, 6, 8),
    8: (0, 1, 2, 3, 5, 6, 7, 8),
    9: tuple(range(9)),
    13: tuple(range(13)),
}


@dataclass(frozen=True)
class Board:
    """Calibration and its truth.

    Attributes
    ----------
    case : what a solver sees.
    cameras, points_mm, exact : true cameras, true points (frame, point, 3), and where these truly
        are in the images (camera, frame, point, 2).
    """

    case: CalibrationCase
    cameras: tuple[Camera, ...]
    points_mm: F64
    exact: F64


def scene_of(
    cameras: int, baseline: float, noise_px: float, start: float, *, wall: bool = True
) -> Scene:
    """Make the array and boards of section 4.4.2.

    Cameras are D s_o apart; five boards of 11 x 11 points are in 50 x 50 x 50 mm behind 5 mm of
    glass.
    `start` is the standard deviation of the initial points over the volume's edge; cameras start
    as wrong as that.
    """
    values: dict[str, Any] = scene_at(
        [(_INNER + _OUTER)[number] for number in _CHOSEN[cameras]], baseline
    ).to_dict()
    values["detection"] = {"noise_px": noise_px}
    values["calibration"] = {
        "points": start,
        "center_mm": 200.0 * start,
        "turn_deg": 20.0 * start,
        "focal_percent": 30.0 * start,
        "known": [{"frame": 2, "point": 60}],
    }
    if not wall:
        del values["wall"]
    return parse_scene(values, f"{cameras} cameras, D = {baseline:g}")


def scene_at(steps: Sequence[tuple[int, int]], baseline: float) -> Scene:
    """Load the bundled scene with cameras at a distance in baselines."""
    values: dict[str, Any] = load_scene("calibration").to_dict()
    middle = values["volume"]["center_mm"][2] - values["cameras"]["center_mm"][2]
    positions = [
        {
            "center_mm": [
                x * baseline * middle,
                y * baseline * middle,
                values["cameras"]["center_mm"][2],
            ]
        }
        for x, y in steps
    ]
    values["cameras"]["layout"] = {"kind": "list", "places": positions}
    return parse_scene(values, f"D = {baseline:g}")


@functools.cache
def board(
    cameras: int, baseline: float, noise_px: float, start: float, seed: int, wall: bool = True
) -> Board:
    """Draw boards, noise and initial guess once."""
    return draw(scene_of(cameras, baseline, noise_px, start, wall=wall), seed)


def draw(scene: Scene, seed: int) -> Board:
    """Simulate what a scene's cameras see of its target, with the truth."""
    true, placed = build_rig(scene).cameras, pose_target(scene, seed)
    exact = np.stack([exact_pixels(camera, placed.points_mm) for camera in true])
    pixels = np.stack(
        [found_pixels(scene.detection, view, seed, number)[0] for number, view in enumerate(exact)]
    )
    given = prior(scene, placed, seed)
    case = CalibrationCase(
        placed.target,
        pixels,
        nominal_cameras(scene, true, seed),
        given.initial_mm,
        given.known_mm,
        given.known_sigma_mm,
        scene.unknown,
        bool(scene.calibration and scene.calibration.known_cameras),
    )
    return Board(case, true, placed.points_mm, exact)


def photograph(scene: Scene, frame: int, camera: int, seed: int) -> U16:
    """Render a scene's target as one camera records it: (rows, columns) grey values."""
    content = Frames(scene, build_rig(scene, scene.title), seed).at(frame)
    return expose(
        scene.sensor, render_camera_view(content, camera).photons, content.sensor_noise(camera)
    )


def solve_case(solver: str, given: Board, **parameters: Any) -> Calibration:
    """Solve a case."""
    answer: Calibration = run(solver, given.case, **parameters)
    return answer


def places_of(answer: Calibration, given: Board) -> F64:
    """Get the points that a solver returns, or triangulate them by its cameras."""
    if answer.points_mm is not None:
        return answer.points_mm
    flat = given.case.pixels.reshape(len(given.cameras), -1, 2)
    return triangulate(answer.cameras, flat).reshape(given.points_mm.shape)


def reprojection(answer: Calibration, given: Board, pixels: F64) -> F64:
    """Compute distances of reprojections to pixels (camera, frame, point, 2).

    Returns (camera, frame, point), px; NaN where there is no pixel.
    """
    flat = places_of(answer, given).reshape(-1, 3)
    again = np.stack([camera.project(flat)[0] for camera in answer.cameras])
    return np.asarray(np.linalg.norm(again.reshape(pixels.shape) - pixels, axis=-1))


def by_camera(errors: F64) -> F64:
    """Average errors (camera, frame, point) over the points that each camera sees."""
    return np.asarray(np.nanmean(errors.reshape(len(errors), -1), axis=1))


def point_errors(answer: Calibration, given: Board, how: Any = "lateral") -> F64:
    """Compute errors (n, 3) of the boards' points, mm, after an alignment."""
    points, truths = places_of(answer, given).reshape(-1, 3), given.points_mm.reshape(-1, 3)
    return np.asarray(fit_alignment(how, points, truths)(points) - truths)


def held_out(
    answer: Calibration, given: Board, noise_px: float, seed: int, count: int = 500
) -> tuple[F64, F64]:
    """Compute errors (n, 3) of other points of the volume, seen with noise.

    They are triangulated by the estimated cameras, in the boards' alignment, and by the true ones.
    """
    rng = stream(seed, "held out")
    positions = np.array([0.0, 0.0, 35.0]) + 45.0 * (rng.random((count, 3)) - 0.5)
    pixels = np.stack([camera.project(positions)[0] for camera in given.cameras])
    pixels = pixels + noise_px * rng.standard_normal(pixels.shape)
    motion = fit_alignment(
        "lateral", places_of(answer, given).reshape(-1, 3), given.points_mm.reshape(-1, 3)
    )
    return motion(triangulate(answer.cameras, pixels)) - positions, triangulate(
        given.cameras, pixels
    ) - positions


def with_points(given: Board, points_mm: F64) -> Board:
    """Replace the nominal positions of a case; the images stay."""
    return replace(given, case=replace(given.case, initial_mm=points_mm))


def stds(errors: Sequence[F64]) -> F64:
    """Compute the root mean square over draws of the scatter along each axis."""
    return np.asarray(np.sqrt(np.mean([np.nanstd(error, axis=0) ** 2 for error in errors], axis=0)))


@dataclass(frozen=True)
class Found:
    """Errors of one solver on one draw.

    Attributes
    ----------
    true_px, measured_px : mean reprojection error of each camera (M,) against the true pixels and
        against the measured ones.
    errors_mm : (n, 3) of the boards' points.
    """

    true_px: F64
    measured_px: F64
    errors_mm: F64


Draws = dict[tuple[str, float], list[Found]]  # of a solver and a start


def measure(cameras: int, noise: float, seeds: Sequence[int]) -> Draws:
    """Calibrate from every initial guess by both solvers."""
    steps = [(start, seed) for start in STARTS for seed in seeds]
    draws: Draws = {(name, start): [] for name in SOLVERS for start in STARTS}
    for start, seed in progress_bar(steps, f"{cameras} cameras, {noise:g} px"):
        for name in SOLVERS:
            draws[name, start].append(_measure_one(name, cameras, noise, start, seed))
    return draws


@functools.cache
def _measure_one(name: str, cameras: int, noise: float, start: float, seed: int) -> Found:
    given = board(cameras, BASELINE, noise, start, seed)
    answer = solve_case(SOLVERS[name], given)
    true, measured = (
        by_camera(reprojection(answer, given, pixels))
        for pixels in (given.exact, given.case.pixels)
    )
    return Found(true, measured, point_errors(answer, given))


def follow_rounds(given: Board) -> tuple[float, ...]:
    """Compute a camera's largest mean error (px) at the start and per round."""
    problem = CalibrationProblem.from_case(given.case, FreeParameters())
    return alternate(problem.start, problem.seen, FreeParameters(), 0.001, 1000).errors_px


def draw_points(name: str, title: str, found: dict[float, Draws]) -> Figure:
    """Draw errors of the points along X, Y, Z by initial guess, one column per noise.

    Each error has a mean and a scatter.
    """
    upper, lower = [], []
    for noise, draws in found.items():
        means, scatters = [], []
        for solver in SOLVERS:
            errors = [[draw.errors_mm for draw in draws[solver, start]] for start in STARTS]
            mean = np.array(
                [np.mean([np.abs(draw.mean(axis=0)) for draw in draws], axis=0) for draws in errors]
            )
            scatter = np.array([stds(draws) for draws in errors])
            means.append(Curve(f"Z, {solver}", STARTS, mean[:, 2].tolist()))
            scatters += [
                Curve(f"{axis}, {solver}", STARTS, scatter[:, number].tolist())
                for number, axis in enumerate("XYZ")
            ]
        upper.append(Panel(f"{noise:g} px: mean along Z", "start", "mm", tuple(means), "xy"))
        lower.append(Panel(f"{noise:g} px: scatter", "start", "mm", tuple(scatters), "xy"))
    return Figure(name, title, (*upper, *lower), across=len(found))
