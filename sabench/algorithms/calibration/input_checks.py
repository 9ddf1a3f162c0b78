"""Checks of a calibration's input; each error names the camera or the frame."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import BoardImages, residuals
from sabench.algorithms.calibration.fit_checks import check_end
from sabench.algorithms.calibration.parameters import Frame, State, common_plane
from sabench.api import CalibrationCase
from sabench.api.truth import Target
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.errors import InputError

_SUSPECT = 0.5  # share of an image's points that fit, below which something is wrong with all of it
_WRONG = 0.01  # of an image's width: noise that no detection has
_FITS = 6.0  # times the noise below which a guess explains the points
_FLAT = 1e-3  # thickness over width of points that lie in one plane
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
    frame: Frame,
    seen: BoardImages,
    used: Bool,
    noise_px: float,
) -> None:
    """Refuse a fit that contradicts the input.

    Such a fit is impossible (see `fit_checks.list_faults`), contradicts the nominal positions,
    leaves out an image because of its order, or rests on one plane. Images through a wall show
    neither the first corner of a board nor the names of cameras: only the nominal positions show
    that a board's corners are counted from another corner in all cameras, or that two cameras are
    swapped.

    Raises
    ------
    InputError
        The message names the camera or the frame, and the explanation.
    """
    there = seen.weights > 0.0
    if noise_px > _WRONG * case.cameras[0].columns:
        raise InputError(
            f"expected points that one array can see, got some that miss by {noise_px:.3g} px at "
            "best: are they the target's, in its order?"
        )
    check_end(state, seen, frame)
    _check_views(case, state, seen, used, there, noise_px)
    points = state.points(seen.board)
    _check_corners(case, points, frame.motion(case.initial_mm), there)
    nominal = frame.motion(np.array([camera.center_mm for camera in case.cameras]))
    _check_names(case, state.centers, nominal)
    _check_mirror(state.centers, nominal)
    found = points[there.any(axis=0)]
    middle = found.mean(axis=0)
    _check_distances(case, state.centers - middle)
    if case.target.pattern == "wand":
        return
    spread = np.linalg.svd(found - middle, compute_uv=False)
    if spread[2] < _FLAT * spread[0]:
        raise InputError(
            "expected a target at different depths or tilts, but all frames show it in one "
            "plane, which leaves focal lengths open"
        )


def _check_views(
    case: CalibrationCase, state: State, seen: BoardImages, used: Bool, there: Bool, noise_px: float
) -> None:
    """Refuse a view that would fit if its points were counted from another corner."""
    shares = used.sum(axis=2) / np.maximum(there.sum(axis=2), 1)  # few used: it never fits
    computed = seen.pixels - residuals(state, seen)
    for camera, number in np.argwhere((shares < _SUSPECT) & there.any(axis=2)).tolist():
        view = camera, number
        for degrees, order in list_relabellings(case.target):
            misses = np.linalg.norm(seen.pixels[view] - computed[view][order], axis=-1)
            if np.nanmedian(misses[there[view]]) < _FITS * noise_px:
                raise InputError(
                    f"{case.cameras[camera].name}: frame {number}: expected its points numbered as "
                    f"in the other cameras, but they are turned by {degrees} degrees"
                )


def list_relabellings(target: Target) -> list[tuple[int, I64]]:
    """List rotations, in degrees, under which a target's grid maps onto itself.

    Each comes with the order of the points under it. Points in any places have none.
    """
    if target.places_mm:
        return []
    grid = np.arange(target.columns * target.rows).reshape(target.rows, target.columns)
    rotated = [(90 * quarters, np.rot90(grid, quarters)) for quarters in (2, 1, 3)]
    return [(degrees, grids.ravel()) for degrees, grids in rotated if grids.shape == grid.shape]


def _check_corners(case: CalibrationCase, points: F64, initial: F64, there: Bool) -> None:
    """Refuse a frame if its points lie at their nominal positions in another order."""
    for number in np.flatnonzero(there.any(axis=(0, 2))).tolist():
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
        own = np.linalg.norm(centers[i] - initial[i]) + np.linalg.norm(centers[j] - initial[j])
        other = np.linalg.norm(centers[i] - initial[j]) + np.linalg.norm(centers[j] - initial[i])
        if other < 0.25 * own:
            raise InputError(
                f"{case.cameras[i].name} and {case.cameras[j].name}: expected each one's own "
                "images, but these two are swapped"
            )


def _check_mirror(centers: F64, initial: F64) -> None:
    """Refuse the mirror image of the nominal array, as mirrored images give."""
    if len(centers) < _SEVERAL:
        return
    own, nominal = (one[:, :2] - one[:, :2].mean(axis=0) for one in (centers, initial))
    left, _, right = np.linalg.svd(own.T @ nominal)
    same, mirrored = (
        _rms(own - nominal @ (left @ np.diag([1.0, sign * np.linalg.det(left @ right)]) @ right).T)
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
    for camera, (found, nominal) in zip(case.cameras, lengths, strict=True):
        if not nominal / _FAR < found < nominal * _FAR:
            raise InputError(
                f"{camera.name}: expected it about {nominal:.4g} mm from the target, as its "
                f"initial guess is, but the fit puts it {found:.4g} mm away: are two cameras "
                "swapped, images mirrored, or a length wrong?"
            )


def _rms(errors: F64) -> float:
    return float(np.sqrt(np.nanmean(np.sum(errors**2, axis=-1))))
