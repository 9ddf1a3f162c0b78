"""Calibrations without some frames, and their errors on these frames.

Nothing here needs a truth. A solver is called again for each fold of frames.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import BoardImages, refine
from sabench.algorithms.calibration.fit_checks import correlated_part, neighbours
from sabench.algorithms.calibration.parameters import FreeParameters, WallFrame
from sabench.algorithms.calibration.resection import known_places
from sabench.algorithms.calibration.unknown_selection import split_frames
from sabench.api import Calibration, CalibrationCase
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.rigid_motion import fit_lateral_motion, fit_rigid_motion
from sabench.geometry.triangulation import triangulate
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_FIXING = 3  # points that fix the pose of a rigid target
_MOST_LOOSE = 4.0  # times the median distance beyond which a triangulated point is an outlier


@dataclass(frozen=True)
class HeldOut:
    """Errors on frames that a calibration did not see.

    Attributes
    ----------
    frames : number of frames that were left out once; without a target, of points.
    failed : number of fits, of five, that failed without their frames.
    reprojection_px : root mean square error of a pixel coordinate, of rigid targets placed by the
        cameras, or of single points at their known places.
    rigidity_mm : root mean square distance of points that the cameras triangulate one by one from
        the rigid target; None for single points.
    known_mm : the same from the known places; None without any.
    bend_mm : (3,) part of these distances that neighbours share, along the wall and its normal.
    spread_mm : (3,) standard deviations of the target's points over the folds (jackknife), in the
        same frame; None where fewer than two cameras see the points.
    depth_mm : that of the depth of all points together; None likewise.
    """

    frames: int
    failed: int
    reprojection_px: float | None
    rigidity_mm: float | None
    known_mm: float | None
    bend_mm: tuple[float, float, float]
    spread_mm: tuple[float, float, float] | None
    depth_mm: float | None


def hold_out(algorithm: Any, case: CalibrationCase, whole: Calibration) -> HeldOut | None:
    """Calibrate without each fold of frames, and measure the frames left out.

    None where there are fewer than three frames to leave out, or where all these fits fail.

    Parameters
    ----------
    whole : the calibration by all frames.
    """
    folds, everything = split_frames(case), case
    if whole.used is not None:  # outliers are no errors of a calibration
        case = replace(case, pixels=np.where(whole.used[..., None], case.pixels, np.nan))
    rigid, shape = places_rigidly(whole.cameras, whole), case.initial_mm.shape
    points = target_places(whole.cameras, case, whole)
    reference = points if rigid else _triangulated(whole.cameras, case)
    board = reference[int(np.argmax(case.found.any(axis=(0, 2))))]  # with its bend
    errors, loose = np.full(case.pixels.shape, np.nan), np.full(shape, np.nan)
    from_known, moved, failed = np.full(shape, np.nan), [], 0
    for fold in folds:
        cameras = _without(algorithm, everything, whole, fold)
        if cameras is None:
            failed += 1
            continue
        placed, free = target_places(cameras, case, whole), _triangulated(cameras, case)
        positions = placed if rigid else free
        errors[:, fold] = residuals_of(cameras, case, placed)[:, fold]
        from_known[fold] = (positions - case.known_mm)[fold]
        loose[fold] = _off_rigid(free, board)[fold]
        moved.append(_aligned(positions, reference, case))
    unknowns = unknowns_of(whole.cameras, case, whole)
    return _summary(case, errors, unknowns, loose, from_known, moved, failed) if moved else None


def _without(
    algorithm: Any, case: CalibrationCase, whole: Calibration, fold: Any
) -> tuple[CameraModel, ...] | None:
    """Calibrate without some frames, from the whole calibration and the nominal wall."""
    pixels = case.pixels.copy()
    pixels[:, fold] = np.nan
    pairs = zip(whole.cameras, case.cameras, strict=True)
    cameras = tuple(replace(c, wall=nominal.wall) for c, nominal in pairs if isinstance(c, Camera))
    try:
        part = replace(case, pixels=pixels)
        if places_rigidly(whole.cameras, whole) and whole.points_mm is not None:
            part = replace(part, cameras=cameras, initial_mm=whole.points_mm)
        return solve_case(algorithm, part).cameras
    except InputError:
        return None


def solve_case(algorithm: Any, case: CalibrationCase) -> Calibration:
    """Call a solver, which may raise anything on a strange case.

    Raises
    ------
    InputError
        Any error of the solver, in a sentence.
    """
    try:
        answer: Calibration = algorithm.solve(case)
    except InputError:
        raise
    except Exception as error:
        failed = f"solver {algorithm.name} failed: {type(error).__name__}: {error}"
        raise InputError(failed) from error
    return answer


def target_places(
    cameras: tuple[CameraModel, ...], case: CalibrationCase, whole: Calibration
) -> F64:
    """Place the target (frame, point, 3) of every frame by some cameras.

    A target seen by pinholes is placed as a rigid body, with the bend of the complete calibration.
    Other targets have their measured or triangulated positions.
    """
    if whole.points_mm is None or not places_rigidly(cameras, whole):
        return case.initial_mm if has_places(case) else _triangulated(cameras, case)
    pinholes = tuple(camera for camera in cameras if isinstance(camera, Camera))
    frame = WallFrame.from_cameras(pinholes, whole.points_mm)
    visible = case.found.any(axis=(0, 2))
    board = whole.points_mm[int(np.argmax(visible))]
    used = case.found if whole.used is None else whole.used
    weights = np.asarray(used, dtype=np.float64)
    images = BoardImages(board, np.nan_to_num(case.pixels), weights, frame=frame.beyond_kernels)
    state = frame.state(board, whole.points_mm)
    return frame.points(refine(state, images, FreeParameters(), moving="boards").state, board)


def places_rigidly(cameras: tuple[CameraModel, ...], whole: Calibration) -> bool:
    """Return whether cameras are pinholes, and a target of several points was found."""
    several = whole.points_mm is not None and whole.points_mm.shape[1] > 1
    return several and all(isinstance(camera, Camera) for camera in cameras)


def has_places(case: CalibrationCase) -> bool:
    """Return whether known points place the target of every frame that is seen."""
    visible = case.found.any(axis=(0, 2))
    return bool(np.isfinite(known_places(case)[visible]).all())


def _triangulated(cameras: tuple[CameraModel, ...], case: CalibrationCase) -> F64:
    """Triangulate every point of every frame; NaN where one camera sees it."""
    places = triangulate(cameras, case.pixels.reshape(len(cameras), -1, 2))
    return places.reshape(case.initial_mm.shape)


def unknowns_of(cameras: tuple[CameraModel, ...], case: CalibrationCase, whole: Calibration) -> int:
    """Count the unknowns of a frame's target in `target_places`."""
    if places_rigidly(cameras, whole):
        return 6
    return 0 if has_places(case) else 3 * case.found.shape[2]


def residuals_of(cameras: tuple[CameraModel, ...], case: CalibrationCase, points: F64) -> F64:
    """Subtract projections of points (frame, point, 3) from the pixels found.

    Returns (camera, frame, point, 2); NaN where there is no image.
    """
    flat = points.reshape(-1, 3)
    pixels = np.stack([camera.project(flat)[0] for camera in cameras])
    return np.asarray(case.pixels - pixels.reshape(case.pixels.shape))


def _off_rigid(points: F64, board: F64) -> F64:
    """Subtract rigid boards from triangulated points (frame, point, 3)."""
    out = np.full(points.shape, np.nan)
    for number, positions in enumerate(points):
        finite = np.isfinite(positions).all(axis=1)
        if finite.sum() > _FIXING:
            out[number] = positions - fit_rigid_motion(board[finite], positions[finite])(board)
    return out


def _aligned(placed: F64, points: F64, case: CalibrationCase) -> F64:
    """Subtract points from those placed by other cameras, in the frame of the wall.

    Motions that the images do not determine are removed, unless known points determine them.
    """
    frame = WallFrame.from_cameras(case.cameras, case.initial_mm)
    aligned, true = frame.motion(placed), frame.motion(points)
    finite = np.asarray(np.isfinite(aligned + true).all(axis=-1))
    free = np.isfinite(case.known_mm).all(axis=-1).sum() < _FIXING
    if free and finite.sum() > _FIXING and frame.beyond_kernels is None:
        fit = fit_rigid_motion if frame.wall is None else fit_lateral_motion
        aligned = fit(aligned[finite], true[finite])(aligned)
    return np.asarray(np.where(finite[..., None], aligned - true, np.nan))


def _summary(
    case: CalibrationCase,
    errors: F64,
    unknowns: int,
    loose: F64,
    from_known: F64,
    moved: list[F64],
    failed: int,
) -> HeldOut:
    axes = WallFrame.from_cameras(case.cameras, case.initial_mm).motion.rotation
    frames = np.isfinite(errors).any(axis=(0, 2, 3)).sum()
    pairs = neighbours(case.target.points_mm)
    if case.found.shape[2] == 1:
        pairs = neighbours(case.initial_mm[:, 0])
        loose, from_known = loose.transpose(1, 0, 2), from_known.transpose(1, 0, 2)
    parts = [correlated_part(_inliers(vectors) @ axes.T, pairs) for vectors in (loose, from_known)]
    bend = np.nan_to_num(np.fmax(*parts))
    spread, depth = _jackknife(np.array(moved))
    return HeldOut(
        int(frames),
        failed,
        rms_px(errors, unknowns),
        _rms(_inliers(loose)),
        _rms(from_known),
        (float(bend[0]), float(bend[1]), float(bend[2])),
        spread,
        depth,
    )


def _jackknife(moved: F64) -> tuple[tuple[float, float, float] | None, float | None]:
    """Estimate standard deviations from motions (fold, frame, point, 3).

    Those of points about their mean depth, and that of the mean depth.
    """
    folds = len(moved)
    flat = moved.reshape(folds, -1, 3)
    flat = flat[:, np.asarray(np.isfinite(flat).all(axis=(0, 2)))]
    if not flat.size:
        return None, None
    flat = flat - flat.mean(axis=0)
    depth = flat[..., 2].mean(axis=1)
    flat[..., 2] -= depth[:, None]
    factor = (folds - 1) / folds
    x, y, z = np.sqrt(factor * (flat**2).sum(axis=0).mean(axis=0)).tolist()
    return (x, y, z), float(np.sqrt(factor * np.sum(depth**2)))


def _inliers(errors: F64) -> F64:
    """Replace outliers among errors (..., 3) by NaN."""
    lengths = np.linalg.norm(errors, axis=-1)
    if not np.isfinite(lengths).any():
        return errors
    return np.where((lengths <= _MOST_LOOSE * np.nanmedian(lengths))[..., None], errors, np.nan)


def rms_px(errors: F64, unknowns: int) -> float | None:
    """Compute the root mean square coordinate of errors, px.

    Errors are (camera, frame, point, 2). Outliers are left out, and `unknowns` of every frame are
    allowed for.
    """
    inliers = _inliers(errors)
    valid = np.asarray(np.isfinite(inliers[..., 0]))
    left = 2 * int(valid.sum()) - unknowns * int(np.sum(valid.any(axis=(0, 2))))
    return float(np.sqrt(np.nansum(inliers**2) / left)) if left > 0 else None


def _rms(errors: F64) -> float | None:
    squares = np.sum(errors**2, axis=-1)
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else None
