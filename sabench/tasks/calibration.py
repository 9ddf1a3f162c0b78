"""The calibration track: a target's points in, cameras out; scored by what these cameras make of points."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import Seen
from sabench.algorithms.calibration.cramer_rao import Limit, limit
from sabench.algorithms.calibration.parameters import Frame, Free
from sabench.algorithms.calibration.problem import anchors_of
from sabench.api import (
    Calibration,
    CalibrationCase,
    CalibrationSolver,
    Observation,
    SelfCalibrationSolver,
)
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import fit_rigid_motion
from sabench.geometry.triangulation import triangulate
from sabench.metrics.alignment import ALIGNMENTS, alignment
from sabench.plotting import pictures
from sabench.tasks.solver_call import attempt
from sabench.utils.arrays import F64, Bool
from sabench.utils.errors import InputError
from sabench.utils.rng import stream
from sabench.worlds.calibration_targets import exact_pixels

_HELD_OUT = 500  # points that no calibration sees; thesis, section 4.4.2
_PARTICLES = 2000


def run(
    algorithm: CalibrationSolver | SelfCalibrationSolver,
    name: str,
    data: Dataset,
    writer: ResultWriter,
) -> list[float]:
    """Calibrate once, from all frames of a target or the first one of particles; returns the seconds that it took.

    Raises
    ------
    InputError
        A solver that declines, raises or returns something else than as many cameras as there are.
    """
    case: Any = data.calibration_case() if data.shows_target else data.observation(0)
    start = time.perf_counter()
    answer = _attempt(algorithm, name, case)
    seconds = time.perf_counter() - start
    writer.add_calibration(answer)
    return [seconds]


def _attempt(
    algorithm: CalibrationSolver | SelfCalibrationSolver, name: str, case: Any
) -> Calibration:
    answer: Calibration = attempt(algorithm, name, case, Calibration)
    return _checked(answer, f"solver {name}", case)


def _checked(answer: Calibration, source: str, case: CalibrationCase | Observation) -> Calibration:
    """A solver's or a file's calibration, if it fits the case."""
    names, expected = (
        [camera.name for camera in answer.cameras],
        [camera.name for camera in case.cameras],
    )
    if names != expected:
        raise InputError(f"{source}: expected the cameras {expected}, got {names}")
    if not isinstance(case, CalibrationCase):
        return answer
    if answer.points_mm is not None and answer.points_mm.shape != case.rough_mm.shape:
        raise InputError(
            f"{source}: points_mm: expected the shape {case.rough_mm.shape}, got {answer.points_mm.shape}"
        )
    if answer.used is not None and (
        answer.used.shape != case.found.shape or answer.used.dtype != np.bool_
    ):
        raise InputError(
            f"{source}: used: expected bool of the shape {case.found.shape}, got {answer.used.dtype} of {answer.used.shape}"
        )
    return answer


def estimate(data: Dataset, result: Result | str) -> Calibration:
    """A result's calibration, or the one that the word `truth` or `empty` stands for: the true cameras, or those that solvers are told."""
    if isinstance(result, Result):
        case = data.calibration_case() if data.shows_target else data.observation(0)
        return _checked(result.calibration(), str(result.path), case)
    if result == "truth":
        return Calibration(
            data.true_cameras, data.placed().points_mm if data.shows_target else None
        )
    return Calibration(data.rig.cameras)


def copy(data: Dataset, result: Result, writer: ResultWriter) -> None:
    """Write a foreign calibration anew; reading checks it."""
    writer.add_calibration(estimate(data, result))


def score_result(data: Dataset, result: Result | str) -> dict[str, float | None]:
    """All scores of a calibration."""
    if not data.shows_target:
        return _score_on_particles(data, estimate(data, result).cameras)
    case, truths, (exact, outliers) = (
        data.calibration_case(),
        data.placed().points_mm,
        data.sightings(),
    )
    guess, noise = estimate(data, result), _noise(case, exact, outliers)
    frame = Frame.of(data.true_cameras, truths)
    points = (
        guess.points_mm
        if guess.points_mm is not None
        else _intersected(guess.cameras, case, guess.used)
    )
    good = case.found & ~outliers
    bound = _bound(case, frame, truths, good, noise)
    scores = _reprojection(guess, points, case, exact, good, bound)
    scores |= _points(points, truths, frame, np.asarray(good.any(axis=0)), bound)
    scores |= _detection(case, exact, good) | _wall_errors(guess.cameras, data.true_cameras[0].wall)
    return scores | _held_out(guess.cameras, points, data, truths, frame, noise)


def images(data: Dataset) -> bytes:
    """What the cameras found of the target in all frames, or saw of the particles in the first, as a PNG."""
    if not data.shows_target:
        seen = data.observation(0)
        return pictures.montage(seen.images, seen.black_dn, seen.white_dn)
    first = data.rig.cameras[0]
    return pictures.dots(data.calibration_case().pixels, first.rows, first.columns)


def picture(data: Dataset, result: Result | str) -> bytes:
    """True reprojection errors of an estimate, as a PNG; of the truth: the errors of detection."""
    first = data.rig.cameras[0]
    if not data.shows_target:
        _, exact, again, _ = _seen_particles(data, estimate(data, result).cameras)
        return pictures.arrows(exact[:, None], (again - exact)[:, None], first.rows, first.columns)
    exact = data.sightings()[0]
    if result == "truth":
        return pictures.arrows(
            exact, data.calibration_case().pixels - exact, first.rows, first.columns
        )
    guess, case = estimate(data, result), data.calibration_case()
    points = (
        guess.points_mm
        if guess.points_mm is not None
        else _intersected(guess.cameras, case, guess.used)
    )
    again = np.stack(
        [camera.project(points.reshape(-1, 3))[0] for camera in guess.cameras]
    ).reshape(exact.shape)
    return pictures.arrows(exact, again - exact, first.rows, first.columns)


def _score_on_particles(data: Dataset, cameras: tuple[CameraModel, ...]) -> dict[str, float | None]:
    """How well cameras agree on where the true particles are, wherever that is: particles do not show a motion of all cameras together."""
    truths, exact, again, found = _seen_particles(data, cameras)
    return {
        "true_px": _length(again - exact, np.asarray(np.isfinite(exact).all(axis=-1))),
        "held_out_mm": _scatter(found - truths),
    }


def _seen_particles(data: Dataset, cameras: tuple[CameraModel, ...]) -> tuple[F64, F64, F64, F64]:
    """Some true particles (n, 3) in the cameras' frame, their exact pixels (camera, n, 2), those by the cameras, and where these see them (n, 3)."""
    truths = data.particles(0).position_mm
    truths = truths[stream(data.manifest.seed, "held out").permutation(len(truths))[:_PARTICLES]]
    exact = np.stack([exact_pixels(camera, truths[None])[0] for camera in data.true_cameras])
    found = triangulate(cameras, exact)
    known = np.isfinite(found).all(axis=1)
    if known.sum() < 3:
        return truths, exact, np.full_like(exact, np.nan), found
    moved = fit_rigid_motion(truths[known], found[known])(truths)
    return moved, exact, np.stack([camera.project(moved)[0] for camera in cameras]), found


def _detection(case: CalibrationCase, exact: F64, good: Bool) -> dict[str, float | None]:
    """What detection adds to pixel coordinates, outliers not counted: mean along columns and rows, and scatter."""
    errors = (case.pixels - exact)[good]
    column, row = errors.mean(axis=0) if len(errors) else (np.nan, np.nan)
    scatter = float(errors.std(axis=0).mean()) if len(errors) else np.nan
    return {
        "found_bias_column_px": _finite(column),
        "found_bias_row_px": _finite(row),
        "found_std_px": _finite(scatter),
    }


def _noise(case: CalibrationCase, exact: F64, outliers: Bool) -> float:
    """Standard deviation of what detection adds to a pixel coordinate, outliers not counted."""
    errors = (case.pixels - exact)[case.found & ~outliers]
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0


def _bound(
    case: CalibrationCase, frame: Frame, truths: F64, good: Bool, noise: float
) -> Limit | None:
    """The Cramer-Rao bound; unknown are turn, centre, focal length of every camera, what else the case says, and all boards; None without noise,
    or where numbers fail."""
    if noise <= 0.0:
        return None
    seen = Seen(
        case.target.points_mm,
        np.nan_to_num(case.pixels),
        good.astype(np.float64),
        anchors_of(case, frame, noise),
    )
    try:
        return limit(frame.state(case.target.points_mm, truths), seen, Free.of(case.unknown), noise)
    except (
        np.linalg.LinAlgError
    ):  # places and cameras so far from anything real that their bound has no number
        return None


def _intersected(cameras: tuple[CameraModel, ...], case: CalibrationCase, used: Bool | None) -> F64:
    pixels = case.pixels if used is None else np.where(used[..., None], case.pixels, np.nan)
    return triangulate(cameras, pixels.reshape(len(cameras), -1, 2)).reshape(case.rough_mm.shape)


def _reprojection(
    guess: Calibration,
    points: F64,
    case: CalibrationCase,
    exact: F64,
    good: Bool,
    bound: Limit | None,
) -> dict[str, float | None]:
    """Mean distances of reprojected points from where they were found and from where they are."""
    flat = points.reshape(-1, 3)
    again = np.stack([camera.project(flat)[0] for camera in guess.cameras]).reshape(
        case.pixels.shape
    )
    used = case.found if guess.used is None else guess.used
    measured, true = _length(again - case.pixels, used), _length(again - exact, good)
    ratio = true / bound.reprojection_px if bound and true is not None else None
    shown = None if not (true and measured and bound) else true / measured / bound.efficiency
    return {
        "true_px": true,
        "measured_px": measured,
        "true_ratio": ratio,
        "bound_px": bound.reprojection_px if bound else None,
        "efficiency_ratio": shown,
        "used_percent": 100.0 * float(used.sum()) / max(int(case.found.sum()), 1),
    }


def _length(errors: F64, chosen: Bool) -> float | None:
    lengths = np.linalg.norm(errors[chosen], axis=-1)
    lengths = lengths[np.isfinite(lengths)]
    return float(lengths.mean()) if len(lengths) else None


def _wall_errors(cameras: tuple[CameraModel, ...], wall: Wall | None) -> dict[str, float | None]:
    """Largest error of a refractive index and of a layer's thickness, where both walls are known."""
    found = cameras[0].wall if isinstance(cameras[0], Camera) else None
    if wall is None or found is None or len(found.layers) != len(wall.layers):
        return {"index_error": None, "thickness_error_mm": None}
    thick = [
        abs(own.thickness_mm - true.thickness_mm)
        for own, true in zip(found.layers, wall.layers, strict=True)
    ]
    return {
        "index_error": float(np.abs(found.indices - wall.indices).max()),
        "thickness_error_mm": max(thick, default=0.0),
    }


def _points(
    points: F64, truths: F64, frame: Frame, seen: Bool, bound: Limit | None
) -> dict[str, float | None]:
    """Errors of the target's points in the wall's frame, mean and scatter, after every alignment."""
    there = seen & np.isfinite(points).all(axis=-1)
    found, true = frame.motion(points[there]), frame.motion(truths[there])
    scores: dict[str, float | None] = {}
    for how in ALIGNMENTS:
        errors = (
            alignment(how, found, true)(found) - true
            if len(found) >= 3
            else np.full((1, 3), np.nan)
        )
        prefix = "" if how == "lateral" else f"{how}_"
        for axis, mean, std in zip("xyz", errors.mean(axis=0), errors.std(axis=0), strict=True):
            scores[f"{prefix}{axis}_mean_mm"], scores[f"{prefix}{axis}_std_mm"] = (
                _finite(mean),
                _finite(std),
            )
    for number, axis in enumerate("xyz"):
        std = scores[f"{axis}_std_mm"]
        scores[f"{axis}_std_ratio"] = (
            std / float(bound.point_std_mm[number]) if bound and std is not None else None
        )
    scores["bound_z_mean_mm"] = float(bound.point_mean_mm[2]) if bound else None
    return scores | {"spacing_mm": _spacing(points, truths, frame, seen)}


def _spacing(points: F64, truths: F64, frame: Frame, seen: Bool) -> float | None:
    """Root mean square error of the mean distance along Z of corresponding points in frames that follow each other; thesis, figure 4-25."""
    depth = [np.where(seen, frame.motion(value)[..., 2], np.nan) for value in (points, truths)]
    both = np.diff(depth[0] - depth[1], axis=0)
    known = [row[np.isfinite(row)] for row in both]
    means = [float(row.mean()) for row in known if len(row)]
    return float(np.sqrt(np.mean(np.square(means)))) if means else None


def _held_out(
    cameras: tuple[CameraModel, ...],
    points: F64,
    data: Dataset,
    truths: F64,
    frame: Frame,
    noise: float,
) -> dict[str, float | None]:
    """Other points of the volume, intersected from noisy images by the estimated and by the true cameras, in the boards' alignment."""
    volume = data.scene.volume
    rng = stream(data.manifest.seed, "held out")
    places = np.asarray(volume.center_mm) + (rng.random((_HELD_OUT, 3)) - 0.5) * np.asarray(
        volume.size_mm
    )
    pixels = np.full((len(cameras), _HELD_OUT, 2), np.nan)
    for number, camera in enumerate(data.true_cameras):
        there, valid = camera.project(places)
        seen = valid & camera.contains(there)
        pixels[number, seen] = there[seen] + noise * rng.standard_normal((int(seen.sum()), 2))
    goal = frame.motion(places)
    known = np.isfinite(points).all(axis=-1) & np.isfinite(truths).all(axis=-1)
    motion = (
        alignment("lateral", frame.motion(points[known]), frame.motion(truths[known]))
        if known.sum() >= 3
        else None
    )
    found = frame.motion(triangulate(cameras, pixels))
    return {
        "held_out_mm": _scatter(motion(found) - goal) if motion else None,
        "held_out_exact_mm": _scatter(frame.motion(triangulate(data.true_cameras, pixels)) - goal),
    }


def _scatter(errors: F64) -> float | None:
    """Root mean square distance of errors (n, 3) from their mean."""
    known = errors[np.isfinite(errors).all(axis=-1)]
    return (
        float(np.sqrt(((known - known.mean(axis=0)) ** 2).sum(axis=1).mean()))
        if len(known)
        else None
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
