"""Choice of a calibration's unknowns by nested fits and held-out boards.

Each unknown is freed in addition to those chosen before. It stays free if the held-out boards fit
better by more than twice the standard error of that difference over the boards.
"""

from dataclasses import dataclass, replace

import numpy as np

from sabench.algorithms.calibration import bundle_adjustment as bundle
from sabench.algorithms.calibration.bundle_adjustment import BoardImages, refine
from sabench.algorithms.calibration.fit_checks import list_faults
from sabench.algorithms.calibration.joint_fit import CAUCHY, fit_jointly, fixes_world, make_prior
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.algorithms.calibration.problem import CalibrationProblem, make_anchors
from sabench.api import CalibrationCase
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.validation import Unknown

# fmt: off
_GROUPS: tuple[tuple[Unknown, ...], ...] = (
    ("principal_point",), ("k1",), ("k2",), ("p1", "p2"), ("k3",), ("tilt",),
    ("bend",), ("wall",), ("thickness",), ("fluid_index",),
)
# fmt: on
_FIRST = {"k2": "k1", "k3": "k2"}  # what an unknown presupposes
_FOLDS = 5
_SURE = 2.0  # standard errors: least improvement of held-out boards
# least gain of an unknown, part of the held-out error: without it, a thickness that hardly shows
_LEAST_GAIN = 0.001


@dataclass(frozen=True)
class Nested:
    """Fit with one more group of unknowns.

    Attributes
    ----------
    added : the group; empty for the first fit.
    held_out_px : error of a pixel coordinate of held-out boards.
    change_px, sigma_px : its change against the fit with the unknowns chosen before, and the
        standard error of that change.
    chosen : whether the group stays free.
    remark : reason why it was not tried or not chosen, if figures do not show it.
    """

    added: tuple[Unknown, ...]
    held_out_px: float | None
    change_px: float | None
    sigma_px: float | None
    chosen: bool
    remark: str = ""


def split_frames(case: CalibrationCase, seed: int = 1) -> list[I64]:
    """Split the frames into folds by chance.

    No fold has the frames with the only known points: they define the world. There
    are no folds for fewer than three frames.
    """
    detected = case.found.any(axis=(0, 2))
    given = np.isfinite(case.known_mm).any(axis=(1, 2))
    if given.sum() < max(3, 0.5 * detected.sum()):
        detected = detected & ~given
    frames = np.random.default_rng(seed).permutation(np.flatnonzero(detected))
    count = min(_FOLDS, len(frames))
    return [np.sort(part) for part in np.array_split(frames, count)] if count >= 3 else []


def select_unknowns(case: CalibrationCase) -> tuple[tuple[Unknown, ...], tuple[Nested, ...]]:
    """Choose unknowns of a case, and return the table of all fits in their order.

    The first fit has no unknowns besides the focal lengths.

    Raises
    ------
    InputError
        Fewer than three boards that could be held out, or a case that `fit_jointly` cannot fit.
    """
    folds = split_frames(case)
    if not folds:
        raise InputError(
            "expected three frames or more, besides those with the only known points, to compare "
            "unknowns on frames that a fit did not see"
        )
    layers = len(case.cameras[0].wall.layers) if case.cameras[0].wall else 0
    problem = CalibrationProblem.from_case(case, FreeParameters())
    base = fit_jointly(problem, FreeParameters())
    held = _HeldOut(problem, folds, layers, base.noise_px)
    chosen: tuple[Unknown, ...] = ()
    state = base.fit.state
    if base.held:  # without what was fitted in addition
        state = replace(state, lenses=problem.start.lenses, bend=problem.start.bend)
    losses = held.losses(state, ())
    if losses is None:
        raise InputError("expected frames that hold-out fits can place, got none")
    rows = [Nested((), _px(losses), None, None, True)]
    possible = [group for group in _GROUPS if _can_free(group, problem)]
    left = possible.copy()
    while group := held.most_promising(state, chosen, left):
        left.remove(group)
        names = (*chosen, *group)
        row, tried = held.compare(state, names, group, losses)
        rows.append(row)
        if row.chosen and tried is not None:
            chosen, losses = names, tried
            state = held.full(state, chosen)
            left = [group for group in possible if group[0] not in chosen]
    return chosen, tuple(rows)


def _can_free(group: tuple[Unknown, ...], problem: CalibrationProblem) -> bool:
    """Return whether a case has the wall, layers or board of a group of unknowns."""
    wall = problem.frame.wall
    if group == ("wall",):
        return wall is not None and fixes_world(problem)
    if group == ("bend",):
        flat = problem.case.target.pattern not in ("wand", "points")
        return flat and problem.frame.beyond_kernels is None
    if group == ("thickness",):
        return wall is not None and bool(wall.layers)
    return group != ("fluid_index",) or wall is not None


def _px(losses: F64) -> float:
    return float(np.sqrt(losses.mean()))


@dataclass(frozen=True)
class _HeldOut:
    """Fits of a problem without some of its frames.

    Attributes
    ----------
    layers : of the wall.
    noise_px : of the first fit; it weights known positions and losses.
    """

    problem: CalibrationProblem
    folds: list[I64]
    layers: int
    noise_px: float

    def free(self, names: tuple[Unknown, ...]) -> FreeParameters:
        return FreeParameters.from_names(names, self.layers)

    @property
    def views(self) -> BoardImages:
        """The images with anchors and nominal values, weighed against the noise."""
        anchors = make_anchors(self.problem.case, self.problem.frame, self.noise_px)
        prior = make_prior(self.problem.start, self.noise_px)
        return replace(self.problem.seen, anchors=anchors, prior=prior)

    def full(self, state: State, names: tuple[Unknown, ...]) -> State:
        return refine(state, self.views, self.free(names), CAUCHY * self.noise_px).state

    def most_promising(
        self, state: State, chosen: tuple[Unknown, ...], left: list[tuple[Unknown, ...]]
    ) -> tuple[Unknown, ...] | None:
        """Find the group with the largest decrease of the cost in one step."""
        ready = [names for names in left if _FIRST.get(names[0], names[0]) in (names[0], *chosen)]
        views, scale, gains = self.views, CAUCHY * self.noise_px, []
        for group in ready:
            normal = bundle.normal_equations(state, views, self.free((*chosen, *group)), scale)
            gains.append(bundle.promised_gain(normal))
        return ready[int(np.argmax(gains))] if ready else None

    def losses(self, state: State, names: tuple[Unknown, ...]) -> F64 | None:
        """Compute the mean loss of every held-out frame; None if a fit is impossible."""
        parts = [self._fold(state, names, fold) for fold in self.folds]
        sound = [part for part in parts if part is not None]
        return np.concatenate(sound) if len(sound) == len(parts) else None

    def _fold(self, state: State, names: tuple[Unknown, ...], fold: I64) -> F64 | None:
        """Fit without the frames of a fold, then place these; their mean losses, px^2."""
        views, free, scale = self.views, self.free(names), CAUCHY * self.noise_px
        weights = views.weights.copy()
        weights[:, fold] = 0.0
        left = tuple(anchor for anchor in views.anchors if anchor.board not in set(fold.tolist()))
        fit = refine(state, replace(views, weights=weights, anchors=left), free, scale)
        if list_faults(fit.state, replace(views, weights=weights), self.problem.frame):
            return None
        placed = refine(fit.state, views, free, scale, moving="boards").state
        squares = np.sum(bundle.residuals(placed, views) ** 2, axis=-1)[:, fold]
        used = views.weights[:, fold] > 0.0
        loss = np.where(used, scale**2 * np.log1p(squares / scale**2), 0.0).sum(axis=(0, 2))
        unknowns = 6 if views.weights.shape[2] > 1 else 0
        return np.asarray(loss / np.maximum(2.0 * used.sum(axis=(0, 2)) - unknowns, 1.0))

    def compare(
        self, state: State, names: tuple[Unknown, ...], group: tuple[Unknown, ...], before: F64
    ) -> tuple[Nested, F64 | None]:
        """Fit with one more group, and compare the losses of held-out frames."""
        losses = self.losses(state, names)
        if losses is None or not np.isfinite(losses).all():
            return Nested(group, None, None, None, False, "the fit left the tank"), None
        gain = before - losses
        sigma = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        old, new = _px(before), _px(losses)
        sure = gain.mean() > _SURE * sigma and old - new > _LEAST_GAIN * old
        return Nested(group, new, new - old, sigma / (old + new), bool(sure)), losses
