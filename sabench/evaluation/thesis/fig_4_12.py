"""Figures 4-11 to 4-15: errors of the auto-calibration against noise.

They also vary with the initial guess; the thesis's alternation is compared with the joint
adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.algorithms.calibration.alternating import alternate
from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.evaluation.thesis.chapter_4 import (
    D_PIX,
    NOISES,
    STARTS,
    Board,
    board,
    point_errors,
    reprojection,
    solve_case,
    stds,
)
from sabench.evaluation.thesis.common import Item, Row, claim, make_row
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.utils.progress import progress_bar

SEEDS = 5
_CAMERAS = (3, 7, 13)
_BASELINE = 0.3
_SOLVERS = {"alternating": "refractive_autocal_alternating", "joint": "refractive_autocal"}
_MEAN, _STD = 0.33, 1.17  # largest mean and scatter with 7 cameras at 2 px, in D_PIX


@dataclass(frozen=True)
class Found:
    """Figures of one solver on one draw."""

    true_px: float
    measured_px: float
    errors_mm: np.ndarray[tuple[int, ...], np.dtype[np.float64]]


Draws = dict[tuple[str, float], list[Found]]  # of a solver and a start


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors per number of cameras and noise, over all initial guesses.

    The measured error is relative to the noise, the true error to the measured one.
    """
    panels = []
    for cameras in _CAMERAS:
        found = {}
        for noise in NOISES:
            found[noise] = _measure(cameras, noise, seeds)
            for name in _SOLVERS:
                yield from _noise_rows(cameras, noise, name, found[noise])
        if cameras == 7:
            yield from _point_rows(found[2.0])
            yield _points_figure(found)
        panels.append(_errors_panel(cameras, found))
    yield Figure("fig-4-12", "Figure 4-12: measured and true reprojection error", tuple(panels))
    yield from _rounds(seeds)


def _errors_panel(cameras: int, found: dict[float, Draws]) -> Panel:
    """Draw figure 4-12: errors against the imposed noise, by initial guess."""
    imposed = [noise * float(np.sqrt(np.pi / 2.0)) for noise in NOISES]
    joint = [
        np.mean([one.measured_px for start in STARTS for one in found[noise]["joint", start]])
        for noise in NOISES
    ]
    curves = [
        Curve("imposed", NOISES, imposed),
        Curve("measured, joint", NOISES, [float(value) for value in joint]),
    ]
    for name, starts in (("joint", (0.2,)), ("alternating", (0.001, 0.01, 0.1, 0.2))):
        for start in starts:
            true = [
                float(np.mean([one.true_px for one in found[noise][name, start]]))
                for noise in NOISES
            ]
            curves.append(Curve(f"true, {name}, start {start:g}", NOISES, true))
    return Panel(
        f"{cameras} cameras", "noise of a coordinate, px", "mean error, px", tuple(curves), "xy"
    )


def _points_figure(found: dict[float, Draws]) -> Figure:
    """Measure figures 4-14 and 4-15: errors along X, Y, Z by initial guess.

    There are 7 cameras; each error has a mean and a scatter.
    """
    upper, lower = [], []
    for noise, draws in found.items():
        means, scatters = [], []
        for name in _SOLVERS:
            errors = [[one.errors_mm for one in draws[name, start]] for start in STARTS]
            mean = np.array(
                [np.mean([np.abs(one.mean(axis=0)) for one in own], axis=0) for own in errors]
            )
            scatter = np.array([stds(own) for own in errors])
            means.append(Curve(f"Z, {name}", STARTS, mean[:, 2].tolist()))
            scatters += [
                Curve(f"{axis}, {name}", STARTS, scatter[:, number].tolist())
                for number, axis in enumerate("XYZ")
            ]
        upper.append(Panel(f"{noise:g} px: mean along Z", "start", "mm", tuple(means), "xy"))
        lower.append(Panel(f"{noise:g} px: scatter", "start", "mm", tuple(scatters), "xy"))
    return Figure(
        "fig-4-14", "Figures 4-14 and 4-15: errors of the points, 7 cameras", (*upper, *lower)
    )


def _measure(cameras: int, noise: float, seeds: Sequence[int]) -> Draws:
    found: Draws = {}
    steps = [(start, seed) for start in STARTS for seed in seeds]
    for start, seed in progress_bar(steps, f"{cameras} cameras, {noise:g} px"):
        given = board(cameras, _BASELINE, noise, start, seed)
        for name, solver in _SOLVERS.items():
            answer = solve_case(solver, given)
            found.setdefault((name, start), []).append(
                Found(*reprojection(answer, given), point_errors(answer, given))
            )
    return found


def _noise_rows(cameras: int, noise: float, name: str, found: Draws) -> Iterator[Row]:
    every = [one for (own, _), draws in found.items() if own == name for one in draws]
    head = f"{cameras} cameras, {noise:g} px, {name}"
    imposed = noise * float(np.sqrt(np.pi / 2.0))
    yield make_row(
        f"{head}: mean measured error, px",
        imposed,
        [one.measured_px for one in every],
        "thesis: equal to the imposed error",
        "smaller",
    )
    ratios = [one.true_px / one.measured_px for one in every]
    by_start = ", ".join(
        f"{start:g}: {np.mean([one.true_px for one in found[name, start]]):.3g}" for start in STARTS
    )
    yield claim(
        f"{head}: true / measured",
        "about 10 %",
        float(np.mean(ratios)),
        0.05 <= float(np.mean(ratios)) <= 0.15,
        f"true px by start: {by_start}",
    )


def _point_rows(found: Draws) -> Iterator[Row]:
    """Measure the last row of figures 4-14 and 4-15: 7 cameras, 2 px."""
    for name in _SOLVERS:
        every = [one.errors_mm for (own, _), draws in found.items() if own == name for one in draws]
        scatter = stds(every) / D_PIX
        means = np.abs([errors.mean(axis=0) for errors in every]).max(axis=0) / D_PIX
        note = f"X, Y, Z: {', '.join(f'{value:.3g}' for value in scatter)}"
        yield make_row(
            f"7 cameras, 2 px, {name}: scatter along Z, pixels of the middle",
            _STD,
            [float(scatter[2])],
            note,
            "smaller",
        )
        yield make_row(
            f"7 cameras, 2 px, {name}: largest mean along Z, the same unit",
            _MEAN,
            [float(means[2])],
            "one point known to 0.05 mm",
            "smaller",
        )
        yield claim(
            f"7 cameras, 2 px, {name}: the error is largest along Z",
            "yes",
            float(scatter[2] / scatter[:2].max()),
            bool(scatter[2] > scatter[:2].max()),
        )


def _rounds(seeds: Sequence[int]) -> Iterator[Item]:
    """Draw figure 4-11: rounds of the alternation with 7 cameras at 0.5 px."""
    curves = []
    for start in STARTS:
        errors = [_alternate(board(7, _BASELINE, 0.5, start, seed)) for seed in seeds]
        before, after = (np.mean([own[end] for own in errors]) for end in (0, -1))
        note = f"largest mean error {before:.3g} px before, {after:.3g} px after"
        yield make_row(
            f"rounds of the alternation, 7 cameras, 0.5 px, start {start:g}",
            None,
            [float(len(own) - 1) for own in errors],
            note,
        )
        curves.append(Curve(f"start {start:g}", range(len(errors[0])), errors[0]))
    panel = Panel(
        "7 cameras, 0.5 px, first seed",
        "round",
        "largest mean error of a camera, px",
        tuple(curves),
        "y",
    )
    yield Figure("fig-4-11", "Figure 4-11: convergence of the alternation", (panel,))


def _alternate(given: Board) -> tuple[float, ...]:
    problem = CalibrationProblem.from_case(given.case, FreeParameters())
    return alternate(problem.start, problem.seen, FreeParameters(), 0.001, 1000).errors_px
