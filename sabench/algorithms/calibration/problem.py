"""Calibration case of the refractive algorithms: checks, start, result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import Anchor, BoardImages
from sabench.algorithms.calibration.fit_checks import check_end
from sabench.algorithms.calibration.input_checks import check_case
from sabench.algorithms.calibration.parameters import Frame, FreeParameters, State, check_plane_wall
from sabench.api import Calibration, CalibrationCase
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import (
    RigidMotion,
    fit_lateral_motion,
    fit_rigid_motion,
    rotation_matrices,
)
from sabench.utils.arrays import F64, Bool
from sabench.utils.errors import InputError
from sabench.utils.validation import LensNumber, WallNumber

_SAME = 1e-6  # part of a unit vector along a wall's normal below which a shift is along the wall


def fit_free_motion(frame: Frame, points: F64, targets: F64) -> RigidMotion:
    """Fit the motion of points (n, 3) to targets, in a frame, that no image shows.

    A cylinder allows a rotation about its axis and a shift along it, several plane walls a shift
    along all of them, other walls nothing.
    """
    walls, motion = {camera.wall for camera in frame.cameras}, frame.motion
    (first, *others) = walls
    if isinstance(first, CylinderWall) and not others:
        axis = motion.rotation @ np.asarray(first.axis)
        point = motion(np.asarray(first.axis_point_mm))
        start, goal = points - point, targets - point
        crossed = np.sum(np.cross(start, goal) @ axis)
        aligned = np.sum(start * goal) - np.sum((start @ axis) * (goal @ axis))
        rotation = rotation_matrices(np.arctan2(crossed, aligned) * axis)
        shift = np.mean((goal - start) @ axis) * axis
        return RigidMotion(rotation, point - rotation @ point + shift)
    planes = [wall for wall in walls if isinstance(wall, Wall)]
    if len(planes) < len(walls):
        return RigidMotion.none()
    _, values, right = np.linalg.svd(np.array([wall.normal for wall in planes]))
    along = right[np.append(values, np.zeros(3))[:3] < _SAME] @ motion.rotation.T
    return RigidMotion(np.eye(3), along.T @ along @ (targets - points).mean(axis=0))


@dataclass(frozen=True)
class CalibrationProblem:
    """Calibration case in the frame of its wall.

    Attributes
    ----------
    frame : leads back to cameras.
    start : initial guess of the cameras and boards.
    seen : the images found.
    case : the case itself.
    """

    frame: Frame
    start: State
    seen: BoardImages
    case: CalibrationCase

    @classmethod
    def from_case(cls, case: CalibrationCase, free: FreeParameters) -> CalibrationProblem:
        """Check that the input suffices, and bring it into the wall's frame.

        Raises
        ------
        InputError
            What `input_checks.check_case` refuses, fewer points than unknowns, or a frame of which
            nothing is known beforehand.
        """
        check_case(case)
        _check_count(case, free.per_camera if free.cameras else 0)
        enough = min(3, case.initial_mm.shape[1])
        for number, points in enumerate(case.initial_mm):
            if np.isfinite(points).all(axis=1).sum() < enough and case.found[:, number].any():
                raise InputError(
                    f"frame {number}: expected a nominal position of its target, got none"
                )
        frame, board = Frame.from_cameras(case.cameras, case.initial_mm), case.target.points_mm
        if not free.cameras:
            _check_known_cameras(case)
        if free != free.of_lenses:
            check_plane_wall(case.cameras)
            _check_shared(case, frame, free)
        pixels, weights = np.nan_to_num(case.pixels), case.found.astype(np.float64)
        seen = BoardImages(board, pixels, weights, frame=frame.beyond_kernels)
        return cls(frame, frame.state(board, case.initial_mm), seen, case)

    def align_to_nominal(self, state: State) -> State:
        """Move the state so that its boards are near their nominal positions.

        Only motions that change neither the images nor the known coordinates are allowed.
        """
        if self.case.known_cameras:
            return state
        points, initial = state.points(self.seen.board), self.frame.motion(self.case.initial_mm)
        there = np.isfinite(initial).all(axis=-1) & (self.seen.weights.sum(axis=0) > 0.0)
        known = np.isfinite(self.case.known_mm).all(axis=-1)
        if self.frame.beyond_kernels:
            motion = fit_free_motion(self.frame, points[there], initial[there])
            return state if known.any() else state.move(motion)
        if known.sum() > (1 if self.frame.wall else 2):
            return state
        if self.frame.wall is None:
            return state.move(fit_rigid_motion(points[there], initial[there]))
        motion = fit_lateral_motion(points[there], initial[there])
        if known.any():  # the rotation is about the known point
            pivot = points[known][0]
            motion = RigidMotion(motion.rotation, pivot - motion.rotation @ pivot)
        return state.move(motion)

    def answer(self, state: State, used: Bool | None = None) -> Calibration:
        """Return cameras and points in the world's frame.

        Raises
        ------
        InputError
            An impossible state: see `fit_checks.list_faults`.
        """
        check_end(state, self.seen, self.frame)
        return Calibration(
            self.frame.build_cameras(state), self.frame.points(state, self.seen.board), used
        )


def make_anchors(case: CalibrationCase, frame: Frame, noise_px: float) -> tuple[Anchor, ...]:
    """Make observations of the known coordinates, weighed against pixels' noise."""
    world, anchors = frame.motion.inverse(), []
    for board, point in np.argwhere(np.isfinite(case.known_mm).any(axis=-1)).tolist():
        position, sigma = case.known_mm[board, point], case.known_sigma_mm[board, point]
        there = np.isfinite(position)
        precision = np.where(there, (noise_px / np.where(there, sigma, 1.0)) ** 2, 0.0)
        anchors.append(Anchor(board, point, np.where(there, position, 0.0), precision, world))
    return tuple(anchors)


def lens_unknowns(case: CalibrationCase) -> FreeParameters:
    """Free the unknowns of a case for a solver that estimates cameras only.

    Raises
    ------
    InputError
        Unknowns of the wall or the board.
    """
    free = FreeParameters.from_names(case.unknown, layers=1)
    if free != free.of_lenses:
        others = [name for name in case.unknown if name not in get_args(LensNumber)]
        raise InputError(
            f"unknown: expected parameters of lenses for this solver, got {', '.join(others)}: use "
            "refractive_autocal"
        )
    return free


def _check_shared(case: CalibrationCase, frame: Frame, free: FreeParameters) -> None:
    """Refuse unknowns of walls or layers that do not exist, or that nothing shows."""
    layers = len(frame.wall.layers) if frame.wall else 0
    media = layers + 2 if frame.wall else 0
    given = (("thicknesses", free.thicknesses, layers), ("indices", free.indices, media))
    for name, numbers, count in given:
        if wrong := [number for number in numbers if not 0 <= number < count]:
            raise InputError(
                f"{name}: expected numbers from 0 and below {count}, for a wall of {layers} "
                f"layers, got {wrong[0]}"
            )
    if free.bend and np.ptp(case.target.points_mm, axis=0)[:2].min() <= 0.0:
        raise InputError("bend: expected a board, got a target whose points are on a line")
    places = int(np.isfinite(case.known_mm).all(axis=-1).sum())
    if free.wall and (frame.wall is None or (free.cameras and places < 3)):
        raise InputError(
            "wall: expected a wall and three points or more with known x, y and z, or known "
            "cameras, since images do not show the wall's place in the world"
        )


def _check_known_cameras(case: CalibrationCase) -> None:
    """Refuse unknowns of lenses that are known, and a case without any unknown."""
    of_wall = ", ".join(get_args(WallNumber))
    if wrong := [name for name in case.unknown if name in get_args(LensNumber)]:
        raise InputError(
            f"unknown: expected {of_wall} or bend, since the cameras are known, got "
            f"{', '.join(wrong)}"
        )
    if not case.unknown:
        raise InputError(
            f"unknown: expected one or more of {of_wall}, since the cameras are known, got none"
        )


def _check_count(case: CalibrationCase, unknowns: int) -> None:
    """Refuse a case with fewer equations than unknowns.

    With boards the thesis's equation 4.3 becomes 2 N + A >= b M + 6 K: N image points, A known
    coordinates, M cameras with b unknowns each, K placed boards, or points of 3 unknowns.
    """
    boards = int(case.found.any(axis=(0, 2)).sum())
    each = 6 if case.found.shape[2] > 1 else 3
    known = int(np.isfinite(case.known_mm).sum())
    needed = unknowns * len(case.cameras) + each * boards - known
    if 2 * int(case.found.sum()) < needed:
        also = f" + {known} known coordinates" if known else ""
        raise InputError(
            f"expected at least {-(-needed // 2)} image points for {len(case.cameras)} cameras "
            f"of {unknowns} unknowns and {boards} boards of {each} "
            f"(2 N{also} >= b M + {each} K), got {int(case.found.sum())}"
        )
    for camera, found in zip(case.cameras, case.found.sum(axis=(1, 2)).tolist(), strict=True):
        if 2 * found < unknowns:
            raise InputError(
                f"{camera.name}: expected at least {-(-unknowns // 2)} image points for its "
                f"{unknowns} unknowns, got {found}"
            )
