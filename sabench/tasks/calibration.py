"""The calibration track: a target's points in, cameras out; scored by what these cameras make of points."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from sabench.algorithms.calibration.parameters import Frame
from sabench.api import (
    Calibration,
    CalibrationCase,
    CalibrationSolver,
    Observation,
    SelfCalibrationSolver,
)
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.metrics.calibration_error import (
    align_particles,
    calibration_scores,
    detection_noise,
    held_out_scores,
    reproject,
    self_calibration_scores,
    target_alignment,
    target_points,
)
from sabench.plotting import pictures
from sabench.tasks.solver_call import attempt
from sabench.utils.arrays import F64
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
    """Score a calibration."""
    answer = estimate(data, result)
    if not data.shows_target:
        return self_calibration_scores(answer.cameras, *_particles(data))
    case, truth_mm, (exact, outliers) = (
        data.calibration_case(),
        data.placed().points_mm,
        data.sightings(),
    )
    good = case.found & ~outliers
    scores = calibration_scores(answer, case, data.true_cameras, truth_mm, exact, good)
    noise_px = detection_noise(case.pixels, exact, good)
    motion = Frame.of(data.true_cameras, truth_mm).motion
    aligned = target_alignment(target_points(answer, case), truth_mm, motion)
    held_out = _held_out(data, noise_px)
    return scores | held_out_scores(answer.cameras, data.true_cameras, *held_out, motion, aligned)


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
        truth_mm, exact = _particles(data)
        _, again, _ = align_particles(estimate(data, result).cameras, truth_mm, exact)
        return pictures.arrows(exact[:, None], (again - exact)[:, None], first.rows, first.columns)
    exact, case = data.sightings()[0], data.calibration_case()
    if result == "truth":
        return pictures.arrows(exact, case.pixels - exact, first.rows, first.columns)
    answer = estimate(data, result)
    again = reproject(answer.cameras, target_points(answer, case))
    return pictures.arrows(exact, again - exact, first.rows, first.columns)


def _particles(data: Dataset) -> tuple[F64, F64]:
    """Some true particles (n, 3) and their exact pixels (camera, n, 2), NaN outside the images."""
    truth_mm = data.particles(0).position_mm
    order = stream(data.manifest.seed, "held out").permutation(len(truth_mm))
    truth_mm = truth_mm[order[:_PARTICLES]]
    return truth_mm, np.stack(
        [exact_pixels(camera, truth_mm[None])[0] for camera in data.true_cameras]
    )


def _held_out(data: Dataset, noise_px: float) -> tuple[F64, F64]:
    """Random points (n, 3) of the volume, and noisy pixels (camera, n, 2) by the true cameras."""
    volume = data.scene.volume
    rng = stream(data.manifest.seed, "held out")
    points_mm = np.asarray(volume.center_mm) + (rng.random((_HELD_OUT, 3)) - 0.5) * np.asarray(
        volume.size_mm
    )
    pixels = np.full((len(data.true_cameras), _HELD_OUT, 2), np.nan)
    for number, camera in enumerate(data.true_cameras):
        there, valid = camera.project(points_mm)
        seen = valid & camera.contains(there)
        pixels[number, seen] = there[seen] + noise_px * rng.standard_normal((int(seen.sum()), 2))
    return points_mm, pixels
