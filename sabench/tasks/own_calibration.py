"""Calibration of an experimenter's own cameras.

The input is a folder with images or points of a target, without any truth;
docs/using/calibrating.md describes it. The output is cameras and a report.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.algorithms.calibration.bundle_adjustment import BoardImages
from sabench.algorithms.calibration.cramer_rao import limit
from sabench.algorithms.calibration.parameters import Frame, FreeParameters
from sabench.algorithms.calibration.problem import make_anchors
from sabench.api import Calibration, CalibrationCase
from sabench.api.make import make_algorithm
from sabench.dataset.camera_files import write_cameras
from sabench.dataset.schema import CAMERAS
from sabench.dataset.wall_entries import wall_entry
from sabench.geometry.camera import Camera
from sabench.plotting import pictures
from sabench.tasks.calibration_folder import read_case
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing


@dataclass(frozen=True)
class Report:
    """Quality of a calibration as far as its own data show it.

    Attributes
    ----------
    noise_px : noise of a pixel coordinate, from the residuals.
    true_px : expected mean error of the calibrated cameras under this noise.
    std_mm : expected standard deviation of the target's points along X, Y, Z under this noise.
    depth_mm : standard deviation of the depth of all points together.
    cameras, frames : for each its name or number, the numbers of points found and used, and the
        mean and largest residual of the used ones, px.
    """

    noise_px: float
    true_px: float
    std_mm: tuple[float, float, float]
    depth_mm: float
    cameras: tuple[dict[str, Any], ...]
    frames: tuple[dict[str, Any], ...]


def calibrate(
    folder: Path, out: Path, solver: str, parameters: dict[str, Any], *, overwrite: bool = False
) -> Report:
    """Calibrate the cameras of a folder and write the files of the folder `out`.

    They are cameras.json, report.json and errors.png.

    Raises
    ------
    InputError
        Anything missing or wrong in the folder, or a calibration that its data do not support.
    """
    case = read_case(folder).case
    algorithm: Any = make_algorithm(solver, parameters)
    if getattr(algorithm, "sees", "") != "target":
        raise InputError(f"solver {solver}: expected one that calibrates by a target")
    reason = algorithm.skip(case)
    if reason:
        raise InputError(f"solver {solver} declines this case: {reason}")
    answer, points = _solve(algorithm, solver, case)
    if points is None or not all(isinstance(camera, Camera) for camera in answer.cameras):
        raise InputError(
            f"solver {solver}: expected one that returns pinhole cameras and the target's "
            "positions, for the report"
        )
    report, errors = report_on(case, answer, points, solver)
    check_finite(report, answer, solver)
    with complete_or_nothing(out, overwrite=overwrite) as partial:
        partial.mkdir()
        write_cameras(partial / CAMERAS, answer.cameras, wall=wall_entry(answer.cameras))
        (partial / "report.json").write_text(canonical_json(asdict(report)), encoding="utf-8")
        (partial / "errors.png").write_bytes(
            pictures.arrows(case.pixels, errors, case.cameras[0].rows, case.cameras[0].columns)
        )
    return report


def _solve(algorithm: Any, solver: str, case: CalibrationCase) -> tuple[Calibration, F64 | None]:
    """Call a solver, which may raise anything on a strange case."""
    try:
        answer: Calibration = algorithm.solve(case)
    except InputError:
        raise
    except Exception as error:
        failed = f"solver {solver} failed: {type(error).__name__}: {error}"
        raise InputError(failed) from error
    return answer, answer.points_mm


def check_finite(report: Report, answer: Calibration, solver: str) -> None:
    """Raise an InputError for a calibration that the data do not determine."""
    figures = (report.noise_px, report.true_px, *report.std_mm, report.depth_mm)
    records = [asdict(camera) for camera in answer.cameras if isinstance(camera, Camera)]
    try:
        json.dumps([figures, records], allow_nan=False)
    except ValueError as error:
        raise InputError(
            f"solver {solver}: expected finite cameras and errors, got NaN or infinity: the data "
            "do not determine the calibration, or calibration.toml has a wrong length"
        ) from error


def report_on(
    case: CalibrationCase, answer: Calibration, points: F64, solver: str
) -> tuple[Report, F64]:
    """Report the quality of a calibration, and the residuals of all points found.

    Residuals are (camera, frame, point, 2).

    Raises
    ------
    InputError
        Points found where the calibration lets no camera see them.
    """
    cameras = tuple(camera for camera in answer.cameras if isinstance(camera, Camera))
    flat = points.reshape(-1, 3)
    errors = case.pixels - np.stack([camera.project(flat)[0] for camera in cameras]).reshape(
        case.pixels.shape
    )
    used = case.found if answer.used is None else answer.used
    if hidden := int(np.isnan(errors[used]).any(axis=-1).sum()):
        raise InputError(
            f"solver {solver}: expected the target in the fluid, but {hidden} of {int(used.sum())} "
            "points found cannot be seen where the calibration puts them: in the wall or before "
            "it; check target_mm, wall and known"
        )
    frame = Frame.from_cameras(cameras, points)
    free = FreeParameters.from_names(case.unknown)
    size, boards = free.per_camera * len(cameras), 6 * int(used.any(axis=(0, 2)).sum())
    noise = float(np.sqrt(np.sum(errors[used] ** 2) / max(2 * used.sum() - size - boards, 1)))
    seen = BoardImages(
        case.target.points_mm,
        np.nan_to_num(case.pixels),
        used.astype(np.float64),
        make_anchors(case, frame, noise),
        frame.beyond_kernels,
    )
    bound = limit(frame.state(case.target.points_mm, points), seen, free, noise)
    lengths = np.linalg.norm(errors, axis=-1)
    by_camera = tuple(
        _line(camera.name, lengths[i], case.found[i], used[i]) for i, camera in enumerate(cameras)
    )
    by_frame = tuple(
        _line(k, lengths[:, k], case.found[:, k], used[:, k]) for k in range(points.shape[0])
    )
    return Report(
        noise,
        bound.reprojection_px,
        triple(bound.point_std_mm),
        float(bound.point_mean_mm[2]),
        by_camera,
        by_frame,
    ), errors


def _line(
    name: str | int, lengths: F64, found: npt.NDArray[np.bool_], used: npt.NDArray[np.bool_]
) -> dict[str, Any]:
    own = lengths[used]
    figures = (float(own.mean()), float(own.max())) if len(own) else (None, None)
    return {
        "name": name,
        "found": int(found.sum()),
        "used": int(used.sum()),
        "mean_px": figures[0],
        "largest_px": figures[1],
    }
