"""Joint fit of cameras, wall and boards: robust or alternating.

Model. Camera i sees point k of board j at pixel P_i(R_j b_k + t_j): lens and wall of the camera, a
rotation and a shift of the board. Free are rotations, centres and focal lengths of the cameras, the
boards, and what a case calls unknown (`parameters.FreeParameters`).

Cost. The sum of squared misses in pixels, plus, weighed against the noise of a pixel coordinate,
squared differences from known positions, and from the nominal thicknesses, indices, wall and flat
boards that are free (`make_prior`). `bundle_adjustment.refine` minimises it.

Course of `fit_jointly`. First lenses and boards alone, which images show; then with known
positions, which fix the world and the depth, and nominal values, which hold the wall. The noise is
that of the median miss, and the second part is repeated while it changes by more than a tenth.
Where known points fix every board, the cameras are fitted to these first; where a case knows its
cameras, only the boards are fitted.

Outliers. A miss that right points exceed once in 100,000 times is odd (4.8 times the noise). If
there is one, the fit is repeated with Cauchy's loss, whose scale falls with the misses; then odd
points are left out, and least squares follow, until the points that are used no longer change.

Impossible ends (`fit_checks.list_faults`: a board in the wall, a negative focal length). Through a
plane wall images hardly show the depth of all boards together. The fit is repeated from boards
placed before the cameras; without known positions also with lenses and boards that are less ideal;
then with the depth held near the initial guess. The answer says so. A fit that stays impossible is
refused by `problem.check_fit`.

`alternate` is the auto-calibration of J. Belden's thesis (MIT 2011, figure 4-1 and section 4.4.2):
cameras are adjusted to fixed boards, then boards to fixed cameras, in turn.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import (
    Anchor,
    BoardImages,
    Fit,
    Moving,
    SharedPrior,
    refine,
    residuals,
)
from sabench.algorithms.calibration.fit_checks import ODD, depths_of, list_faults
from sabench.algorithms.calibration.kernels import BEND
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.algorithms.calibration.problem import CalibrationProblem, make_anchors
from sabench.geometry.rigid_motion import RigidMotion
from sabench.utils.arrays import F64, I64, Bool

ROUNDS = 10  # at most
SAME_NOISE = 0.1  # relative change of the noise below which weights stay
CAUCHY = 3.0  # scale of Cauchy's loss over the noise
LEAST_NOISE_PX = 1e-3  # of any detection; weights of known positions are finite

Held = Literal["richer model", "initial guess"]


@dataclass(frozen=True)
class Robust:
    """Fit, used observations (camera, board, point), noise of a coordinate in px.

    `held` names what determines the boards' depth if the unknowns alone put boards into the wall.
    """

    fit: Fit
    used: Bool
    noise_px: float
    held: Held | None = None


def adjust(
    state: State,
    seen: BoardImages,
    free: FreeParameters,
    *,
    noise_px: float | None = None,
    moving: Moving = "all",
) -> Robust:
    """Fit by least squares, robustly if errors exceed normal noise.

    The robust fit uses Cauchy's loss, then rejects outliers, then uses least squares again.

    Parameters
    ----------
    noise_px : of the pixel coordinates, if it is known; by default it is estimated from the median
        error.
    moving : what is adjusted, as for `refine`.
    """
    start = np.asarray(seen.weights > 0.0)
    fit, used = refine(state, seen, free, moving=moving), start
    noise = noise_px or median_noise(_lengths(fit.state, seen)[used])
    if _lengths(fit.state, seen)[used].max(initial=0.0) <= ODD * noise:
        return Robust(fit, used, noise)
    fit = _fit_cauchy(fit.state, seen, free, moving)
    for _ in range(ROUNDS):
        lengths = _lengths(fit.state, seen)
        noise = median_noise(lengths[used])
        accepted = start & (lengths <= ODD * noise)
        if np.array_equal(accepted, used):
            break
        used = accepted
        kept_only = replace(seen, weights=np.where(used, seen.weights, 0.0))
        fit = refine(fit.state, kept_only, free, moving=moving)
    return Robust(fit, used, noise)


def _fit_cauchy(state: State, views: BoardImages, free: FreeParameters, moving: Moving) -> Fit:
    """Fit with Cauchy's loss; its scale falls with the errors."""
    used = np.asarray(views.weights > 0.0)
    scale = np.inf
    for _ in range(ROUNDS):
        smaller = CAUCHY * median_noise(_lengths(state, views)[used])
        if smaller > (1.0 - SAME_NOISE) * scale:
            break
        scale = smaller
        fit = refine(state, views, free, scale, moving=moving)
        state = fit.state
    return fit


def _lengths(state: State, views: BoardImages) -> F64:
    """Compute reprojection errors (camera, board, point) in px, or infinity."""
    lengths = np.linalg.norm(residuals(state, views), axis=-1)
    return np.where(np.isfinite(lengths), lengths, np.inf)


def median_noise(lengths: F64) -> float:
    """Compute the standard deviation of coordinates from their pairs' median length."""
    return max(float(np.median(lengths) / np.sqrt(np.log(4.0))), LEAST_NOISE_PX)


THICKNESS = 0.5  # standard deviation of a nominal thickness, part of it
INDEX_SIGMA = 0.05  # of a nominal index
_WALL_TILT, _WALL_SHIFT_MM = np.deg2rad(5.0), 100.0  # of a nominal wall
_BEND_MM = 1.0  # of a board that is nominally flat
_RICH = ("k1", "k2", "p1", "p2")  # tried, with tilts and bend, where unknowns lack
_HELD = 0.1  # standard deviation of a depth that no image shows, part of it


def fit_jointly(problem: CalibrationProblem, free: FreeParameters) -> Robust:
    """Adjust cameras, boards and what they share, robustly.

    An impossible state (see `fit_checks.list_faults`) is returned if all fits end in one:
    `problem.check_fit` refuses it.
    """
    if not free.cameras:
        return _weigh(problem, adjust(problem.start, problem.seen, free, moving="boards"), free)
    if fixes_world(problem):  # the cameras are fitted to known positions first, taken as exact
        fit = refine(problem.start, problem.seen, free.of_lenses, moving="cameras")
        used = np.asarray(problem.seen.weights > 0.0)
        lengths = np.linalg.norm(residuals(fit.state, problem.seen), axis=-1)[used]
        placed = Robust(fit, used, median_noise(lengths))
        return _weigh(replace(problem, start=fit.state), placed, free)
    robust = _fit_soundly(problem, problem.seen, free.of_lenses)
    if free == free.of_lenses and not make_anchors(problem.case, problem.frame, 1.0):
        return robust
    return _weigh(problem, robust, free)


def fixes_world(problem: CalibrationProblem) -> bool:
    """Return whether known places determine the place of every board."""
    given = np.isfinite(problem.case.known_mm).all(axis=-1)
    used = problem.seen.weights.sum(axis=0) > 0.0
    enough = min(3, given.shape[1])
    return bool((given.sum(axis=1) >= enough)[used.any(axis=1)].all() and given.sum() >= 3)


def _weigh(problem: CalibrationProblem, robust: Robust, free: FreeParameters) -> Robust:
    """Fit with the known places and nominal values, weighed against the noise."""
    for _ in range(ROUNDS):
        noise = robust.noise_px
        anchors = make_anchors(problem.case, problem.frame, noise)
        prior = make_prior(problem.start, noise)
        views = replace(problem.seen, anchors=anchors, prior=prior)
        if robust.held is None:
            robust = adjust(problem.align_to_nominal(robust.fit.state), views, free)
        if robust.held or not _is_sound(robust, views, problem):
            robust = _fit_soundly(problem, views, free)
        if free == free.of_lenses or abs(robust.noise_px - noise) <= SAME_NOISE * noise:
            break
    return robust


def make_prior(nominal: State, noise_px: float) -> SharedPrior:
    """Weigh nominal thicknesses, indices, wall and flat boards against the noise."""
    thick = THICKNESS * np.maximum(nominal.thicknesses, 1e-3)
    index = np.full(len(nominal.indices), INDEX_SIGMA)
    bend = np.full(BEND, _BEND_MM)
    sigma = np.concatenate([index, thick, [_WALL_TILT, _WALL_TILT, _WALL_SHIFT_MM], bend])
    return SharedPrior(nominal.shared, (noise_px / sigma) ** 2)


def _fit_soundly(problem: CalibrationProblem, views: BoardImages, free: FreeParameters) -> Robust:
    """Fit; where the end is impossible, with more unknowns, or with a held depth."""
    robust = adjust(problem.start, views, free)
    if _is_sound(robust, views, problem):
        return robust
    # boards, then cameras: this finds mirrored images, which `problem.check_fit` names
    placed = refine(problem.start, views, FreeParameters(), moving="boards").state
    placed = refine(placed, views, FreeParameters(), moving="cameras").state
    second = adjust(placed, views, free)
    if _is_sound(second, views, problem):
        return second
    rich = replace(free, distortion=_RICH, tilt=True, bend=True)
    if problem.frame.wall and np.isfinite(robust.noise_px) and free != rich and not views.anchors:
        # a bent board modelled as flat appears at another depth
        prior = make_prior(problem.start, robust.noise_px)
        richer = _fit_soundly(problem, replace(views, prior=prior), rich)
        if richer.held is None:
            return replace(richer, held="richer model")
    views = _hold_depth(problem, views, robust.noise_px)
    return replace(adjust(problem.start, views, free), held="initial guess")


def _is_sound(robust: Robust, views: BoardImages, problem: CalibrationProblem) -> bool:
    faults = list_faults(robust.fit.state, views, problem.frame)
    return np.isfinite(robust.fit.cost) and not faults


def _hold_depth(problem: CalibrationProblem, views: BoardImages, noise_px: float) -> BoardImages:
    """Anchor boards to their nominal depths, within a part of the mean.

    Through a plane wall images hardly show the depth of all boards together: where noise would put
    boards into the wall, the nominal depth is nearer to the truth.
    """
    if problem.frame.wall is None or not np.isfinite(noise_px):
        return views
    start = problem.start
    depths = depths_of(start, views)
    boards = np.flatnonzero(np.isfinite(depths).any(axis=1))
    sigma = _HELD * max(float(np.nanmean(depths)), 1e-6) * np.sqrt(len(boards))
    weight = (noise_px / sigma) ** 2
    middle = int(np.argmin(np.linalg.norm(views.board, axis=1)))
    places = start.points(views.board)[:, middle]
    held = tuple(
        Anchor(board, middle, places[board], np.array([0.0, 0.0, weight]), RigidMotion.none())
        for board in boards.tolist()
    )
    return replace(views, anchors=(*views.anchors, *held))


_OF_CAMERAS = ("rotations", "centers", "lenses")  # of a state


@dataclass(frozen=True)
class Rounds:
    """End of an alternation, and the largest error of a camera per round, px."""

    state: State
    errors_px: tuple[float, ...]


def alternate(
    state: State, seen: BoardImages, free: FreeParameters, tolerance_px: float, most: int
) -> Rounds:
    """Adjust cameras and boards in turn until the error converges."""
    errors = [_largest(state, seen)]
    while len(errors) <= most:
        state = _boards(_cameras(state, seen, free), seen, free)
        errors.append(_largest(state, seen))
        if abs(errors[-1] - errors[-2]) < tolerance_px:
            break
    return Rounds(state, tuple(errors))


def select_cameras(state: State, seen: BoardImages, cameras: I64) -> tuple[State, BoardImages]:
    """Select some of the cameras, and what they see."""
    part = replace(state, **{name: getattr(state, name)[cameras] for name in _OF_CAMERAS})
    return part, replace(
        seen,
        pixels=np.ascontiguousarray(seen.pixels[cameras]),
        weights=np.ascontiguousarray(seen.weights[cameras]),
        frame=seen.frame and seen.frame.select(cameras),
    )


def _cameras(state: State, views: BoardImages, free: FreeParameters) -> State:
    """Adjust every camera on its own to the boards as they are."""
    fits = [
        refine(*select_cameras(state, views, np.array([number])), free, moving="cameras").state
        for number in range(len(state.rotations))
    ]
    parts: dict[str, Any] = {
        name: np.concatenate([getattr(fit, name) for fit in fits]) for name in _OF_CAMERAS
    }
    return replace(state, **parts)


def _boards(state: State, views: BoardImages, free: FreeParameters) -> State:
    """Adjust every board on its own to the cameras as they are."""
    rotations, positions = state.board_rotations.copy(), state.board_positions.copy()
    for number in np.flatnonzero(views.weights.sum(axis=(0, 2)) > 0.0).tolist():
        part = slice(number, number + 1)
        view = replace(
            views,
            pixels=np.ascontiguousarray(views.pixels[:, part]),
            weights=np.ascontiguousarray(views.weights[:, part]),
            anchors=(),
        )
        board = replace(
            state, board_rotations=rotations[part].copy(), board_positions=positions[part].copy()
        )
        fit = refine(board, view, free, moving="boards").state
        rotations[part], positions[part] = fit.board_rotations, fit.board_positions
    return replace(state, board_rotations=rotations, board_positions=positions)


def _largest(state: State, views: BoardImages) -> float:
    errors = np.where(views.weights > 0.0, np.linalg.norm(residuals(state, views), axis=-1), np.nan)
    return float(np.nanmax(np.nanmean(errors.reshape(len(errors), -1), axis=1)))


def mean_rotation(rotations: F64) -> F64:
    """Average rotations (n, ..., 3, 3) in the least-squares sense of their entries."""
    left, _, right = np.linalg.svd(rotations.mean(axis=0))
    sign = np.sign(np.linalg.det(left @ right))
    left[..., :, 2] *= sign[..., None]
    return np.asarray(left @ right)
