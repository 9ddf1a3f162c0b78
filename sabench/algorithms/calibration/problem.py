"""Calibration case of the refractive algorithms: checked input, start, result.

Each error of the input names the camera or the frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import Anchor, BoardImages, residuals
from sabench.algorithms.calibration.fit_checks import FLAT, ODD, check_state
from sabench.algorithms.calibration.parameters import (
    FreeParameters,
    State,
    WallFrame,
    check_plane_wall,
    common_plane,
)
from sabench.api import Calibration, CalibrationCase
from sabench.api.truth import Target
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import (
    RigidMotion,
    fit_lateral_motion,
    fit_rigid_motion,
    rotation_matrices,
)
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.errors import InputError
from sabench.utils.validation import LensNumber, WallNumber

_WRONG = 0.01  # of an image's width: noise that no detection has
_SEVERAL = 3  # points that distinguish an image from another
_MIRRORED = 0.25  # times its misfit below which the mirror image of an array fits better
_FAR = 3.0  # times the nominal distance of a camera, beyond which no guess can be so wrong
_GLASS = 1.4  # index that solids exceed and most fluids do not


def check_case(case: CalibrationCase) -> None:
    """Refuse input that is faulty without any calculation.

    Raises
    ------
    InputError
        A camera in or behind the wall, indices in the wrong order, or two images that are the same.
    """
    for camera in case.cameras:
        if camera.wall and camera.wall.depth_of(np.asarray(camera.center_mm)) >= 0.0:
            raise InputError(
                f"{camera.name}: expected it in front of the wall's outer face, but the wall is "
                "behind it"
            )
    if wall := common_plane(case.cameras):
        first, *solids, last = wall.indices.tolist()
        if first > last:
            raise InputError(
                "wall: expected indices from the cameras' side on, air first, got air_index "
                f"{first:g} above fluid_index {last:g}"
            )
        if solids and max(solids) < _GLASS <= last:
            raise InputError(
                "wall: expected layers of glass and a fluid behind them, got layers of index "
                f"{max(solids):g} before a fluid of {last:g}"
            )
    if case.pixels.shape[2] < _SEVERAL:
        return
    # noise never repeats: equal pixels of several points are one image under two names
    for i, j in _equal_images(case.pixels):
        raise InputError(
            f"{case.cameras[i].name} and {case.cameras[j].name}: expected images of their "
            "own, but all their points are the same"
        )
    for camera, frames in zip(case.cameras, case.pixels, strict=True):
        for i, j in _equal_images(frames):
            raise InputError(
                f"{camera.name}: expected different images in frames {i} and {j}, but all "
                "their points are the same"
            )


def _equal_images(images: F64) -> Iterator[tuple[int, int]]:
    """Find pairs of images (n, ...) with the same points."""
    first: dict[bytes, int] = {}
    for number, image in enumerate(images):
        if np.isfinite(image).any():
            other = first.setdefault(np.nan_to_num(image, nan=-1e9).tobytes(), number)
            if other != number:
                yield other, number


def check_fit(
    case: CalibrationCase,
    state: State,
    frame: WallFrame,
    seen: BoardImages,
    used: Bool,
    noise_px: float,
) -> None:
    """Refuse a fit that contradicts the input.

    Such a fit is impossible (see `fit_checks.list_faults`), contradicts the nominal positions,
    leaves out an image because of its order, or has one plane only. Images through a wall show
    neither the first corner of a board nor the names of cameras: only the nominal positions show
    that a board's corners are counted from another corner in all cameras, or that two cameras are
    swapped.

    Raises
    ------
    InputError
        The message names the camera or the frame, and the explanation.
    """
    visible = seen.weights > 0.0
    if noise_px > _WRONG * case.cameras[0].columns:
        raise InputError(
            f"expected points that one array can see, got some that miss by {noise_px:.3g} px at "
            "best: are they the target's, in its order?"
        )
    check_state(state, seen, frame)
    _check_views(case, state, seen, used, noise_px)
    points = state.points(seen.board)
    _check_corners(case, points, frame.motion(case.initial_mm), visible)
    nominal = frame.motion(np.array([camera.center_mm for camera in case.cameras]))
    _check_names(case, state.centers, nominal)
    _check_mirror(state.centers, nominal)
    fitted = points[visible.any(axis=0)]
    middle = fitted.mean(axis=0)
    _check_distances(case, state.centers - middle)
    if case.target.pattern == "wand":
        return
    spread = np.linalg.svd(fitted - middle, compute_uv=False)
    if spread[2] < FLAT * spread[0]:
        raise InputError(
            "expected a target at different depths or tilts, but all frames show it in one "
            "plane, which leaves focal lengths open"
        )


def _check_views(
    case: CalibrationCase, state: State, views: BoardImages, used: Bool, noise_px: float
) -> None:
    """Refuse a view that would fit if its points were counted from another corner."""
    visible = views.weights > 0.0
    computed = views.pixels - residuals(state, views)
    for camera, number in np.argwhere((visible & ~used).any(axis=2)).tolist():
        view = camera, number
        for degrees, order in list_relabellings(case.target):
            misses = np.linalg.norm(views.pixels[view] - computed[view][order], axis=-1)
            if np.nanmedian(misses[visible[view]]) < ODD * noise_px:
                raise InputError(
                    f"{case.cameras[camera].name}: frame {number}: expected its points numbered as "
                    f"in the other cameras, but they are turned by {degrees} degrees"
                )


def list_relabellings(target: Target) -> list[tuple[int, I64]]:
    """List rotations, in degrees, that map a target's grid onto itself.

    Each comes with the order of the points under it. Points in any places have none.
    """
    if target.places_mm:
        return []
    grid = np.arange(target.columns * target.rows).reshape(target.rows, target.columns)
    rotated = [(90 * quarters, np.rot90(grid, quarters)) for quarters in (2, 1, 3)]
    return [(degrees, grids.ravel()) for degrees, grids in rotated if grids.shape == grid.shape]


def _check_corners(case: CalibrationCase, points: F64, initial: F64, visible: Bool) -> None:
    """Refuse a frame if its points lie at their nominal positions in another order."""
    for number in np.flatnonzero(visible.any(axis=(0, 2))).tolist():
        fitted = points[number] - points[number].mean(axis=0)
        nominal = initial[number] - np.nanmean(initial[number], axis=0)
        apart = _rms(fitted - nominal)
        for degrees, order in list_relabellings(case.target):
            if _rms(fitted[order] - nominal) < 0.5 * apart:
                raise InputError(
                    f"frame {number}: expected its points numbered as at its nominal position, but "
                    f"they are turned by {degrees} degrees against it"
                )


def _check_names(case: CalibrationCase, centers: F64, initial: F64) -> None:
    """Refuse two cameras that stand at each other's nominal positions."""
    for i, j in itertools.combinations(range(len(centers)), 2):
        direct = np.linalg.norm(centers[i] - initial[i]) + np.linalg.norm(centers[j] - initial[j])
        other = np.linalg.norm(centers[i] - initial[j]) + np.linalg.norm(centers[j] - initial[i])
        if other < 0.25 * direct:
            raise InputError(
                f"{case.cameras[i].name} and {case.cameras[j].name}: expected each one's own "
                "images, but these two are swapped"
            )


def _check_mirror(centers: F64, initial: F64) -> None:
    """Refuse the mirror image of the nominal array, as mirrored images give."""
    if len(centers) < _SEVERAL:
        return
    plan, nominal = (points[:, :2] - points[:, :2].mean(axis=0) for points in (centers, initial))
    left, _, right = np.linalg.svd(plan.T @ nominal)
    same, mirrored = (
        _rms(plan - nominal @ (left @ np.diag([1.0, sign * np.linalg.det(left @ right)]) @ right).T)
        for sign in (1.0, -1.0)
    )
    if mirrored < _MIRRORED * same and same > _MIRRORED * _rms(nominal):
        raise InputError(
            "expected rows counted from the top of the images and columns from the left, but the "
            "cameras stand as the mirror image of their initial guess"
        )


def _check_distances(case: CalibrationCase, apart: F64) -> None:
    """Refuse vectors (n, 3) from the target to cameras of a wrong length."""
    middle = np.nanmean(case.initial_mm.reshape(-1, 3), axis=0)
    given = np.array([camera.center_mm for camera in case.cameras]) - middle
    lengths = np.linalg.norm([apart, given], axis=-1).T.tolist()
    for camera, (fitted, nominal) in zip(case.cameras, lengths, strict=True):
        if not nominal / _FAR < fitted < nominal * _FAR:
            raise InputError(
                f"{camera.name}: expected it about {nominal:.4g} mm from the target, as its "
                f"initial guess is, but the fit puts it {fitted:.4g} mm away: are two cameras "
                "swapped, images mirrored, or a length wrong?"
            )


def _rms(errors: F64) -> float:
    return float(np.sqrt(np.nanmean(np.sum(errors**2, axis=-1))))


def fit_free_motion(frame: WallFrame, points: F64, targets: F64) -> RigidMotion:
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
    along = right[np.append(values, np.zeros(3))[:3] < FLAT] @ motion.rotation.T
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

    frame: WallFrame
    start: State
    seen: BoardImages
    case: CalibrationCase

    @classmethod
    def from_case(cls, case: CalibrationCase, free: FreeParameters) -> CalibrationProblem:
        """Check that the input suffices, and bring it into the wall's frame.

        Raises
        ------
        InputError
            What `input_checks.check_case` refuses, fewer points than unknowns, or a frame
            without an initial guess.
        """
        check_case(case)
        _check_count(case, free.per_camera if free.cameras else 0)
        enough = min(3, case.initial_mm.shape[1])
        for number, points in enumerate(case.initial_mm):
            if np.isfinite(points).all(axis=1).sum() < enough and case.found[:, number].any():
                raise InputError(
                    f"frame {number}: expected a nominal position of its target, got none"
                )
        frame, board = WallFrame.from_cameras(case.cameras, case.initial_mm), case.target.points_mm
        if not free.cameras:
            _check_known_cameras(case)
        if free != free.of_lenses:
            check_plane_wall(case.cameras)
            _check_shared(case, frame, free)
        pixels, weights = np.nan_to_num(case.pixels), case.found.astype(np.float64)
        views = BoardImages(board, pixels, weights, frame=frame.beyond_kernels)
        return cls(frame, frame.state(board, case.initial_mm), views, case)

    def align_to_nominal(self, state: State) -> State:
        """Move the state so that its boards are near their nominal positions.

        Only motions that change neither the images nor the known coordinates are allowed.
        """
        if self.case.known_cameras:
            return state
        points, initial = state.points(self.seen.board), self.frame.motion(self.case.initial_mm)
        usable = np.isfinite(initial).all(axis=-1) & (self.seen.weights.sum(axis=0) > 0.0)
        given = np.isfinite(self.case.known_mm).all(axis=-1)
        if self.frame.beyond_kernels:
            motion = fit_free_motion(self.frame, points[usable], initial[usable])
            return state if given.any() else state.move(motion)
        if given.sum() > (1 if self.frame.wall else 2):
            return state
        if self.frame.wall is None:
            return state.move(fit_rigid_motion(points[usable], initial[usable]))
        motion = fit_lateral_motion(points[usable], initial[usable])
        if given.any():  # the rotation is about the known point
            pivot = points[given][0]
            motion = RigidMotion(motion.rotation, pivot - motion.rotation @ pivot)
        return state.move(motion)

    def answer(self, state: State, used: Bool | None = None) -> Calibration:
        """Return cameras and points in the world's frame.

        Raises
        ------
        InputError
            An impossible state: see `fit_checks.list_faults`.
        """
        check_state(state, self.seen, self.frame)
        return Calibration(
            self.frame.build_cameras(state), self.frame.points(state, self.seen.board), used
        )


def make_anchors(case: CalibrationCase, frame: WallFrame, noise_px: float) -> tuple[Anchor, ...]:
    """Make observations of the known coordinates, weighed against pixels' noise."""
    world, anchors = frame.motion.inverse(), []
    for board, point in np.argwhere(np.isfinite(case.known_mm).any(axis=-1)).tolist():
        position, sigma = case.known_mm[board, point], case.known_sigma_mm[board, point]
        finite = np.isfinite(position)
        precision = np.where(finite, (noise_px / np.where(finite, sigma, 1.0)) ** 2, 0.0)
        anchors.append(Anchor(board, point, np.where(finite, position, 0.0), precision, world))
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


def _check_shared(case: CalibrationCase, frame: WallFrame, free: FreeParameters) -> None:
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
    given = int(np.isfinite(case.known_mm).sum())
    needed = unknowns * len(case.cameras) + each * boards - given
    if 2 * int(case.found.sum()) < needed:
        also = f" + {given} known coordinates" if given else ""
        raise InputError(
            f"expected at least {-(-needed // 2)} image points for {len(case.cameras)} cameras "
            f"of {unknowns} unknowns and {boards} boards of {each} "
            f"(2 N{also} >= b M + {each} K), got {int(case.found.sum())}"
        )
    for camera, points in zip(case.cameras, case.found.sum(axis=(1, 2)).tolist(), strict=True):
        if 2 * points < unknowns:
            raise InputError(
                f"{camera.name}: expected at least {-(-unknowns // 2)} image points for its "
                f"{unknowns} unknowns, got {points}"
            )
