"""Calibration of an experimenter's own cameras.

The input is a folder with images or points of a target, without any truth;
docs/using/calibrating.md describes it. The output is cameras and a report.
"""

import csv
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from sabench.algorithms.calibration.unknown_selection import Nested, select_unknowns
from sabench.api import Calibration, CalibrationCase
from sabench.api.make import make_algorithm
from sabench.apps.own_calibration.folder import Recording, read_case
from sabench.apps.own_calibration.held_out import has_places, hold_out, solve_case
from sabench.apps.own_calibration.report import CalibrationReport, report_on
from sabench.dataset.cameras import wall_entry, write_cameras
from sabench.dataset.schema import CAMERAS
from sabench.geometry.camera import Camera
from sabench.plotting import pictures
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, refuse_existing
from sabench.utils.validation import Unknown

_PLACES = ("frame", "point", "x_mm", "y_mm", "z_mm", "cameras", "from_known_mm")


def calibrate(
    folder: Path,
    out: Path,
    solver: str,
    parameters: dict[str, Any],
    *,
    unknowns: str | None = None,
    overwrite: bool = False,
) -> CalibrationReport:
    """Calibrate the cameras of a folder and write the files of the folder `out`.

    They are cameras.json, report.json, target.csv, errors.png and residuals/CAMERA.png.

    Parameters
    ----------
    unknowns : names that commas separate, in place of those of calibration.toml; or "auto", see
        `unknown_selection.select_unknowns`.

    Raises
    ------
    InputError
        Anything missing or wrong in the folder, or a calibration that its data do not support.
    """
    refuse_existing(out, overwrite=overwrite)
    recording = read_case(folder)
    chosen, compared = _choose_unknowns(recording.case, unknowns)
    case = replace(recording.case, unknown=chosen)
    recording = replace(recording, case=case)
    algorithm = _solver_of(solver, parameters, case)
    answer = solve_case(algorithm, case)
    check_finite(answer, solver)
    try:
        held_out = hold_out(algorithm, case, answer)
        report, points, errors = report_on(recording, answer, held_out, compared)
    except InputError as error:
        raise InputError(f"solver {solver}: {error}") from error
    with complete_or_nothing(out, overwrite=overwrite) as partial:
        partial.mkdir()
        write_cameras(partial / CAMERAS, answer.cameras, wall=wall_entry(answer.cameras))
        (partial / "report.json").write_text(canonical_json(asdict(report)), encoding="utf-8")
        _write_places(partial / "target.csv", recording, points)
        # draw the residuals over the images, for each camera with cell means
        size = case.cameras[0].rows, case.cameras[0].columns
        (partial / "errors.png").write_bytes(pictures.arrows(case.pixels, errors, *size))
        (partial / "residuals").mkdir()
        for camera, pixels, off in zip(case.cameras, case.pixels, errors, strict=True):
            both = pictures.with_cell_means(pixels.reshape(-1, 2), off.reshape(-1, 2), *size)
            drawn = pictures.arrows(*both, *size)
            (partial / "residuals" / f"{camera.name}.png").write_bytes(drawn)
    return report


def _choose_unknowns(
    case: CalibrationCase, unknowns: str | None
) -> tuple[tuple[Unknown, ...], tuple[Nested, ...]]:
    """Take the case's unknowns, those named, or those that held-out frames recommend.

    The latter come with the table of the fits.
    """
    if unknowns == "auto":
        return select_unknowns(case)
    return case.unknown if unknowns is None else parse_unknowns(unknowns), ()


def parse_unknowns(text: str) -> tuple[Unknown, ...]:
    """Read names of unknowns that commas separate."""
    valid = [name for part in get_args(Unknown) for name in (get_args(part) or (part,))]
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in valid:
            raise InputError(
                f"--unknowns: expected auto, or names of {', '.join(valid)}, got {name}"
            )
    chosen: tuple[Any, ...] = tuple(names)
    return chosen


def _solver_of(solver: str, parameters: dict[str, Any], case: CalibrationCase) -> Any:
    algorithm: Any = make_algorithm(solver, parameters)
    if getattr(algorithm, "sees", "") != "target":
        raise InputError(f"solver {solver}: expected one that calibrates by a target")
    if getattr(algorithm, "needs_places", False) and not has_places(case):
        raise InputError(
            f"solver {solver}: expected known places of the target in every frame (x_mm, y_mm and "
            "z_mm in points.csv), since it takes them as exact, got none or too few"
        )
    reason = algorithm.skip(case)
    if reason:
        raise InputError(f"solver {solver} declines this case: {reason}")
    return algorithm


def check_finite(answer: Calibration, solver: str) -> None:
    """Raise an InputError for a calibration that the data do not determine."""
    records = [asdict(camera) for camera in answer.cameras if isinstance(camera, Camera)]
    try:
        json.dumps(records, allow_nan=False)
    except ValueError as error:
        raise InputError(
            f"solver {solver}: expected finite cameras, got NaN or infinity: the data do not "
            "determine the calibration, or calibration.toml has a wrong length"
        ) from error


def _write_places(path: Path, recording: Recording, points: F64) -> None:
    """Write the places of all points seen, and distances from known ones."""
    case = recording.case
    views = case.found.sum(axis=0)
    apart = np.linalg.norm(points - case.known_mm, axis=-1)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_PLACES)
        for k, i in np.argwhere((views > 0) & np.isfinite(points).all(axis=-1)).tolist():
            distance = f"{apart[k, i]:.6g}" if np.isfinite(apart[k, i]) else ""
            place = [f"{value:.6f}" for value in points[k, i].tolist()]
            labels = [recording.frames[k], recording.points[k, i]]
            writer.writerow([*labels, *place, views[k, i], distance])
