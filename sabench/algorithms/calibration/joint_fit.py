"""Joint fit of cameras, boards and wall that ends in a possible state.

Lenses and boards come first. What images hardly show, or not at all, follows: the known places fix
the world and the depth, and nominal values hold the wall.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import (
    Anchor,
    BoardImages,
    Prior,
    refine,
    residuals,
)
from sabench.algorithms.calibration.end_state import depths_of, list_faults, mirror_boards
from sabench.algorithms.calibration.kernels import BEND
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.algorithms.calibration.problem import CalibrationProblem, make_anchors
from sabench.algorithms.calibration.robust import Robust, adjust, median_noise
from sabench.geometry.rigid_motion import RigidMotion

_LEAST_NOISE_PX = 1e-3  # with which known places are weighed
_ROUNDS = 3  # of weighing what is known against the noise, where it changes much
_SAME_NOISE = 0.1  # relative change of the noise below which weights stay
THICKNESS = 0.5  # standard deviation of a nominal thickness, part of it
INDEX = 0.05  # of a nominal index
_WALL_TILT, _WALL_SHIFT_MM = np.deg2rad(5.0), 100.0  # of a nominal wall
_BEND_MM = 1.0  # of a board that is nominally flat
_RICH = ("k1", "k2", "p1", "p2")  # tried, with tilts and bend, where unknowns lack
_HELD = (0.5, 0.1, 0.02)  # standard deviations of a depth that no image shows, parts of it


def fit_jointly(problem: CalibrationProblem, free: FreeParameters) -> Robust:
    """Adjust cameras, boards and what they share, robustly.

    An end state that cannot be is left by other starts, see `end_state.list_faults`. If all of them
    fail, the last one is returned: `input_checks.check_fit` refuses it.
    """
    if not free.cameras:
        return _weigh(problem, adjust(problem.start, problem.seen, free, moving="boards"), free)
    if fixes_world(problem):
        placed = _place_cameras(problem, free)
        return _weigh(replace(problem, start=placed.fit.state), placed, free)
    found = _fit_soundly(problem, problem.seen, free.of_lenses)
    if free == free.of_lenses and not make_anchors(problem.case, problem.frame, 1.0):
        return found
    return _weigh(problem, found, free)


def _place_cameras(problem: CalibrationProblem, free: FreeParameters) -> Robust:
    """Fit the cameras to known places, taken as exact."""
    fit = refine(problem.start, problem.seen, free.of_lenses, moving="cameras")
    used = np.asarray(problem.seen.weights > 0.0)
    lengths = np.linalg.norm(residuals(fit.state, problem.seen), axis=-1)[used]
    return Robust(fit, used, max(median_noise(lengths), _LEAST_NOISE_PX))


def fixes_world(problem: CalibrationProblem) -> bool:
    """Return whether known places determine the place of every board."""
    known = np.isfinite(problem.case.known_mm).all(axis=-1)
    used = problem.seen.weights.sum(axis=0) > 0.0
    enough = min(3, known.shape[1])
    return bool((known.sum(axis=1) >= enough)[used.any(axis=1)].all() and known.sum() >= 3)


def _weigh(problem: CalibrationProblem, found: Robust, free: FreeParameters) -> Robust:
    """Fit with the known places and nominal values, weighed against the noise."""
    for _ in range(_ROUNDS):
        noise = max(found.noise_px, _LEAST_NOISE_PX)
        anchors = make_anchors(problem.case, problem.frame, noise)
        prior = make_prior(problem.start, noise)
        seen = replace(problem.seen, anchors=anchors, prior=prior)
        found = adjust(problem.align_to_nominal(found.fit.state), seen, free)
        if not _is_sound(found, seen, problem):
            found = _fit_soundly(problem, seen, free)
        if free == free.of_lenses or abs(found.noise_px - noise) <= _SAME_NOISE * noise:
            break
    return found


def make_prior(nominal: State, noise_px: float) -> Prior:
    """Weigh nominal thicknesses, indices, wall and flat boards against the noise."""
    thick = THICKNESS * np.maximum(nominal.thicknesses, 1e-3)
    index = np.full(len(nominal.indices), INDEX)
    bend = np.full(BEND, _BEND_MM)
    sigma = np.concatenate([index, thick, [_WALL_TILT, _WALL_TILT, _WALL_SHIFT_MM], bend])
    return Prior(nominal.shared, (noise_px / sigma) ** 2)


def _fit_soundly(problem: CalibrationProblem, seen: BoardImages, free: FreeParameters) -> Robust:
    """Fit from the start, and again from other states while the end cannot be.

    The last fit is returned if none ends well.
    """
    found = adjust(problem.start, seen, free)
    if _is_sound(found, seen, problem):
        return found
    ends = [adjust(start, seen, free) for start in _other_starts(problem, found.fit.state, seen)]
    if sound := [end for end in ends if _is_sound(end, seen, problem)]:
        return min(sound, key=lambda end: end.noise_px)
    start, deep = _staged(problem.start, seen, free), _fit_richly(problem, seen, free, found)
    for part in _HELD:
        held = hold_depth(deep or problem.start, problem, seen, found.noise_px, part)
        found = adjust(start, held, free)
        if _is_sound(found, seen, problem):
            break
    return replace(found, held="richer model" if deep else "initial guess")


def _fit_richly(
    problem: CalibrationProblem, seen: BoardImages, free: FreeParameters, found: Robust
) -> State | None:
    """Fit with what the unknowns may lack; None if that does not end well, either.

    A bent board that is taken for flat seems to be at another depth.
    """
    if problem.frame.wall is None or not np.isfinite(found.noise_px):
        return None
    rich = replace(free, distortion=_RICH, tilt=True, bend=True)
    seen = replace(seen, prior=make_prior(problem.start, max(found.noise_px, _LEAST_NOISE_PX)))
    first = adjust(problem.start, seen, rich)
    others = (adjust(start, seen, rich) for start in _other_starts(problem, first.fit.state, seen))
    ends = itertools.chain([first], others)
    return next((end.fit.state for end in ends if _is_sound(end, seen, problem)), None)


def _is_sound(found: Robust, seen: BoardImages, problem: CalibrationProblem) -> bool:
    faults = list_faults(found.fit.state, seen, problem.frame)
    return np.isfinite(found.fit.cost) and not faults


def _other_starts(problem: CalibrationProblem, end: State, seen: BoardImages) -> Iterator[State]:
    """Give the mirrored ends, and the start with boards placed before the cameras."""
    if problem.frame.wall is not None and np.isfinite(end.board_positions).all():
        yield mirror_boards(end, seen, turned=False)
        yield mirror_boards(end, seen, turned=True)
    yield _staged(problem.start, seen, FreeParameters())


def _staged(start: State, seen: BoardImages, free: FreeParameters) -> State:
    """Adjust boards, then cameras: slower than both together, and less prone to leap."""
    return refine(
        refine(start, seen, free, moving="boards").state, seen, free, moving="cameras"
    ).state


def hold_depth(
    start: State, problem: CalibrationProblem, seen: BoardImages, noise_px: float, part: float
) -> BoardImages:
    """Add that boards are about as deep in the fluid as in a state.

    Through a plane wall images hardly show the depth of all boards together. Where noise, or what
    a model lacks, would put boards into the wall, a richer model or the nominal depth says more.

    Parameters
    ----------
    part : standard deviation of the mean depth, as a part of it.
    """
    if problem.frame.wall is None or not np.isfinite(noise_px):
        return seen
    depths = depths_of(start, seen)
    there = np.flatnonzero(np.isfinite(depths).any(axis=1))
    sigma = part * max(float(np.nanmean(depths)), 1e-6) * np.sqrt(len(there))
    weight = (max(noise_px, _LEAST_NOISE_PX) / sigma) ** 2
    middle = int(np.argmin(np.linalg.norm(seen.board, axis=1)))
    places = start.points(seen.board)[:, middle]
    held = tuple(
        Anchor(board, middle, places[board], np.array([0.0, 0.0, weight]), RigidMotion.none())
        for board in there.tolist()
    )
    return replace(seen, anchors=(*seen.anchors, *held))
