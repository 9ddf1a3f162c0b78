"""Errors of a calibration: reprojection, target and held-out points, wall."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import BoardImages
from sabench.algorithms.calibration.cramer_rao import Limit, compute_bound
from sabench.algorithms.calibration.parameters import FreeParameters, WallFrame, common_plane
from sabench.algorithms.calibration.problem import make_anchors
from sabench.api import Calibration, CalibrationCase
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import RigidMotion, fit_lateral_motion, fit_rigid_motion
from sabench.geometry.triangulation import triangulate
from sabench.metrics.averages import finite_or_none, root_mean_square
from sabench.utils.arrays import F64, Bool

Alignment = Literal["raw", "shift", "lateral", "rigid"]
ALIGNMENTS: tuple[Alignment, ...] = ("raw", "shift", "lateral", "rigid")


def fit_alignment(how: Alignment, estimate: F64, truth: F64) -> RigidMotion:
    """Fit the motion that brings estimated points (n, 3) nearest to true ones.

    Both are in the frame of the wall.

    Parameters
    ----------
    how : raw: no motion. shift: along X and Y, as in the thesis (section 4.4.2). lateral: also a
        rotation about Z, which is all that a plane wall leaves open. rigid: any rigid motion.
    """
    if how == "raw":
        return RigidMotion.none()
    if how == "shift":
        return RigidMotion(np.eye(3), np.append((truth - estimate).mean(axis=0)[:2], 0.0))
    return (fit_lateral_motion if how == "lateral" else fit_rigid_motion)(estimate, truth)


Scores = dict[str, float | None]


def calibration_scores(
    estimate: Calibration,
    case: CalibrationCase,
    true_cameras: tuple[Camera, ...],
    truth_mm: F64,
    true_pixels: F64,
    good: Bool,
) -> Scores:
    """Score a calibration by a target, without its held-out points.

    Parameters
    ----------
    truth_mm : (frame, point, 3) true positions of the target's points, world frame.
    true_pixels : (camera, frame, point, 2) their exact images.
    good : (camera, frame, point) which points were detected and are no outliers.
    """
    frame = WallFrame.from_cameras(true_cameras, truth_mm)
    noise_px = detection_noise(case.pixels, true_pixels, good)
    bound = lower_bound(case, frame, truth_mm, good, noise_px)
    points, visible = target_points(estimate, case), np.asarray(good.any(axis=0))
    pinholes = [camera for camera in estimate.cameras if isinstance(camera, Camera)]
    wall = common_plane(pinholes) if pinholes else None
    scores = _reprojection_scores(estimate, points, case, true_cameras, true_pixels, good, bound)
    scores |= point_scores(points, truth_mm, visible, frame.motion)
    for number, axis in enumerate("xyz"):
        std = scores[f"{axis}_std_mm"]
        ratio = std / float(bound.point_std_mm[number]) if bound and std is not None else None
        scores[f"{axis}_std_ratio"] = ratio
    scores["bound_z_mean_mm"] = float(bound.point_mean_mm[2]) if bound else None
    scores["spacing_mm"] = spacing_error(points, truth_mm, visible, frame.motion)
    scores |= _detection_scores(case.pixels, true_pixels, good)
    return scores | wall_scores(wall, common_plane(true_cameras))


def target_points(estimate: Calibration, case: CalibrationCase) -> F64:
    """Get or triangulate the positions (frame, point, 3) of the target's points.

    Triangulation takes the observations that the estimate used, and all of a point if it used fewer
    than two, so that no estimate chooses the points that it is scored by; NaN for a point in fewer
    than two cameras.
    """
    if estimate.points_mm is not None:
        return estimate.points_mm
    used = _used(estimate, case)
    used = np.where(used.sum(axis=0) >= 2, used, case.found)
    pixels = np.where(used[..., None], case.pixels, np.nan)
    flat = pixels.reshape(len(estimate.cameras), -1, 2)
    return triangulate(estimate.cameras, flat).reshape(case.initial_mm.shape)


def reproject(cameras: Sequence[CameraModel], points_mm: F64) -> F64:
    """Project points (..., 3) into every camera: pixels (camera, ..., 2)."""
    flat = points_mm.reshape(-1, 3)
    pixels = np.stack([camera.project(flat)[0] for camera in cameras])
    return pixels.reshape(len(cameras), *points_mm.shape[:-1], 2)


def _used(estimate: Calibration, case: CalibrationCase) -> Bool:
    """Mark the observations (camera, frame, point) that an estimate used."""
    return case.found if estimate.used is None else estimate.used & case.found


def mean_distance(
    pixels: F64, true_pixels: F64, selected: Bool, cameras: Sequence[CameraModel]
) -> float | None:
    """Average the distances of selected pixels (camera, ..., 2) from the true ones.

    No distance is larger than the diagonal of its camera's image, and a point without a pixel is
    that far away: leaving a point out improves nothing. None without selected points.
    """
    diagonal = np.array([np.hypot(camera.rows, camera.columns) for camera in cameras])
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.linalg.norm(pixels - true_pixels, axis=-1)
    most = np.broadcast_to(diagonal.reshape(-1, *[1] * (apart.ndim - 1)), apart.shape)[selected]
    lengths = np.fmin(apart[selected], most)
    return float(lengths.mean()) if len(lengths) else None


def scatter(errors: F64) -> float | None:
    """Compute the rms distance of finite errors (n, 3) from their mean, or None."""
    finite = errors[np.isfinite(errors).all(axis=-1)]
    if not len(finite):
        return None
    return float(np.sqrt(((finite - finite.mean(axis=0)) ** 2).sum(axis=1).mean()))


def detection_noise(pixels: F64, truth: F64, good: Bool) -> float:
    """Compute the rms error of good pixels (..., 2); 0 without any."""
    errors = (pixels - truth)[good]
    return root_mean_square(errors) if len(errors) else 0.0


def _detection_scores(pixels: F64, truth: F64, good: Bool) -> Scores:
    """Compute mean error and scatter of good pixels (..., 2)."""
    keys = ("found_bias_column_px", "found_bias_row_px", "found_std_px")
    errors = (pixels - truth)[good]
    if not len(errors):
        return dict.fromkeys(keys)
    figures = (*errors.mean(axis=0), errors.std(axis=0).mean())
    return dict(zip(keys, map(finite_or_none, figures), strict=True))


def lower_bound(
    case: CalibrationCase, frame: WallFrame, truth_mm: F64, good: Bool, noise_px: float
) -> Limit | None:
    """Compute the Cramer-Rao bound of a case; None without noise or if singular.

    Unknowns are the rotation, centre and focal length of every camera, the unknowns that the case
    names, and all boards.
    """
    if noise_px <= 0.0:
        return None
    board = case.target.points_mm
    anchors = make_anchors(case, frame, noise_px)
    pixels, weights = np.nan_to_num(case.pixels), good.astype(np.float64)
    views = BoardImages(board, pixels, weights, anchors, frame.beyond_kernels)
    try:
        return compute_bound(
            frame.state(board, truth_mm), views, FreeParameters.from_case(case), noise_px
        )
    except np.linalg.LinAlgError:  # positions and cameras far from anything real
        return None


def _reprojection_scores(
    estimate: Calibration,
    points_mm: F64,
    case: CalibrationCase,
    true_cameras: tuple[Camera, ...],
    true_pixels: F64,
    good: Bool,
    bound: Limit | None,
) -> Scores:
    """Compute distances of reprojected points from detected and true pixels."""
    pixels, used = reproject(estimate.cameras, points_mm), _used(estimate, case)
    placed = (case.found.sum(axis=0) >= 2) | np.isfinite(points_mm).all(axis=-1)
    lengths = np.linalg.norm((pixels - case.pixels)[used], axis=-1)
    lengths = lengths[np.isfinite(lengths)]
    measured = float(lengths.mean()) if len(lengths) else None
    true = mean_distance(pixels, true_pixels, good & placed, true_cameras)
    return {
        "true_px": true,
        "measured_px": measured,
        "true_ratio": true / bound.reprojection_px if bound and true is not None else None,
        "bound_px": bound.reprojection_px if bound else None,
        "efficiency_ratio": (
            true / measured / bound.efficiency if true and measured and bound else None
        ),
        "used_percent": 100.0 * float(used.sum()) / max(int(case.found.sum()), 1),
    }


def wall_scores(estimate: Wall | None, truth: Wall | None) -> Scores:
    """Compute errors of a wall: largest of index, thickness; position, tilt.

    The position is that of the estimated wall's point along the true normal. None if one of the
    walls is missing or they have different numbers of layers.
    """
    names = ("index_error", "thickness_error_mm", "wall_place_error_mm", "wall_tilt_error_deg")
    if truth is None or estimate is None or len(estimate.layers) != len(truth.layers):
        return dict.fromkeys(names)
    layers = zip(estimate.layers, truth.layers, strict=True)
    turn = np.clip(np.linalg.norm(np.cross(estimate.normal, truth.normal)), 0.0, 1.0)
    figures = (
        float(np.abs(estimate.indices - truth.indices).max()),
        max((abs(layer.thickness_mm - true.thickness_mm) for layer, true in layers), default=0.0),
        abs(float(truth.depth_of(np.asarray(estimate.point_mm)))),
        float(np.rad2deg(np.arcsin(turn))),
    )
    return dict(zip(names, figures, strict=True))


def point_scores(estimate: F64, truth: F64, seen: Bool, motion: RigidMotion) -> Scores:
    """Compute mean error and scatter of points, per axis and alignment.

    Parameters
    ----------
    estimate, truth : (frame, point, 3), world frame; NaN where the estimate has none.
    seen : (frame, point) which points count.
    motion : from the world to the frame of the wall, that of the errors.
    """
    used = seen & np.isfinite(estimate).all(axis=-1)
    estimated, true = motion(estimate[used]), motion(truth[used])
    scores: Scores = {}
    for how in ALIGNMENTS:
        errors = np.full((1, 3), np.nan)
        if len(estimated) >= 3:
            errors = fit_alignment(how, estimated, true)(estimated) - true
        prefix = "" if how == "lateral" else f"{how}_"
        for axis, mean, std in zip("xyz", errors.mean(axis=0), errors.std(axis=0), strict=True):
            scores[f"{prefix}{axis}_mean_mm"] = finite_or_none(mean)
            scores[f"{prefix}{axis}_std_mm"] = finite_or_none(std)
    return scores


def spacing_error(estimate: F64, truth: F64, seen: Bool, motion: RigidMotion) -> float | None:
    """Compute the rms error of the mean distance along Z between successive frames.

    Arguments as for `point_scores`. Source: thesis, figure 4-25.
    """
    depth = [np.where(seen, motion(value)[..., 2], np.nan) for value in (estimate, truth)]
    errors = np.diff(depth[0] - depth[1], axis=0)
    finite = [row[np.isfinite(row)] for row in errors]
    means = [float(row.mean()) for row in finite if len(row)]
    return root_mean_square(np.array(means)) if means else None


def held_out_scores(
    cameras: Sequence[CameraModel],
    true_cameras: Sequence[Camera],
    points_mm: F64,
    pixels: F64,
    motion: RigidMotion,
    aligned: RigidMotion | None,
) -> Scores:
    """Compute the scatter of triangulated points that no calibration saw.

    They are triangulated by the estimated and by the true cameras.

    Parameters
    ----------
    points_mm : (n, 3) true positions, world frame.
    pixels : (camera, n, 2) their measured images; NaN where a camera does not see one.
    motion : from the world to the frame of the wall.
    aligned : alignment of the estimate in that frame, None: the estimate has no score.
    """
    goal = motion(points_mm)
    points = motion(triangulate(cameras, pixels))
    return {
        "held_out_mm": scatter(aligned(points) - goal) if aligned else None,
        "held_out_exact_mm": scatter(motion(triangulate(true_cameras, pixels)) - goal),
    }


def target_alignment(estimate: F64, truth: F64, motion: RigidMotion) -> RigidMotion | None:
    """Align a target's points (frame, point, 3) laterally with the true ones.

    None with fewer than three points.

    Parameters
    ----------
    motion : from the world to the frame of the wall, that of the alignment.
    """
    finite = np.isfinite(estimate).all(axis=-1) & np.isfinite(truth).all(axis=-1)
    if finite.sum() < 3:
        return None
    return fit_alignment("lateral", motion(estimate[finite]), motion(truth[finite]))


def self_calibration_scores(
    cameras: Sequence[CameraModel],
    truth_mm: F64,
    true_pixels: F64,
    true_cameras: Sequence[CameraModel],
) -> Scores:
    """Score cameras by true particles, up to a rigid motion of all cameras together.

    Images of particles do not show such a motion.

    Parameters
    ----------
    truth_mm : (n, 3) true positions of particles.
    true_pixels : (camera, n, 2) their exact images; NaN outside of an image.
    """
    moved, pixels, triangulated = align_particles(cameras, truth_mm, true_pixels)
    visible = np.asarray(np.isfinite(true_pixels).all(axis=-1))
    true = mean_distance(pixels, true_pixels, visible, true_cameras)
    return {"true_px": true, "held_out_mm": scatter(triangulated - moved)}


def align_particles(
    cameras: Sequence[CameraModel], truth_mm: F64, true_pixels: F64
) -> tuple[F64, F64, F64]:
    """Move true particles (n, 3) into the estimated cameras' frame by a rigid fit.

    Returns the moved particles (n, 3), their images by the estimated cameras (camera, n, 2), and
    the positions (n, 3) where these cameras triangulate the exact images. With fewer than three
    triangulated particles nothing is moved and the images are NaN.
    """
    triangulated = triangulate(cameras, true_pixels)
    finite = np.isfinite(triangulated).all(axis=1)
    if finite.sum() < 3:
        return truth_mm, np.full_like(true_pixels, np.nan), triangulated
    moved = fit_rigid_motion(truth_mm[finite], triangulated[finite])(truth_mm)
    return moved, reproject(cameras, moved), triangulated
