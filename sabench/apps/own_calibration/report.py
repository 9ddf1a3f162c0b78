"""Report of a calibration: its quality as far as its own data show it.

It includes the unknowns of a wall, and how well the data determine them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.algorithms.calibration.bundle_adjustment import BoardImages
from sabench.algorithms.calibration.cramer_rao import Limit, compute_bound
from sabench.algorithms.calibration.fit_checks import correlated_part, neighbours
from sabench.algorithms.calibration.joint_fit import INDEX_SIGMA, THICKNESS
from sabench.algorithms.calibration.parameters import WALL, FreeParameters, WallFrame, common_plane
from sabench.algorithms.calibration.problem import make_anchors
from sabench.algorithms.calibration.unknown_selection import Nested
from sabench.api import Calibration, CalibrationCase
from sabench.apps.own_calibration.folder import Recording
from sabench.apps.own_calibration.held_out import (
    HeldOut,
    places_rigidly,
    residuals_of,
    rms_px,
    target_places,
    unknowns_of,
)
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import frame_of_normal
from sabench.plotting.card import Card
from sabench.utils.arrays import F64, Bool, triple
from sabench.utils.errors import InputError
from sabench.utils.number_text import format_number

# errors of what a data sheet, a ruler and a spirit level show, without any calibration
_INDEX, _THICKNESS_MM, _TILT_DEG, _PLACE_MM = 0.01, 0.5, 0.5, 1.0


@dataclass(frozen=True)
class WallUnknown:
    """Unknown of the wall.

    Attributes
    ----------
    name, unit : such as "thickness of glass" and "mm".
    nominal, found : values; tilts and the place count from the nominal wall, the place along its
        normal through the world's origin.
    std : smallest standard deviation that the data allow without the nominal value (Cramer-Rao
        bound); None where nothing shows it.
    shown : whether they are more precise than a data sheet, a ruler and a spirit level.
    """

    name: str
    unit: str
    nominal: float
    found: float
    std: float | None
    shown: bool


def _name_media(wall: Wall) -> tuple[str, ...]:
    """Name the media along the way of light from a camera."""
    return "the cameras' medium", *(layer.name for layer in wall.layers), "the fluid"


def wall_unknowns(
    nominal: Wall, found: Wall, free: FreeParameters, shared_std: F64
) -> tuple[WallUnknown, ...]:
    """List the free unknowns of a wall.

    Parameters
    ----------
    shared_std : (s,) bound of what all cameras share, see `cramer_rao.Limit`.
    """
    names = [
        *((f"index of {name}", "", _INDEX) for name in _name_media(nominal)),
        *((f"thickness of {layer.name}", "mm", _THICKNESS_MM) for layer in nominal.layers),
        ("tilt of the wall about X", "deg", _TILT_DEG),
        ("tilt of the wall about Y", "deg", _TILT_DEG),
        ("place of the wall", "mm", _PLACE_MM),
    ]
    scales = np.ones(len(names))
    scales[-WALL:-1] = math.degrees(1.0)
    before, after = (_values(wall, nominal).tolist() for wall in (nominal, found))
    _, shared = free.columns(len(nominal.indices))
    rows = []
    for number, std in zip(shared.tolist(), shared_std.tolist(), strict=True):
        if number < len(names):
            name, unit, measured = names[number]
            deviation = std * float(scales[number])
            finite = deviation if math.isfinite(deviation) else None
            figures = before[number], after[number], finite
            rows.append(WallUnknown(name, unit, *figures, deviation < measured))
    return tuple(rows)


def _values(wall: Wall, nominal: Wall) -> F64:
    """List indices, thicknesses, tilts (deg) and place (mm) of a wall.

    Tilts and place count from the nominal wall.
    """
    axes = frame_of_normal(np.asarray(nominal.normal))
    right, down, along = axes @ np.asarray(wall.normal)
    place = np.asarray(wall.point_mm) @ np.asarray(wall.normal) / along
    tilts = np.rad2deg([-down, right])
    base = np.asarray(nominal.point_mm) @ axes[2]
    thick = [layer.thickness_mm for layer in wall.layers]
    return np.concatenate([wall.indices, thick, tilts, [place - base]])


def warn_of_unknowns(unknowns: Sequence[WallUnknown]) -> Iterator[str]:
    """Report in one sentence which unknowns of the wall are not determined."""
    hidden = [unknown for unknown in unknowns if not unknown.shown]
    if hidden:
        listed = " and ".join(_standard_deviation(unknown) for unknown in hidden)
        yield f"The data hardly show the {listed}: measure it, and take it out of the unknowns."


def _standard_deviation(unknown: WallUnknown) -> str:
    unit = f" {unknown.unit}" if unknown.unit else ""
    std = "infinite" if unknown.std is None else f"{unknown.std:.3g}{unit}"
    return f"{unknown.name} (standard deviation {std})"


_SHALLOW = 0.002  # error of the depth, part of the distance from the wall, that images leave open
_LEAST_PX = 1e-3  # misfit that no data have reason to show
_MISFIT = 0.5  # times the noise: residuals that neighbours share, above which a model is too simple


@dataclass(frozen=True, repr=False)
class CalibrationReport(Card):
    """Quality of a calibration as far as its own data show it.

    Attributes
    ----------
    summary : most important findings, one sentence each, in order of importance.
    unknown : unknowns of lenses, wall and board.
    compared : fits for choosing the unknowns; empty if they were given.
    noise_px : error of a pixel coordinate, from the residuals.
    misfit_px : the part of it that neighbouring points share: of the model and not of noise.
    true_px : expected mean error of the calibrated cameras, with the misfit; None for solvers
        without a bound.
    std_mm : expected standard deviation of the target's points along the wall's X and Y and its
        normal, with the misfit; None without frames to hold out and without a bound.
    noise_std_mm : the same if there were only noise: the Cramer-Rao bound.
    wall : unknowns of the wall, and what the data show of them; empty without any.
    depth_mm : standard deviation of the distance of all points together from the wall; None without
        a wall.
    held_out : errors of frames that the fit did not see; None where there are too few.
    cameras, frames : for each its name or number, the numbers of points found and used, and the
        mean and largest residual of the used ones, px.
    """

    summary: tuple[str, ...]
    unknown: tuple[str, ...]
    compared: tuple[Nested, ...]
    noise_px: float
    misfit_px: float
    true_px: float | None
    std_mm: tuple[float, float, float] | None
    noise_std_mm: tuple[float, float, float] | None
    wall: tuple[WallUnknown, ...]
    depth_mm: float | None
    held_out: HeldOut | None
    cameras: tuple[dict[str, Any], ...]
    frames: tuple[dict[str, Any], ...]

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield from ((sentence,) for sentence in self.summary)
        if self.compared:
            yield "unknowns", "held-out px", "change", "standard error", "keep"
            for fit in self.compared:
                name = f"+ {' and '.join(fit.added)}" if fit.added else "focal lengths"
                figures = fit.held_out_px, fit.change_px, fit.sigma_px
                kept = fit.remark or ("yes" if fit.chosen else "no")
                yield name, *(format_number(value, 4) for value in figures), kept
            quoted = ", ".join(f'"{name}"' for name in self.unknown)
            yield (f"recommended and used: unknown = [{quoted}]",)
        yield "camera or frame", "found", "used", "mean px", "largest px"
        for line in (*self.cameras, *self.frames):
            name = line["name"] if isinstance(line["name"], str) else f"frame {line['name']}"
            errors = (format_number(line[key], 3) for key in ("mean_px", "largest_px"))
            yield name, str(line["found"]), str(line["used"]), *errors
        yield from ((sentence,) for sentence in self._sentences())
        if self.wall:
            yield "unknown of the wall", "unit", "nominal", "found", "bound", "shown"
        for one in self.wall:
            values = (format_number(figure, 4) for figure in (one.nominal, one.found, one.std))
            yield one.name, one.unit or "-", *values, "yes" if one.shown else "no"

    def _sentences(self) -> Iterator[str]:
        shared = f"of which neighbours share {self.misfit_px:.4f} px"
        yield f"residuals: {self.noise_px:.4f} px, {shared}"
        if self.true_px is not None:
            yield f"expected true error, misfit included: {self.true_px:.4f} px"
        if held := self.held_out:
            figures = [
                (f"reprojection {held.reprojection_px:.4f} px", held.reprojection_px),
                (f"off a rigid target {held.rigidity_mm or 0.0:.4f} mm", held.rigidity_mm),
                (f"off known places {held.known_mm or 0.0:.4f} mm", held.known_mm),
            ]
            what = "frames" if held.frames <= len(self.frames) else "points"
            lost = f" ({held.failed} fits failed)" if held.failed else ""
            good = ", ".join(text for text, measured in figures if measured)
            yield f"{held.frames} {what} held out{lost}: {good}"
        where = "along the wall's X and Y and its normal"
        for label, std in (("misfit included", self.std_mm), ("noise alone", self.noise_std_mm)):
            if std is not None:
                x, y, z = std
                yield f"expected scatter of points {where}, {label}: {x:.4f}, {y:.4f}, {z:.4f} mm"
        if self.depth_mm is not None:
            error = f"{self.depth_mm:.3g} mm"
            yield f"expected error of the distance of all points from the wall: {error}"


def report_on(
    recording: Recording,
    answer: Calibration,
    held_out: HeldOut | None,
    compared: tuple[Nested, ...] = (),
) -> tuple[CalibrationReport, F64, F64]:
    """Report the quality of a calibration.

    Also returns the places of the target (frame, point, 3) in mm and the residuals of the points
    used (camera, frame, point, 2) in px, NaN for others.

    Raises
    ------
    InputError
        Points found where the calibration lets no camera see them.
    """
    case = recording.case
    points = answer.points_mm
    if points is None:
        points = target_places(answer.cameras, case, answer)
    errors = residuals_of(answer.cameras, case, points)
    used = case.found & np.isfinite(points).all(axis=-1) if answer.used is None else answer.used
    if hidden := int(np.isnan(errors[used]).any(axis=-1).sum()):
        raise InputError(
            f"expected the target in the fluid, but {hidden} of {int(used.sum())} points found "
            "cannot be seen where the calibration puts them: in the wall or before it; check "
            "target_mm, wall and known"
        )
    residuals = np.where(used[..., None], errors, np.nan)
    misfit = _misfit_px(case, residuals)
    noise = _noise_px(case, answer, residuals)
    bound, wall = _bound(case, answer, points, used, noise)
    std = _expected_mm(bound, held_out)
    walled = any(camera.wall for camera in case.cameras)
    depth = _depth_mm(bound, held_out) if walled else None
    report = CalibrationReport(
        (
            *answer.remarks,
            *warn_of_unknowns(wall),
            *_warn_of_depth(case, points, depth),
            *_warn_of_model(case, answer, misfit, noise),
        ),
        case.unknown,
        compared,
        noise,
        misfit,
        None if bound is None else float(np.hypot(bound.reprojection_px, np.sqrt(2.0) * misfit)),
        std,
        None if bound is None else triple(bound.point_std_mm),
        wall,
        depth,
        held_out,
        tuple(
            _line(camera.name, errors[i], case.found[i], used[i])
            for i, camera in enumerate(answer.cameras)
        ),
        tuple(
            _line(int(k), errors[:, of_frame], case.found[:, of_frame], used[:, of_frame])
            for k in np.unique(recording.frames)
            if (of_frame := recording.frames == k).any()
        ),
    )
    return report, points, residuals


def _noise_px(case: CalibrationCase, answer: Calibration, errors: F64) -> float:
    """Compute the standard deviation of a pixel coordinate, unknowns allowed for."""
    valid = np.isfinite(errors[..., 0])
    free = FreeParameters.from_case(case)
    unknowns = free.per_camera * len(answer.cameras) if free.cameras else 0
    if not places_rigidly(answer.cameras, answer):
        return rms_px(errors, unknowns_of(answer.cameras, case, answer)) or 0.0
    unknowns += 6 * int(valid.any(axis=(0, 2)).sum())
    return float(np.sqrt(np.nansum(errors**2) / max(2 * int(valid.sum()) - unknowns, 1)))


def _misfit_px(case: CalibrationCase, errors: F64) -> float:
    """Compute the part of residuals that neighbouring points share, per coordinate."""
    if case.found.shape[2] == 1:
        parts = correlated_part(errors.transpose(0, 2, 1, 3), neighbours(case.initial_mm[:, 0]))
    else:
        parts = correlated_part(errors, neighbours(case.target.points_mm))
    return float(np.sqrt(np.mean(np.nan_to_num(parts) ** 2)))


def _bound(
    case: CalibrationCase, answer: Calibration, points: F64, used: Bool, noise: float
) -> tuple[Limit | None, tuple[WallUnknown, ...]]:
    """Compute the Cramer-Rao bound of pinholes that look at boards; None for others.

    It comes with the unknowns of the wall.
    """
    cameras = tuple(camera for camera in answer.cameras if isinstance(camera, Camera))
    if not places_rigidly(answer.cameras, answer):
        return None, ()
    frame, free = WallFrame.from_cameras(cameras, points), FreeParameters.from_case(case)
    board = points[int(np.argmax(used.any(axis=(0, 2))))]  # with its bend
    images = BoardImages(
        board - board.mean(axis=0),
        np.nan_to_num(case.pixels),
        used.astype(np.float64),
        make_anchors(case, frame, noise),
        frame.beyond_kernels,
    )
    state = frame.state(images.board, points)
    bound, nominal = compute_bound(state, images, free, noise), common_plane(case.cameras)
    if nominal is None or frame.wall is None:
        return bound, ()
    return bound, wall_unknowns(nominal, frame.wall, free, bound.shared_std)


def _expected_mm(
    bound: Limit | None, held_out: HeldOut | None
) -> tuple[float, float, float] | None:
    """Join noise, scatter between fits and what neighbours share on frames held out."""
    noise = None if bound is None else bound.point_std_mm
    if held_out is None or held_out.spread_mm is None:
        return None if noise is None else triple(noise)
    spread = np.asarray(held_out.spread_mm)
    if noise is not None:
        spread = np.maximum(spread, noise)
    return triple(np.hypot(spread, held_out.bend_mm))


def _depth_mm(bound: Limit | None, held_out: HeldOut | None) -> float | None:
    """Take the larger of the standard deviations by noise and between fits."""
    depths = [None if bound is None else float(bound.point_mean_mm[2])]
    depths.append(None if held_out is None else held_out.depth_mm)
    return max((value for value in depths if value is not None), default=None)


def _warn_of_depth(case: CalibrationCase, points: F64, depth: float | None) -> Iterator[str]:
    """Warn where the boards do not determine the depth."""
    wall = common_plane(case.cameras)
    if wall is None or depth is None:
        return
    behind = float(np.nanmean(wall.depth_of(points))) - wall.thickness_mm
    if depth > _SHALLOW * abs(behind):
        yield (
            f"The boards do not show how far they are from the wall: all points together are "
            f"uncertain by {depth:.3g} mm along its normal. Measure the distance of one point "
            "of the target from the outer face of the wall and enter it in [[known]]."
        )


def _warn_of_model(
    case: CalibrationCase, answer: Calibration, misfit: float, noise: float
) -> Iterator[str]:
    """Warn of systematic residuals and of values far from the nominal ones."""
    pinholes = tuple(camera for camera in answer.cameras if isinstance(camera, Camera))
    if pinholes and misfit > max(_MISFIT * noise, _LEAST_PX):
        yield (
            f"Neighbouring points share {misfit:.3g} px of their residuals of {noise:.3g} px, "
            "which is no noise: the model lacks something. Compare with --unknowns auto."
        )
    nominal, fitted = common_plane(case.cameras), common_plane(pinholes) if pinholes else None
    if nominal is None or fitted is None:
        return
    for before, after in zip(nominal.layers, fitted.layers, strict=True):
        if abs(after.thickness_mm - before.thickness_mm) > THICKNESS * before.thickness_mm:
            yield (
                f"The fit gives {before.name} a thickness of {after.thickness_mm:.3g} mm where "
                f"{before.thickness_mm:.3g} mm is nominal: measure it, and take it out of the "
                "unknowns."
            )
    for name, old, new in zip(_name_media(nominal), nominal.indices, fitted.indices, strict=True):
        if abs(new - old) > INDEX_SIGMA:
            yield (
                f"The fit gives {name} an index of {new:.4g} where {old:.4g} is nominal: measure "
                "it, and take it out of the unknowns."
            )


def _line(
    name: str | int, errors: F64, detected: npt.NDArray[np.bool_], used: npt.NDArray[np.bool_]
) -> dict[str, Any]:
    distances = np.linalg.norm(errors, axis=-1)[used]
    figures = (float(distances.mean()), float(distances.max())) if len(distances) else (None, None)
    return {
        "name": name,
        "found": int(detected.sum()),
        "used": int(used.sum()),
        "mean_px": figures[0],
        "largest_px": figures[1],
    }
