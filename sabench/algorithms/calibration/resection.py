"""Positions of a target's points, for the fit of each camera.

Classical calibrations take the nominal positions as known; `place_boards` fits them to the images.
No axis of the world is preferred: a board starts upright in the cameras' images.
"""

from dataclasses import replace

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import BoardImages, refine, residuals
from sabench.algorithms.calibration.fit_checks import FEWEST, FLAT
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame, common_plane
from sabench.api import CalibrationCase
from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.common_view import FLATTEST_DEGREES
from sabench.geometry.polynomial_cameras import fit_planes as fit_planes, fit_soloff as fit_soloff
from sabench.geometry.projective_camera import (
    Projective as Projective,
    fit_projective as fit_projective,
)
from sabench.geometry.rigid_motion import RigidMotion, fit_rigid_motion, rotation_matrices
from sabench.utils.arrays import F64

_NEAR = 0.5  # part of the nominal depth behind a wall that all boards keep


def upright_axes(cameras: tuple[Camera, ...]) -> F64:
    """Make the axes (3, 3) of a board that stands upright in the cameras' images.

    Columns are its X (right in the images), Y (down) and Z (away from the cameras): along the
    normal of the cameras' plane wall, or along their mean line of sight.
    """
    axes = np.array([camera.rotation for camera in cameras])
    wall = common_plane(cameras)
    forward = axes[:, 2].mean(axis=0) if wall is None else np.asarray(wall.normal)
    if np.linalg.norm(forward) < 0.1:  # cameras that face each other
        forward = axes[0, 2]
    nearest = axes[int(np.argmax(axes[:, 2] @ forward))]  # its image is upright
    return np.asarray(aimed_rotation(forward, nearest[1])).T


def place_boards(case: CalibrationCase) -> F64:
    """Find initial positions (frame, point, 3) of a target's points, world frame, mm.

    A frame with enough known points is placed by these. The pose of any other is fitted to its
    images by the nominal cameras, from the case's initial positions at four rotations about the
    line of sight, and from the mirrored tilt, which looks similar from afar.
    """
    board = case.target.points_mm
    places = known_places(case)
    if len(board) == 1:
        return places
    frame = WallFrame.from_cameras(case.cameras, case.initial_mm)
    pixels, weights = np.nan_to_num(case.pixels), case.found.astype(np.float64)
    views = BoardImages(board, pixels, weights, frame=frame.beyond_kernels)
    start = frame.state(board, case.initial_mm)
    ahead = frame.motion.rotation @ upright_axes(case.cameras)
    best = refine(start, views, FreeParameters(), moving="boards").state
    quarter = rotation_matrices(np.array([0.0, 0.0, np.pi / 2.0]))
    for quarters in (1, 2, 3):
        turned = start.board_rotations @ np.linalg.matrix_power(quarter, quarters)
        best = _refit_boards(best, replace(start, board_rotations=turned), views)
    flip = ahead @ np.diag([1.0, 1.0, -1.0]) @ ahead.T
    mirrored = flip @ best.board_rotations @ np.diag([1.0, 1.0, -1.0])
    best = _refit_boards(best, replace(best, board_rotations=mirrored), views)
    fitted = frame.points(best, board)
    # all boards move off the wall together: nominal cameras put boards too near, and a fit that
    # starts in the wall does not move
    near = _NEAR * _depth(case, case.initial_mm)
    fitted = fitted + (near - min(_depth(case, fitted), near)) * upright_axes(case.cameras)[:, 2]
    enough = case.found.sum(axis=(0, 2)) >= FEWEST
    fitted = np.where(enough[:, None, None], fitted, case.initial_mm)
    return np.where(np.isfinite(places), places, fitted)


def _depth(case: CalibrationCase, points_mm: F64) -> float:
    """Compute the smallest depth of points behind any inner face, mm."""
    walls = {camera.wall for camera in case.cameras} - {None}
    depths = [wall.depth_of(points_mm) - wall.thickness_mm for wall in walls if wall]
    return float(np.nanmin(depths)) if depths else 0.0


def known_places(case: CalibrationCase) -> F64:
    """Place the target (frame, point, 3) by known points; NaN if too few."""
    board = case.target.points_mm
    given = np.asarray(np.isfinite(case.known_mm).all(axis=-1))
    places = np.full(case.known_mm.shape, np.nan)
    for number, rows in enumerate(given):
        points, goal = board[rows], case.known_mm[number, rows]
        if len(board) == 1 and len(points):
            motion = RigidMotion(np.eye(3), goal[0] - points[0])
        elif len(points) >= 3 and not _on_line(points):
            motion = fit_rigid_motion(points, goal)
        else:
            continue
        places[number] = motion(board)
        places[number, rows] = goal
    return places


def _on_line(points: F64) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] <= FLAT * spread[0])


def _refit_boards(best: State, start: State, views: BoardImages) -> State:
    """Fit the boards from another start, and keep each that fits its images better."""
    fitted, costs = refine(start, views, FreeParameters(), moving="boards").state, []
    for state in (best, fitted):
        squares = np.sum(residuals(state, views) ** 2, axis=-1)
        cost = np.where(views.weights > 0.0, squares, 0.0).sum(axis=(0, 2))
        costs.append(np.where(np.isfinite(cost), cost, np.inf))
    better = costs[1] < costs[0]
    return replace(
        best,
        board_rotations=np.where(
            better[:, None, None], fitted.board_rotations, best.board_rotations
        ),
        board_positions=np.where(better[:, None], fitted.board_positions, best.board_positions),
    )


def known_points(case: CalibrationCase, camera: int) -> tuple[F64, F64]:
    """Return positions (n, 3) and pixels (n, 2) of all points that a camera found."""
    points, pixels = known_frames(case, camera)
    return np.vstack(points), np.vstack(pixels)


def known_frames(case: CalibrationCase, camera: int) -> tuple[list[F64], list[F64]]:
    """Split known points and pixels by the frames that a camera found."""
    points, pixels = [], []
    for initial, detected in zip(case.initial_mm, case.pixels[camera], strict=True):
        usable = np.isfinite(initial).all(axis=1) & np.isfinite(detected).all(axis=1)
        if usable.any():
            points.append(initial[usable])
            pixels.append(detected[usable])
    return points, pixels


def reason_if_flat(case: CalibrationCase) -> str | None:
    """Return the reason to refuse nominal positions in one plane, or None."""
    nominal = case.initial_mm[np.isfinite(case.initial_mm).all(axis=-1)]
    spread = np.linalg.svd(nominal - nominal.mean(axis=0), compute_uv=False)
    if spread[2] > FLAT * spread[0]:
        return None
    return "expected nominal positions at different depths, got all of them in one plane"


def reason_if_edge_on(case: CalibrationCase) -> str | None:
    """Say which camera sees planes of constant Z edge-on; None if none does."""
    for camera in case.cameras:
        angle = float(np.rad2deg(np.arcsin(min(abs(camera.rotation[2][2]), 1.0))))
        if angle < FLATTEST_DEGREES:
            return (
                f"its polynomial is quadratic along Z, and {camera.name} looks {angle:.0f} degrees "
                f"from planes of constant Z (at least {FLATTEST_DEGREES:.0f}): turn the world so "
                "that Z is the viewing direction"
            )
    return None
