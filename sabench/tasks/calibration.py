"""Task `calibration`: solvers turn the points of a target into cameras.

The cameras are scored by the pixels of projected points.
"""

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.algorithms.calibration.parameters import WallFrame
from sabench.api import Calibration, CalibrationCase, Observation
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.geometry.camera import Camera
from sabench.metrics.averages import finite_or_none
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
from sabench.tasks.solver_call import call_solver
from sabench.tasks.task import ANY, ERROR, PERCENT, Captions, Figures, Score, Source, Task
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.rng import stream
from sabench.worlds.calibration_targets import exact_pixels

_HELD_OUT = 500  # points that no calibration receives; thesis, section 4.4.2
_PARTICLES = 2000
_ROTATION = 1e-6  # how far a rotation's product with its transpose may be from the identity
_ALIKE = 0.05  # largest effect of the cameras' order, share of the nominal cameras' error


class CalibrationTask(Task):
    """Calibration of cameras, by a target or by particles."""

    name = "calibration"
    shown = "target"
    estimate = Calibration
    # fmt: off
    scores = (
        Score("true_px", "smaller", 4,
              "mean distance of reprojected points from their true pixels"),
        Score("bound_px", "steady", 4,
              "smallest true px that the data allow (Cramer-Rao bound)", range=ANY),
        Score("true_ratio", "smaller", 3, "true px over bound px", heading="true / bound"),
        Score("measured_px", "smaller", 4,
              "mean distance of reprojected points from their detected pixels"),
        Score("x_std_mm", "smaller", 4, "scatter of the points' errors along X, after a shift in X "
              "and Y and a rotation about the wall's normal"),
        Score("y_std_mm", "smaller", 4, "the same along Y"),
        Score("z_std_mm", "smaller", 4, "the same along Z"),
        Score("z_mean_mm", "smaller", 3,
              "mean error along Z, which images through a plane wall hardly determine", range=ANY),
        Score("z_std_ratio", "smaller", 3,
              "scatter along Z over its bound", heading="z std / bound"),
        Score("held_out_mm", "smaller", 4, "root mean square error of other points in the volume, "
              "intersected from noisy images"),
        Score("held_out_exact_mm", "steady", 4,
              "the same with the true cameras", heading="with exact cameras", range=ANY),
        Score("bound_z_mean_mm", "steady", 4,
              "smallest z mean mm that the data allow (Cramer-Rao bound)", hidden=True, range=ANY),
        Score("efficiency_ratio", "unity", 4, "true over measured px, over the same ratio of an "
              "efficient estimate", hidden=True, range=ANY),
        Score("used_percent", "larger", 4, "share of the observations that the algorithm accepted",
              heading="used percent", hidden=True, range=PERCENT),
        Score("found_bias_column_px", "steady", 4,
              "mean error of detection along the columns", hidden=True, range=ANY),
        Score("found_bias_row_px", "steady", 4,
              "mean error of detection along the rows", hidden=True, range=ANY),
        Score("found_std_px", "steady", 4, "scatter of detection", hidden=True, range=ANY),
        Score("index_error", "smaller", 4,
              "largest error of a refractive index of the wall", hidden=True),
        Score("thickness_error_mm", "smaller", 4,
              "largest error of a layer's thickness", hidden=True),
        Score("wall_place_error_mm", "smaller", 4,
              "error of the wall's place along its normal", hidden=True),
        Score("wall_tilt_error_deg", "smaller", 4,
              "error of the direction of the wall's normal", hidden=True),
        Score("spacing_mm", "smaller", 4,
              "error of the spacing between a traversed target's planes", hidden=True),
        Score("x_std_ratio", "smaller", 4, "scatter along X over its bound", hidden=True),
        Score("y_std_ratio", "smaller", 4, "scatter along Y over its bound", hidden=True),
        Score("x_mean_mm", "smaller", 4, "mean error along X", hidden=True, range=ANY),
        Score("y_mean_mm", "smaller", 4, "mean error along Y", hidden=True, range=ANY),
        *(
            Score(f"{kind}_{axis}_{moment}_mm", "smaller", 4,
                  f"{word} of the points' errors along {axis.upper()} {alignment}", hidden=True,
                  range=limits)
            for kind, alignment in (
                ("raw", "without alignment"),
                ("shift", "after a shift"),
                ("rigid", "after a rigid motion"),
            )
            for axis in "xyz"
            for moment, word, limits in (("std", "scatter", ERROR), ("mean", "mean", ANY))
        ),
    )
    # fmt: on
    sufficient = 0.1  # px
    picture_has_truth = True
    captions = Captions(
        heading="Errors in the images",
        estimates="Arrows from the target's detected points to their reprojections; the number is "
        "their magnification.",
        cameras="Detected points of the target in every camera, each frame in its own grey, or the "
        "images of the particles.",
        wide=True,
    )

    def scores_data(self, data: Dataset) -> bool:
        """Check whether a data set shows a target, or particles for self-calibration."""
        return data.shows_target or "particles" in data.shows

    def frames(self, data: Dataset) -> Sequence[int]:
        """Return [0] only: one calibration serves all frames."""
        return [0]

    def case(self, data: Dataset) -> CalibrationCase | Observation:
        """Make the target's case, or read the first frame of particles."""
        return data.calibration_case() if data.shows_target else data.observation(0)

    def run(self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
        """Calibrate once, by all frames of a target or the first frame of particles."""
        case = self.case(data)
        answer, seconds = call_solver(algorithm, name, case, Calibration)
        check_calibration(answer, f"solver {name}", case)
        writer.add(answer)
        return [seconds]

    def read(self, data: Dataset, source: Source, frame: int = 0) -> Calibration:
        """Read a result's calibration, or make the best or the worst possible one."""
        answer: Calibration = super().read(data, source, frame)
        if isinstance(source, Result):
            check_calibration(answer, str(source.path), self.case(data))
        return answer

    def truth(self, data: Dataset, frame: int = 0) -> Calibration:
        """Make the true cameras and points."""
        points = data.placed().points_mm if data.shows_target else None
        return Calibration(data.true_cameras, points)

    def empty(self, data: Dataset, frame: int = 0) -> Calibration:
        """Make the nominal cameras, as solvers receive them."""
        return Calibration(data.setup.cameras)

    def wrong(self, data: Dataset, frame: int = 0) -> Calibration:
        """Shift every camera's principal point, and stretch the target's points.

        The points are stretched about their middle.
        """
        points = data.placed().points_mm
        middle = points.reshape(-1, 3).mean(axis=0)
        cameras = []
        for number, camera in enumerate(data.true_cameras):
            column, row = camera.principal_point_px
            point = (column + 0.3 * math.cos(number), row + 0.2 * math.sin(2.0 * number))
            cameras.append(replace(camera, principal_point_px=point))
        return Calibration(tuple(cameras), middle + (points - middle) * [1.001, 0.999, 1.003])

    def score(self, data: Dataset, source: Source) -> Figures:
        """Score a calibration."""
        answer = self.read(data, source)
        with _refuse_failures(source):
            scores = score_calibration(data, answer)
        return {k: None if value is None else finite_or_none(value) for k, value in scores.items()}

    def images(self, data: Dataset) -> bytes:
        """Draw the found points of the target, or the images of the particles, as a PNG."""
        if not data.shows_target:
            return super().images(data)
        first = data.setup.cameras[0]
        return pictures.dots(data.calibration_case().pixels, first.rows, first.columns)

    def alike(self, data: Dataset, one: Calibration, other: Calibration) -> bool:
        """Compare calibrations by their true reprojection errors."""
        again = replace(other, cameras=other.cameras[::-1])
        answers = (replace(answer, used=None) for answer in (one, again))
        first, second = (score_calibration(data, answer)["true_px"] for answer in answers)
        worst = self.score(data, "empty")["true_px"]
        if first is None or second is None or worst is None:
            return False
        return abs(first - second) < _ALIKE * worst

    def picture(self, data: Dataset, source: Source) -> bytes:
        """Draw the true reprojection errors as a PNG; for the truth those of detection."""
        with _refuse_failures(source):
            return self._picture(data, source)

    def _picture(self, data: Dataset, source: Source) -> bytes:
        first = data.setup.cameras[0]
        if not data.shows_target:
            truth_mm, exact = _particles(data)
            _, again, _ = align_particles(self.read(data, source).cameras, truth_mm, exact)
            arrows = (exact[:, None], (again - exact)[:, None])
            return pictures.arrows(*arrows, first.rows, first.columns)
        exact, case = data.sightings()[0], data.calibration_case()
        if source == "truth":
            return pictures.arrows(exact, case.pixels - exact, first.rows, first.columns)
        answer = self.read(data, source)
        again = reproject(answer.cameras, target_points(answer, case))
        return pictures.arrows(exact, again - exact, first.rows, first.columns)


def score_calibration(data: Dataset, answer: Calibration) -> Figures:
    """Score a calibration by a data set's target or, without one, by its particles."""
    if not data.shows_target:
        return self_calibration_scores(answer.cameras, *_particles(data), data.true_cameras)
    case, truth_mm = data.calibration_case(), data.placed().points_mm
    exact, outliers = data.sightings()
    good = case.found & ~outliers
    scores = calibration_scores(answer, case, data.true_cameras, truth_mm, exact, good)
    noise_px = detection_noise(case.pixels, exact, good)
    motion = WallFrame.from_cameras(data.true_cameras, truth_mm).motion
    aligned = target_alignment(target_points(answer, case), truth_mm, motion)
    # draw random points (n, 3) of the volume, with noisy pixels (camera, n, 2). The true cameras
    # project the points
    volume, rng = data.scene.volume, stream(data.manifest.seed, "held out")
    aside = (rng.random((_HELD_OUT, 3)) - 0.5) * np.asarray(volume.size_mm)
    points_mm = np.asarray(volume.center_mm) + aside
    pixels = np.full((len(data.true_cameras), _HELD_OUT, 2), np.nan)
    for number, camera in enumerate(data.true_cameras):
        projected, valid = camera.project(points_mm)
        visible = valid & camera.contains(projected)
        noise = noise_px * rng.standard_normal((int(visible.sum()), 2))
        pixels[number, visible] = projected[visible] + noise
    cameras = answer.cameras, data.true_cameras
    return scores | held_out_scores(*cameras, points_mm, pixels, motion, aligned)


@contextlib.contextmanager
def _refuse_failures(source: Source) -> Iterator[None]:
    """Raise an InputError where the cameras of a result make the arithmetic fail."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        if not isinstance(source, Result):
            raise
        raise InputError(
            f"{source.path}: calibration/cameras: expected cameras that project points, got some "
            f"that fail: {error}"
        ) from error


def check_calibration(
    answer: Calibration, source: str, case: CalibrationCase | Observation
) -> None:
    """Raise an InputError, opened by `source`, for a calibration unfit for its case."""
    names = [camera.name for camera in answer.cameras]
    expected = [camera.name for camera in case.cameras]
    if names != expected:
        raise InputError(f"{source}: expected the cameras {expected}, got {names}")
    for camera in answer.cameras:
        if isinstance(camera, Camera):
            _check_pinhole(camera, source)
    if not isinstance(case, CalibrationCase):
        return
    frames, points = case.initial_mm.shape[:2]
    try:
        answer.check(camera=len(case.cameras), frame=frames, point=points)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error


def _check_pinhole(camera: Camera, source: str) -> None:
    """Raise an InputError for a camera that is none; `source` opens the sentence."""
    for key in ("principal_distance_mm", "pixel_mm"):
        value = getattr(camera, key)
        if not value > 0.0:
            raise InputError(f"{source}: {camera.name}: {key}: expected more than 0, got {value:g}")
    if not max(map(abs, camera.tilt_deg)) < 90.0:
        raise InputError(
            f"{source}: {camera.name}: tilt_deg: expected angles between -90 and 90, got "
            f"{list(camera.tilt_deg)}"
        )
    rotation = np.asarray(camera.rotation, dtype=np.float64)
    with np.errstate(all="ignore"):
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off < _ROTATION or np.linalg.det(rotation) < 0.0:
        raise InputError(
            f"{source}: {camera.name}: rotation: expected a rotation, got {rotation.tolist()}"
        )


def _particles(data: Dataset) -> tuple[F64, F64]:
    """Select true particles (n, 3) and exact pixels (camera, n, 2), NaN outside."""
    truth_mm = data.particles(0).position_mm
    order = stream(data.manifest.seed, "held out").permutation(len(truth_mm))
    truth_mm = truth_mm[order[:_PARTICLES]]
    exact = [exact_pixels(camera, truth_mm[None])[0] for camera in data.true_cameras]
    return truth_mm, np.stack(exact)


TASK = CalibrationTask()
