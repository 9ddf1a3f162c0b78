"""Auto-calibration of the thesis.

Cameras are adjusted to fixed boards, then boards to fixed cameras, in turn.

Source: J. Belden, PhD thesis, MIT 2011, figure 4-1 and section 4.4.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import BoardImages, refine, residuals
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.utils.arrays import F64, I64


@dataclass(frozen=True)
class Rounds:
    """End of an alternation and the errors on its way.

    The errors are the largest mean reprojection error of a camera (px) before it began and after
    every round.
    """

    state: State
    errors_px: tuple[float, ...]


def alternate(
    state: State, seen: BoardImages, free: FreeParameters, tolerance_px: float, most: int
) -> Rounds:
    """Adjust cameras and boards in turn.

    Stop when the largest of the cameras' mean reprojection errors changes by less than the
    tolerance.
    """
    errors = [_largest(state, seen)]
    while len(errors) <= most:
        state = _boards(_cameras(state, seen, free), seen, free)
        errors.append(_largest(state, seen))
        if abs(errors[-1] - errors[-2]) < tolerance_px:
            break
    return Rounds(state, tuple(errors))


def select_cameras(state: State, seen: BoardImages, cameras: I64) -> tuple[State, BoardImages]:
    """Select some of the cameras, and what they see."""
    part = replace(
        state,
        rotations=state.rotations[cameras],
        centers=state.centers[cameras],
        lenses=state.lenses[cameras],
    )
    return part, replace(
        seen,
        pixels=np.ascontiguousarray(seen.pixels[cameras]),
        weights=np.ascontiguousarray(seen.weights[cameras]),
        frame=seen.frame and seen.frame.select(cameras),
    )


def _cameras(state: State, seen: BoardImages, free: FreeParameters) -> State:
    """Adjust every camera on its own to the boards as they are."""
    fits = [
        refine(*select_cameras(state, seen, np.array([number])), free, moving="cameras").state
        for number in range(len(state.rotations))
    ]
    rotations, centers, lenses = (
        np.concatenate([getattr(fit, name) for fit in fits])
        for name in ("rotations", "centers", "lenses")
    )
    return replace(state, rotations=rotations, centers=centers, lenses=lenses)


def _boards(state: State, seen: BoardImages, free: FreeParameters) -> State:
    """Adjust every board on its own to the cameras as they are."""
    rotations, positions = state.board_rotations.copy(), state.board_positions.copy()
    for number in np.flatnonzero(seen.weights.sum(axis=(0, 2)) > 0.0).tolist():
        own = slice(number, number + 1)
        view = replace(
            seen,
            pixels=np.ascontiguousarray(seen.pixels[:, own]),
            weights=np.ascontiguousarray(seen.weights[:, own]),
            anchors=(),
        )
        fit = refine(
            replace(
                state, board_rotations=rotations[own].copy(), board_positions=positions[own].copy()
            ),
            view,
            free,
            moving="boards",
        ).state
        rotations[own], positions[own] = fit.board_rotations, fit.board_positions
    return replace(state, board_rotations=rotations, board_positions=positions)


def _largest(state: State, seen: BoardImages) -> float:
    lengths = np.where(seen.weights > 0.0, np.linalg.norm(residuals(state, seen), axis=-1), np.nan)
    return float(np.nanmax(np.nanmean(lengths.reshape(len(lengths), -1), axis=1)))


def mean_rotation(rotations: F64) -> F64:
    """Average rotations (n, ..., 3, 3) in the least-squares sense of their entries.

    Returns (..., 3, 3).
    """
    left, _, right = np.linalg.svd(rotations.mean(axis=0))
    sign = np.sign(np.linalg.det(left @ right))
    left[..., :, 2] *= sign[..., None]
    return np.asarray(left @ right)
